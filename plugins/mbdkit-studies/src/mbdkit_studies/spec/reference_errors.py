"""Differences between a run and a reference run. The two may have recorded different times."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError

EVERY_ROW, LAST_ROW = slice(None), slice(-1, None)

#: Multipliers that a method computes itself, in addition to the index-1 multipliers at the recorded states.
METHOD_MULTIPLIER = "constraints/method_multiplier"


def offsets(run: Run, reference: Run, rows: slice = EVERY_ROW) -> np.ndarray:
    """Return the differences in the positions of the bodies between a run and a reference at the times of the run.

    Parameters
    ----------
    run, reference
        Runs with the same bodies; the reference covers the time span of the run.
    rows
        Recorded rows of the run to compare.

    Returns
    -------
    ndarray
        Differences of position and angle, (N, B, 3), m and rad.

    Raises
    ------
    MbdkitError
        If the bodies or the end times differ.
    """
    if list(run.bodies) != list(reference.bodies):
        raise MbdkitError(
            f"the reference has the bodies {', '.join(reference.bodies)}, but the run has {', '.join(run.bodies)}"
        )
    if abs(reference.time[-1] - run.time[-1]) > 1e-9 * abs(run.time[-1] - run.time[0]):
        raise MbdkitError(f"the reference ends at {reference.time[-1]:g} s, but the run at {run.time[-1]:g} s")
    return np.asarray(run.array("trajectory/position")[rows] - interpolated(reference, run.time[rows]))


def common_rows(run: Run, reference: Run) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows that a run and a reference over the same time span recorded at the same times, without the first
    row of the run: row numbers in the run and in the reference, (K,) each; empty if no times agree.
    """
    mine, theirs = run.time, reference.time
    near = np.clip(np.searchsorted(theirs, mine), 1, len(theirs) - 1)
    near = np.where(mine - theirs[near - 1] < theirs[near] - mine, near - 1, near)
    same = np.abs(theirs[near] - mine) <= 1e-9 * abs(mine[-1] - mine[0])
    same[0] = False
    return np.flatnonzero(same), near[same]


def multiplier_error(run: Run, reference: Run) -> float:
    """Return the relative error of the Lagrange multipliers of a run at the times that both runs recorded.

    If the run recorded multipliers of its method, these are compared, otherwise the index-1 multipliers at the
    recorded states. Of the reference, the index-1 multipliers are always used.

    Parameters
    ----------
    run, reference
        Runs of the same mechanism with recorded constraints.

    Returns
    -------
    float
        Largest error, relative to the largest multiplier of the same unit in the reference; nan if the runs have no
        common times after the start, inf if multipliers that are all zero in the reference are not zero in the run.
    """
    mine, theirs = common_rows(run, reference)
    if not len(mine):
        return math.nan
    result = run.array(METHOD_MULTIPLIER if run.records(METHOD_MULTIPLIER) else "constraints/multiplier")[mine]
    right = reference.array("constraints/multiplier")
    units = run.array("constraints/multiplier_row_units")
    worst = 0.0
    for unit in dict.fromkeys(units):
        chosen = units == unit
        scale = float(np.max(np.abs(right[:, chosen]), initial=0.0))
        off = float(np.max(np.abs(result[:, chosen] - right[theirs][:, chosen]), initial=0.0))
        if off > 0:
            worst = max(worst, off / scale if scale > 0 else math.inf)
    return worst


def interpolated(run: Run, time: np.ndarray) -> np.ndarray:
    """Return the positions of the bodies of a run, interpolated between its recorded rows.

    The interpolant is the Hermite polynomial of degree five through the positions, velocities and accelerations at both
    ends of each interval. Its error is of order six in the length of the interval, and zero at recorded rows.

    Parameters
    ----------
    time
        Times within the time span of the run, (N,), s.

    Returns
    -------
    ndarray
        Positions and angles of the bodies, (N, B, 3), m and rad.
    """
    rows = run.time
    left = np.clip(np.searchsorted(rows, time, side="right") - 1, 0, len(rows) - 2)
    span = rows[left + 1] - rows[left]
    u = np.clip((time - rows[left]) / span, 0.0, 1.0)
    u = np.where(np.abs(time - rows[left + 1]) <= 1e-9 * span, 1.0, u)
    w = 1.0 - u
    weights = (
        (w**3 * (1 + 3 * u + 6 * u**2), w**3 * (u + 3 * u**2), w**3 * u**2 / 2),
        (u**3 * (1 + 3 * w + 6 * w**2), -(u**3) * (w + 3 * w**2), u**3 * w**2 / 2),
    )
    motion = [run.array(f"trajectory/{name}") for name in ("position", "velocity", "acceleration")]
    powers = (np.ones_like(span), span, span**2)
    result = np.zeros((len(time), *motion[0].shape[1:]))
    for end, of_end in enumerate(weights):
        for values, weight, power in zip(motion, of_end, powers, strict=True):
            result += (weight * power)[:, None, None] * values[left + end]
    return result
