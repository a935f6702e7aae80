"""The solution of a design: the best values of some numbers of a spec, with an estimate of their reliability."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from mbdkit.base.errors import SpecError
from mbdkit.base.text import counted, table
from mbdkit.spec.run_spec import RunSpec
from mbdkit_design.compared_settings import Comparison, compare
from mbdkit_design.derivatives import checked, derivatives_sentence
from mbdkit_design.design_spec import DesignSpec, LocalOptimizer
from mbdkit_design.design_tables import comparison_table, front_table
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.gains import (
    Gain,
    gains,
    goal_units,
    goal_words,
    limits_in_degrees,
    measure_units,
    variable_unit,
    violations,
)
from mbdkit_design.identifiability import sentence, undetermined
from mbdkit_design.known_points import DesignPoint, Notify, Stored, point_of
from mbdkit_design.problem import Problem
from mbdkit_design.search import Search, advice, searches
from mbdkit_design.stages import Stages
from mbdkit_design.trust import Trust, certified
from mbdkit_report import table_text, with_unit
from mbdkit_studies import start_warnings_of_study

ROWS = 20  #: Largest number of points of a front in the summary.
LEAST_ERROR = 1e-3  #: Errors of measures at their limits are reported if they exceed this share of the limit.


@dataclass(frozen=True)
class Design:
    """The result of a design.

    Attributes
    ----------
    spec
        Spec of the design.
    start, best
        The start point and the best point. On a Pareto front, the best point is the one closest to the smallest values
        of all goals, each goal relative to its range on the front.
    front
        Points of the Pareto front, for two goals in ascending order of the first goal; only `best` for a single goal.
    trust
        Certification of the best point.
    is_feasible
        Whether the best point satisfies all limits.
    runs, failures
        Number of runs, and number of failed runs.
    searches
        Number of searches whose goal at the end is within 0.1 % of the best one, and number of all searches.
    message
        Reason why the best search ended.
    derivatives
        How the derivatives of goals and limits were computed, as a sentence, and which of them are inaccurate at the
        best point; empty if none were needed.
    unconfirmed
        Goals and limits whose exact derivatives at the best point disagree with differences of runs, as sentences.
    undetermined
        Simultaneous changes of variables, by name, that do not affect the goal at the best point, so that only a
        combination of these variables is determined, or none if a single variable changes. Empty for a Pareto front.
    compared
        Results of the design with other settings of the runs (`compare` of its spec); empty until they are computed.
    changed_starts
        Sentences about variables that set initial values of bodies which assembly changes.
    is_converged
        Whether the best search converged, and did not end because of its largest number of iterations, for example.
    """

    spec: DesignSpec
    start: DesignPoint
    best: DesignPoint
    front: tuple[DesignPoint, ...]
    trust: Trust
    is_feasible: bool
    runs: int
    failures: int
    searches: tuple[int, int]
    message: str
    derivatives: str = ""
    unconfirmed: tuple[str, ...] = ()
    undetermined: tuple[dict[str, Stored], ...] = ()
    compared: tuple[Comparison, ...] = ()
    is_converged: bool = True
    changed_starts: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON; unknown numbers are None."""
        plain: dict[str, Any] = json.loads(TypeAdapter(Design).dump_json(self, exclude={"spec"}))
        return plain | {"searches": dict(zip(("at_best", "all"), self.searches, strict=True))}

    @classmethod
    def from_dict(cls, spec: DesignSpec, data: Mapping[str, Any]) -> Design:
        """Return the design from the result of `to_dict`.

        Raises ValueError, KeyError or TypeError if the data are not valid.
        """
        searches = data["searches"]["at_best"], data["searches"]["all"]
        design = TypeAdapter(cls).validate_python({**data, "spec": spec, "searches": searches})
        for point in (design.start, design.best, *design.front):
            if [*point.variables] != [*spec.chosen] or [*point.goals] != [*spec.totals]:
                raise ValueError
        return design

    def summary(self) -> str:
        """Return the result as text for a terminal."""
        rows = [("", "START", "BEST", "ERROR", "UNIT")]
        goals, measured = goal_units(self.spec), measure_units(self.spec)
        told = {name: "unknown" if np.isnan(error) else f"{error:.1g}" for name, error in self.trust.errors.items()}
        rows += [(*texts, "", variable_unit(self.spec, texts[0])) for texts in self.both_points("{:.6g}")]
        for name, value in self.best.goals.items():
            rows.append((name, f"{self.start.goals[name]:.6g}", f"{value:.6g}", told[name], goals[name]))
        for name in self.spec.subject_to:
            for scenario, measures in self.best.measures.items():
                label = f"{scenario}: {name}" if scenario else name
                rows.append((label, f"{self.start.measures[scenario][name]:.6g}", f"{measures[name]:.6g}", told[name],
                             measured[scenario, name]))  # fmt: skip
        at_best, every = self.searches
        lines = [*filter(None, [self.doubt]), self.trust.judgement]
        lines += [*(f"{goal_words(gain.name)}: {gain.text()}" for gain in self.gains), table(rows)]
        lines += [f"{self.counted_runs}, {at_best} of {every} searches ended here: {self.message}"]
        lines += filter(None, (self.single, self.derivatives))
        if len(self.front) > 1:
            points = front_table(self.spec, self.front, self.best)
            more = f"{len(self.front) - ROWS} more points are in design.json." if len(self.front) > ROWS else ""
            lines.append(table_text(replace(points, rows=points.rows[:ROWS], note=more)))
        if self.compared:
            points = comparison_table(self.spec, self.best, self.compared, is_feasible=self.is_feasible)
            lines.append(table_text(points))
            for comparison in self.compared:
                lines += filter(None, (comparison.confirmation(*goals.values()), comparison.reason))
        return "\n".join([*lines, *self.warnings])

    def both_points(self, form: str = "{:.4g}") -> Iterator[tuple[str, str, str]]:
        """Yield the variables by name, with their values at both points as text; for tables, the range of values."""
        for name in self.spec.variables:
            table = self.spec.tables.get(name)
            points = (self.start.variables, self.best.variables)
            ends = [(one[name],) if table is None else (min(x := table.values(one)), max(x)) for one in points]
            start, best = (" to ".join(map(form.format, some)) for some in ends)
            yield name, start, best

    @property
    def tables(self) -> dict[str, np.ndarray]:
        """Arguments and values (2, N) of the tables at the best point, by name of the variable."""
        return {name: np.array([one.at, one.values(self.best.variables)]) for name, one in self.spec.tables.items()}

    @property
    def doubt(self) -> str:
        """Sentence that says that the best point violates limits, or why it may not be an optimum; empty otherwise.

        It may not be an optimum if the search ended early, or if derivatives at the best point are not confirmed.
        """
        if not self.is_feasible:
            wrong = "; ".join(violations(self.spec, self.best, self.start))
            return f"No point that satisfies all limits was found; this one violates them least{wrong and ': '}{wrong}."
        if not self.is_converged:
            early = f"the search ended early ({self.message.rstrip('.')})"
            return f"This point may not be an optimum: {early}. {advice(self.message)}"
        if not self.unconfirmed:
            return ""
        return (
            "This point may not be an optimum: a goal or limit is not smooth there, and searches along gradients stop "
            "at such points. Try the optimizer bundle, several `starts`, or a smooth goal, such as rms(...) instead of "
            "a maximum."
        )

    @property
    def single(self) -> str:
        """Sentence that says that only one search along gradients was made; empty otherwise."""
        is_single = self.searches[1] == 1 and isinstance(self.spec.optimizer, LocalOptimizer)
        return "A single search finds a local minimum; `optimizer.starts` makes several." if is_single else ""

    @property
    def counted_runs(self) -> str:
        """Number of runs, and number of failed runs, in words."""
        return counted(self.runs, "run") + (f" ({self.failures} failed)" if self.failures else "")

    @property
    def warnings(self) -> list[str]:
        """Remarks on the best point for the user, as sentences."""
        sides = {name: self.side(name) for name in self.spec.single}
        at_bounds = [f"{name} is at its {side} bound." for name, side in sides.items() if side]
        held = [
            f"{name} has not moved from its start."
            for name, side in sides.items()
            if not side and abs(self.best.variables[name] - self.start.variables[name]) <= self._slack(name)
        ]
        remarks = ((name, one.remark(self.best.variables)) for name, one in self.spec.tables.items())
        told = [*at_bounds, *held, *(f"In {name}, {remark}." for name, remark in remarks if remark)]
        told += (sentence(self.spec, one) for one in self.undetermined)
        told += [*self.unconfirmed, *self.changed_starts, *map(_as_sentence, limits_in_degrees(self.spec))]
        return [*told, *self._uncertain_limits(), *self.trust.sentences(goal_units(self.spec))]

    def _uncertain_limits(self) -> list[str]:
        """Return sentences about limits that the best point may violate because of the errors of its runs."""
        texts, units = [], {name: unit for (_, name), unit in measure_units(self.spec).items()}
        for name, limit in self.spec.subject_to.items():
            values, error = [measures[name] for measures in self.best.measures.values()], self.trust.errors[name]
            for end in (one for one in (limit.max, limit.min) if one is not None):
                is_near = min(abs(value - end) for value in values) < error
                if is_near and error > LEAST_ERROR * abs(end or 1.0) and self.is_feasible:
                    limit_text, error_text = with_unit(end, units[name]), with_unit(error, units[name], 2)
                    texts.append(f"{name} may violate its limit of {limit_text}, because its error is {error_text}.")
        return texts

    @property
    def gains(self) -> list[Gain]:
        """The gain of each goal from the start to the best point."""
        return gains(self.spec, self.start, self.best, self.trust)

    def _slack(self, variable: str) -> float:
        """Return the difference below which two values of a variable count as equal."""
        return 1e-6 * self.spec.chosen[variable].width

    def side(self, variable: str) -> str:
        """Return ``lower`` or ``upper`` if the best value of a variable is at this bound; otherwise an empty text."""
        (low, high), best = self.spec.chosen[variable].bounds, self.best.variables[variable]
        slack = self._slack(variable)
        return "lower" if best <= low + slack else "upper" if best >= high - slack else ""


