"""Comparisons beyond the paper: orders, growth laws, adaptive steps, more stages, work, precision and drift."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mbdkit_paper.paper.published_results import GAUSS2, GAUSS3, GILL
from mbdkit_paper.wording import least_most
from mbdkit_report import (
    Answer,
    Axis,
    Cell,
    Claim,
    Figure,
    Line,
    Range,
    Table,
    columns_of,
    growth_law,
    observed_order,
    together,
    worst_history,
)
from mbdkit_studies import METHOD, MODEL, STEP, Points, at_equal_work, family, value, work_for

if TYPE_CHECKING:
    from mbdkit_studies import Study

ORDERS = {GILL: 4, GAUSS2: 4, GAUSS3: 6}
TOLERANCE = 0.2
ADAPTIVE, RADAU3 = "SciPy Radau, adaptive", "Radau IIA 3"
EVALUATIONS, ERROR, DRIFT = "rhs_evaluations", "end_error", "misalignment_max"


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
                near = abs(seen.order - expected) <= TOLERANCE
                answers.append((Answer.YES if near else Answer.NO) if seen.found else Answer.OPEN)
                found.append(f"{seen.order:.2f} ({model} pendulum, {method})")
    claim = Claim(
        "orders",
        "RK-Gill and Gauss with two stages have order 4, Gauss with three stages order 6.",
        "orders 4, 4 and 6",
        "orders " + ", ".join(found),
        together(answers),
        f"In the asymptotic range of steps, {sum(answer is Answer.YES for answer in answers)} of {len(answers)} "
        f"observed orders lie within {TOLERANCE} of the theoretical ones.",
    )
    columns = columns_of(
        "pendulum; method; theoretical order; observed order; standard error; "
        "window of steps; round-off floor [m]; order of the misalignment"
    )
    note = (
        "Error of the positions at 15 s against six-stage Gauss. Empty: no window, because the error reaches round-off "
    )
    return claim, Table("order", "Observed orders", columns, tuple(rows), note + "within two halvings of the step.")


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
            duration = float(time[last - 1])
            rows.append(
                (model, method, duration, laws[model, method, share], law.exponent, float(history[:last].max()))
            )
    gill = [law for (_, method, share), law in laws.items() if method == GILL and share == 1]
    single = [laws.get(("single", method, 10), "") for method in (GAUSS2, GAUSS3)]
    answers = [Answer.YES if law == "quadratic" else Answer.NO for law in gill]
    answers += [Answer.YES if law == "bounded" else Answer.NO for law in single if law]
    late = laws.get(("single", GAUSS2, 1), "unknown")
    radau = " and ".join(dict.fromkeys(law for (_, method, _), law in laws.items() if method == RADAU3)) or "unknown"
    claim = Claim(
        "growth",
        "The misalignment grows with RK-Gill, but not with the Gauss methods.",
        "over 150 steps (Fig. 4), it increases with RK-Gill, but not with Gauss",
        f"with RK-Gill, the growth is {' and '.join(dict.fromkeys(gill)) or 'unknown'}; for the single pendulum, it is "
        f"{' and '.join(dict.fromkeys(single)) or 'unknown'} with Gauss 2 and 3 over twenty swings, and {late} with "
        "Gauss 2 over two hundred",
        (Answer.PARTLY if late == "quadratic" and together(answers) is Answer.YES else together(answers))
        if laws
        else Answer.OPEN,
        "The misalignment grows with the square of time with RK-Gill. With the Gauss methods it oscillates about a "
        "constant for the first twenty swings of the single pendulum. Over two hundred swings the growth is "
        f"{late}, but from a much smaller value: constraints at acceleration level do not close the gap of a joint. "
        f"With Radau IIA the growth is {radau}.",
    )
    columns = columns_of("pendulum; method; over [s]; law; exponent of t; largest misalignment [m]")
    note = "All laws that the data do not distinguish are listed; unclear: no law can be separated from oscillation."
    return claim, Table("growth", "How misalignment grows, h = 0.1 s", columns, tuple(rows), note)


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
    columns = columns_of(
        "method; set by; step or tolerance; evaluations; factorizations; error at 15 s [m]; misalignment [m]; time [s]"
    )
    table = Table("work-precision", "Work, precision and drift of the double pendulum", columns, tuple(rows))
    figures = tuple(
        Figure(name, title, caption, Axis("evaluations", log=True), Axis(label, "m", log=True), _lines(lines, column))
        for name, title, caption, label, column in (
            (
                "work-precision",
                "Work and precision, double pendulum over 15 s",
                "Lower left is better. Errors below 1e-13 m are dominated by round-off.",
                "error at the end",
                ERROR,
            ),
            (
                "work-drift",
                "Work and drift, double pendulum over 15 s",
                "Misalignment of the joints against work.",
                "largest misalignment",
                DRIFT,
            ),
        )
    )
    return (_adaptive_claim(lines), _stages_claim(lines)), table, figures


def _lines(lines: dict[str, Points], column: str) -> tuple[Line, ...]:
    drawn = []
    for method, points in lines.items():
        pairs = sorted((value(point, EVALUATIONS), value(point, column)) for point in points)
        x, y = np.array(pairs).T
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
    return Claim(
        "adaptive",
        "Refining the step adaptively makes the implicit method better.",
        "the paper recommends this, but does not try it",
        "ratios of the evaluations of SciPy's adaptive Radau to those with fixed steps, at equal misalignments: "
        f"{text or 'unknown'}",
        answer,
        f"{start} the same misalignment, SciPy's adaptive Radau needs {least_most(ratios.get(RADAU3, []))} times the "
        f"evaluations of the same method with fixed steps, and {least_most(ratios.get(GAUSS3, []))} times those of "
        "three-stage Gauss.",
    )


def _stages_claim(lines: dict[str, Points]) -> Claim:
    gains: list[float] = []
    if "Gauss 6" in lines and GAUSS3 in lines:
        three, six = _curve(lines[GAUSS3]), _curve(lines["Gauss 6"])
        gains = [work_for(*three, target) / work_for(*six, target) for target in TARGETS]
        at = max((w for w, d in zip(*six, strict=True) if d > 1e-12), default=math.nan)
        drift = at_equal_work(*three, at) / at_equal_work(*six, at)
    else:
        drift = math.nan
    answers = [_saves_work(1 / gain) for gain in gains]
    text = ", ".join(f"{gain:.2f} at {target:.0e} m" for gain, target in zip(gains, TARGETS, strict=False))
    extra = (
        f" At equal work, the misalignment is {drift:.0f} times smaller with six stages."
        if math.isfinite(drift) and drift > 1
        else ""
    )
    return Claim(
        "stages",
        "With more than three stages, the same misalignment needs less work.",
        "the paper does not try this",
        f"ratios of the evaluations of Gauss 3 to those of Gauss 6, at equal misalignments: {text}",
        together(answers),
        f"For the same misalignment, six stages need {least_most([1 / gain for gain in gains])} times the evaluations "
        f"of three.{extra}",
    )
