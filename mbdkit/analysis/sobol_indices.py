"""Sobol sensitivity indices from a Saltelli design, with confidence intervals by the bootstrap."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

RESAMPLES = 1000
"""Number of bootstrap samples. With 1000 samples, 25 values lie beyond each end of a 95 % interval."""

ROUND_OFF = 1e-13
"""Values count as equal if their range is at most this share of their largest magnitude."""


@dataclass(frozen=True, eq=False)
class SobolIndices:
    """First-order and total Sobol indices of d variables.

    Attributes
    ----------
    first, total
        (d,) share of the variance that each variable explains alone, and share that it explains alone and by
        interactions with other variables.
    first_low, first_high, total_low, total_high
        (d,) ends of the confidence intervals.
    """

    first: np.ndarray
    first_low: np.ndarray
    first_high: np.ndarray
    total: np.ndarray
    total_low: np.ndarray
    total_high: np.ndarray

    def informative(self) -> SobolIndices:
        """Return the indices with nan for those whose intervals cover 0 to 1, and so contain no information."""
        first, total = (
            np.where((low <= 0.0) & (high >= 1.0), np.nan, value)
            for value, low, high in (
                (self.first, self.first_low, self.first_high),
                (self.total, self.total_low, self.total_high),
            )
        )
        return replace(self, first=first, total=total)


def members_for(members: int, width: float, wanted: float) -> int:
    """Return the number of members, a power of 2, that gives intervals of about the width `wanted` instead of `width`.

    The standard error of the estimates is inversely proportional to the root of the number of members.
    """
    return int(2 ** math.ceil(math.log2(members * (width / wanted) ** 2)))


def sobol_indices(
    values: np.ndarray, *, confidence: float = 0.95, resamples: int = RESAMPLES, seed: int = 0
) -> SobolIndices:
    """Return the Sobol indices of values from a Saltelli design.

    First-order indices are estimated by formula (b) in table 2 of [1]_, total indices by formula (f) of that table,
    which is from [2]_. `scipy.stats.sobol_indices` uses the same formulas. Intervals are bootstrap quantiles over the
    rows, which are treated as independent, with the correction for few rows of [3]_. For a Sobol or Halton sequence,
    the actual errors are smaller.

    `scipy.stats.sobol_indices` itself cannot be used. It requires that the number of rows is a power of 2, but rows
    with a failed run are left out here. It also returns 0 instead of nan if all values are equal.

    Parameters
    ----------
    values
        (n, d + 2) finite values. Each row contains the values at a point of matrix A, at one of matrix B, and at the d
        points of A in which one coordinate is replaced by that of B.
    confidence
        Probability of the intervals.
    resamples
        Number of bootstrap samples.
    seed
        Seed of the bootstrap.

    Returns
    -------
    SobolIndices
        The indices; nan if all values are equal except for rounding errors.

    References
    ----------
    .. [1] A. Saltelli, P. Annoni, I. Azzini, F. Campolongo, M. Ratto and S. Tarantola, "Variance based sensitivity
       analysis of model output. Design and estimator for the total sensitivity index", Computer Physics Communications
       181 (2010) 259-270.
    .. [2] M. J. W. Jansen, "Analysis of variance designs for model output", Computer Physics Communications 117 (1999)
       35-43.
    .. [3] T. C. Hesterberg, "What teachers should know about the bootstrap", The American Statistician 69 (2015)
       371-386.
    """
    from scipy.special import ndtr, stdtrit

    if np.ptp(values) <= ROUND_OFF * np.max(np.abs(values)):
        unknown = np.full(values.shape[1] - 2, np.nan)
        return SobolIndices(unknown, unknown, unknown, unknown, unknown, unknown)
    terms = _terms(values)
    first, total = _indices(np.mean(terms, axis=0)[None])
    random, n = np.random.default_rng(seed), len(values)
    means = np.empty((resamples, terms.shape[1]))
    for index in range(resamples):
        chosen = np.bincount(random.integers(0, n, n), minlength=n)
        means[index] = chosen @ terms / n
    # Plain quantiles of the bootstrap give intervals that are too short by a factor of about sqrt(1 - 1/n).
    lower = float(ndtr(stdtrit(n - 1, (1 - confidence) / 2) * np.sqrt(n / (n - 1))))
    ends = lower, 1 - lower
    with np.errstate(invalid="ignore"):
        (low, high), (total_low, total_high) = (np.quantile(index, ends, axis=0) for index in _indices(means))
    return SobolIndices(first[0], low, high, total[0], total_low, total_high)


def _terms(values: np.ndarray) -> np.ndarray:
    """Return the terms whose means give the indices, (n, 2 + 2 d)."""
    centred = values - np.mean(values[:, :2])  # a large mean would cause large errors of the first-order estimator
    a, b, mixed = centred[:, :1], centred[:, 1:2], centred[:, 2:]
    return np.hstack([(a + b) / 2, (a * a + b * b) / 2, b * (mixed - a), (a - mixed) ** 2 / 2])


def _indices(means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return first-order and total indices, (R, d) each, from means of the terms (R, 2 + 2 d)."""
    variance = means[:, 1:2] - means[:, :1] ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = np.where(variance > 0, means[:, 2:] / variance, np.nan)
    d = shares.shape[1] // 2
    return shares[:, :d], shares[:, d:]
