"""Verdict on the packaged study `methods`: error, drift, forces and cost by problem and method, and failures."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbdkit_paper.methods.problems import Problem, problems
from mbdkit_paper.methods.study import OTHERS, column, family_of
from mbdkit_paper.wording import Words, reported
from mbdkit_report import Answer, Cell, Claim, Figure, Line, Table, Verdict
from mbdkit_studies import IN_TOLERANCES, OPERATIONS, Study, StudyPoint, value, work_for
from mbdkit_studies.results.judge import study_verdict

TARGET = 1e-6  #: Relative error at which costs are compared, unless the references are less accurate.
DRAWN = 6  #: Largest number of integrators in a figure, besides added ones; there are no more colours.
#: Number of families of integrators that have to reach a published result, and where no more than three take part.
ENOUGH, FEW = 3, 2
#: A code of others with less than this share of the error of a published result shows that this has an error.
SHARE = 1 / 3
LEAST = 1e-17  #: Smallest error in figures, whose axes are logarithmic.
WORDS = Words(__file__)


@dataclass(frozen=True)
class Result:
    """The runs of one method, in one formulation, on one problem.

    Attributes
    ----------
    problem, method
        Name of the problem, and label of the method.
    integrator
        Name of the integrator.
    points
        The runs, which differ in the step or in the tolerance.
    """

    problem: str
    method: str
    integrator: str
    points: tuple[StudyPoint, ...]

    @cached_property
    def errors(self) -> tuple[float, ...]:
        """Largest error of a result of each run, relative to the result if it exceeds 1; nan for incomplete runs."""
        quantities = problems()[self.problem].quantities
        return tuple(
            max(
                (abs(value(point, column(self.problem, name)) - known.reference) / max(1.0, abs(known.reference))
                 for name, known in quantities.items()),
                key=lambda error: math.inf if math.isnan(error) else error,
            )
            for point in self.points
        )  # fmt: skip

    @cached_property
    def operations(self) -> tuple[float, ...]:
        """Evaluations, Jacobians and factorizations of each run; nan for incomplete runs."""
        return tuple(sum(value(point, name) for name in OPERATIONS) for point in self.points)

    def cost(self, of: Sequence[float]) -> float:
        """Return the least cost for errors of at most `_target`; nan if it is not reached."""
        return work_for([0.0 if math.isnan(cost) else cost for cost in of], self.errors, _target(self.problem))

    @cached_property
    def work(self) -> float:
        """Operations for the error of the comparison."""
        return self.cost(self.operations)

    @cached_property
    def seconds(self) -> float:
        """Wall time for the error of the comparison [s]."""
        return self.cost([value(point, "wall_s") for point in self.points])

    @property
    def best(self) -> StudyPoint | None:
        """The run with the smallest error; None if no run is complete."""
        complete = [(error, place) for place, error in enumerate(self.errors) if not math.isnan(error)]
        return self.points[min(complete)[1]] if complete else None

    @property
    def error(self) -> float:
        """The smallest error."""
        return min((error for error in self.errors if not math.isnan(error)), default=math.nan)

    @property
    def failed(self) -> list[StudyPoint]:
        """The runs that failed, also those that reached the limit of wall time."""
        return [point for point in self.points if point.status == "failed"]

    def reaches(self, name: str, error: float) -> bool:
        """Return whether one run has the result `name` with at most an absolute error."""
        reference = problems()[self.problem].quantities[name].reference
        return any(abs(value(point, column(self.problem, name)) - reference) <= error for point in self.points)


@study_verdict
def verdict(study: Study) -> Verdict:
    """Return the verdict on the packaged study `methods`.

    Parameters
    ----------
    study
        The study, some of whose families may be missing.
    """
    results = list(_results(study))
    by_problem = {
        name: [result for result in results if result.problem == name]
        for name in dict.fromkeys(result.problem for result in results)
    }
    claims = reported([_published(name, found) for name, found in by_problem.items() if _meeting(name, found)])
    reached = sum(claim.answer is Answer.YES for claim in claims)
    failures = sum(len(result.failed) for result in results)
    sentence = (
        f"Several families of integrators reach the published results of {reached} of {len(claims)} problems with "
        f"such results. {failures} of {len(study.points)} runs failed or reached the limit of wall time."
    )
    bases = [json.loads(study.grid(name).base_json) for name in study.families]
    limit = " or ".join(f"{limit:g}" for limit in sorted({base["limits"]["wall_time"] for base in bases}))
    return Verdict(
        "methods",
        study.spec.title,
        sentence,
        claims,
        (
            WORDS.table("choice", [_choice(name, found) for name, found in by_problem.items()]),
            WORDS.table("published", [row for name, found in by_problem.items() for row in _reached(name, found)]),
            WORDS.table("results", [_row(result) for result in results]),
            _failures(results),
            WORDS.table("problems", [row for name in by_problem for row in _statement(name, problems()[name])]),
        ),
        tuple(_figure(name, found, study.spec.added) for name, found in by_problem.items()),
        WORDS.notes(limit=limit),
    )


def _results(study: Study) -> Iterator[Result]:
    found: dict[tuple[str, str, str], list[StudyPoint]] = {}
    integrators: dict[tuple[str, str], str] = {}
    for name, family in study.spec.families.items():
        for entry in family.axes[0]["method"]:
            integrators[name, str(entry["label"])] = entry["set"]["integrator"]["name"]
    for point in study.points:
        label = str(point.axes["method"])
        key = point.family.removesuffix(IN_TOLERANCES), label, integrators[point.family, label]
        found.setdefault(key, []).append(point)
    order = list(problems())
    for key, points in sorted(found.items(), key=lambda item: order.index(item[0][0])):
        yield Result(*key, tuple(points))


def _target(problem: str) -> float:
    """Return the relative error at which costs are compared on a problem."""
    return max(TARGET, *(known.reference_error for known in problems()[problem].quantities.values()))


def _meeting(name: str, results: Sequence[Result], share: float = 1.0) -> dict[str, list[str]]:
    """Return the integrators that reach each published result of a problem to a share of its error."""
    return {
        key: list(dict.fromkeys(x.integrator for x in results if x.reaches(key, share * quantity.published_error)))
        for key, quantity in problems()[name].quantities.items()
        if quantity.published_error is not None
    }


def _published(name: str, results: Sequence[Result]) -> Claim:
    """Return the claim that the published results of a problem are reached by several families of integrators."""
    common = set.intersection(*map(set, _meeting(name, results).values()))
    families = list(dict.fromkeys(family_of(x.integrator) for x in results if x.integrator in common))
    enough = ENOUGH if len({family_of(x.integrator) for x in results}) > ENOUGH else FEW
    answer = Answer.YES if len(families) >= enough else Answer.PARTLY if families else Answer.OPEN
    values = {"title": problems()[name].title, "enough": enough, "count": len(families), "integrators": len(common)}
    return WORDS.claim("published", answer, name, problem=name, names=", ".join(families) or "none", **values)


def _reached(name: str, results: Sequence[Result]) -> Iterator[tuple[Cell, ...]]:
    """Yield a row for each published result: its error, and the integrators that reach it or show its error."""
    closer = _meeting(name, results, SHARE)
    for key, found in _meeting(name, results).items():
        quantity = problems()[name].quantities[key]
        others = ", ".join(integrator for integrator in closer[key] if integrator.startswith(OTHERS))
        families = len({family_of(integrator) for integrator in found})
        yield name, key, repr(quantity.published), quantity.published_error, families, ", ".join(found), others


def _least(costs: Iterable[tuple[float, str]], form: str) -> str | None:
    """Return the method with the least cost and this cost, of costs and methods; None if none reaches the target."""
    known = [(cost, method) for cost, method in costs if not math.isnan(cost)]
    return f"{min(known)[1]} ({min(known)[0]:{form}})" if known else None


def _choice(name: str, results: Sequence[Result]) -> tuple[Cell, ...]:
    work = _least(((result.work, result.method) for result in results), ",.0f")
    seconds = _least(((result.seconds, result.method) for result in results), ".2g")
    best = min((result for result in results if result.best), key=lambda result: result.error, default=None)
    reaching = sum(not math.isnan(result.work) for result in results)
    least = None if best is None else f"{best.method} ({best.error:.0e})"
    failed = sum(len(result.failed) for result in results)
    return name, f"{reaching} of {len(results)}", work, seconds, least, failed


def _row(result: Result) -> tuple[Cell, ...]:
    best = result.best
    complete = f"{sum(point.status == 'complete' for point in result.points)} of {len(result.points)}"
    codes = ", ".join(dict.fromkeys(point.reason.partition(":")[0] for point in result.failed))
    if best is None:
        return (result.problem, result.method, complete, *[None] * 10, codes)
    setting = next(f"{label:.2g}" for key, label in best.axes.items() if key != "method")
    errors: list[Cell] = [_known(value(best, name)) for name in ("multiplier_error", "misalignment_max")]
    counters = (OPERATIONS[0], "host_evaluations", *OPERATIONS[1:])
    counts = [None if math.isnan(count := value(best, name)) else int(count) for name in counters]
    work = None if math.isnan(result.work) else round(result.work)
    cells = (complete, setting, result.error, *errors, *counts, _known(value(best, "wall_s")), work, codes)
    return (result.problem, result.method, *cells)


def _known(number: float) -> float | None:
    return None if math.isnan(number) else number


def _failures(results: Sequence[Result]) -> Table:
    """Return the table of failures: for each method and code, the number of runs, their problems, and a reason."""
    found: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for result in results:
        for point in result.failed:
            key = result.method, point.reason.partition(":")[0]
            found.setdefault(key, []).append((result.problem, point.reason))
    rows: list[tuple[Cell, ...]] = [
        (method, code, len(runs), ", ".join(dict.fromkeys(problem for problem, _ in runs)), runs[0][1])
        for (method, code), runs in found.items()
    ]
    return WORDS.table("failures", rows)


def _statement(name: str, problem: Problem) -> Iterator[tuple[Cell, ...]]:
    for key, quantity in problem.quantities.items():
        published = None if quantity.published is None else f"{quantity.published!r}"
        bound = quantity.published_error
        yield (
            name, problem.title, key, quantity.value, published, bound, f"{quantity.reference!r}",
            quantity.reference_error, problem.source, problem.reference_source,
        )  # fmt: skip


def _figure(name: str, results: Sequence[Result], added: Sequence[str]) -> Figure:
    """Return the work-precision figure of a problem: each integrator as it costs the least."""

    def rank(result: Result) -> tuple[bool, float, float]:
        return math.isnan(result.work), 0.0 if math.isnan(result.work) else result.work, result.error

    groups: dict[str, Result] = {}
    for result in sorted((result for result in results if result.best is not None), key=rank):
        groups.setdefault(result.integrator, result)
    chosen = list(groups.values())[:DRAWN]
    chosen += [result for result in results if result.method in added and result.best and result not in chosen]
    lines = []
    for result in chosen:
        x, y = np.array(result.operations), np.maximum(result.errors, LEAST)
        order = np.argsort(x)
        lines.append(Line(result.method, x[order], y[order], "both", result.method))
    return WORDS.figure("work-precision", lines, f"work-precision-{name}", problem=problems()[name].title)
