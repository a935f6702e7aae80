"""Estimation: least squares of whitened residuals, alternating with the estimation of the noise of the signals.

Y. Bard, Nonlinear Parameter Estimation (1974); G. A. F. Seber, C. J. Wild, Nonlinear Regression (1989).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from mbdkit.plugin import RunError
from mbdkit_identify.noise import LEAST_DEVIATION, Noise
from mbdkit_identify.problem import FAILED, Problem

#: Relative change of the sum of squares, and of the unknowns, at which a search ends: with the noise that is estimated,
#: with its first guess, and in the last search.
TOLERANCE, ROUGH, FINE = 1e-8, 1e-2, 1e-12
MOST_EVALUATIONS = 200
#: Largest number of alternations between unknowns and noise, and of evaluations in each: a step of the unknowns.
MOST_ROUNDS, FEW_EVALUATIONS = 50, 2
#: Smallest mean square of the influence of residuals, which is less for data without noise.
LEAST_EFFECT = 0.01
SETTLED = 1e-3  #: Relative change of the innovations at which the noise counts as settled.
CLOSE = 0.05  #: Change of a correlation, in standard errors, at which it counts as settled.
#: Reduction of the sum of squares that a search leaves only if runs fail where it leads.
LEFT = 1e-3


NORMAL_MEDIAN = 0.6744897501960817  #: Median of the magnitude of a standard normal number.


@dataclass(frozen=True)
class Fit:
    """The best fit.

    Attributes
    ----------
    x
        (n,) the unknowns.
    white, jacobian
        (R + P,) whitened residuals with priors, and their derivatives (R + P, n).
    cost
        Sum of their squares.
    at_low, at_high
        (n,) whether each unknown is at its lower or upper bound.
    loss
        The loss of residuals.
    is_settled
        Whether the noise has settled.
    """

    x: np.ndarray
    white: np.ndarray
    jacobian: np.ndarray
    cost: float
    at_low: np.ndarray
    at_high: np.ndarray
    loss: str = "linear"
    is_settled: bool = True

    @property
    def free(self) -> np.ndarray:
        """(n,) whether each unknown is between its bounds."""
        return np.asarray(~(self.at_low | self.at_high))

    def further(self, free: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the Gauss-Newton step (n,) of the unknowns that are `free` (n,), without bounds, and by how much it
        reduces the sum of squares to first order.
        """
        gradient = self.jacobian.T @ (losses(self.loss, self.white)[1] * self.white)
        step = -covariance_of(self.jacobian, free) @ gradient
        return step, float(-gradient @ step)


def best_fit(
    problem: Problem, starts: int, seed: int, loss: str, notify: Callable[[str], None] = lambda _: None
) -> Fit:
    """Return the best fit of a problem, and leave the noise that was estimated in it.

    Raises
    ------
    RunError
        If the run fails at every start.
    """
    found: list[tuple[float, np.ndarray]] = []
    reasons = []
    for number, start in enumerate(_starts(problem, starts, seed)):
        if np.all(np.isnan(problem.predicted(start))):
            reasons.append(_why(problem, start))
            continue
        x = _search(problem, start, loss, tolerance=ROUGH)
        cost = float(np.sum(problem.residuals(x) ** 2))
        found.append((cost, x))
        notify(f"start {number + 1} of {starts}: sum of squares {cost:.6g}")
    if not found:
        raise RunError(f"the run fails at the start of the parameters: {reasons[0]}")
    fit = _with_noise(problem, min(found, key=lambda one: one[0])[1], loss, notify)
    for _ in fit.x:
        low, high = problem.bounds
        step, gain = fit.further(fit.free)
        inside = problem.bound_at_edge(fit.x, np.clip(fit.x + step, low, high), LEFT) if gain > LEFT else None
        if inside is None:
            break
        fit = _with_noise(problem, inside, loss, notify)
    return fit


