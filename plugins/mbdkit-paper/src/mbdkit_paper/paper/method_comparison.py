"""Comparisons beyond the paper: orders, growth laws, adaptive steps, more stages, work, precision and drift."""

from __future__ import annotations

import math

import numpy as np

from mbdkit_paper.paper.published_results import GAUSS2, GAUSS3, GILL
from mbdkit_paper.wording import Words, least_most
from mbdkit_report import (
    Answer,
    Cell,
    Claim,
    Figure,
    Line,
    Range,
    Table,
    growth_law,
    observed_order,
    together,
    worst_history,
)
from mbdkit_studies import METHOD, MODEL, STEP, Points, Study, at_equal_work, family, value, work_for

ORDERS = {GILL: 4, GAUSS2: 4, GAUSS3: 6}
TOLERANCE = 0.2
ADAPTIVE, RADAU3 = "SciPy Radau, adaptive", "Radau IIA 3"
EVALUATIONS, ERROR, DRIFT = "rhs_evaluations", "end_error", "misalignment_max"
WORDS = Words(__file__)


def orders(study: Study) -> tuple[Claim, Table]:
    """Compare the observed orders with the theoretical ones."""
    rows: list[tuple[Cell, ...]] = []
    answers, found = [], []
    for model, name in (("single", "steps"), ("double", "precision")):
        points = family(study, name)
        for method in points.labels(METHOD):
            steps, errors = points.at({METHOD: method}).along(STEP, ERROR)
            if not len(steps):  # an added method with tolerances in place of steps
                continue
            seen = observed_order(steps, errors)
            apart = observed_order(steps, points.at({METHOD: method}).along(STEP, DRIFT)[1])
            expected = ORDERS.get(str(method))
            span = f"{seen.steps[-1]:.2g} to {seen.steps[0]:.2g} s" if seen.found else ""
            rows.append((model, method, expected, seen.order, seen.error, span, seen.floor, apart.order))
            if expected is not None:
                is_near = abs(seen.order - expected) <= TOLERANCE
                answers.append((Answer.YES if is_near else Answer.NO) if seen.found else Answer.OPEN)
                found.append(f"{seen.order:.2f} ({model} pendulum, {method})")
    near = sum(answer is Answer.YES for answer in answers)
    values = {"computed": ", ".join(found), "near": near, "count": len(answers), "tolerance": TOLERANCE}
    return WORDS.claim("orders", together(answers), **values), WORDS.table("order", rows)


def growth(study: Study) -> tuple[Claim, Table]:
    """Determine the growth laws of misalignment over the first tenth of a long run, and over all of it."""
    rows: list[tuple[Cell, ...]] = []
    laws: dict[tuple[str, str, int], str] = {}
    for point in family(study, "long"):
        run = study.run(point)
        if run is None or point.status != "complete":
            continue
        with run:
            time, history = run.time, worst_history(run)
        model, method = str(point.axes[MODEL]), str(point.axes[METHOD])
        for share in (10, 1):
            last = np.searchsorted(time, time[-1] / share * (1 + 1e-9))
            law = growth_law(time[:last], history[:last])
            laws[model, method, share] = " or ".join(law.candidates)
            duration, largest = float(time[last - 1]), float(history[:last].max())
            rows.append((model, method, duration, laws[model, method, share], law.exponent, largest))
    gill = [law for (_, method, share), law in laws.items() if method == GILL and share == 1]
    single = [laws.get(("single", method, 10), "") for method in (GAUSS2, GAUSS3)]
    answers = [Answer.YES if law == "quadratic" else Answer.NO for law in gill]
    answers += [Answer.YES if law == "bounded" else Answer.NO for law in single if law]
    late = laws.get(("single", GAUSS2, 1), "unknown")
    radau = " and ".join(dict.fromkeys(law for (_, method, _), law in laws.items() if method == RADAU3)) or "unknown"
    gill_text, single_text = (" and ".join(dict.fromkeys(found)) or "unknown" for found in (gill, single))
    answer = together(answers) if laws else Answer.OPEN
    answer = Answer.PARTLY if late == "quadratic" and answer is Answer.YES else answer
    claim = WORDS.claim("growth", answer, gill=gill_text, single=single_text, late=late, radau=radau)
    return claim, WORDS.table("growth", rows)


