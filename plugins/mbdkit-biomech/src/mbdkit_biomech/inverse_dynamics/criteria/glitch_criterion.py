"""Criterion of the verdict on measured loads: a load does not jump away and back within a few rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from mbdkit.base.text import counted, listed
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.criteria.doubt import doubt
from mbdkit_biomech.inverse_dynamics.loads.loads import LoadSeries, global_point

#: Residual forces and moments from which the balance is doubtful, and jumps of loads that are glitches.
#:
#: Forces are given as a share of the largest load or, if it is larger, the weight of the mechanism; moments as a share
#: of this force times the height of the mechanism. J. L. Hicks et al. (Journal of Biomechanical Engineering 137, 2015,
#: 020905) recommend at most 0.05 for peak forces, and 0.01 for the root mean square of moments.
FORCE, MOMENT = 0.05, 0.02

#: A glitch lasts for at most `LONGEST` rows. The load jumps at both ends, in opposite directions, by more than `JUMP`
#: times the largest change between two of the `AROUND` rows before and after it.
#:
#: A cutoff or a foot makes no such jumps: a load that changes fast enough changes fast in the neighbouring rows, too.
#: The impact of a foot may be shorter than a row, so that glitches are sought only where all neighbouring rows are
#: loaded. Gaussian noise gives such jumps once in some 1e9 rows.
LONGEST, AROUND, JUMP = 5, 5, 4.0

#: A row is loaded if the force exceeds this share of the force that a tenth of the rows with a load exceed.
LOADED = 0.1


def limits_of_balance(result: Inverse) -> tuple[float, float, np.ndarray]:
    """Return the largest load, the weight of the mechanism, and (3,) the limits for forces x, y and the moment."""
    mechanism = result.problem.names.mechanism
    load = float(np.max(np.linalg.norm(result.loads.force.sum(axis=1), axis=1), initial=0.0))
    weight = sum(body.mass for body in mechanism.bodies.values()) * float(np.linalg.norm(mechanism.gravity))
    height = max(result.problem.fitter.manifold.length, float(np.mean(np.ptp(result.motion.q[:, 1::3], axis=1))))
    return load, weight, np.array([FORCE, FORCE, MOMENT * height]) * max(load, weight)


def glitch_doubts(result: Inverse, name: str) -> Iterator[Finding]:
    """Yield a doubt if the force of a plate, or its moment about the body, jumps away and back within a few rows."""
    time, wrench = _wrench(result, result.problem.loads[name])
    size = np.linalg.norm(wrench[:, :2], axis=1)
    if len(time) <= 2 * AROUND or not np.any(size):
        return
    is_loaded = size > LOADED * np.quantile(size[size > 0], 0.9)
    limits = limits_of_balance(result)[2]
    glitches = [
        (first, length, jump, axis)
        for axis in range(3)
        for first, length, jump in _glitches(wrench[:, axis], is_loaded)
        if jump > limits[axis]
    ]
    if not glitches:
        return
    first, length, jump, axis = max(glitches, key=lambda glitch: glitch[2] / limits[glitch[3]])
    rows = np.zeros(len(time), dtype=bool)
    for start, count, _, _ in glitches:
        rows[start : start + count] = True
    what, unit = (("force along x", "N"), ("force along y", "N"), ("moment about its body", "N m"))[axis]
    yield doubt(
        "outliers",
        f"load '{name}' has glitches of at most {LONGEST} rows, {spans(time, rows)}. The largest one is in the "
        f"{what}, which jumps by {jump:.4g} {unit} at t = {time[first]:.6g} s and back after {counted(length, 'row')} "
        f"(doubtful above {limits[axis]:.3g} {unit} and {JUMP:g} times the changes in the rows around): a signal that "
        "was lost, or a spike of a force, point or torque.",
    )


def spans(time: np.ndarray, rows: np.ndarray) -> str:
    """Return the times of sequences of marked rows, (T,) or (T, ...), as text; at most four sequences."""
    marked = np.flatnonzero(np.any(rows.reshape(len(time), -1), axis=1))
    parts = [time[part] for part in np.split(marked, np.flatnonzero(np.diff(marked) > 1) + 1)]
    told = [f"{part[0]:.6g} s" if len(part) == 1 else f"{part[0]:.6g} to {part[-1]:.6g} s" for part in parts]
    more = [f"{len(told) - 4} more times"] if len(told) > 4 else []
    return f"at t = {listed([*told[:4], *more], 'and')}"


def _wrench(result: Inverse, series: LoadSeries) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows (R,) of a load within the motion, and (R, 3) its force and its moment about its body."""
    motion, body = result.motion, 3 * series.body
    rows = (series.time >= motion.time[0]) & (series.time <= motion.time[-1])
    q = np.column_stack([np.interp(series.time, motion.time, x) for x in motion.q.T])
    arm = global_point(series, series.time, q) - q[:, body : body + 2]
    moment = arm[:, 0] * series.force[:, 1] - arm[:, 1] * series.force[:, 0] + series.torque
    return series.time[rows], np.column_stack([series.force, moment])[rows]


def _glitches(x: np.ndarray, is_loaded: np.ndarray) -> Iterator[tuple[int, int, float]]:
    """Yield first row, number of rows and jump of each glitch of a column (R,); see `LONGEST`."""
    change = np.diff(x)
    largest = sliding_window_view(np.pad(np.abs(change), AROUND), AROUND).max(axis=1)  # of the changes before each one
    loaded = np.min(sliding_window_view(np.pad(is_loaded, AROUND, constant_values=True), AROUND), axis=1)
    for length in range(1, LONGEST + 1):
        first = np.arange(1, len(x) - length)
        last = first + length - 1
        away, back = change[first - 1], -change[last]
        jump = np.where(away * back > 0, np.minimum(np.abs(away), np.abs(back)), 0.0)
        around = np.maximum(largest[first - 1], largest[last + AROUND + 1])
        for index in np.flatnonzero((jump > JUMP * around) & loaded[first] & loaded[last + AROUND + 1]):
            yield int(first[index]), length, float(jump[index])
