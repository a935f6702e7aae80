"""Intervals of estimates: linear ones from the covariance, and profiles of the likelihood.

A profile is the smallest sum of squares with a fixed value of one parameter, or of one expression of parameters. The
limits of the interval are where it exceeds the minimum by the square of the quantile of Student's distribution; see
A. Raue et al., Bioinformatics 25 (2009) 1923-1929, and D. M. Bates, D. G. Watts, Nonlinear Regression Analysis and Its
Applications (1988), 6.1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from mbdkit_identify.estimation import Fit
from mbdkit_identify.identification import Profile
from mbdkit_identify.problem import FAILED, Problem

MOST_STEPS = 25
"""Largest number of points of one side of a profile."""
MOST_ITERATIONS = 30
CLOSE = 2e-3
"""Relative distance of the increase at a limit from the threshold."""
SMALL = 1e-4
"""A point of a profile is found when a further step would reduce its increase by less than this share of the threshold.
"""
FAR = 100.0
"""A side has no limit if it is not reached within this many standard deviations."""


@dataclass(frozen=True)
class Goal:
    """A function of the unknowns whose interval is computed.

    Attributes
    ----------
    name
        Name of the parameter or expression.
    value, slope
        Functions of the unknowns (n,) that return it, and its derivatives (n,).
    low, high
        Bounds of the value.
    """

    name: str
    value: Callable[[np.ndarray], float]
    slope: Callable[[np.ndarray], np.ndarray]
    low: float = -np.inf
    high: float = np.inf


def covariance_of(jacobian: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return the covariance (n, n) of unknowns from derivatives (R, n) of whitened residuals; 0 for those at bounds."""
    found = np.zeros((len(free), len(free)))
    j = jacobian[:, free]
    scale = np.linalg.norm(j, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    inverse = np.linalg.pinv(j / scale, rcond=1e-12)
    found[np.ix_(free, free)] = (inverse @ inverse.T) / np.outer(scale, scale)
    return found


def freedom_of(fit: Fit) -> float:
    """Return the degrees of freedom of the residuals."""
    return max(float(len(fit.white) - np.sum(fit.free)), 1.0)


def quantile(level: float, freedom: float) -> float:
    """Return the half width of an interval in standard deviations."""
    return float(student.ppf(0.5 * (1.0 + level), freedom))


def profile_of(
    problem: Problem, fit: Fit, goal: Goal, covariance: np.ndarray, level: float
) -> tuple[float, float, Profile]:
    """Return the limits of the interval of a goal, infinite where there is none, and its profile."""
    threshold = quantile(level, freedom_of(fit)) ** 2
    slope, best = goal.slope(fit.x), goal.value(fit.x)
    deviation = float(np.sqrt(max(slope @ covariance @ slope, 0.0)))
    points: list[tuple[float, float]] = [(best, 0.0)]
    limits = []
    for side in (-1.0, 1.0):
        limit, some = _limit(problem, fit, goal, covariance, deviation, side, threshold)
        limits.append(limit)
        points += some
    values, costs = np.array(sorted(points)).T
    return limits[0], limits[1], Profile(goal.name, values, costs, threshold)


def _limit(
    problem: Problem, fit: Fit, goal: Goal, covariance: np.ndarray, deviation: float, side: float, threshold: float
) -> tuple[float, list[tuple[float, float]]]:
    """Return the limit of one side, and the points (value, increase) of the profile that were computed."""
    best, root = goal.value(fit.x), np.sqrt(threshold)
    bound = goal.low if side < 0 else goal.high
    if deviation == 0.0:
        deviation = 1e-3 * max(abs(best), 1e-3)
    points: list[tuple[float, float]] = []
    inner, outer = (0.0, 0.0), (np.inf, np.inf)  # distance, root of the increase
    distance, x = root * deviation, fit.x
    for _ in range(MOST_STEPS):
        distance = min(distance, abs(bound - best))
        value = best + side * distance
        found = _constrained(problem, fit, goal, value, x, covariance, threshold)
        increase = np.inf if found is None else max(found[0] - fit.cost, 0.0)
        if found is not None:
            points.append((value, increase))
        if abs(increase - threshold) <= CLOSE * threshold:
            return value, points
        at = distance, float(np.sqrt(increase))
        if increase < threshold:
            inner, x = at, found[1] if found is not None else x
            if value == bound or distance > FAR * deviation:
                return side * np.inf, points
        else:
            outer = at
        if np.isinf(outer[0]):
            ratio = root / max(inner[1], 1e-3 * root)
            distance = inner[0] * float(np.clip(ratio, 1.05, 3.0))
        elif np.isinf(outer[1]):  # the run fails there
            distance = 0.5 * (inner[0] + outer[0])
            if outer[0] - inner[0] < 1e-3 * outer[0]:
                return side * np.inf, points
        else:
            share = (root - inner[1]) / (outer[1] - inner[1])
            distance = inner[0] + float(np.clip(share, 0.05, 0.95)) * (outer[0] - inner[0])
    return best + side * distance, points


def _constrained(
    problem: Problem,
    fit: Fit,
    goal: Goal,
    value: float,
    x: np.ndarray,
    covariance: np.ndarray,
    threshold: float,
) -> tuple[float, np.ndarray] | None:
    """Return the smallest sum of squares with a fixed value of the goal, and the unknowns; None if the run fails.

    Gauss-Newton iterations use the derivatives at the best fit as long as they converge, and then those at the point.
    """
    low, high = problem.bounds
    jacobian, is_own = fit.jacobian, False
    best: tuple[float, np.ndarray] | None = None
    last = np.inf
    for _ in range(MOST_ITERATIONS):
        slope = goal.slope(x)
        free = (x > low) & (x < high) & fit.free | (slope != 0.0)
        x = np.clip(_on_goal(x, goal, value, covariance), low, high)
        white = problem.residuals(x)
        cost = float(white @ white)
        if np.any(np.abs(white) >= FAILED):
            return best
        if best is None or cost < best[0]:
            best = cost, x
        step = _step(jacobian[:, free], white, slope[free])
        gain = float(np.sum((jacobian[:, free] @ step) ** 2))
        if gain < SMALL * threshold:
            return best
        if gain > 0.3 * last or cost > best[0]:  # converges too slowly
            if is_own and cost > best[0]:
                step *= 0.5
            jacobian, is_own = problem.jacobian(best[1]), True
            if cost > best[0]:
                x, last = best[1], np.inf
                white = problem.residuals(x)
                step = 0.5 * _step(jacobian[:, free], white, goal.slope(x)[free])
                x = x.copy()
                x[free] += step
                continue
        last = gain
        x = x.copy()
        x[free] += step
    return best


def _on_goal(x: np.ndarray, goal: Goal, value: float, covariance: np.ndarray) -> np.ndarray:
    """Return the unknowns moved such that the goal has a value, along the direction in which costs grow least."""
    for _ in range(20):
        slope = goal.slope(x)
        lack = value - goal.value(x)
        along = covariance @ slope
        if not np.any(along):
            along = slope
        change = lack / float(slope @ along) * along
        x = x + change
        if np.all(np.abs(change) <= 1e-12 * np.maximum(np.abs(x), 1e-12)):
            break
    return x


def _step(jacobian: np.ndarray, white: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return the Gauss-Newton step that does not change the goal to first order."""
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    j, s = jacobian / scale, slope / scale
    size = np.linalg.norm(s)
    if size == 0.0 or len(s) == 1:
        return np.zeros(len(s)) if size else np.asarray(-np.linalg.lstsq(j, white, rcond=1e-12)[0] / scale)
    normal = s / size
    basis = np.linalg.qr(np.column_stack([normal, np.eye(len(s))]))[0][:, 1:]
    inner = np.linalg.lstsq(j @ basis, -white, rcond=1e-12)[0]
    return np.asarray(basis @ inner / scale)