def _with_noise(problem: Problem, x: np.ndarray, loss: str, notify: Callable[[str], None]) -> Fit:
    """Return the best fit near unknowns x (n,), alternating with the estimation of the noise."""
    is_settled, is_moved, most = False, True, FEW_EVALUATIONS
    for number in range(MOST_ROUNDS):
        before = list(problem.noises)
        raw = problem.predicted(x) - problem.measured
        problem.noises = problem.estimated_noises(raw, x)
        if loss != "linear":
            problem.noises = _without_outliers(problem, raw)
        is_settled = _is_settled(before, problem.noises)
        if is_settled and (is_moved or most == MOST_EVALUATIONS):
            break  # noise that follows from the last unknowns again, because a search refused all steps, is not settled
        most = FEW_EVALUATIONS if is_moved else MOST_EVALUATIONS
        last, x = x, _search(problem, x, loss, most)
        is_moved = bool(np.any(x != last))
        notify(f"noise, round {number + 1}: sum of squares {np.sum(problem.residuals(x) ** 2):.6g}")
    x = _search(problem, x, loss, tolerance=FINE)
    return fit_at(problem, x, loss, is_settled=is_settled)


def fit_at(problem: Problem, x: np.ndarray, loss: str = "linear", *, is_settled: bool = True) -> Fit:
    """Return the fit at unknowns x (n,)."""
    jacobian = problem.jacobian(x)  # before the residuals, which it evaluates too
    white = problem.residuals(x)
    low, high = problem.bounds
    close = 1e-6 * np.where(np.isfinite(high - low), high - low, problem.sizes)
    gradient = jacobian.T @ (losses(loss, white)[1] * white)
    at_low, at_high = (x <= low + close) & (gradient >= 0), (x >= high - close) & (gradient <= 0)
    x = np.where(at_low, low, np.where(at_high, high, x))
    return Fit(x, white, jacobian, float(white @ white), at_low, at_high, loss, is_settled)


