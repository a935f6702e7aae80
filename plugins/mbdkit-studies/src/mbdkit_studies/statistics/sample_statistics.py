"""Mean, standard deviation, quantiles and correlation of a random sample, with confidence intervals; those of a measure
over the runs of a study.

The values of a member of the sample may depend on each other, as those of the runs of a Saltelli design do. The
intervals therefore treat members, not values, as independent. In quasi-random samples the errors are usually smaller
than the intervals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import has_exponent
from mbdkit_studies.points.planned_points import Label
from mbdkit_studies.statistics.sample_groups import SampleGroup, measured, one_group
from mbdkit_studies.store.study_runs import StudyRuns

QUANTILES = (0.05, 0.5, 0.95)
FEWEST = 3  #: Smallest number of values that have statistics.

CONFIDENCE = 0.95  #: Probability of the intervals, by default.


@dataclass(frozen=True)
class Estimate:
    """A number that is estimated from a sample, with its confidence interval.

    Attributes
    ----------
    value
        The estimate.
    low, high
        Ends of the interval; -inf or inf if the sample is too small to determine them.
    """

    value: float
    low: float
    high: float

    def text(self, unit: str = "", most_decimals: int = 12) -> str:
        """Return the number, its interval and its unit, with the digits that the interval justifies, such as
        ``350 (347 to 353) N``.
        """
        known = [abs(end - self.value) for end in (self.low, self.high) if math.isfinite(end)]
        width = sum(known) / len(known) if known else 0.0
        ends = (self.value, self.low, self.high)
        value, low, high = (_rounded(one, self.value, width, most_decimals) for one in ends)
        if not known:
            told = f"{self.value:.3g} (interval unknown)"
        elif value == low == high:
            told = value
        elif not math.isfinite(self.low):
            told = f"{value} (at most {high})"
        elif not math.isfinite(self.high):
            told = f"{value} (at least {low})"
        else:
            told = f"{value} ({low} to {high})"
        return f"{told} {unit}".rstrip()


def _rounded(number: float, value: float, width: float, most_decimals: int) -> str:
    """Return a number with about one and a half significant digits of the half-width of an interval around `value`."""
    if not math.isfinite(number):
        return ""
    if width <= 1e-12 * abs(value):
        return f"{number:.6g}"
    first, place = math.floor(math.log10(max(abs(value), width))), math.floor(math.log10(width / 3))
    if has_exponent(first):
        return f"{number:.{max(0, first - place)}e}"
    return f"{round(number, -place) + 0.0:.{min(max(0, -place), most_decimals)}f}"


def mean(values: np.ndarray, confidence: float = CONFIDENCE) -> Estimate:
    """Return the mean of the values that are not nan, with an interval by Student's distribution.

    Parameters
    ----------
    values
        (C, R) values of C members.
    confidence
        Probability of the interval.
    """
    known = np.isfinite(values)
    found = float(np.mean(values[known]))
    rest = np.sum(np.where(known, values - found, 0.0), axis=1)
    half = _student(len(_members(values)), confidence) * _error(rest, known)
    return Estimate(found, found - half, found + half)


def standard_deviation(values: np.ndarray, confidence: float = CONFIDENCE) -> Estimate:
    """Return the standard deviation of the values (C, R) that are not nan.

    The interval is that of the jackknife of the logarithm of the variance [1]_, which does not assume a normal
    distribution.

    References
    ----------
    .. [1] R. G. Miller, "Jackknifing variances", Annals of Mathematical Statistics 39 (1968) 567-582.
    """
    known = np.isfinite(values)
    total = np.sum(known)
    centred = np.where(known, values - np.mean(values[known]), 0.0)
    found = float(np.sqrt(np.sum(centred**2) / (total - 1)))
    chosen = _members(values)
    left = total - np.sum(known[chosen], axis=1)
    sums, squares = -np.sum(centred[chosen], axis=1), np.sum(centred**2) - np.sum(centred[chosen] ** 2, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        variances = (squares - sums**2 / left) / (left - 1)
        logarithms = np.log(variances)
    if len(chosen) < 3 or not np.all(np.isfinite(logarithms)):
        return Estimate(found, -np.inf, np.inf)
    count = len(chosen)
    error = np.sqrt((count - 1) / count * np.sum((logarithms - np.mean(logarithms)) ** 2))
    ratio = math.exp(0.5 * min(_student(count, confidence) * error, 700.0))
    return Estimate(found, found / ratio, found * ratio)


def quantile(values: np.ndarray, probability: float, confidence: float = CONFIDENCE) -> Estimate:
    """Return a quantile of the values (C, R) that are not nan.

    The ends of the interval are order statistics, so that the interval holds for any distribution. If values of a
    member depend on each other, the number of values is replaced by the number of independent values that has the same
    variance of the share of values below the quantile.
    """
    from scipy.special import bdtr

    known = np.isfinite(values)
    ordered = np.sort(values[known])
    total, found = len(ordered), float(np.quantile(ordered, probability))
    independent = total
    if np.any(np.sum(known, axis=1) > 1):
        below = np.where(known, (values <= found) - np.mean(ordered <= found), 0.0)
        plain = probability * (1 - probability) / total
        independent = int(total / max(1.0, _error(np.sum(below, axis=1), known) ** 2 / plain))
    tail = (1 - confidence) / 2
    ranks = np.arange(independent + 1)
    under = bdtr(ranks, independent, probability)  # under[k]: at most k values are below the quantile
    low, high = int(np.searchsorted(under, tail, side="right")), int(np.searchsorted(under, 1 - tail)) + 1
    scale = total / max(independent, 1)
    return Estimate(
        found,
        float(ordered[max(0, math.floor(low * scale) - 1)]) if low >= 1 else -np.inf,
        float(ordered[min(total, math.ceil(high * scale)) - 1]) if high <= independent else np.inf,
    )


def squared_correlation(x: np.ndarray, y: np.ndarray, confidence: float = CONFIDENCE) -> Estimate:
    """Return the squared correlation of two variables (N,), the share of the variance that a linear fit explains.

    The interval is that of the correlation in Fisher's transformation, with a standard error that does not assume a
    normal distribution [1]_. Its lower end is 0 if the sign of the correlation is unknown.

    References
    ----------
    .. [1] D. L. Hawkins, "Using U statistics to derive the asymptotic distribution of Fisher's Z statistic", The
       American Statistician 43 (1989) 235-237.
    """
    a, b = ((one - np.mean(one)) / np.std(one) for one in (x, y))
    correlation = float(np.clip(np.mean(a * b), -1.0, 1.0))
    rest = 1 - correlation**2
    if len(x) < 3:
        return Estimate(correlation**2, 0.0, 1.0)
    if rest < 1e-12:
        return Estimate(correlation**2, correlation**2, correlation**2)
    influence = a * b - 0.5 * correlation * (a * a + b * b)
    error = float(np.std(influence, ddof=1)) / math.sqrt(len(x)) / rest
    half = _student(len(x) - 1, confidence) * error
    low, high = (math.tanh(math.atanh(correlation) + change) for change in (-half, half))
    least = 0.0 if low * high <= 0 else min(low**2, high**2)
    return Estimate(correlation**2, least, max(low**2, high**2))


def _members(values: np.ndarray) -> np.ndarray:
    """Return the indices of the members (C, R) that have a value."""
    return np.flatnonzero(np.any(np.isfinite(values), axis=1))


def _error(rest: np.ndarray, known: np.ndarray) -> float:
    """Return the standard error of a mean, from the sums (C,) of the differences from the mean of each member, and from
    which values are known (C, R); inf for less than two members.
    """
    count = int(np.sum(np.any(known, axis=1)))
    return math.sqrt(count / (count - 1) * float(np.sum(rest**2))) / float(np.sum(known)) if count > 1 else math.inf


def _student(count: int, confidence: float) -> float:
    """Return the quantile of Student's distribution for an interval from `count` members."""
    from scipy.special import stdtrit

    return float(stdtrit(max(count - 1, 1), (1 + confidence) / 2))


