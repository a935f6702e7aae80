"""Sobol sensitivity indices from a Saltelli design, with confidence intervals by the bootstrap, and those of a measure
with respect to the variables of a sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.text import listed
from mbdkit_report import data_frame, key_words
from mbdkit_studies.points.planned_points import Label
from mbdkit_studies.statistics.sample_groups import measured, one_group
from mbdkit_studies.statistics.sample_statistics import CONFIDENCE
from mbdkit_studies.store.study_runs import StudyRuns
from mbdkit_studies.texts import ERROR

if TYPE_CHECKING:
    import pandas

#: Number of bootstrap samples. With 1000 samples, 25 values lie beyond each end of a 95 % interval.
RESAMPLES = 1000

ROUND_OFF = 1e-13  #: Values count as equal if their range is at most this share of their largest magnitude.


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

    @property
    def with_intervals(self) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]:
        """First-order and total indices, each with the lower and the upper ends of their intervals."""
        return (self.first, self.first_low, self.first_high), (self.total, self.total_low, self.total_high)

    def informative(self) -> SobolIndices:
        """Return the indices with nan for those whose intervals cover 0 to 1, and so contain no information."""
        first, total = (np.where((low <= 0) & (high >= 1), np.nan, value) for value, low, high in self.with_intervals)
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
    which is from [2]_. `scipy.stats.sobol_indices` uses the same formulas. Intervals are computed by the bootstrap over
    the rows, which are treated as independent. Those of first-order indices are quantiles with the correction for few
    rows of [3]_. Those of total indices are bootstrap-t intervals of their cube roots [4]_, because the estimates of
    small total indices have skewed distributions. For a Halton sequence, the actual errors are smaller. For a Sobol
    sequence, they are mostly smaller, but several times larger in scramblings that align columns of both matrices.

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
    .. [4] B. Efron and R. J. Tibshirani, An introduction to the bootstrap (Chapman and Hall, 1993), chapter 12.
    """
    from scipy.special import ndtr, stdtrit

    if np.ptp(values) <= ROUND_OFF * np.max(np.abs(values)):
        unknown = np.full(values.shape[1] - 2, np.nan)
        return SobolIndices(unknown, unknown, unknown, unknown, unknown, unknown)
    terms = _terms(values)
    random, n = np.random.default_rng(seed), len(values)
    means = np.empty((1 + resamples, terms.shape[1]))
    means[0] = np.mean(terms, axis=0)
    for index in range(1, 1 + resamples):
        means[index] = np.bincount(random.integers(0, n, n), minlength=n) @ terms / n
    first, total = _indices(means)
    # Plain quantiles of the bootstrap give intervals that are too short by a factor of about sqrt(1 - 1/n).
    lower = float(ndtr(stdtrit(n - 1, (1 - confidence) / 2) * np.sqrt(n / (n - 1))))
    ends = lower, 1 - lower
    with np.errstate(invalid="ignore"):
        low, high = np.quantile(first[1:], ends, axis=0)
    total_low, total_high = _bootstrap_t(total, _relative_errors(means), confidence)
    return SobolIndices(first[0], low, high, total[0], total_low, total_high)


def _terms(values: np.ndarray) -> np.ndarray:
    """Return the terms whose means give the indices and the standard errors of total indices, (n, 5 + 5 d).

    They are, with c = (a + b) / 2, s = (a^2 + b^2) / 2 and the squared differences f of the total indices: c, s, c^2,
    s^2, c s, the d products of the first-order indices, f, f^2, f c and f s.
    """
    centred = values - np.mean(values[:, :2])  # a large mean would cause large errors of the first-order estimator
    a, b, mixed = centred[:, :1], centred[:, 1:2], centred[:, 2:]
    c, s, f = (a + b) / 2, (a * a + b * b) / 2, (a - mixed) ** 2 / 2
    return np.hstack([c, s, c * c, s * s, c * s, b * (mixed - a), f, f * f, f * c, f * s])


