"""`mbdkit.design`: the best values of some numbers of a spec, and how far they can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mbdkit.designs.evaluation import Evaluator
from mbdkit.designs.identifiability import sentence, undetermined
from mbdkit.designs.problem import Problem
from mbdkit.designs.search import Search, searches
from mbdkit.designs.trust import Trust, certified
from mbdkit.errors import RunError
from mbdkit.spec import DesignSpec, load_design_spec
from mbdkit.text import counted, table

Notify = Callable[[str], None]


@dataclass(frozen=True)
class DesignPoint:
    """Values of the variables and what they yield.

    Attributes
    ----------
    variables
        Values of the variables by name.
    goals
        Goals by name, summed over the scenarios by their weights.
    measures
        Goals and limits of each scenario, by its name, which is empty for the base alone, and theirs.
    """

    variables: dict[str, float]
    goals: dict[str, float]
    measures: dict[str, dict[str, float]]


@dataclass(frozen=True)
class Design:
    """The result of a design.

    Attributes
    ----------
    spec
        Its spec.
    start, best
        The start of the variables and the best point. Of a Pareto front, the best point is the one that is nearest to
        the least values of both goals, each relative to its range on the front.
    front
        Points of the Pareto front from the least first goal to the least second one; only `best` for a single goal.
    trust
        How far the best point can be trusted.
    is_feasible
        Whether the best point satisfies all limits.
    runs
        Number of runs.
    searches
        Number of searches that ended at the best point to 0.1 % of its goal, and of all searches.
    message
        Why the best search ended.
    undetermined
        Changes of variables by name, each of which leaves the goal at the best point as it is, because only a
        combination of these variables is determined; empty for a Pareto front.
    """

    spec: DesignSpec
    start: DesignPoint
    best: DesignPoint
    front: tuple[DesignPoint, ...]
    trust: Trust
    is_feasible: bool
    runs: int
    searches: tuple[int, int]
    message: str
    undetermined: tuple[dict[str, float], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON; unknown numbers are None."""
        points = {"start": self.start, "best": self.best}
        plain: dict[str, Any] = _plain(
            {name: asdict(point) for name, point in points.items()}
            | {
                "front": [asdict(point) for point in self.front],
                "trust": asdict(self.trust),
                "is_feasible": self.is_feasible,
                "runs": self.runs,
                "searches": {"at_best": self.searches[0], "all": self.searches[1]},
                "message": self.message,
                "undetermined": self.undetermined,
            }
        )
        return plain

    def summary(self) -> str:
        """Return the result as text for a terminal."""
        rows = [("", "START", "BEST", "ERROR")]
        for name, value in self.best.variables.items():
            rows.append((name, f"{self.start.variables[name]:.6g}", f"{value:.6g}", ""))
        for name, value in self.best.goals.items():
            error = self.trust.errors[name]
            told = "unknown" if np.isnan(error) else f"{error:.1g}"
            rows.append((name, f"{self.start.goals[name]:.6g}", f"{value:.6g}", told))
        at_best, every = self.searches
        lines = [table(rows), f"{counted(self.runs, 'run')}, {at_best} of {every} searches ended here: {self.message}"]
        if not self.is_feasible:
            lines.append("No point that satisfies all limits was found; this one violates them least.")
        return "\n".join([*lines, *self.warnings])

    @property
    def warnings(self) -> list[str]:
        """What a user should know of the best point, in sentences."""
        return [*map(sentence, self.undetermined), *self.trust.sentences()]


def design(source: Any, *, notify: Notify | None = None, **sections: Any) -> Design:
    """Choose numbers of a spec so that measures of its runs become small.

    Parameters
    ----------
    source
        A design spec: a file, a mapping, or a DesignSpec.
    notify
        Called with a sentence when a search ends.
    **sections
        Sections of the spec, such as ``optimizer={"name": "slsqp", "starts": 8}``; they replace those of `source`.

    Returns
    -------
    Design
        The result: ``.best``, ``.front`` and ``.trust``.

    Raises
    ------
    SpecError
        If the spec is not valid.
    RunError
        If a run fails at the start of the variables.

    Examples
    --------
    The stiffness with which a mass swings by as little as possible:

    >>> import mbdkit
    >>> m = mbdkit.Mechanism()
    >>> mass = m.body("mass", mass=1.0, inertia=1.0)
    >>> m.revolute("pin", m.ground, mass, at=(0, 0))
    >>> m.torsion_spring("spring", m.ground, mass, stiffness=1.0)
    >>> m.torque("load", mass, value=1.0)
    >>> base = {"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.01}}
    >>> stiffness = {"model.forces.spring.stiffness": {"bounds": [1.0, 4.0]}}
    >>> found = mbdkit.design(
    ...     {"mbdkit_design": 1, "base": base, "variables": stiffness, "minimize": "rms(mass.angle)"}
    ... )
    >>> round(found.best.variables["model.forces.spring.stiffness"], 6)
    4.0
    """
    spec = load_design_spec(source, **sections)
    return solve(spec, notify or _silent)