@dataclass(frozen=True)
class MeasureStatistics:
    """Statistics of a measure over the runs of a study, with confidence intervals.

    Attributes
    ----------
    measure, unit
        Name and unit of the measure.
    mean, std
        Mean and standard deviation (`Estimate`: `value`, `low`, `high`).
    quantiles
        Quantiles by probability.
    confidence
        Probability of each interval.
    runs
        Number of runs that are used: those that are complete, are not rated bad, and have a value.
    bad
        Number of complete runs that are left out because they are rated bad.
    mean_with_bad
        Mean of the runs including those that are rated bad.
    """

    measure: str
    unit: str
    mean: Estimate
    std: Estimate
    quantiles: Mapping[float, Estimate]
    confidence: float
    runs: int
    bad: int
    mean_with_bad: float

    def __str__(self) -> str:
        lines = [("mean", self.mean), ("standard deviation", self.std)]
        lines += [(f"{100 * q:g} % quantile", quantile) for q, quantile in self.quantiles.items()]
        text = [f"{self.measure}: {self.runs} runs, {100 * self.confidence:g} % intervals"]
        return "\n".join([*text, *(f"{name:<18}  {found.text(self.unit)}" for name, found in lines)])


def statistics(
    study: StudyRuns, measure: str, *, where: Mapping[str, Label] | None = None, confidence: float = CONFIDENCE
) -> MeasureStatistics:
    """Return the statistics of a measure; see `Study.statistics`."""
    if not study.spec.is_sampled:
        raise MbdkitError("statistics need a sample: the values on the axes of a study are not drawn at random")
    if not 0 < confidence < 1:
        raise MbdkitError(f"the confidence should be a probability between 0 and 1, such as 0.95, not {confidence!r}")
    if (group := statistics_of_group(study, one_group(study, where), measure, confidence)) is None:
        needed = f"at least {FEWEST} complete runs that are not rated bad"
        raise MbdkitError(f"statistics need values of '{measure}' from {needed}")
    return group


def statistics_of_group(
    study: StudyRuns, group: SampleGroup, measure: str, confidence: float = CONFIDENCE
) -> MeasureStatistics | None:
    """Return the statistics of a measure over the runs of one sample; None if fewer than `FEWEST` runs have a value."""
    sample = study.spec.sample
    runs_of_member = 1 if sample is None else sample.runs_of_member
    values = measured(study, measure, group.places).reshape(-1, runs_of_member)
    if (count := int(np.sum(np.isfinite(values)))) < FEWEST:
        return None
    every = measured(study, measure, group.places, with_bad=True)
    known = every[np.isfinite(every)]
    return MeasureStatistics(
        measure=measure,
        unit=study.described(measure)[0].removesuffix("1"),
        mean=mean(values, confidence),
        std=standard_deviation(values, confidence),
        quantiles={q: quantile(values, q, confidence) for q in QUANTILES},
        confidence=confidence,
        runs=count,
        bad=len(known) - count,
        mean_with_bad=float(np.mean(known)),
    )
