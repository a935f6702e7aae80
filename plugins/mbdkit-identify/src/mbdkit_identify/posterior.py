"""Mean and covariance of parameters near bounds or with curved effects, by samples of their posterior distribution.

The prior is uniform within the bounds. Samples of a wider Student distribution are weighted by their likelihood, and
the next distribution is that of their moments (O. Cappe et al., population Monte Carlo: Journal of Computational and
Graphical Statistics 13 (2004) 907-929), with a power of the weights as long as few samples have most of the weight.
Initial values are integrated out to second order (L. Tierney, J. B. Kadane, Journal of the American Statistical
Association 81 (1986) 82-86).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from mbdkit_identify.estimation import Fit, covariance_of
from mbdkit_identify.intervals import Chord
from mbdkit_identify.problem import Problem

SAMPLES, ROUNDS = 192, 12  #: Number of samples of a round, and largest number of rounds.
FREEDOM = 5.0  #: Degrees of freedom of the distributions that are sampled.
#: Their widths less 1, times the root of the number of parameters, without which most weights of many parameters would
#: be small; the larger one finds out whether few samples lie where much of the weight is.
WIDER = (0.6, 0.6, 3.0)
#: Number of samples by which it is tested whether residuals are linear, and largest share by which increases of the sum
#: of squares are then off; further samples need no runs, and there are up to this multiple of them.
CHECKED, OFF, MORE = 24, 0.1, 16
ENOUGH = 48.0  #: Effective number of samples.
LIKELY = 3.84  #: Increase of the sum of squares up to which values are within an interval of 95 %.
SETTLED = 0.3  #: Largest change of the mean in each of the last two rounds, in standard deviations.
FARTHEST = 2.0  #: Largest distance of the centre of the first samples from a bound, in standard deviations.
MOST_DRAWS = 400  #: Largest number of draws for each sample, of which most may lie beyond the bounds.


def posterior(problem: Problem, fit: Fit, known: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the mean (K,) and the covariance (K, K) of the parameters, or None if samples do not describe them.

    The square of the distance between mean and estimate, which follows from the prior alone, is added to the
    covariance, which is also enlarged until its ellipsoid contains the likely samples: otherwise, bars of predictions
    contain too few true values if parameters are at their bounds, or far from where most of the prior is.

    Parameters
    ----------
    known
        (K,) whether the data determine each parameter; others keep their estimates.
    seed
        Seed of the random numbers.
    """
    count, random = len(known), np.random.default_rng(seed)
    places = np.flatnonzero(known)
    whole = covariance_of(fit.jacobian, np.ones(len(fit.x), dtype=bool))
    low, high = (bound[places] for bound in problem.bounds)
    sizes = np.sqrt(np.diagonal(whole))[places]
    narrower = np.minimum(1.0, (high - low) / sizes)  # where bounds say more than the data
    spread = whole[np.ix_(places, places)] * np.outer(narrower, narrower)
    step = -(whole @ (fit.jacobian.T @ fit.white))[places]  # to the best fit without bounds, which may be far away
    beyond = np.maximum(low - fit.x[places] - step, fit.x[places] + step - high) / (sizes * narrower)
    center = fit.x[places] + step * min(1.0, FARTHEST / max(beyond.max(), 1e-9))
    basis, values, directions = np.linalg.svd(fit.jacobian[:, count:], full_matrices=False)
    some = values > 1e-9 * values.max(initial=0.0)
    follow = -(directions[some].T / values[some]) @ basis[:, some].T @ fit.jacobian[:, places]

    def costs_of(points: np.ndarray, of: Problem | Chord) -> np.ndarray:
        found = []
        for own in points:
            x = fit.x.copy()
            x[places] = own
            x[count:] += follow @ (own - fit.x[places])
            white = of.residuals(x)
            found.append(white @ white - np.sum((basis[:, some].T @ white) ** 2))
        return np.array(found)

    present: Problem | Chord = Chord(problem, fit, True)
    widths, settled = 1.0 + np.array(WIDER) / np.sqrt(len(places)), 0  # number of settled rounds in succession
    for number in range(ROUNDS):
        factor = np.linalg.cholesky(spread + 1e-12 * np.diag(np.diagonal(spread)))
        draws = random.standard_normal((MOST_DRAWS * SAMPLES, len(places)))
        draws *= (random.choice(widths, len(draws)) * np.sqrt(FREEDOM / random.chisquare(FREEDOM, len(draws))))[:, None]
        points = center + draws @ factor.T
        points = points[np.all((points >= low) & (points <= high), axis=1)]
        if len(points) < SAMPLES:
            return None
        points = points[: SAMPLES if present is problem else MORE * SAMPLES]
        costs = costs_of(points, present)
        if number == 0:
            miss = np.abs(costs_of(points[:CHECKED], problem) - costs[:CHECKED])
            if np.any(miss > OFF * (1.0 + costs[:CHECKED] - costs.min())):
                present, points = problem, points[:SAMPLES]
                costs = costs_of(points, problem)
        squares = np.sum(np.linalg.solve(factor, (points - center).T) ** 2, axis=0) / FREEDOM
        by_width = [(1.0 + squares / w**2) ** (-0.5 * (FREEDOM + len(places))) / w ** len(places) for w in widths]
        logs = -0.5 * costs - np.log(np.sum(by_width, axis=0))
        excess = _excess(1.0, logs)
        if number == ROUNDS // 3 and excess < -0.9 * ENOUGH:  # there is no progress
            return None
        weights = _weights(logs if excess >= 0.0 else logs * brentq(_excess, 0.0, 1.0, args=(logs,)))
        last, center = center, weights @ points
        spread = (points - center).T @ (weights[:, None] * (points - center))
        is_near = np.all(np.abs(center - last) <= SETTLED * np.sqrt(np.diagonal(spread)))
        settled = settled + 1 if is_near and excess >= 0.0 else 0
        if settled == 2:
            mean, covariance = fit.x[:count].copy(), np.zeros((count, count))
            mean[places], shift = center, center - fit.x[places]
            spread += np.outer(shift, shift)
            likely = points[:SAMPLES][costs[:SAMPLES] <= costs[:SAMPLES].min() + LIKELY] - center
            farthest = np.max(np.sum(np.linalg.solve(spread, likely.T) * likely.T, axis=0))
            covariance[np.ix_(places, places)] = spread * max(1.0, farthest / LIKELY)
            return mean, covariance
    return None


def _weights(logs: np.ndarray) -> np.ndarray:
    """Return weights (N,) with the sum 1 from their logarithms, up to a constant."""
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


def _excess(power: float, logs: np.ndarray) -> float:
    """Return the effective number of samples with a power of their weights, less that which is enough."""
    return float(1.0 / np.sum(_weights(power * logs) ** 2)) - ENOUGH
