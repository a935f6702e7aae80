"""A design as a problem of constrained optimisation with scaled variables, goals and limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import RunError
from mbdkit.engine.linear_systems import product
from mbdkit_design.derivatives import derivatives
from mbdkit_design.design_spec import FEASIBLE

if TYPE_CHECKING:
    from mbdkit_design.evaluation import Evaluator

#: Cost assigned to points where a run fails, relative to the cost at the start; so large that no search ends there.
FAILED = 1e3


@dataclass(frozen=True)
class Bound:
    """A limit of one measure in one scenario, or an upper limit of a goal.

    Attributes
    ----------
    weights
        (S, K) weights of K goals and limits in S scenarios. The weighted sum of their values is the limited quantity.
    low, high
        Limits; infinite if there is no limit.
    """

    weights: np.ndarray
    low: float
    high: float

    def of(self, values: np.ndarray) -> np.ndarray:
        """Return the limited quantity (N,) from values of goals and limits (N, S, K); nan where a run failed."""
        return _weighted(values, self.weights)


def _weighted(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted sum (N,) of goals and limits (N, S, K); nan is ignored where the weight is zero."""
    return np.asarray(np.where(weights != 0.0, weights * values, 0.0).sum(axis=(1, 2)))


class Problem:
    """Minimises one goal of a design within its limits.

    Parameters
    ----------
    evaluator
        Evaluates goals and limits.
    goal
        Index of the goal.
    caps
        Upper limits of other goals, by index of the goal.

    Raises
    ------
    RunError
        If a run fails at the start.
    """

    def __init__(self, evaluator: Evaluator, goal: int = 0, caps: dict[int, float] | None = None):
        self.evaluator = evaluator
        self._differentiated: tuple[bytes, np.ndarray] = b"", np.empty(0)
        self.sums_squares = evaluator.spec.sums_squares
        self.weights = goal_weights(evaluator, goal)
        self.bounds = _limits(evaluator)
        self.bounds += (Bound(goal_weights(evaluator, k), -np.inf, most) for k, most in (caps or {}).items())
        for scenario, one in zip(evaluator.spec.specs, evaluator.outcomes(evaluator.first[None])[0], strict=True):
            if one.verdict == "failed":
                where = f" in the scenario '{scenario}'" if scenario else ""
                raise RunError(f"a run fails at the start of the variables{where}: {one.reason}")
        first = evaluator.values(evaluator.first[None])
        self.scale = float(abs(self._goal(first)[0])) or 1.0
        self._sizes = [_size(bound, float(bound.of(first)[0])) for bound in self.bounds]
        self._rows, self._offsets = _of_tables(evaluator)
        self.is_limited = bool(self.bounds) or len(self._rows) > 0

    def _goal(self, values: np.ndarray) -> np.ndarray:
        if self.sums_squares:
            return np.asarray(np.sum(self._terms(values) ** 2, axis=1))
        return _weighted(values, self.weights)

    def _terms(self, values: np.ndarray) -> np.ndarray:
        """Return the terms (N, R), whose squares are summed, of goals and limits (N, S, K)."""
        terms = self.evaluator.root_weights[:, None] * values[:, :, : len(self.evaluator.spec.goals)]
        return np.asarray(terms.reshape(len(values), -1))

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return the terms (R,) at a point (n,) whose sum of squares is the cost."""
        result = self._terms(self.evaluator.values(x[None]))[0]
        return np.asarray(np.nan_to_num(result / np.sqrt(self.scale), nan=np.sqrt(FAILED)))

    def residual_slopes(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives (R, n) of the terms of a sum of squares."""
        return np.asarray(self._terms(np.moveaxis(self._derivatives(x), -1, 0)).T / np.sqrt(self.scale))

    def cost(self, x: np.ndarray) -> float:
        """Return the goal at a point (n,), relative to its value at the start; `FAILED` if a run fails."""
        return float(self.costs(x[None])[0])

    def costs(self, points: np.ndarray, failed: float = FAILED) -> np.ndarray:
        """Return the cost at points (N, n); `failed` where a run fails."""
        return np.nan_to_num(self._goal(self.evaluator.values(points)) / self.scale, nan=failed)

    def slope(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives (n,) of the cost; zero where they are unknown."""
        return np.asarray(np.sum(self.weights[..., None] * self._derivatives(x), axis=(0, 1)) / self.scale)

    def margins(self, x: np.ndarray) -> np.ndarray:
        """Return distances (m,) from all limits, relative to their size; negative where a limit is violated."""
        return np.asarray(self.all_margins(x[None])[0])

    def all_margins(self, points: np.ndarray) -> np.ndarray:
        """Return the margins (N, m) at points (N, n)."""
        values = self.evaluator.values(points)
        columns = []
        for bound, size in zip(self.bounds, self._sizes, strict=True):
            columns += [side * (bound.of(values) - limit) / size for side, limit in _sides(bound)]
        found = np.nan_to_num(np.array(columns).T, nan=-FAILED) if columns else np.zeros((len(points), 0))
        return np.hstack([found, product(self._rows, points.T).T + self._offsets])

    def margin_slopes(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives (m, n) of the margins."""
        by_variable = self._derivatives(x) if self.bounds else np.zeros(0)
        rows = []
        for bound, size in zip(self.bounds, self._sizes, strict=True):
            slope = np.sum(bound.weights[..., None] * by_variable, axis=(0, 1))
            rows += [side * slope / size for side, _ in _sides(bound)]
        return np.vstack([*rows, self._rows])

    def worth(self, points: np.ndarray) -> list[tuple[float, float]]:
        """Return the violation of limits and the cost of points (N, n); points are compared in this order.

        The violation is 0 where all limits are satisfied, and at least `FAILED` where a run fails.
        """
        costs = self.costs(points, failed=np.nan)
        violation = np.sum(np.maximum(-self.all_margins(points) - FEASIBLE, 0.0), axis=1)
        violation += np.where(np.isnan(costs), FAILED, 0.0)
        return list(zip(violation.tolist(), np.nan_to_num(costs, nan=FAILED).tolist(), strict=True))

    def is_feasible(self, x: np.ndarray) -> bool:
        """Return whether no run fails at a point, and all limits are satisfied."""
        return self.worth(x[None])[0][0] == 0.0

    def _derivatives(self, x: np.ndarray) -> np.ndarray:
        # optimisers request the derivatives of goals and of limits separately
        if self._differentiated[0] != x.tobytes():
            self._differentiated = x.tobytes(), np.nan_to_num(derivatives(self.evaluator, x))
        return self._differentiated[1]


def goal_weights(evaluator: Evaluator, goal: int) -> np.ndarray:
    """Return the weights (S, K) of goals and limits whose weighted sum is a goal of the design."""
    situations = evaluator.spec.situations.values()
    weights = np.zeros((len(situations), len(evaluator.names)))
    weights[:, goal] = [situation.weight for situation in situations]
    return weights


def _limits(evaluator: Evaluator) -> list[Bound]:
    """Return the limits of a design in every scenario."""
    bounds = []
    for row in range(len(evaluator.spec.situations)):
        for name, limit in evaluator.spec.subject_to.items():
            weights = np.zeros((len(evaluator.spec.situations), len(evaluator.names)))
            weights[row, evaluator.names.index(name)] = 1.0
            bounds.append(Bound(weights, *limit.ends))
    return bounds


def _of_tables(evaluator: Evaluator) -> tuple[np.ndarray, np.ndarray]:
    """Return the margins of slopes and curvatures of tables as linear functions (R, n), (R,) of the shares."""
    names, rows, offsets = [*evaluator.spec.chosen], [np.zeros((0, len(evaluator.widths)))], [np.zeros(0)]
    for one in evaluator.spec.tables.values():
        places = [names.index(key) for key in one.keys]
        for _, combinations, low, high in one.rows:
            size = max(abs(low), abs(high))
            by_share = np.zeros((len(combinations), len(names)))
            np.add.at(by_share.T, places, (combinations * evaluator.widths[places] / size).T)
            rows += [by_share, -by_share]
            offsets += [np.full(len(by_share), -low / size), np.full(len(by_share), high / size)]
    return np.vstack(rows), np.concatenate(offsets)


def _size(bound: Bound, first: float) -> float:
    """Return the magnitude to which the margins of a limit are relative; `first` is the value at the start."""
    return max([abs(x) for x in (bound.low, bound.high, first) if np.isfinite(x)], default=1.0) or 1.0


def _sides(bound: Bound) -> list[tuple[float, float]]:
    """Return the sign and the value of each limit of a bound."""
    return [(side, limit) for side, limit in ((1.0, bound.low), (-1.0, bound.high)) if np.isfinite(limit)]
