"""Verdict on the four-bar linkage of a public textbook: published residuals, and residuals with mbdkit's methods.

J. K. Moore, *Learn Multibody Dynamics*, 2022, CC BY 4.0, chapter "Equations of Motion with Holonomic Constraints",
https://moorepants.github.io/learn-multibody-dynamics/holonomic-eom.html, reports residuals of up to 8 cm with a
standard ODE solver at its default tolerances, below 8 mm with the DAE solver IDA at the same tolerances, and below
5e-10 m with IDA at tolerances of 1e-10.
"""

from __future__ import annotations

import math

import numpy as np

from mbdkit.archive.run import Run
from mbdkit_paper.textbook_four_bar.textbook_equations import GROUND, LENGTHS, LoopRun, integrate
from mbdkit_paper.wording import Words, least_most, reported, two_digits
from mbdkit_report import Answer, Band, Cell, Claim, Column, Figure, Line, Range, Table, Verdict, exceeds, together
from mbdkit_studies import METHOD, STEP, Study, at_equal_work, family, value, work_for
from mbdkit_studies.results.judge import study_verdict

STANDARD = 0.08
DAE = 0.008
DAE_FINE = 5e-10
DRAWN_STEP = 0.025
WORDS = Words(__file__)
Curves = dict[str, tuple[list[float], list[float]]]  #: Evaluations and residuals [m] of the runs of each method.
NAMES = {
    STANDARD: "8 cm, the book's ODE solver at 1e-3",
    DAE: "8 mm, its DAE solver at 1e-3",
    DAE_FINE: "5e-10 m, its DAE solver at 1e-10",
}


def loop_residual(run: Run) -> np.ndarray:
    """Return the gap (T, 2) of the loop [m] as in the textbook, for links of exact length in the computed
    directions.
    """
    second, third = run["P2"].position, run["P3"].position
    links = (second, third - second, np.array([GROUND, 0.0]) - third)
    total = np.zeros_like(second)
    for link, length in zip(links, LENGTHS, strict=True):
        total += length * link / np.linalg.norm(link, axis=1, keepdims=True)
    return np.asarray(total - (GROUND, 0.0))


@study_verdict
def verdict(study: Study) -> Verdict:
    """Return the verdict on the packaged study `textbook-four-bar`.

    Parameters
    ----------
    study
        The study. The textbook's own equations are integrated each time, which takes well under a second.
    """
    book, fine = integrate(1e-3, 1e-6), integrate(1e-10, 1e-10)
    shifted = [integrate(1e-3, 1e-6, shift) for shift in (1e-15, 1e-13, 1e-11)]
    rows: list[tuple[Cell, ...]] = []
    curves: Curves = {}
    drifts: list[Line] = []
    for name in ("fixed", "tolerance"):
        for point in family(study, name):
            method = str(point.axes[METHOD])
            run = study.run(point) if point.status == "complete" else None
            opening, instants = np.zeros((0, 2)), np.zeros(0)
            if run is not None:
                with run:
                    opening, instants = loop_residual(run), run.time
            residual = math.nan if run is None else float(np.max(np.abs(opening)))
            work, seconds = value(point, "rhs_evaluations"), value(point, "wall_s")
            setting = point.axes.get(STEP, point.axes.get("integrator.rtol"))
            rows.append((method, "step" if STEP in point.axes else "tolerance", setting, work, residual, 1e3 * seconds))
            if run is not None:
                works, residuals = curves.setdefault(method, ([], []))
                works.append(work)
                residuals.append(residual)
                if point.axes.get(STEP) == DRAWN_STEP:
                    gaps = np.linalg.norm(opening, axis=1)
                    drifts.append(Line(method, instants, np.where(gaps > 0, gaps, np.nan), "line", method))
    own = {method: curve for method, curve in curves.items() if method not in study.spec.added}
    targets = (_reached(target, own) for target in (DAE, DAE_FINE))
    claims = reported((_repeated(book, fine, shifted), _same_cost(book, own), *targets))
    tables = (_residuals(rows, book, fine), _needed(curves))
    figures = (WORDS.figure("drift", drifts, step=DRAWN_STEP), _work_figure(curves, book, fine))
    return WORDS.verdict("textbook-four-bar", "The textbook's four-bar linkage", claims, tables, *figures)


