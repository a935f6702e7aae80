"""Confidence intervals, linear shares, Sobol indices and costs against known distributions and functions."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import scipy.stats
from tests.analysis.ishigami import FIRST, TAIL_SHARES, TOTAL, tail, values

import mbdkit
from mbdkit_studies.points.sampled_values import sampled_values
from mbdkit_studies.results.cost_at_error import at_equal_work, work_for
from mbdkit_studies.spec.sample_section import Sample
from mbdkit_studies.statistics.sample_statistics import (
    Estimate,
    mean,
    quantile,
    squared_correlation,
    standard_deviation,
)
from mbdkit_studies.statistics.sobol_indices import SobolIndices, sobol_indices
from tests.margins import assert_within

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


def _error(indices: SobolIndices) -> float:
    return float(np.max(np.abs([indices.first - FIRST, indices.total - TOTAL])))


def test_the_indices_are_those_of_scipy() -> None:
    given = 1e6 + values(128)  # the mean is subtracted first
    mine = sobol_indices(given, resamples=1)
    columns = {"f_A": given[:, 0][None], "f_B": given[:, 1][None], "f_AB": given[:, 2:].T[:, None]}
    expected = scipy.stats.sobol_indices(func=columns, n=128)
    assert mine.first == pytest.approx(np.ravel(expected.first_order), abs=1e-7)
    assert mine.total == pytest.approx(np.ravel(expected.total_order), abs=1e-7)


def test_the_indices_of_the_ishigami_function_converge_to_the_analytic_ones() -> None:
    errors = [_error(sobol_indices(values(n), resamples=1)) for n in (64, 512, 4096, 32768)]
    assert errors[0] > errors[1] > errors[2] > errors[3]
    assert_within(errors[3], 1e-3)


@pytest.mark.parametrize("method", ["halton", "latin-hypercube", "random"])
def test_other_samples_give_them_too(method: str) -> None:
    assert _error(sobol_indices(values(16384, method), resamples=1)) < 0.04


def test_intervals_contain_the_analytic_indices_as_often_as_they_say() -> None:
    hits, count = np.zeros((2, 3)), 150
    for seed in range(count):
        found = sobol_indices(values(256, "random", seed), confidence=0.9, resamples=200, seed=seed)
        hits[0] += (found.first_low <= FIRST) & (found.first_high >= FIRST)
        hits[1] += (found.total_low <= TOTAL) & (found.total_high >= TOTAL)
    assert np.all(hits / count > 0.8)  # 0.9, with a standard deviation of 0.025 and a bias of quantile intervals
    assert np.all(hits / count < 0.99)


def test_intervals_of_halton_samples_almost_always_contain_the_analytic_indices() -> None:
    """Of the intervals of `sobol` with 512 members for the first-order index of the third variable, 17 % do not."""
    hits, count = np.zeros((2, 3)), 60
    for seed in range(count):
        found = sobol_indices(values(512, "halton", seed), resamples=100, seed=seed)
        hits[0] += (found.first_low <= FIRST) & (found.first_high >= FIRST)
        hits[1] += (found.total_low <= TOTAL) & (found.total_high >= TOTAL)
    assert np.all(hits / count > 0.95)


def test_intervals_contain_small_total_indices_of_skewed_effects_more_often_than_quantiles_of_the_bootstrap() -> None:
    hits, count = np.zeros(3), 300
    for seed in range(count):
        found = sobol_indices(tail(256, seed), resamples=200, seed=seed)
        hits += (found.total_low <= TAIL_SHARES) & (found.total_high >= TAIL_SHARES)
    assert np.all(hits[:2] / count > 0.9)
    assert hits[2] / count > 0.83  # 0.78 with quantiles; the variance of few lognormal values is mostly too small


def test_a_variable_that_acts_in_no_row_has_the_total_index_zero() -> None:
    without = values(64)
    without[:, 4] = without[:, 0]
    found = sobol_indices(without, resamples=50)
    assert (found.total_low[2], found.total[2], found.total_high[2]) == (0.0, 0.0, 0.0)


def test_equal_values_have_no_indices() -> None:
    noise = 1 + 1e-15 * values(32)
    assert np.all(np.isnan(sobol_indices(noise, resamples=5).total))


WORK = np.array([100.0, 200.0, 400.0, 800.0])
ERROR = 1e6 * WORK**-4.0


def test_cost_of_an_explicit_method_is_four_evaluations_a_step() -> None:
    # expected: Gill's method has four stages, each one evaluation and one factorization
    run = mbdkit.run("pendulum", integrator={"name": "rk-gill"}, time={"steps": 50, "step": 0.01})
    counters = ("steps", "rhs_evaluations", "factorizations", "newton_iterations")
    assert [run.stats[name] for name in counters] == [50, 200, 200, 0]
    assert run.stats["wall_s"] > 0


def test_result_at_equal_work_follows_a_power_law_exactly() -> None:
    assert at_equal_work(WORK, ERROR, 300.0) == pytest.approx(1e6 * 300.0**-4, rel=1e-12)


def test_nothing_is_extrapolated() -> None:
    assert math.isnan(at_equal_work(WORK, ERROR, 1000.0))
    assert math.isnan(at_equal_work(WORK, ERROR, 50.0))
    assert math.isnan(work_for(WORK, ERROR, 1e-8))


def test_work_for_a_result_follows_a_power_law_exactly() -> None:
    assert work_for(WORK, ERROR, 1e6 * 300.0**-4) == pytest.approx(300.0, rel=1e-12)
    assert work_for(WORK, ERROR, 1.0) <= 100.0


def test_work_for_a_result_is_that_from_which_on_it_stays_good() -> None:
    # An accurate run does not count if finer runs are less accurate.
    assert work_for(WORK, [1e-9, 1e-2, 1e-4, 1e-8], 1e-5) > 400.0


def test_runs_that_failed_count_as_too_large() -> None:
    assert work_for(WORK, [math.nan, 1e-5, 1e-6, 1e-7], 1e-4) == 200.0
