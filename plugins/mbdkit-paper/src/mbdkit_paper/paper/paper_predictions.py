"""Predictions of the paper: misalignment of the knee linkage with four joints, and growth with each joint."""

from __future__ import annotations

import math
from itertools import groupby

import numpy as np

from mbdkit.archive.run import Run
from mbdkit_paper.paper.published_results import GAUSS2, GAUSS3, PAPER_STEP, methods_of
from mbdkit_paper.wording import Words, least_most
from mbdkit_report import Answer, Band, Cell, Claim, Column, Figure, Line, Range, Table, together
from mbdkit_studies import METHOD, STEP, Study, family

PREDICTED = {GAUSS2: Range(1e-3, 1.0, "mm"), GAUSS3: Range(1e-7, 1e-4, "mm")}
PER_JOINT = Range(10.0, 100.0)
SPRING, FREE = "support spring", "no spring"
WORDS = Words(__file__)


def steps_within(steps: np.ndarray, values: np.ndarray, wanted: Range) -> tuple[float, float]:
    """Return the longest interval of steps in which all values lie in a range, interpolated in logarithms.

    Parameters
    ----------
    steps
        (K,) ascending steps [s].
    values
        (K,) misalignments; values that are not finite count as outside.

    Returns
    -------
    float, float
        Lower and upper end of the interval; the first or last step if the values do not leave the range before it. Both
        are nan if no value lies in the range.
    """
    inside = np.isfinite(values) & (values >= wanted.low) & (values <= wanted.high)
    groups = [list(group) for is_inside, group in groupby(range(len(steps)), inside.__getitem__) if is_inside]
    if not groups:
        return math.nan, math.nan
    longest = max(groups, key=len)
    first, last = longest[0], longest[-1]
    return _crossing(steps, values, first, first - 1, wanted), _crossing(steps, values, last, last + 1, wanted)


def _crossing(steps: np.ndarray, values: np.ndarray, inner: int, outer: int, wanted: Range) -> float:
    """Return the step at which the values leave a range, between a step inside and its neighbour outside.

    Without a positive value at the neighbour, the step inside is returned.
    """
    if not 0 <= outer < len(steps) or not math.isfinite(values[outer]) or values[outer] <= 0:
        return float(steps[inner])
    border = wanted.low if values[outer] < wanted.low else wanted.high
    share = math.log(border / values[inner]) / math.log(values[outer] / values[inner])
    return math.exp(math.log(steps[inner]) + share * math.log(steps[outer] / steps[inner]))


def knee(study: Study) -> tuple[tuple[Claim, ...], Table, Figure]:
    """Test the predictions for the knee linkage over a range of steps."""
    points = family(study, "knee")
    methods = methods_of(points)
    rows: list[tuple[Cell, ...]] = []
    spans: dict[tuple[str, str], tuple[float, float]] = {}
    curves: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]] = {}
    for springs in (SPRING, FREE):
        for method in methods:
            steps, values = points.at({METHOD: method, "model.springs": springs}).along(STEP, "misalignment_max")
            curves[springs, method] = steps, 1e3 * values
            if method in PREDICTED:
                spans[springs, method] = steps_within(steps, 1e3 * values, PREDICTED[method])
        for k, step in enumerate(curves[springs, GAUSS2][0]):
            found = {method: float(curves[springs, method][1][k]) for method in methods}
            held = [str(wanted.holds(found[method])) for method, wanted in PREDICTED.items()]
            rows.append((springs, float(step), *found.values(), *held))
    period = swing(study)
    claims = [_knee_claim(method, curves, spans, period) for method in PREDICTED]
    claims.append(_both_claim(spans))
    columns = (Column("knee"), Column("step", "s"), *(Column(method, "mm") for method in methods))
    columns += tuple(Column(f"{method} as predicted") for method in PREDICTED)
    lines = [
        Line(f"{method}, {springs}", *curves[springs, method], "both", method)
        for springs in (SPRING, FREE)
        for method in methods
    ]
    bands = [Band(f"predicted, {method}", wanted.low, wanted.high) for method, wanted in PREDICTED.items()]
    table = WORDS.table("knee-prediction", rows, columns)
    return tuple(claims), table, WORDS.figure("knee-prediction", lines, bands=bands)