def solve(evaluator: Evaluator, stages: Stages) -> Design:
    """Solve a design, without the comparisons with other settings of the runs."""
    spec, first = evaluator.spec, evaluator.first
    for warning in limits_in_degrees(spec):
        stages.notify(f"warning: {warning}")
    stages.begin("optimisation", evaluator)
    problem = Problem(evaluator)
    result = searches(problem, spec.optimizer, first)
    end = evaluator.variables(result[0].end)
    at = ", ".join(f"{name} {with_unit(end[name], variable_unit(spec, name))}" for name in spec.single)
    least, before = evaluator.totals(result[0].end)[0], evaluator.totals(first)[0]
    unit, where = goal_units(spec)[spec.totals[0]], f" at {at}" if at else ""
    stages.notify(f"{counted(evaluator.runs, 'run')}: the least {spec.totals[0]} is {with_unit(least, unit)}{where}; "
                  f"at the start it is {with_unit(before, unit)}")  # fmt: skip
    front = [result[0]] if len(spec.totals) == 1 else pareto_front(evaluator, result[0], stages.notify)
    best = front[0] if len(front) == 1 else _knee(evaluator, front)
    stages.begin("errors of the result")
    trust = certified(evaluator, first, best.end)
    most = result[0].cost + 1e-3 * abs(result[0].cost)
    near = sum(one.feasible == result[0].feasible and one.cost <= most for one in result)
    unconfirmed, inaccurate = checked(evaluator, best.end) if evaluator.gradients and not best.is_least else ((), ())
    alone = undetermined(problem, best.end) if len(spec.totals) == 1 else ()  # its runs count, too
    return Design(
        spec=spec,
        start=point_of(evaluator, first),
        best=point_of(evaluator, best.end),
        front=tuple(point_of(evaluator, search.end) for search in front),
        trust=trust,
        is_feasible=best.feasible,
        runs=evaluator.runs,
        failures=evaluator.failures,
        searches=(near, len(result)),
        message=best.message,
        is_converged=best.is_converged,
        derivatives=" ".join(filter(None, (derivatives_sentence(evaluator), *inaccurate))),
        unconfirmed=unconfirmed,
        undetermined=alone,
        changed_starts=_changed_starts(evaluator, best.end),
    )


