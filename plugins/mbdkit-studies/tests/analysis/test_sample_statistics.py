"""Confidence intervals of means, standard deviations, quantiles and linear shares against known distributions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.stats

from mbdkit_studies.points.sampled_values import sampled_values
from mbdkit_studies.spec.sample_section import Sample
from mbdkit_studies.statistics.sample_statistics import (
    Estimate,
    mean,
    quantile,
    squared_correlation,
    standard_deviation,
)

ASKED: tuple[Callable[[np.ndarray], Estimate], ...] = (
    mean, standard_deviation, lambda values: quantile(values, 0.05), lambda values: quantile(values, 0.95),
)  # fmt: skip
SEEDS = 150
"""With this number of samples, the share of intervals that hold has a standard deviation of 0.018."""


def _coverage(draw: Callable[[int], np.ndarray], truth: tuple[float, ...]) -> np.ndarray:
    """Return the share of samples in which each interval contains the truth."""
    hits = np.zeros(4)
    for seed in range(SEEDS):
        values = draw(seed)
        found = [ask(values) for ask in ASKED]
        hits += [one.low <= true <= one.high for one, true in zip(found, truth, strict=True)]
    return hits / SEEDS


@pytest.mark.parametrize(
    "law",
    [scipy.stats.norm(10, 2), scipy.stats.uniform(0, 1), scipy.stats.expon()],
    ids=("normal", "uniform", "exponential"),
)
def test_intervals_hold_as_often_as_they_say(law) -> None:
    truth = law.mean(), law.std(), law.ppf(0.05), law.ppf(0.95)
    assert np.all(_coverage(lambda seed: law.rvs((128, 1), random_state=seed), truth) > 0.88)


@pytest.mark.parametrize(("method", "least", "most"), [("random", 0.88, 0.995), ("sobol", 0.99, 1.0)])
def test_intervals_hold_for_the_runs_of_a_saltelli_design(method, least, most) -> None:
    """The runs of a member share values: intervals that took them as independent would hold in only 80 to 90 %.

    The measure is the product of two variables; its quantiles are those of ten million values.
    """
    speed, mass = scipy.stats.uniform(1, 2), scipy.stats.uniform(1, 3)
    ends = 1.869, 9.417
    truth = speed.mean() * mass.mean()
    square = (speed.var() + speed.mean() ** 2) * (mass.var() + mass.mean() ** 2)

    def draw(seed: int) -> np.ndarray:
        variables = {"speed": {"uniform": [1, 3]}, "mass": {"uniform": [1, 4]}}
        sample = Sample(n=64, method=method, seed=seed, design="saltelli", variables=variables)
        return np.prod(list(sampled_values(sample).values()), axis=0).reshape(64, 4)

    found = _coverage(draw, (truth, float(np.sqrt(square - truth**2)), *ends))
    assert np.all(found >= least)
    assert np.all(found <= most)


def test_the_share_of_a_linear_fit_has_an_interval_that_holds() -> None:
    """For y = 3 a + b with independent variables of equal variance, a explains 9/10, b 1/10, and c nothing."""
    hits = np.zeros(3)
    for seed in range(SEEDS):
        x = np.random.default_rng(seed).uniform(-1, 1, (3, 64))
        found = [squared_correlation(one, 3 * x[0] + x[1]) for one in x]
        hits += [one.low <= true <= one.high for one, true in zip(found, (0.9, 0.1, 0.0), strict=True)]
    assert np.all(hits / SEEDS > 0.88)
    assert np.all(hits / SEEDS < 0.995)


def test_a_small_sample_bounds_a_quantile_on_one_side_only() -> None:
    """The smallest of n values is below the 5 % quantile with a probability of 1 - 0.95^n, above 97.5 % from n = 72."""
    values = scipy.stats.norm.rvs(size=(72, 1), random_state=1)
    assert np.isfinite(quantile(values, 0.05).low)
    few = quantile(values[:71], 0.05)
    assert few.low == -np.inf
    assert few.text("N") == f"{few.value:.2f} (at most {few.high:.2f}) N"
    assert np.isinf(quantile(values[:71], 0.95).high)


def test_values_that_are_not_known_are_left_out() -> None:
    values = np.random.default_rng(1).normal(size=(40, 3))
    holes = np.vstack([values, np.full((9, 3), np.nan)])
    for ask in ASKED:
        assert ask(holes) == ask(values)


@pytest.mark.parametrize(
    ("estimate", "text"),
    [
        (Estimate(368.23, 367.9, 368.5), "368.2 (367.9 to 368.5) N"),
        (Estimate(2760.0, 2310.0, 3310.0), "2800 (2300 to 3300) N"),
        (Estimate(1.2e-5, 1e-5, 1.3e-5), "1.20e-05 (1.00e-05 to 1.30e-05) N"),
        (Estimate(5.12, 4.13, np.inf), "5.1 (at least 4.1) N"),
        (Estimate(7.0, 7.0, 7.0), "7 N"),
        (Estimate(0.01, -0.3, 0.5), "0.0 (-0.3 to 0.5) N"),
    ],
)
def test_numbers_have_the_digits_that_their_intervals_justify(estimate: Estimate, text: str) -> None:
    assert estimate.text("N") == text
