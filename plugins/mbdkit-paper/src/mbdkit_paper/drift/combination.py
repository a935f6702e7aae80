"""Results of the study `drift` for one combination of method, formulation and stabilization on one mechanism."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mbdkit_report import Cell, Trend, observed_order
from mbdkit_studies import STEP, Points, Study, StudyPoint, family

COMBINATION = "method"  #: Axis of the combinations.
#: Suffix of the family of long runs, after the name of the family of short runs of the same mechanism.
LONG = "-long"
#: Error level below which round-off makes an order indeterminable.
#:
#: It is relative to the size of the mechanism for positions, to this size per second for velocities, and to the largest
#: multiplier for multipliers.
ROUND_OFF = 1e-12
#: Round-off level of errors is assumed to be at least this, in the same relative units; close to double precision.
EPSILON = 5e-16
#: Slopes at neighbouring steps agree if they differ by at most this; the stricter tolerance is tried first.
CLOSE = (0.1, 0.25)
#: Largest logarithm of the ratio of neighbouring steps; a larger one means that a run between them failed.
NEIGHBOURS = math.log(2.5)
SPENT = 1e-12  #: Change of energy over a run that counts as round-off, relative to the largest kinetic energy.

#: Reason why a number is missing, for example `failed`, `not installed`, `round-off` or `not reversible`.
Undetermined = str


@dataclass(frozen=True)
class Combination:
    """Results for a method with its formulation and stabilization on one mechanism.

    Each result is a number, or the reason why there is none.

    Attributes
    ----------
    mechanism, method
        Family of the study, and label on the axis `method`.
    position_order, velocity_order, multiplier_order
        Observed orders of the errors against the reference.
    own
        Whether the method computes the multipliers; otherwise they are the index-1 multipliers at its states.
    position_drift, velocity_drift
        Largest misalignment over all steps, and largest velocity misalignment in the recorded rows, of the long run,
        relative to the size of the mechanism [1, 1/s].
    trend, trend_error
        Slope of the energy balance of the long run and its standard error, relative to the largest kinetic energy
        [1/s]; `none` if the slope cannot be distinguished from oscillation or round-off.
    oscillation
        Largest distance of the energy balance from its trend line, relative to the largest kinetic energy.
    reversal
        Distance from the start after the long run and its reversal, relative to the size of the mechanism.
    evaluations, factorizations, microseconds
        Cost per step of the long run.
    errors
        Errors of positions by step [s], relative to the size of the mechanism.
    """

    mechanism: str
    method: str
    position_order: float | Undetermined
    velocity_order: float | Undetermined
    multiplier_order: float | Undetermined
    own: bool
    position_drift: float | Undetermined
    velocity_drift: float | Undetermined
    trend: float | Undetermined
    trend_error: float
    oscillation: float | Undetermined
    reversal: float | Undetermined
    evaluations: float | Undetermined
    factorizations: float | Undetermined
    microseconds: float | Undetermined
    errors: dict[float, float]

    @property
    def has_trend(self) -> bool | None:
        """Whether the energy has a trend; None if unknown."""
        return None if isinstance(self.trend, str) and self.trend != "none" else self.trend != "none"

    def cells(self) -> tuple[Cell, ...]:
        """Return the row of the table, without mechanism and method."""
        orders = [self.position_order, self.velocity_order, self.multiplier_order]
        known = not isinstance(self.multiplier_order, str)
        sure = abs(self.trend) / self.trend_error if not isinstance(self.trend, str) and self.trend_error else None
        drift = (self.position_drift, self.velocity_drift, self.trend, sure, self.oscillation, self.reversal)
        costs = (self.evaluations, self.factorizations, self.microseconds)
        source = ("own" if self.own else "index-1") if known else None
        shown = (order if isinstance(order, str) else f"{order:.2f}" for order in orders)
        return (*shown, source, *map(two, (*drift, *costs)))


def two(value: float | Undetermined | None) -> Cell:
    """Return a float rounded to two significant digits, and any other value unchanged."""
    return float(f"{value:.2g}") if isinstance(value, float) else value


def combinations(study: Study) -> list[Combination]:
    """Return the results for each combination on each mechanism, in the order of the study.

    Parameters
    ----------
    study
        A study with pairs of families: NAME over the axes `method` and `time.step`, and NAME-long over `method`.

    Raises
    ------
    ValueError
        If there is no such pair of families.
    """
    names = [name for name in study.families if f"{name}{LONG}" in study.families]
    if not names:
        raise ValueError(f"the study needs pairs of families NAME and NAME{LONG}, but has none")
    found = []
    for name in names:
        short, long = family(study, name), family(study, f"{name}{LONG}")
        for method in dict.fromkeys((*short.labels(COMBINATION), *long.labels(COMBINATION))):
            at = {COMBINATION: method}
            found.append(_combination(name, str(method), short.at(at), long.at(at)))
    return found


def _combination(mechanism: str, method: str, short: Points, long: Points) -> Combination:
    size, scale = (_largest(long, column) for column in ("mechanism_size", "energy_scale"))
    size = _largest(short, "mechanism_size") if math.isnan(size) else size
    steps, errors = short.along(STEP, "trajectory_error")
    slope, error, oscillation = (_number(long, f"energy_{name}") for name in ("trend", "trend_error", "oscillation"))
    defect = _number(long, "reversibility_defect")
    number = _number(long, "steps")

    def share(value: float | Undetermined, of: float) -> float | Undetermined:
        return value if isinstance(value, str) else value / of if of > 0 else "no scale"

    def a_step(column: str, factor: float = 1.0) -> float | Undetermined:
        value = _number(long, column)
        return value if isinstance(value, str) else share(factor * value, number if isinstance(number, float) else 0.0)

    return Combination(
        mechanism=mechanism,
        method=method,
        position_order=_order(short, "trajectory_error", size),
        velocity_order=_order(short, "velocity_error", size),
        multiplier_order=_order(short, "multiplier_error", 1.0),
        own=_largest(short, "own_multipliers") == 1,
        position_drift=share(_number(long, "misalignment_max"), size),
        velocity_drift=share(_number(long, "velocity_misalignment_max"), size),
        trend=_trend(slope, error, scale, _largest(long, "duration")),
        trend_error=error / scale if isinstance(error, float) and scale > 0 else math.nan,
        oscillation=share(oscillation, scale),
        reversal=share(_why_not_reversed(long) if defect == "no value" else defect, size),
        evaluations=a_step("rhs_evaluations"),
        factorizations=a_step("factorizations"),
        microseconds=a_step("wall_s", 1e6),
        errors={float(step): float(error) / size for step, error in zip(steps, errors, strict=True) if size > 0},
    )


def state_of(points: Iterable[StudyPoint]) -> Undetermined:
    """Return the reason why points have no values; empty if any of them is complete."""
    states = {point.status for point in points}
    for status, told in (("complete", ""), ("failed", "failed"), ("left-out", "not installed")):
        if status in states:
            return told
    return "missing"


def _largest(points: Points, column: str) -> float:
    numbers = [point.values.get(column, math.nan) for point in points if point.status == "complete"]
    return max((number for number in numbers if math.isfinite(number)), default=math.nan)


def _number(points: Points, column: str) -> float | Undetermined:
    if state := state_of(points):
        return state
    found = points.value(column)
    return found if math.isfinite(found) else "no value"


def _order(points: Points, column: str, scale: float) -> float | Undetermined:
    if state := state_of(points):
        return state
    steps, errors = points.along(STEP, column)
    if not len(steps):
        return "adaptive"
    floor = max(observed_order(steps, errors).floor, EPSILON * scale)
    for agree in CLOSE:
        if not math.isnan(found := _finest(steps, errors, floor, agree)):
            return found
    finite = errors[np.isfinite(errors)]
    if len(finite) and np.min(finite) <= ROUND_OFF * scale:
        return "round-off"
    return "no order" if len(finite) >= 3 else "failed"


def _finest(steps: np.ndarray, errors: np.ndarray, floor: float, agree: float) -> float:
    """Return the order at the three finest neighbouring steps with agreeing slopes above the floor; nan if none.

    `observed_order` would choose the longest window. If a method has different orders for different variables, that
    window may lie at steps where the error of another variable dominates. The finest window is closest to the limit of
    small steps.
    """
    known = np.isfinite(errors)
    steps, errors = steps[known], errors[known]
    for first in range(len(steps) - 2):  # finest first: `along` returns ascending steps
        window = slice(first, first + 3)
        found = observed_order(steps[window], errors[window], floor=floor, agree=agree)
        if found.found and np.all(np.diff(np.log(steps[window])) <= NEIGHBOURS):
            return found.order
    return math.nan


def _trend(
    slope: float | Undetermined, error: float | Undetermined, scale: float, duration: float
) -> float | Undetermined:
    """Return the slope of energy relative to `scale`; `none` if it is not significant, or at round-off level."""
    if isinstance(slope, str) or isinstance(error, str):
        return str(slope)
    if not scale > 0:
        return "no scale"
    if abs(slope) <= Trend.SURE * error or abs(slope) * duration <= SPENT * scale:
        return "none"
    return slope / scale


def _why_not_reversed(points: Points) -> Undetermined:
    """Return the reason why a complete run has no reversibility defect."""
    note = next((point.second_run for point in points), "")
    code = note.partition(":")[0]
    return {"": "not made", "not-reversible": "not reversible", "too-short": "too short"}.get(code, "failed")