def _knee_claim(
    method: str,
    curves: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]],
    spans: dict[tuple[str, str], tuple[float, float]],
    period: float,
) -> Claim:
    wanted = PREDICTED[method]
    steps, values = curves[SPRING, method]
    low, high = spans[SPRING, method]
    at = _interpolated(steps, values, PAPER_STEP)
    there = wanted.holds(at)
    answer = Answer.OPEN if not len(steps) or np.all(np.isnan(values)) else Answer.PARTLY
    if answer is Answer.PARTLY and math.isnan(low):
        answer = Answer.NO
    at_paper = {Answer.YES: "inside the range", Answer.NO: "outside it"}.get(there, "at its limit")
    resolved = ""
    if math.isfinite(period):
        fine = period / PER_SWING
        expected = _interpolated(steps, values, fine)
        resolved = (
            f" With {PER_SWING} steps per swing (h = {fine:.2g} s), as for the paper's pendulum, the misalignment of "
            f"the knee is {expected:.0e} mm."
        )
    name = "knee-" + method.lower().replace(" ", "")
    free = _span(*spans[FREE, method])
    words = {"wanted": wanted, "method": method, "at": at, "span": _span(low, high), "free": free}
    return WORDS.claim("knee", answer, name, inside=at_paper, resolved=resolved, **words)


def _both_claim(spans: dict[tuple[str, str], tuple[float, float]]) -> Claim:
    common = []
    for springs in (SPRING, FREE):
        low = max(spans[springs, method][0] for method in PREDICTED)
        high = min(spans[springs, method][1] for method in PREDICTED)
        common.append((low, high) if low < high else (math.nan, math.nan))
    found = math.isfinite(common[0][0])
    known = all(math.isfinite(end) for end in (*spans[SPRING, GAUSS2], *spans[SPRING, GAUSS3]))
    answer = (Answer.PARTLY if found else Answer.NO) if known else Answer.OPEN
    span, free = (_span(*ends) for ends in common)
    computed = f"both hold for steps of {span}" if found else "at no step do both hold"
    return WORDS.claim("knee-both", answer, computed=computed, span=span, free=free)


def _span(low: float, high: float) -> str:
    return "no length" if math.isnan(low) else f"{low:.2g} to {high:.2g} s"


def _interpolated(steps: np.ndarray, values: np.ndarray, step: float) -> float:
    keep = np.isfinite(values) & (values > 0)
    if not np.any(keep) or not steps[keep][0] <= step <= steps[keep][-1]:
        return math.nan
    return float(np.exp(np.interp(math.log(step), np.log(steps[keep]), np.log(values[keep]))))


#: Number of steps of 0.1 s in a swing (a period) of the paper's single pendulum: 7.5 s with the assumed parameters.
PER_SWING = 75


def swing(study: Study) -> float:
    """Return the period of the knee without a spring [s]; nan if the required run is missing."""
    for point in family(study, "knee").at({METHOD: GAUSS3, "model.springs": FREE, STEP: 0.025}):
        run = study.run(point)
        if run is not None:
            with run:
                return _period(run)
    return math.nan


def _period(run: Run) -> float:
    """Return twice the time between the first two reversals of the shank after the start."""
    rate, time = run["shank"].angular_velocity, run.time
    turns = np.flatnonzero(rate[1:-1] * rate[2:] < 0) + 1
    if len(turns) < 2:
        return math.nan
    at = time[turns] + (time[turns + 1] - time[turns]) * rate[turns] / (rate[turns] - rate[turns + 1])
    return 2 * float(at[1] - at[0])


def joints(study: Study) -> tuple[Claim, Table, Figure]:
    """Test on chains the claim that misalignment grows by a factor of 10 to 100 with each further joint."""
    points = family(study, "joints")
    steps = [float(step) for step in points.labels(STEP)]
    curves = {
        (method, step): points.at({METHOD: method, STEP: step}).along("model.n", "misalignment_max")
        for method in methods_of(points)
        for step in steps
    }
    factors = {key: values[1:] / values[:-1] for key, (_, values) in curves.items()}
    claimed = {key: found for key, found in factors.items() if key[0] in PREDICTED}
    answers = [PER_JOINT.holds(float(factor)) for found in claimed.values() for factor in found]
    first = [float(found[0]) for found in claimed.values() if len(found)]
    later = [float(factor) for found in claimed.values() for factor in found[1:] if math.isfinite(factor)]
    rows: list[tuple[Cell, ...]] = []
    for (method, step), (numbers, values) in curves.items():
        for k, number in enumerate(numbers):
            factor = float(factors[method, step][k - 1]) if k else None
            rows.append((method, step, int(number), float(values[k]), factor))
    beyond = sum(answer is Answer.YES for key, found in claimed.items() for answer in map(PER_JOINT.holds, found[1:]))
    answer = together(answers)
    words = {
        "first": least_most(first),
        "later": least_most(later),
        "count": len(later),
        "grows": "grows" if answer is Answer.YES else "does not grow",
        "beyond": beyond or "none",
        "be": "is" if beyond == 1 else "are",
    }
    lines = [
        Line(f"{method}, h = {step:g} s", numbers, largest, "both", method)
        for (method, step), (numbers, largest) in curves.items()
        if len(numbers)
    ]
    claim = WORDS.claim("per-joint", answer, **words)
    return claim, WORDS.table("joints-chain", rows), WORDS.figure("joints-chain", lines)
