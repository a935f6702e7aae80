"""Sobol indices of the Ishigami function against the analytic ones and against scipy.stats."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats
from tests.analysis.ishigami import FIRST, TAIL_SHARES, TOTAL, tail, values

from mbdkit_studies.statistics.sobol_indices import SobolIndices, sobol_indices


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
    assert errors[3] < 1e-3


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
