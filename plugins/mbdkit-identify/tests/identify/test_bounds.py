"""Intervals near bounds and with robust losses contain the true values, and only right covariances are passed on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from mbdkit_identify.estimation import best_fit, covariance_of
from mbdkit_identify.intervals import Goal, bounded_share, profile_of
from mbdkit_identify.posterior import posterior

from .bounds import LOSSES, repeats, shares
from .regressions import Regression

NO_ANSWERS = ((), (), 0.0)


def sums_of_columns(count: int, seed: int) -> Regression:
    """Return a linear regression of numbers that are zero, and whose estimates must not be negative."""
    random = np.random.default_rng(seed)
    columns = random.standard_normal((count, 60))
    model = lambda x, *numbers: sum(number * column for number, column in zip(numbers, columns, strict=True))  # noqa: E731
    return Regression([*range(60)], random.normal(0.0, 0.1, 60).tolist(), model, (0.1,) * count, *NO_ANSWERS, 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_samples_describe_five_parameters_at_bounds(seed: int) -> None:
    # each is half-normal if its best fit without a bound is near zero, with 0.6 of the deviation
    problem = sums_of_columns(5, seed).problem
    fit = best_fit(problem, 1, 0, "linear")
    found = posterior(problem, fit, np.ones(5, dtype=bool), 0)
    assert found is not None
    mean, covariance = found
    whole = np.sqrt(np.diagonal(covariance_of(fit.jacobian, np.ones(5, dtype=bool))))
    assert np.all((mean > 0.0) & (mean < 2.5 * whole))
    assert np.all(np.sqrt(np.diagonal(covariance)) < 2.0 * whole)


def test_an_expression_may_be_undefined_beyond_a_bound() -> None:
    problem = sums_of_columns(2, 3).problem
    problem.measure(problem.measured + 0.03 * np.random.default_rng(3).standard_normal((2, 60))[0])
    fit = best_fit(problem, 1, 0, "linear")
    assert fit.x[0] > 0.0
    goal = Goal("sqrt", lambda x: float(np.sqrt(x[0])), lambda x: np.array([0.5 / np.sqrt(x[0]), 0.0]))
    covariance = covariance_of(fit.jacobian, np.ones(2, dtype=bool))
    with np.errstate(invalid="ignore"):
        limits = [profile_of(problem, fit, goal, covariance, 0.95, is_linear=one)[:2] for one in (True, False)]
    assert goal.value(fit.x) < limits[0][1] < 1.0
    np.testing.assert_allclose(*limits, rtol=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_an_edge_beyond_which_runs_fail_counts_as_a_bound(seed: int) -> None:
    columns = np.random.default_rng(seed).standard_normal((3, 60))
    data = (columns[0] - 0.05 * columns[1] + np.random.default_rng(seed + 10).normal(0.0, 0.1, 60)).tolist()

    def model(x: np.ndarray, a: complex, b: complex, c: complex) -> np.ndarray:
        return a * columns[0] + (b if np.real(b) >= 0.0 else np.nan * b) * (columns[1] + columns[0]) + c * columns[2]

    free = Regression([*range(60)], data, model, (0.5, 0.5, 0.5), *NO_ANSWERS)
    problems = free.problem, replace(free, lowest=0.0, start=(0.5, 0.5, 0.5)).problem
    problems[1].bounds[0][[0, 2]] = -np.inf  # the plain way: the same fit with the bound stated
    at_edge, at_bound = (best_fit(one, 1, 0, "linear") for one in problems)
    assert at_bound.at_low.tolist() == [False, True, False]
    assert at_edge.at_low.tolist() == at_bound.at_low.tolist()
    np.testing.assert_allclose(at_edge.x, at_bound.x, rtol=1e-6, atol=1e-9)
    assert problems[0].edges == {1: "runs fail if b2 is less than 0"}
    assert not problems[1].edges


@pytest.mark.parametrize("distance", [0.0, 0.3, 1.0, 1.7, 2.5])
def test_an_estimate_near_a_bound_has_the_limits_of_feldman_and_cousins(distance: float) -> None:
    # the likelihood ratio of a normal number that is not negative, by the integral over a fine grid
    x = np.linspace(distance - 8.0, distance + 8.0, 400_001)
    increase = (x - distance) ** 2 - np.minimum(x, 0.0) ** 2
    inside = increase <= bounded_share(distance, 0.95) * norm.ppf(0.975) ** 2
    share = np.sum(norm.pdf(x - distance)[inside]) * (x[1] - x[0])
    assert share == pytest.approx(0.95, abs=3e-4)


@pytest.mark.parametrize(("loss", "count"), [("linear", 24), *((loss, 16) for loss in LOSSES[1:])])
def test_intervals_contain_the_truth_near_a_bound(loss: str, count: int) -> None:
    # 95 % of the intervals of four parameters; fewer than 85 % are more than three standard deviations away
    *covers, _, wrong = shares(repeats(loss, "profile", count))
    assert np.mean(covers) >= 0.85
    assert wrong <= 0.15


@pytest.mark.slow
@pytest.mark.parametrize(("loss", "method"), [("linear", "linear"), *((loss, "profile") for loss in LOSSES)])
def test_coverage_near_a_bound_is_that_of_the_level(loss: str, method: str) -> None:
    *covers, _, wrong = shares(repeats(loss, method, 1000))
    assert min(covers) >= 0.93
    assert max(covers) <= 0.97
    assert wrong <= 0.07  # 5 %, with three standard errors
