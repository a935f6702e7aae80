"""Pareto fronts: the minimum of the first goal for many combinations of upper limits of the other goals."""

from __future__ import annotations

from itertools import product

import numpy as np

from mbdkit.base.text import counted
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.known_points import Notify
from mbdkit_design.problem import Problem
from mbdkit_design.search import Search, searches

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