def work(study: Study) -> tuple[tuple[Claim, ...], Table, tuple[Figure, ...]]:
    """Return claims on adaptive steps and more stages, and figures of precision and drift against work."""
    precision, adaptive = family(study, "precision"), family(study, "adaptive")
    lines = {str(method): precision.at({METHOD: method}) for method in precision.labels(METHOD)}
    if len(adaptive):
        lines[ADAPTIVE] = adaptive
    rows: list[tuple[Cell, ...]] = []
    for method, points in lines.items():
        for point in points:
            setting = point.axes.get(STEP, point.axes.get("integrator.rtol"))
            numbers = (value(point, column) for column in (EVALUATIONS, "factorizations", ERROR, DRIFT, "wall_s"))
            rows.append((method, "step" if STEP in point.axes else "tolerance", setting, *numbers))
    shown = {"work-precision": ERROR, "work-drift": DRIFT}
    figures = tuple(WORDS.figure(name, _lines(lines, column)) for name, column in shown.items())
    return (_adaptive_claim(lines), _stages_claim(lines)), WORDS.table("work-precision", rows), figures


def _lines(lines: dict[str, Points], column: str) -> tuple[Line, ...]:
    drawn = []
    for method, points in lines.items():
        x, y = np.array(sorted((value(point, EVALUATIONS), value(point, column)) for point in points)).T
        drawn.append(Line(method, x, np.where(y > 0, y, np.nan), "both", method))
    return tuple(drawn)


def _curve(points: Points) -> tuple[list[float], list[float]]:
    return [value(point, EVALUATIONS) for point in points], [value(point, DRIFT) for point in points]


#: Misalignments [m] at which the work of two methods is compared.
TARGETS = (1e-6, 1e-8, 1e-10)


def _saves_work(ratio: float) -> Answer:
    """Return whether a ratio of the work of two methods is a clear saving: well below 1; open if it is unknown."""
    if not math.isfinite(ratio):
        return Answer.OPEN
    return Answer.YES if ratio < 1 / Range.MARGIN else Answer.NO


def _adaptive_claim(lines: dict[str, Points]) -> Claim:
    ratios: dict[str, list[float]] = {}
    for method in (RADAU3, GAUSS3):
        if ADAPTIVE in lines and method in lines:
            ratios[method] = [
                work_for(*_curve(lines[ADAPTIVE]), target) / work_for(*_curve(lines[method]), target)
                for target in TARGETS
            ]
    answers = [_saves_work(ratio) for ratio in ratios.get(RADAU3, [])]
    text = "; ".join(
        ", ".join(f"{ratio:.2g} at {target:.0e} m" for ratio, target in zip(found, TARGETS, strict=True))
        + f" ({method})"
        for method, found in ratios.items()
    )
    answer = together(answers)
    start = {Answer.NO: "No, not on this problem: for", Answer.YES: "Yes: for"}.get(answer, "For")
    radau, gauss = (least_most(ratios.get(method, [])) for method in (RADAU3, GAUSS3))
    return WORDS.claim("adaptive", answer, computed=text or "unknown", start=start, radau=radau, gauss=gauss)


def _stages_claim(lines: dict[str, Points]) -> Claim:
    gains, drift = list[float](), math.nan
    if "Gauss 6" in lines and GAUSS3 in lines:
        three, six = _curve(lines[GAUSS3]), _curve(lines["Gauss 6"])
        gains = [work_for(*three, target) / work_for(*six, target) for target in TARGETS]
        at = max((w for w, d in zip(*six, strict=True) if d > 1e-12), default=math.nan)
        drift = at_equal_work(*three, at) / at_equal_work(*six, at)
    answers = [_saves_work(1 / gain) for gain in gains]
    text = ", ".join(f"{gain:.2f} at {target:.0e} m" for gain, target in zip(gains, TARGETS, strict=False))
    extra = (
        f" At equal work, the misalignment is {drift:.0f} times smaller with six stages."
        if 1 < drift < math.inf
        else ""
    )
    return WORDS.claim("stages", together(answers), computed=text, work=least_most([1 / g for g in gains]), extra=extra)
