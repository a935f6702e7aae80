"""Errors of the largest recorded forces and torques: errors of the method, and peaks missed between recorded rows.

The missed part of a peak may be arbitrarily large. Checked runs therefore determine the largest values during the run,
between rows as well, as measures do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from keyword import iskeyword
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.archive.measured_values import ComparedMeasures, Integrals
from mbdkit.quantities.registered_kinds import mode_arrays
from mbdkit.trust.measure_error import measure_error

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

#: Safety factors for interpolated peaks: for a parabola through three rows, and for a cubic spline through all rows.
#:
#: Each factor multiplies the height by which the interpolation exceeds the rows. For random sums of three sines, the
#: larger of the two heights covers the true peak in 93 % of the cases with 4 rows per period of the highest frequency,
#: in 99 % with 6, and in all cases with 10.
PARABOLA, SPLINE = 2.0, 1.5

NEGLIGIBLE = 1e-5  #: Share of the largest value up to which a part of it that rows miss is not told.

#: Error of the part of a peak that the ends of steps miss, as a share of this part.
#:
#: It adds to the largest error of the method in the rows, because forces between the ends of coarse steps may have
#: larger errors than at these ends. In 14 packaged examples with 10 to 20 times their steps, the sum covers all of 66
#: loads with a share of 0.5, and 50 without any.
BETWEEN = 1.0


def expression_of_largest(quantity: str, name: str) -> str:
    """Return the expression of the largest value of a quantity of the element `name`, as measures usually have it.

    The quantity is one of magnitudes, such as ``joints.force``, or a negative one after a minus sign. A measure with
    this expression and the largest load of a checked run are then one functional.
    """
    kind, attribute = quantity.removeprefix("-").split(".")
    is_plain = name.isidentifier() and name.isascii() and not iskeyword(name)
    value = f"{kind}.{name}.{attribute}" if is_plain else f"{kind}[{name!r}].{attribute}"
    return f"max(-{value})" if quantity.startswith("-") else f"max(abs({value}))"


def missed_by_rows(
    integrals: Integrals, quantity: str, names: Sequence[str], size: np.ndarray, *, skips_steps: bool
) -> np.ndarray | None:
    """Return by how much the largest values during a run exceed those in its rows, (E,); nan where unknown.

    The result is None if every step is recorded and a value is unknown.

    `integrals`: integrals and extrema of the run. Those of checked runs contain the largest values; see
    `mbdkit.runs.integrals.largest_loads_of`. `quantity`, `names`: quantity as in `expression_of_largest`, and names of
    the elements. `size`: (T, E) values in all rows. `skips_steps`: whether rows may skip ends of steps.
    """
    other = {"joints.force": "joints.torque", "joints.torque": "joints.force"}.get(quantity, quantity)
    # loads that are always zero, such as the torque of a pin, are left out of the largest values
    unknown = [0.0 if expression_of_largest(other, name) in integrals else np.nan for name in names]
    texts = [expression_of_largest(quantity, name) for name in names]
    largest = [integrals.get(text, value) for text, value in zip(texts, unknown, strict=True)]
    missed = np.maximum(np.array(largest, dtype=float) - np.max(size, axis=0), 0.0)
    return None if not skips_steps and np.any(np.isnan(missed)) else np.asarray(missed)


def errors_of_largest(
    integrals: Integrals, compared: ComparedMeasures, quantity: str, names: Sequence[str]
) -> np.ndarray:
    """Return the errors (E,) of the largest values of a quantity of elements during a run, nan where unknown.

    They are estimated like those of measures, from the comparison runs of the check; see
    `mbdkit.runs.integrals.compared_loads`.
    """
    texts = [expression_of_largest(quantity, name) for name in names]
    known = {text: float(integrals[text]) for text in texts if text in compared and text in integrals}  # type: ignore[arg-type]
    return np.array([measure_error(known[text], compared[text]) if text in known else np.nan for text in texts])


def missed_of_verdict(
    missed: np.ndarray | None, names: Sequence[str], measures: Mapping[str, object]
) -> np.ndarray | None:
    """Return the forces (J,) that the rows of a run miss, as they count in its verdict.

    They do not count for joints whose largest force is a measure, because the run states it with its own error.
    """
    own = measures_of_largest(measures, "joints.force", names)
    return None if missed is None else np.where([name in own for name in names], 0.0, missed)


def skips_steps(spec: Mapping[str, Any]) -> bool:
    """Return whether the rows of runs of a spec may skip ends of steps."""
    output = spec.get("output") or {}
    return output.get("interval") is not None or (output.get("every") or 1) > 1


def jumps(run: Run) -> np.ndarray:
    """Return the times (B,) at which forces may be discontinuous [s].

    These are the times of impacts, of events that set states, and of changes of the mode of an element. A mode is
    assumed to change halfway between two rows.
    """
    named = [name for name, event in (run.spec.get("events") or {}).items() if event.get("set")]
    times = [run.impacts.time, *(run.events.of_name(name).time for name in named)]
    for path in mode_arrays():
        if run.records(path):
            changed = np.flatnonzero(np.any(np.diff(run.array(path), axis=0), axis=1))
            times.append(0.5 * (run.time[changed] + run.time[changed + 1]))
    return np.unique(np.concatenate(times))


def measures_of_largest(measures: Mapping[str, object], quantity: str, names: Sequence[str]) -> dict[str, str]:
    """Return the measures of the largest magnitude of a quantity, such as ``joints.force``, by name of the element.

    `measures`: the section `measures` of a spec. `quantity`: quantity of joints or actuators. `names`: names of the
    elements.
    """
    kind, attribute = quantity.split(".")
    spelled = {
        "".join(f"max(abs({kind}{element}.{attribute}))".split()): name
        for name in names
        for element in (f".{name}", f"[{name!r}]", f'["{name}"]')
    }
    texts = {
        measure: "".join(str(defined.get("value") if isinstance(defined, Mapping) else defined).split())
        for measure, defined in measures.items()
    }
    return {spelled[text]: measure for measure, text in texts.items() if text in spelled}


def excess_between_rows(time: np.ndarray, size: np.ndarray, jumps: Sequence[float] | np.ndarray = ()) -> np.ndarray:
    """Return by how much the largest values (J,) of continuous curves may exceed the largest values in the rows.

    `time`: (T,) times of the rows [s]. `size`: (T, J) values of the curves. `jumps`: (B,) increasing times at which the
    curves may be discontinuous [s]. The curves on both sides of such a time are extrapolated to it by parabolas.
    """
    recorded: np.ndarray = np.max(size, axis=0)
    above = recorded
    firsts = np.searchsorted(time, jumps)
    begin, start = 0, None
    for first, jump in [*zip(firsts, jumps, strict=True), (len(time), None)]:
        rows = slice(begin, first)
        above = np.maximum(above, _above_rows(time[rows], size[rows], recorded, [start, jump]))
        begin, start = first, jump
    return np.asarray(above - recorded)


def is_resolved(time: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return of which curves (E,) the rows, all ends of steps, show the largest values: parabolas through three rows
    exceed them by no more than a share of `NEGLIGIBLE`. Arguments as in `excess_between_rows`.
    """
    if len(time) < 3:
        return np.zeros(size.shape[1], bool)
    largest = np.max(size, axis=0)
    with np.errstate(all="ignore"):  # of a motion that flew apart
        return np.asarray(_above_parabolas(time, size) - largest <= NEGLIGIBLE * largest)