def _changed_starts(evaluator: Evaluator, best: np.ndarray) -> tuple[str, ...]:
    """Return sentences about initial values that variables set and that assembly changes, over the bounds of the
    variables, their start and the best point (n,).
    """
    points, told = (np.zeros_like(best), np.ones_like(best), evaluator.first, best), []
    for scenario in evaluator.scenarios:
        specs = []
        for x in points:
            with suppress(SpecError):  # some points within the bounds may have no valid spec
                specs.append(scenario.at(evaluator.settings(x)))
        told += start_warnings_of_study(spec for spec in specs if isinstance(spec, RunSpec))
    return tuple(map(_as_sentence, dict.fromkeys(told)))


def _as_sentence(warning: str) -> str:
    return f"{warning[0].upper()}{warning[1:]}."


def with_comparisons(evaluator: Evaluator, design: Design, stages: Stages) -> Design:
    """Return a design to which the comparisons with other settings of the runs (`compare` of its spec) are added.

    Parameters
    ----------
    evaluator
        A new evaluator of the design. With the evaluator of the optimisation, the number of runs would depend on
        whether a call was interrupted.
    """
    best = evaluator.point(design.best.variables)
    # these outcomes are stored by the optimisation, and therefore not computed again
    evaluator.outcomes(np.array([evaluator.first, best]))
    evaluator.runs, evaluator.failures = design.runs, design.failures
    compared = tuple(compare(evaluator, name, best, stages) for name in design.spec.compare)
    return replace(design, runs=evaluator.runs, failures=evaluator.failures, compared=compared)


