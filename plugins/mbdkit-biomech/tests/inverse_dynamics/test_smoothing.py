"""Smoothing splines with a given parameter, of many series at once, against those of SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_smoothing_spline

from mbdkit_biomech.inverse_dynamics.motion.smoothing import fixed, smoothed
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import SmoothingSpline

RANDOM = np.random.default_rng(0)
EVEN = np.linspace(2.0, 5.0, 151)
UNEVEN = 2.0 + np.cumsum(RANDOM.uniform(0.01, 0.03, 151))


@pytest.mark.parametrize("time", [EVEN, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("parameter", [0.0, 1e-8, 1e-5, 1e-2])
def test_splines_of_many_series_are_those_of_scipy(time: np.ndarray, parameter: float) -> None:
    series = np.sin(3 * time)[:, None] + 0.01 * RANDOM.standard_normal((len(time), 4))
    found = smoothed(time, series, SmoothingSpline(parameter=parameter))
    unit = (time[-1] - time[0]) / (len(time) - 1)  # SciPy loses digits unless intervals are about 1
    for column, x in enumerate(series.T):
        spline = make_smoothing_spline((time - time[0]) / unit, x, lam=parameter / unit**3)
        for order, values in enumerate((found.value, found.rate, found.acceleration)):
            expected = spline((time - time[0]) / unit, order) / unit**order
            np.testing.assert_allclose(values[:, column], expected, rtol=0, atol=1e-8 * np.max(np.abs(expected)))


def test_a_heavy_parameter_leaves_the_straight_line_of_least_squares() -> None:
    series = RANDOM.standard_normal((len(EVEN), 2))
    found = smoothed(EVEN, series, SmoothingSpline(parameter=1e9))
    for column, x in enumerate(series.T):
        line = np.polynomial.Polynomial.fit(EVEN, x, 1)
        np.testing.assert_allclose(found.value[:, column], line(EVEN), atol=1e-6)
        np.testing.assert_allclose(found.rate[:, column], line.deriv()(EVEN), atol=1e-6)


def test_the_parameter_of_cross_validation_gives_the_same_spline() -> None:
    series = np.sin(3 * EVEN)[:, None] + 0.01 * RANDOM.standard_normal((len(EVEN), 1))
    chosen = fixed(EVEN, series, SmoothingSpline())[0]
    again, first = smoothed(EVEN, series, chosen), smoothed(EVEN, series, SmoothingSpline())
    np.testing.assert_allclose(again.value, first.value, rtol=0, atol=1e-6)