def _parts(means: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the means (R, 5 + 5 d) of the terms as ten arrays, five of (R, 1) and five of (R, d)."""
    d = means.shape[1] // 5 - 1
    return tuple(np.split(means, [1, 2, 3, 4, 5, 5 + d, 5 + 2 * d, 5 + 3 * d, 5 + 4 * d], axis=1))


def _indices(means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return first-order and total indices, (R, d) each, from means of the terms."""
    c, s, *_, products, f, _, _, _ = _parts(means)
    variance = s - c**2
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(variance > 0, products / variance, np.nan), np.where(variance > 0, f / variance, np.nan)


def _relative_errors(means: np.ndarray) -> np.ndarray:
    """Return the standard errors of total indices as shares of the indices, times the square root of the number of
    rows.

    They are those of the linearized quotient of the mean of f and the variance s - c^2; (R, d).
    """
    c, s, cc, ss, cs, _, f, ff, fc, fs = _parts(means)
    variance = s - c**2
    of_f, of_both = ff - f**2, fs - f * s - 2 * c * (fc - f * c)
    of_variance = ss - s**2 - 4 * c * (cs - c * s) + 4 * c**2 * (cc - c**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        squared = of_f / f**2 - 2 * of_both / (f * variance) + of_variance / variance**2
        return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def _bootstrap_t(total: np.ndarray, errors: np.ndarray, confidence: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the intervals of total indices, (d,) each, from the index and its relative standard error for
    the sample and for R resamples, (1 + R, d) each.

    An upper end above 1 that exceeds the estimate is set to 1, the largest possible index.
    """
    root = np.cbrt(total)
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = (root[1:] - root[0]) / (root[1:] * errors[1:])
        scaled = np.where(np.isnan(scaled), -np.inf, scaled)  # an index of zero, whose error is unknown
        lower, upper = np.quantile(scaled, [(1 - confidence) / 2, (1 + confidence) / 2], axis=0, method="nearest")
        low = np.maximum(root[0] - upper * root[0] * errors[0], 0.0) ** 3
        high = np.maximum(root[0] - lower * root[0] * errors[0], 0.0) ** 3
    high = np.where(np.isnan(high), 1.0, high)
    known = total[0] > ROUND_OFF**2  # otherwise, the variable has no effect in any row
    return np.where(known, low, total[0]), np.where(known, np.minimum(high, np.maximum(1.0, total[0])), total[0])


NARROW = 0.05  #: Width of the intervals of indices for which a note says how many members are needed.


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Sobol indices of a measure.

    Attributes
    ----------
    measure
        Name of the measure.
    variables
        The d variables, as dotted keys of the run spec.
    indices
        Indices of the variables with confidence intervals. `first` and `total` are also attributes of this object.
    confidence
        Probability of the intervals.
    members
        Number of members of the sample that are used: those for which all runs have a value of the measure.
    left_out
        Number of members that are not used, because one of their runs failed, is rated bad or has no value.
    reason
        Sentence that says why all indices are nan; empty otherwise. A single index is also nan if its interval covers 0
        to 1.
    """

    measure: str
    variables: tuple[str, ...]
    indices: SobolIndices
    confidence: float
    members: int
    left_out: int
    reason: str = ""

    @property
    def first(self) -> np.ndarray:
        """(d,) first-order indices: the share of the variance that each variable explains alone."""
        return self.indices.first

    @property
    def total(self) -> np.ndarray:
        """(d,) total indices: the share of the variance that each variable explains alone or together with others."""
        return self.indices.total

    @property
    def note(self) -> str:
        """Sentence on total indices below first-order indices, which are sampling errors; empty if there are none."""
        places = np.flatnonzero(self.total < self.first)
        if not len(places):
            return ""
        ends, several = self.indices, len(places) > 1
        widest = float(np.max(np.maximum(ends.first_high - ends.first_low, ends.total_high - ends.total_low)[places]))
        words = listed([key_words(self.variables[place]) for place in places], "and")
        told = (
            f"The total {'indices' if several else 'index'} of {self.measure} for {words} "
            f"{'are smaller than the first-order indices' if several else 'is smaller than the first-order index'}, "
            f"because of sampling errors: from {self.members} members, the intervals are up to {widest:.2g} wide"
        )
        if not NARROW < widest < math.inf:
            return f"{told}."
        return f"{told}; about sample.n={members_for(self.members, widest, NARROW)} makes them {NARROW:g} wide."

    def to_frame(self) -> pandas.DataFrame:
        """Return a table with a row for each variable.

        Raises
        ------
        MbdkitError
            If pandas is not installed.
        """
        names = ("first", "first_low", "first_high", "total", "total_low", "total_high")
        return data_frame({name: getattr(self.indices, name) for name in names}, self.variables, "variable")

    def __str__(self) -> str:
        width = max(map(len, ("variable", *self.variables)))
        lines = [f"{'variable':<{width}}  {'first order':<26}  total"]
        for index, name in enumerate(self.variables):
            first, total = (
                f"{_shown(value[index])} ({low[index]:.3f} to {high[index]:.3f})"
                for value, low, high in self.indices.with_intervals
            )
            lines.append(f"{name:<{width}}  {first:<26}  {total}")
        return "\n".join([*lines, *filter(None, [self.reason, self.note])])


def _shown(index: float) -> str:
    return "unknown" if np.isnan(index) else f"{index:.3f}"


def sensitivity(
    study: StudyRuns,
    measure: str,
    *,
    where: Mapping[str, Label] | None = None,
    confidence: float = CONFIDENCE,
    members: int | None = None,
    resamples: int = RESAMPLES,
) -> Sensitivity:
    """Return the Sobol indices of a measure; see `Study.sensitivity`."""
    if (sample := study.spec.sample) is None or sample.design != "saltelli":
        message = "Sobol indices need a sample with `design: saltelli`, which creates the runs needed to compute them"
        raise study.spec.placed(SpecError(message, key="sample" if sample is None else "sample.design"))
    if not 0 < confidence < 1:
        raise MbdkitError(f"the confidence should be a probability between 0 and 1, such as 0.95, not {confidence!r}")
    if resamples < 1:
        raise MbdkitError(f"the number of bootstrap samples should be positive, not {resamples!r}")
    if members is not None and not 2 <= members <= sample.n:
        raise MbdkitError(f"the sample has {sample.n} members; choose from 2 to {sample.n} of them, not {members!r}")
    group = one_group(study, where)
    values = measured(study, measure, group.places).reshape(-1, sample.runs_of_member)[:members]
    known = values[np.all(np.isfinite(values), axis=1)]
    if len(known) < 2:
        raise MbdkitError(
            f"Sobol indices need values of '{measure}' from all runs of at least two members of the sample"
        )
    indices = sobol_indices(known, confidence=confidence, resamples=resamples, seed=sample.seed).informative()
    if reason := _within_errors(study, measure, group.places, known):
        indices = sobol_indices(np.zeros_like(known))
    left_out = len(values) - len(known)
    return Sensitivity(measure, tuple(sample.variables), indices, confidence, len(known), left_out, reason)


def _within_errors(study: StudyRuns, measure: str, places: range, values: np.ndarray) -> str:
    """Return a sentence if the variation of values (n, d + 2) can be explained by their errors; otherwise an empty
    text.
    """
    if measure + ERROR not in study.columns():
        return ""
    errors = measured(study, measure + ERROR, places)
    largest, spread = float(np.max(errors[np.isfinite(errors)], initial=0.0)), float(np.ptp(values))
    if spread >= 2.0 * largest:  # the errors at both ends of the range may add up
        return ""
    return f"The values of {measure} differ by {spread:.3g}, within their estimated errors of up to {largest:.3g}."
