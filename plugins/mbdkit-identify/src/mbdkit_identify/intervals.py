"""Intervals of estimates: linear ones from the covariance, and profiles of the likelihood.

A profile is the smallest sum of squares, or of another loss, within the bounds and with a fixed value of one parameter
or of one expression of parameters. The limits of the interval are where it exceeds the minimum by the square of the
quantile of Student's distribution; see A. Raue et al., Bioinformatics 25 (2009) 1923-1929, and D. M. Bates, D. G.
Watts, Nonlinear Regression Analysis and Its Applications (1988), 6.1. For values near a bound of the parameter itself,
the increase is smaller, such that the intervals contain the true value with the same probability (G. J. Feldman, R. D.
Cousins, Physical Review D 57 (1998) 3873-3889).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm
from scipy.stats import t as student

from mbdkit.plugin import listed
from mbdkit_identify.estimation import Fit, covariance_of, factors, losses
from mbdkit_identify.identification import Profile
from mbdkit_identify.noise import CHANGE
from mbdkit_identify.problem import FAILED, Problem

MOST_STEPS = 25  #: Largest number of points of one side of a profile.
MOST_ITERATIONS = 30
#: Relative distance of the root of the increase from that of the threshold, over which it counts as linear.
CLOSE = 0.015
#: A point of a profile is found when a further step would reduce its increase by less than this share of the threshold.
SMALL = 1e-2
FAR = 100.0  #: A side has no limit if it is not reached within this many standard deviations.
RELATED = 0.1  #: Correlation above which a bound of one parameter affects the interval of another.
CONVEX = ("linear", "soft_l1", "huber")  #: Losses that grow at least linearly.
#: Largest ratio between limits of an interval and linear ones, with which a covariance describes the estimate.
STRAIGHT = 1.25
MISS = 0.02  #: Largest error of the increase by derivatives at the best fit, as a share of the threshold.


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


@dataclass(frozen=True)
class Interval:
    """The interval of a goal: its limits, infinite where there is none; its profile, if it has one; the standard
    deviation without bounds; and why no covariance describes the estimate, empty if one does.
    """

    lower: float
    upper: float
    profile: Profile | None
    deviation: float
    why: str = ""


def interval_of(
    problem: Problem,
    fit: Fit,
    goal: Goal,
    covariance: np.ndarray,
    level: float,
    *,
    is_linear: bool,
    growth: float = 1.0,
) -> Interval:
    """Return the interval of a goal.

    It is a profile unless `is_linear`, and also where the linear interval of a related parameter reaches its bound, and
    for losses that are not convex, with which linear intervals are too narrow.

    Parameters
    ----------
    covariance
        (n, n) covariance of the unknowns without bounds.
    growth
        Factor of the interval; see `Blocks.growth`.
    """
    slope, value, sizes = goal.slope(fit.x), goal.value(fit.x), np.sqrt(np.diagonal(covariance))
    deviation = float(np.sqrt(max(slope @ covariance @ slope, 0.0)))
    reach = growth * quantile(level, max(len(fit.white) - len(fit.x), 1)) * sizes
    low, high = problem.bounds
    near = fit.at_low | fit.at_high | (fit.x - reach < low) | (fit.x + reach > high)
    near &= np.abs(covariance @ slope) >= RELATED * sizes * deviation
    half = growth * quantile(level, freedom_of(problem, fit, slope)) * deviation
    along = half / deviation**2 * (covariance @ slope) if deviation else np.zeros(len(slope))
    is_plain = is_linear and not np.any(near) and fit.loss in CONVEX
    if is_plain and not any(problem.fails(fit.x + side * along) for side in (-1.0, 1.0)):
        lower, upper, profile = value - half, value + half, None
        limit = max((half / max(deviation, 1e-300)) ** 2 * factors(fit)[1], 1e-300)
        lowest = losses(fit.loss, fit.white)[0]
        ends = [losses(fit.loss, problem.residuals(fit.x + side * along))[0] for side in (-1.0, 1.0)]
        ratios = [float(np.sqrt(max(end - lowest, 0.0) / limit)) for end in ends]
    else:
        lower, upper, profile = profile_of(problem, fit, goal, covariance, level, is_linear=is_linear, growth=growth)
        ratios = [abs(one - value) / max(half, 1e-300) for one in (lower, upper)]
    why = ""
    if np.any(near):
        names = [unknown.name for unknown, is_near in zip(problem.unknowns, near, strict=True) if is_near]
        why = f"the interval of {listed(names, 'and')} reaches a bound"
    elif not all(1.0 / STRAIGHT < ratio < STRAIGHT for ratio in ratios):
        why = "its effect on the data is too nonlinear"
    return Interval(lower, upper, profile, growth * deviation, why)


def bounded_share(distance: float, level: float) -> float:
    """Return the share of the increase of a profile at the limits that holds for a value at a distance from a bound.

    Estimates are normal with deviation 1, but not beyond the bound. Values within the limits have a likelihood ratio to
    the best estimate such that they are within them with the probability `level`; see Feldman and Cousins.
    """
    full, half = float(norm.ppf(0.5 * (1.0 + level))) ** 2, float(norm.ppf(level)) ** 2
    if distance >= np.sqrt(full):
        return 1.0

    def lack(increase: float) -> float:
        root = np.sqrt(increase)
        first = -root if root < distance else -(increase + distance**2) / (2.0 * max(distance, 1e-9))
        return float(norm.cdf(root) - norm.cdf(first)) - level

    return float(brentq(lack, half, full)) / full if lack(half) < 0.0 else half / full


def freedom_of(problem: Problem, fit: Fit, slope: np.ndarray) -> float:
    """Return the degrees of freedom of the variance of a function of the unknowns with derivatives `slope` (n,).

    They are twice the square of the variance over the variance of its estimate, which follows from the errors of the
    estimated deviations and correlations of the noise (F. E. Satterthwaite, Biometrics Bulletin 2 (1946) 110-114;
    M. G. Kenward, J. H. Roger, Biometrics 53 (1997) 983-997). Without correlation, a single signal has those of its
    residuals.
    """
    along = covariance_of(fit.jacobian, fit.free | (slope != 0.0)) @ slope
    change, variance, spread = problem.slopes(fit.x) @ along, float(along @ slope), 0.0
    for piece, noise in zip(problem.pieces, problem.noises, strict=True):
        low, own, high = (
            float(np.sum(piece.white(change, some) ** 2)) for some in (noise.moved(-CHANGE), noise, noise.moved(CHANGE))
        )
        spread += 2.0 * own**2 / noise.freedom + ((high - low) / (2.0 * CHANGE) * noise.error) ** 2
    return max(2.0 * variance**2 / spread, 1.0) if spread > 0.0 else np.inf


def quantile(level: float, freedom: float) -> float:
    """Return the half width of an interval in standard deviations."""
    return float(student.ppf(0.5 * (1.0 + level), freedom))


@dataclass(frozen=True)
class Chord:
    """A problem whose derivatives are everywhere those at its best fit, so that they need no runs; if it `is_straight`,
    its residuals are linear, and need none either.
    """

    problem: Problem
    fit: Fit
    is_straight: bool

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds (n,) of the unknowns."""
        return self.problem.bounds

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return the whitened residuals (R + P,) for unknowns (n,)."""
        if not self.is_straight:
            return self.problem.residuals(x)
        white = self.fit.white + self.fit.jacobian @ (x - self.fit.x)
        return np.asarray(np.nan_to_num(white, nan=FAILED, posinf=FAILED, neginf=-FAILED))

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives (R + P, n)."""
        return self.fit.jacobian


