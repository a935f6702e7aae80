"""Sobol indices of the Ishigami function against the analytic ones and against scipy.stats."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from mbdkit.analysis.sobol_indices import SobolIndices, sobol_indices
from mbdkit.spec.sample_section import Sample
from mbdkit.studies.sampled_values import sampled_values

# T. Ishigami and T. Homma, 1990; with a = 7, b = 0.1 the variance is a^2/8 + b pi^4/5 + b^2 pi^8/18 + 1/2.
_A, _B = 7.0, 0.1
_VARIANCE = _A**2 / 8 + _B * np.pi**4 / 5 + _B**2 * np.pi**8 / 18 + 0.5
_OF_1 = 0.5 * (1 + _B * np.pi**4 / 5) ** 2
_OF_2 = _A**2 / 8
_OF_13 = _B**2 * np.pi**8 * (1 / 18 - 1 / 50)
FIRST = np.array([_OF_1, _OF_2, 0.0]) / _VARIANCE
TOTAL = np.array([_OF_1 + _OF_13, _OF_2, _OF_13]) / _VARIANCE


def ishigami(x: np.ndarray) -> np.ndarray:
    """Return the Ishigami function of x (3, N), (N,)."""
    return np.asarray(np.sin(x[0]) + _A * np.sin(x[1]) ** 2 + _B * x[2] ** 4 * np.sin(x[0]))


def values(n: int, method: str = "sobol", seed: int = 1) -> np.ndarray:
    """Return the function in a Saltelli design, (n, 5)."""
    variables = {name: {"uniform": [-np.pi, np.pi]} for name in "abc"}
    sample = Sample(n=n, method=method, seed=seed, design="saltelli", variables=variables)  # type: ignore[arg-type]
    return ishigami(np.array(list(sampled_values(sample).values()))).reshape(n, 5)


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


def test_equal_values_have_no_indices() -> None:
    noise = 1 + 1e-15 * values(32)
    assert np.all(np.isnan(sobol_indices(noise, resamples=5).total))