def covariance_of(jacobian: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return the covariance (n, n) of unknowns from derivatives (R, n) of whitened residuals; 0 for those at bounds."""
    values = np.zeros((len(free), len(free)))
    j = jacobian[:, free]
    scale = np.linalg.norm(j, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    inverse = np.linalg.pinv(j / scale, rcond=1e-12)
    values[np.ix_(free, free)] = (inverse @ inverse.T) / np.outer(scale, scale)
    return values


def losses(loss: str, white: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the sum of the losses of whitened residuals (R,), and the weights (R,) of the least squares with the same
    slope; see `scipy.optimize.least_squares`.
    """
    z = white**2
    if loss == "soft_l1":
        root = np.sqrt(1.0 + z)
        return float(np.sum(2.0 * (root - 1.0))), 1.0 / root
    if loss == "huber":
        root = np.sqrt(np.maximum(z, 1.0))
        return float(np.sum(np.where(z < 1.0, z, 2.0 * root - 1.0))), 1.0 / root
    if loss == "cauchy":
        return float(np.sum(np.log1p(z))), 1.0 / (1.0 + z)
    if loss == "arctan":
        return float(np.sum(np.arctan(z))), 1.0 / (1.0 + z**2)
    return float(np.sum(z)), np.ones_like(z)


def factors(fit: Fit) -> tuple[float, float]:
    """Return the factor of the covariance of least squares for estimates with another loss, and the factor of the
    increase of the sum of losses in place of the sum of squares.

    The first is that of P. J. Huber, Robust Statistics (1981), 7.6; the second follows from the expansion of the sum to
    second order, see E. Ronchetti, Statistics & Probability Letters 1 (1982) 111-114. Both are 1 for least squares.
    """
    if fit.loss == "linear":
        return 1.0, 1.0
    weights, count = losses(fit.loss, fit.white)[1], len(fit.white)
    effect, z = weights * fit.white, fit.white**2
    slope = {
        "soft_l1": weights**3, "huber": (z < 1.0).astype(float), "cauchy": (1.0 - z) * weights**2,
        "arctan": (1.0 - 3.0 * z**2) * weights**2,
    }[fit.loss]  # fmt: skip
    mean, used = float(np.mean(slope)), int(np.sum(fit.free))
    correction = 1.0 + used / count * float(np.var(slope)) / mean**2
    squares = correction**2 * max(float(np.sum(effect**2)) / max(count - used, 1), LEAST_EFFECT)
    return squares / mean**2, squares / mean


def _without_outliers(problem: Problem, raw: np.ndarray) -> list[Noise]:
    """Return the noise with deviations that follow from the medians of the whitened residuals."""
    white = problem.white(raw)
    sizes = [float(np.median(np.abs(white[piece.places]))) / NORMAL_MEDIAN for piece in problem.pieces]
    return [
        noise if known else replace(noise, deviation=max(noise.deviation * size, LEAST_DEVIATION * scale))
        for noise, size, known, scale in zip(problem.noises, sizes, problem.known, problem.scales, strict=True)
    ]


def _search(
    problem: Problem, start: np.ndarray, loss: str, most: int = MOST_EVALUATIONS, tolerance: float = TOLERANCE
) -> np.ndarray:
    """Return the unknowns after a search with at most so many evaluations."""
    low, high = problem.bounds
    inside = np.clip(start, low + 1e-9 * problem.sizes, high - 1e-9 * problem.sizes)
    limits = {"ftol": tolerance, "xtol": tolerance, "gtol": 1e-12}
    return _least_squares(problem, inside, slice(None), loss=loss, max_nfev=most, **limits)


def _least_squares(problem: Problem, start: np.ndarray, places: np.ndarray | slice, **options: Any) -> np.ndarray:
    """Return the unknowns (n,) after a search for those at some `places` (n,), which changes them relative to their
    magnitudes.
    """
    size = problem.sizes[places]
    low, high = (bound[places] / size for bound in problem.bounds)

    def whole(y: np.ndarray) -> np.ndarray:
        x = start.copy()
        x[places] = y * size
        return x

    result = least_squares(
        lambda y: problem.residuals(whole(y)),
        start[places] / size,
        lambda y: problem.jacobian(whole(y))[:, places] * size,
        bounds=(low, high),
        x_scale="jac",
        **options,
    )
    return whole(np.asarray(result.x))


def _starts(problem: Problem, count: int, seed: int) -> list[np.ndarray]:
    """Return the first start, and others whose bounded unknowns are points of a Sobol sequence."""
    first = problem.first
    if count < 2:
        return [first]
    low, high = problem.bounds
    bounded = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
    points = qmc.Sobol(len(bounded), seed=seed).random_base2(int(np.ceil(np.log2(count - 1))) if count > 2 else 0)
    found = np.tile(first, (count, 1))
    found[1:, bounded] = low[bounded] + points[: count - 1] * (high - low)[bounded]
    return list(found)


def _why(problem: Problem, start: np.ndarray) -> str:
    try:
        problem.slopes(start)
    except RunError as error:
        return str(error)
    return "the measured quantities are not finite"


def _is_settled(before: list[Noise], now: list[Noise]) -> bool:
    """Return whether innovations, which whitened residuals are relative to, hardly change, and correlations change by
    little of their errors; if the correlation is close to 1, they determine the deviation of the noise badly.
    """
    return all(
        abs(a.innovation - b.innovation) <= SETTLED * b.innovation
        and (
            abs(a.correlation - b.correlation) * b.deviation <= SETTLED * b.innovation
            or abs(np.arctanh(a.correlation) - np.arctanh(b.correlation)) <= CLOSE * b.error
        )
        for a, b in zip(before, now, strict=True)
    )


def failed(fit: Fit) -> bool:
    """Return whether a run fails at the fit."""
    return bool(np.any(np.abs(fit.white) >= FAILED))


def fit_some(problem: Problem, x: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return unknowns x (n,) of which those at some `places` (n,) are fitted."""
    if not np.any(places):
        return x
    start = np.where(places, np.clip(x, *problem.bounds), x)
    return _least_squares(problem, start, places, ftol=TOLERANCE, xtol=TOLERANCE, max_nfev=MOST_EVALUATIONS)
