"""Whether intervals of 95 % contain true parameters in 95 % of repeats with other noise.

Shares are compared with exact binomial limits. Models are replaced by polynomials, see `coverage`.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, norm

from tests.margins import assert_within

from .coverage import CORRELATIONS, LEVEL, REACH, Campaign, InterpolatedProblem, Repeats
from .synthetic_cases import synthetic_cases

ACCEPTED = {"linear": (1000, 0.93, 0.97), "profile": (200, 0.90, 0.99)}
"""Repeats, and smallest and largest accepted share, by method: the exact binomial probability that the share of a right
interval is accepted is 0.997 and 0.998.
"""
WIDTH = 1.15
"""Largest mean width, relative to the bound of Cramer and Rao."""


@pytest.fixture(scope="module")
def crank() -> Repeats:
    """The slider-crank with correlated noise."""
    return Repeats(Campaign("slider-crank", "ar"))


def test_polynomials_agree_with_the_model_where_estimates_are(crank: Repeats) -> None:
    # at 4 standard deviations of the best estimates in random directions
    exact = Repeats(Campaign("slider-crank", "ar", is_interpolated=False)).problem
    fast = crank.problem
    assert isinstance(fast, InterpolatedProblem)
    deviation = crank.noises[0].deviation
    for direction in np.random.default_rng(5).normal(size=(3, len(crank.truth))):
        x = crank.truth + fast.factor @ direction * (4.0 / REACH / np.linalg.norm(direction))
        slopes = exact.slopes(x) @ fast.factor
        assert_within(fast.predicted(x) - exact.predicted(x), 1e-3 * deviation)
        assert_within(fast.slopes(x) @ fast.factor - slopes, 1e-2 * deviation)
        assert np.max(np.abs(slopes)) > deviation


def test_intervals_cover_the_truth_unless_correlation_is_ignored(
    crank: Repeats, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Shares of right intervals leave these limits with a probability of 0.1 %. Without correlation, intervals are too
    # narrow by sqrt((1 + phi)/(1 - phi)) where motions are slow (G. E. P. Box, G. M. Jenkins), and cover 59 %.
    def limits(share: float) -> tuple[float, float]:
        low, high = binom.interval(0.999, 100, share)
        return low, high

    least, most = limits(LEVEL)
    found = crank.coverage(range(100))
    covered = found.covers.sum(axis=0)
    assert np.all((least <= covered) & (covered <= most))
    assert np.all(found.widths.mean(axis=0) <= WIDTH)

    phi = CORRELATIONS["ar"]
    low, high = limits(2.0 * norm.cdf(norm.ppf(0.5 * (1.0 + LEVEL)) * np.sqrt((1 - phi) / (1 + phi))) - 1.0)
    monkeypatch.setattr(crank.problem, "may_correlate", [False])
    ignored = crank.coverage(range(100)).covers.sum(axis=0)
    assert np.all((low <= ignored) & (ignored <= high))
    assert high < least


@pytest.mark.slow
@pytest.mark.parametrize("noise", CORRELATIONS)
@pytest.mark.parametrize("case", synthetic_cases())
@pytest.mark.parametrize("method", ACCEPTED)
def test_intervals_of_all_cases_cover_the_truth(case: str, noise: str, method: str) -> None:
    # One redraw, because one of the 36 right intervals of a method is not accepted with a probability of 0.1.
    count, low, high = ACCEPTED[method]
    for seed in (1, 2):
        found = Repeats(Campaign(case, noise, method, seed=seed)).coverage(range(count))
        assert np.all(found.widths.mean(axis=0) <= WIDTH)
        shares = found.covers.mean(axis=0)
        if np.all((low <= shares) & (shares <= high)):
            return
    pytest.fail(f"covered: {dict(zip(found.names, shares, strict=True))}")
