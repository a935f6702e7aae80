"""Intervals near bounds and with robust losses contain the true values, and only right covariances are passed on."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from mbdkit_identify.intervals import bounded_share

from .bounds import LOSSES, repeats, shares


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