def _above_rows(time: np.ndarray, size: np.ndarray, recorded: np.ndarray, ends: Sequence[float | None]) -> np.ndarray:
    """Return estimated upper bounds (J,) of continuous curves between the rows, and up to `ends` that are not None."""
    from scipy.interpolate import BarycentricInterpolator  # runs import this module, but rarely need SciPy's

    if len(time) < 2:
        return recorded
    above = [recorded]
    if len(time) > 2:
        above.append(recorded + PARABOLA * (_above_parabolas(time, size) - recorded))
        if np.all(np.diff(time) > 0) and np.all(np.isfinite(size)):
            above.append(recorded + SPLINE * (_above_spline(time, size) - recorded))
    for end, last in zip(ends, (slice(None, 3), slice(-3, None)), strict=True):
        if end is not None:
            reached = BarycentricInterpolator(time[last], size[last])(end)
            above.append(recorded + PARABOLA * (reached - recorded))
    return np.asarray(np.max(above, axis=0))


def _above_parabolas(time: np.ndarray, size: np.ndarray) -> np.ndarray:
    left, right = np.diff(time)[:-1, None], np.diff(time)[1:, None]
    with np.errstate(all="ignore"):
        before, after = np.diff(size, axis=0)[:-1] / left, np.diff(size, axis=0)[1:] / right
        curvature = (after - before) / (left + right)
        slope = (before * right + after * left) / (left + right)  # slope in the middle row
        vertex = -0.5 * slope / curvature
        height = size[1:-1] - 0.25 * slope**2 / curvature
    is_between = (curvature < 0) & (vertex > -left) & (vertex < right)  # false for nan, and for rows at equal times
    return np.asarray(np.max(np.where(is_between, height, size[1:-1]), axis=0))


def _above_spline(time: np.ndarray, size: np.ndarray) -> np.ndarray:
    from scipy.interpolate import CubicSpline

    a, b, c, d = CubicSpline(time, size).c
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b**2 - 3.0 * a * c)
        stationary = -c / (b + np.where(b < 0, -root, root)), -(b + np.where(b < 0, -root, root)) / (3.0 * a)
        inside = [np.where((x > 0) & (x < np.diff(time)[:, None]), x, 0.0) for x in stationary]
    return np.asarray(np.max([d + x * (c + x * (b + x * a)) for x in inside], axis=(0, 1)))