def _repeated(book: LoopRun, fine: LoopRun, shifted: list[LoopRun]) -> Claim:
    residuals = [100 * run.residual for run in (book, *shifted)]
    answer = together([Range.around(STANDARD, 1.5).holds(residual / 100) for residual in residuals])
    values = {"residuals": least_most(residuals), "fine": fine.residual, "opening": 100 * book.residual}
    return WORDS.claim("standard-solver", answer, **values)


def _same_cost(book: LoopRun, curves: Curves) -> Claim:
    told = []
    best: dict[int, float] = {}
    for times in (1, 2.5, 10):
        work = times * book.evaluations
        results = {method: at_equal_work(*curve, work) for method, curve in curves.items()}
        known = {method: residual for method, residual in results.items() if math.isfinite(residual)}
        name = min(known, key=lambda method: known[method]) if known else ""
        best[int(times)] = known[name] if name else math.nan
        told.append(f"{work:.0f} evaluations: " + (f"{known[name]:.1e} m ({name})" if name else "no run with so few"))
    answer = exceeds(STANDARD, best[1])
    if math.isnan(best[1]) and curves:
        answer = Answer.NO
    values = {"evaluations": book.evaluations, "rounded": two_digits(book.evaluations), "computed": "; ".join(told)}
    return WORDS.claim("same-cost", answer, equal=best[1], tenfold=best[10], **values)


def _reached(target: float, curves: Curves) -> Claim:
    needed = {method: work_for(*curve, target) for method, curve in curves.items()}
    known = sorted((work, method) for method, work in needed.items() if math.isfinite(work))
    text = f"{target * 1e3:.0f} mm" if target == DAE else f"{target:.0e} m"
    least = f"{known[0][1]} ({two_digits(known[0][0])} evaluations)" if known else "none"
    name = "dae-solver" if target == DAE else "dae-solver-fine"
    answer = Answer.YES if known else Answer.OPEN if not curves else Answer.NO
    computed = ", ".join(f"{method} from {two_digits(work)} evaluations" for work, method in known)
    values = {"target": text, "computed": computed, "reached": len(known), "count": len(curves), "least": least}
    return WORDS.claim("dae-solver", answer, name, **values)


def _residuals(rows: list[tuple[Cell, ...]], book: LoopRun, fine: LoopRun) -> Table:
    first = "textbook's equations, SciPy RK45"
    published: list[tuple[Cell, ...]] = [
        ("textbook, standard ODE solver (published)", "tolerance", 1e-3, None, STANDARD, None),
        ("textbook, DAE solver IDA (published)", "tolerance", 1e-3, None, DAE, None),
        ("textbook, DAE solver IDA (published)", "tolerance", 1e-10, None, DAE_FINE, None),
        (first, "tolerance", 1e-3, book.evaluations, book.residual, 1e3 * book.seconds),
        (first, "tolerance", 1e-10, fine.evaluations, fine.residual, 1e3 * fine.seconds),
    ]
    return WORDS.table("residuals", (*published, *rows))


def _needed(curves: Curves) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for method, curve in curves.items():
        works = [work_for(*curve, target) for target in NAMES]
        rows.append((method, *(work if math.isfinite(work) else None for work in works)))
    columns = (Column("method"), *(Column(f"evaluations for {name}") for name in NAMES.values()))
    return WORDS.table("same-cost", rows, columns)


def _work_figure(curves: Curves, book: LoopRun, fine: LoopRun) -> Figure:
    lines = []
    for method, curve in curves.items():
        x, y = np.array(sorted(zip(*curve, strict=True))).T
        lines.append(Line(method, x, np.where(y > 0, y, np.nan), "both", method))
    x, y = np.array([(run.evaluations, run.residual) for run in (book, fine)]).T
    lines.append(Line("textbook's equations, RK45", x, y, "both", "textbook"))
    return WORDS.figure("work-drift", lines, bands=[Band("textbook's DAE solver", DAE_FINE, DAE)])