def profile_of(
    problem: Problem, fit: Fit, goal: Goal, covariance: np.ndarray, level: float, *, is_linear: bool = False,
    growth: float = 1.0,
) -> tuple[float, float, Profile]:  # fmt: skip
    """Return the limits of the interval of a goal, infinite where there is none, and its profile.

    With `is_linear`, the search begins with linear residuals, and goes on with residuals of runs and derivatives at the
    best fit. Derivatives at its last point confirm it; otherwise, the search goes on with derivatives at each point.
    """
    search = _ProfileSearch(problem, fit, goal, growth**2 * covariance, level)
    search.threshold *= growth**2
    ways: list[Problem | Chord] = [Chord(problem, fit, True), Chord(problem, fit, False)] if is_linear else []
    points: list[tuple[float, float]] = [(search.best, 0.0)]
    limits = []
    for side in (-1.0, 1.0):
        search.last = None
        for way in [*ways, problem]:
            search.problem = way
            limit, some = search.limit(side)
            search.problem = problem
            if isinstance(way, Chord) and not way.is_straight and search.is_confirmed():
                break
        limits.append(limit)
        points += some
    values, costs = np.array(sorted(points)).T
    return limits[0], limits[1], Profile(goal.name, values, costs, search.threshold)


class _ProfileSearch:
    """The search for the limits of the interval of a goal; see `profile_of`.

    `last`: value, sum of losses and unknowns at the end of the latest search, from which the next one begins; None if
    it has ended where runs fail, or where the sum is discontinuous.
    """

    problem: Problem | Chord
    last: tuple[float, float, np.ndarray] | None = None

    def __init__(self, problem: Problem, fit: Fit, goal: Goal, covariance: np.ndarray, level: float):
        self.problem, self.fit, self.goal, self.covariance, self.level = problem, fit, goal, covariance, level
        slope, self.best = goal.slope(fit.x), goal.value(fit.x)
        self.threshold = quantile(level, freedom_of(problem, fit, slope)) ** 2 * factors(fit)[1]
        self.deviation = float(np.sqrt(max(slope @ covariance @ slope, 0.0))) or 1e-3 * max(abs(self.best), 1e-3)

    def limit(self, side: float) -> tuple[float, list[tuple[float, float]]]:
        """Return the limit of one side, and the points (value, increase) of the profile that were computed."""
        best, goal, root = self.best, self.goal, np.sqrt(self.threshold)
        bound = goal.low if side < 0 else goal.high
        points: list[tuple[float, float]] = []
        if best == bound:
            return side * np.inf, points

        def share(value: float) -> float:
            return bounded_share(min(value - goal.low, goal.high - value) / self.deviation, self.level)

        lowest = losses(self.fit.loss, self.fit.white)[0]
        known = [(0.0, 0.0, self.fit.x)]  # distances, roots of the increase, unknowns
        outer = fails = np.inf  # distances at which the increase is too large, and from which runs fail
        first, self.last = self.last, None
        distance = abs(first[0] - best) if first else root * self.deviation
        for number in range(MOST_STEPS):
            distance = min(distance, abs(bound - best))
            value = best + side * distance if distance < abs(bound - best) else bound
            result = self._constrained(value, _between(known, distance) if number or not first else first[2])
            inner = max((one for one in known if one[1] < root), key=lambda one: one[0])
            if result is None:  # the run fails there
                outer = fails = distance
                if outer - inner[0] < 1e-3 * outer:
                    return side * np.inf, points
                distance = 0.5 * (inner[0] + outer)
                continue
            increase = max(result[0] - lowest, 0.0)
            points.append((value, increase))
            at = distance, float(np.sqrt(increase / share(value))), result[1]
            near = min(known, key=lambda one: abs(one[1] - root))
            known.append(at)
            slope = (at[1] - near[1]) / (at[0] - near[0]) if at[0] != near[0] else 0.0
            if abs(at[1] - root) <= CLOSE * root and slope > 0.0:
                self.last = value, *result
                limit = best + side * (distance + (root - at[1]) / slope)
                return limit, [*points, (limit, self.threshold * share(limit))]
            if at[1] < root:
                inner = max(inner, at, key=lambda one: one[0])
                if value == bound or distance > FAR * self.deviation:
                    self.last = value, *result
                    return side * np.inf, points
            else:
                outer = min(outer, distance)
            if outer - inner[0] < 1e-6 * outer:  # the increase is discontinuous there
                return side * np.inf if outer == fails else best + side * outer, points
            if np.isinf(outer):
                distance = inner[0] * float(np.clip(root / max(inner[1], 1e-3 * root), 1.05, 3.0))
            else:
                part = (distance + (root - at[1]) / slope - inner[0]) / (outer - inner[0]) if slope > 0.0 else 0.5
                distance = inner[0] + float(np.clip(part, 0.05, 0.95)) * (outer - inner[0])
        return best + side * distance, points

    def is_confirmed(self) -> bool:
        """Return whether the sum of losses at the end of the latest search is the smallest one, up to a share `MISS` of
        the threshold.
        """
        best = self._constrained(self.last[0], self.last[2], MISS) if self.last else None
        return best is not None and self.last is not None and self.last[1] - best[0] <= MISS * self.threshold

    def _constrained(self, value: float, x: np.ndarray, small: float = SMALL) -> tuple[float, np.ndarray] | None:
        """Return the smallest sum of losses with a fixed value of the goal, and the unknowns; None if the run fails.

        Gauss-Newton steps, with the weights of the loss, are halved as long as they increase the sum. The search ends
        before a step that would reduce it by a `small` share of the threshold, or after two whole steps that have done
        so, as when large residuals let it oscillate.
        """
        problem, (low, high) = self.problem, self.problem.bounds
        best: tuple[float, np.ndarray] | None = None
        step, gain, is_halved, slow = np.zeros(len(x)), 0.0, False, 0  # number of slow steps in succession
        for _ in range(MOST_ITERATIONS):
            x = np.clip(_on_goal(x, self.goal, value, self.covariance), low, high)
            jacobian = problem.jacobian(x)  # before the residuals, which it evaluates too
            white = problem.residuals(x)
            cost, weights = losses(self.fit.loss, white)
            is_failed = bool(np.any(np.abs(white) >= FAILED))
            if is_failed and best is None:
                return None
            if best is not None and (is_failed or cost > best[0]):
                step, gain, is_halved = 0.5 * step, 0.5 * gain, True
                if gain < small * self.threshold:
                    return best
                x = best[1] + step
                continue
            is_slow = best is not None and not is_halved and best[0] - cost < small * self.threshold
            slow = slow + 1 if is_slow else 0
            best, is_halved = (cost, x), False
            if slow == 2:
                return best
            jacobian, white = np.sqrt(weights)[:, None] * jacobian, np.sqrt(weights) * white
            slope, gradient = self.goal.slope(x), jacobian.T @ white
            free = (x > low) & (x < high) | (x <= low) & (gradient < 0) | (x >= high) & (gradient > 0) | (slope != 0.0)
            step, beyond = np.zeros(len(x)), free
            while np.any(beyond):
                step[free] = _step(jacobian[:, free], white + jacobian[:, ~free] @ step[~free], slope[free])
                beyond = free & ((x + step < low) | (x + step > high)) & (slope == 0.0)
                reach = (np.where(step < 0, low, high) - x)[beyond] / step[beyond]  # 0 for those at their bounds
                first = np.flatnonzero(beyond)[reach <= np.min(reach, initial=1.0)]
                step[first] = (np.clip(x + step, low, high) - x)[first]
                free[first] = False
            gain = max(0.0, float(white @ white - np.sum((white + jacobian @ step) ** 2)))
            if gain == 0.0:
                return best
            if gain < small * self.threshold:
                return cost - gain, np.clip(x + step, low, high)
            x = x + step
        return best


def _between(known: list[tuple[float, float, np.ndarray]], distance: float) -> np.ndarray:
    """Return unknowns at a distance, on the line through those at the two nearest distances."""
    first, *others = sorted(known, key=lambda one: abs(one[0] - distance))
    if not others:
        return first[2]
    share = (distance - first[0]) / (others[0][0] - first[0])
    return np.asarray(first[2] + share * (others[0][2] - first[2]))


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
    basis = np.linalg.qr(np.column_stack([s / size, np.eye(len(s))]))[0][:, 1:]
    inner = np.linalg.lstsq(j @ basis, -white, rcond=1e-12)[0]
    return np.asarray(basis @ inner / scale)