def solve(spec: DesignSpec, notify: Notify) -> Design:
    """Solve a validated design; see `design`."""
    evaluator = Evaluator(spec)
    first = evaluator.first
    problem = Problem(evaluator)
    found = searches(problem, spec.optimizer, first)
    notify(f"{counted(evaluator.runs, 'run')}: the least {spec.totals[0]} is {evaluator.totals(found[0].end)[0]:.6g}")
    front = [found[0]] if len(spec.totals) == 1 else _front(evaluator, found[0], notify)
    best = front[0] if len(front) == 1 else _knee(evaluator, front)
    trust = certified(evaluator, first, best.end)
    near = sum(
        one.feasible == found[0].feasible and one.cost <= found[0].cost + 1e-3 * abs(found[0].cost) for one in found
    )
    return Design(
        spec=spec,
        start=_point(evaluator, first),
        best=_point(evaluator, best.end),
        front=tuple(_point(evaluator, one.end) for one in front),
        trust=trust,
        is_feasible=best.feasible,
        runs=evaluator.runs,
        searches=(near, len(found)),
        message=best.message,
        undetermined=undetermined(problem, best.end) if len(spec.totals) == 1 else (),
    )


def _front(evaluator: Evaluator, first_end: Search, notify: Notify) -> list[Search]:
    """Return points of the Pareto front, from the least first goal: the least one for each of several second goals."""
    spec = evaluator.spec
    other_end = searches(Problem(evaluator, goal=1), spec.optimizer, first_end.end)[0]
    most, least = (float(evaluator.totals(one.end)[1]) for one in (first_end, other_end))
    points = [first_end]
    for cap in np.linspace(most, least, spec.front)[1:]:
        problem = Problem(evaluator, caps={1: float(cap)})
        start = other_end.end if cap == least else points[-1].end
        points.append(searches(problem, spec.optimizer, start)[0])
        notify(f"{counted(evaluator.runs, 'run')}: point {len(points)} of {spec.front} of the front")
    kept = [one for one in points if one.feasible]
    if not kept:
        raise RunError("no point of the Pareto front satisfies all limits")
    goals = np.array([evaluator.totals(one.end) for one in kept])
    slack = 1e-9 * np.ptp(goals, axis=0)
    dominated = [bool(np.any(np.all(goals < one - slack, axis=1))) for one in goals]
    return [one for one, worse in zip(kept, dominated, strict=True) if not worse]


def _knee(evaluator: Evaluator, front: list[Search]) -> Search:
    """Return the point that is nearest to the least goals, each relative to its range on the front."""
    goals = np.array([evaluator.totals(one.end) for one in front])
    range_ = np.ptp(goals, axis=0)
    away = np.linalg.norm((goals - goals.min(axis=0)) / np.where(range_ > 0, range_, 1.0), axis=1)
    return front[int(np.argmin(away))]


def _point(evaluator: Evaluator, x: np.ndarray) -> DesignPoint:
    values, goals = evaluator.values(x[None])[0], evaluator.totals(x)
    return DesignPoint(
        variables=evaluator.variables(x),
        goals=dict(zip(evaluator.spec.totals, goals.tolist(), strict=True)),
        measures={
            name: dict(zip(evaluator.names, row.tolist(), strict=True))
            for name, row in zip(evaluator.spec.situations, values, strict=True)
        },
    )


def _plain(data: Any) -> Any:
    """Return plain data with None in place of nan."""
    match data:
        case dict():
            return {key: _plain(value) for key, value in data.items()}
        case list() | tuple():
            return [_plain(value) for value in data]
        case float() if not np.isfinite(data):
            return None
    return data


def _silent(text: str) -> None:
    """Ignore a message."""