def _knee(evaluator: Evaluator, front: list[Search]) -> Search:
    """Return the point that is closest to the smallest values of all goals, each relative to its range on the front."""
    goals = np.array([evaluator.totals(search.end) for search in front])
    range_ = np.ptp(goals, axis=0)
    away = np.linalg.norm((goals - goals.min(axis=0)) / np.where(range_ > 0, range_, 1.0), axis=1)
    return front[int(np.argmin(away))]


SLACK = 1e-6  #: Differences of goals below this, as a share of their range on the front, count as zero.


def pareto_front(evaluator: Evaluator, first_end: Search, notify: Notify) -> list[Search]:
    """Return the searches that end at points of the Pareto front, for two goals in ascending order of the first goal.

    First, each goal is minimised alone. Each goal except the first is then limited to values between its largest and
    its smallest value at these points, and the first goal is minimised for all combinations of these limits
    (epsilon-constraint method). Points that are dominated by another point, or that violate limits of the design, are
    left out. If no point is left, the result is `first_end`.

    Parameters
    ----------
    first_end
        The search for the minimum of the first goal.
    """
    spec = evaluator.spec
    others = range(1, len(spec.totals))
    ends = {k: searches(Problem(evaluator, goal=k), spec.optimizer, first_end.end)[0] for k in others}
    goals = np.array([evaluator.totals(one.end) for one in (first_end, *ends.values())])
    caps = {k: np.linspace(np.max(goals[:, k]), goals[k, k], spec.front) for k in others}
    places = list(product(range(spec.front), repeat=len(others)))
    results = {places[0]: first_end}  # `first_end` does not exceed the first limits, the largest values
    for number, place in enumerate(places[1:], start=2):
        limits = {k: float(caps[k][step]) for k, step in zip(others, place, strict=True)}
        strictest = next((k for k, step in zip(others, place, strict=True) if step == spec.front - 1), None)
        start = _before(results, place) if strictest is None else ends[strictest]
        results[place] = searches(Problem(evaluator, caps=limits), spec.optimizer, start.end)[0]
        notify(f"{counted(evaluator.runs, 'run')}: point {number} of {len(places)} of the front")
    return _efficient(evaluator, [value for value in results.values() if value.feasible]) or [first_end]


def _before(found: dict[tuple[int, ...], Search], place: tuple[int, ...]) -> Search:
    """Return the search with the same limits, except that the limit of the last limited goal is looser by one step."""
    last = max(k for k, step in enumerate(place) if step > 0)
    return found[(*place[:last], place[last] - 1, *place[last + 1 :])]


def _efficient(evaluator: Evaluator, points: list[Search]) -> list[Search]:
    """Return the searches that are not dominated: no other end is better in one goal and as good in all others."""
    if not points:
        return []
    goals = np.array([evaluator.totals(point.end) for point in points])
    slack = SLACK * np.ptp(goals, axis=0)
    better = (np.all(goals <= goal + slack, axis=1) & np.any(goals < goal - slack, axis=1) for goal in goals)
    return [point for point, others in zip(points, better, strict=True) if not np.any(others)]
