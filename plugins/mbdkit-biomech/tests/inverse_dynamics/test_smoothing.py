"""Smoothing splines, interpolating splines and digital filters, against SciPy, mpmath, closed forms and polynomials."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy.interpolate import make_smoothing_spline

from mbdkit_biomech.inverse_dynamics.motion.smoothing import (
    butterworth_coefficients,
    filtered,
    filtered_both_ways,
    fixed,
    single_cutoff,
    smoothed,
    state_after,
)
from mbdkit_biomech.inverse_dynamics.signals.chi_square import LEVEL, quantile
from mbdkit_biomech.inverse_dynamics.signals.interpolating_splines import interpolating_spline
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import SmoothingSpline
from tests.margins import assert_within

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


X = np.cumsum(np.random.default_rng(0).uniform(0.05, 0.2, 14))
FINE = np.linspace(X[0], X[-1], 301)


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_polynomials_of_its_degree_are_reproduced(degree: int) -> None:
    polynomial = np.polynomial.Polynomial([0.3, -1.0, 0.5, 2.0, -1.5, 0.7][: degree + 1])
    middle = (degree - 1) // 2
    orders = range(degree - middle, degree)
    ends = tuple([(order, np.array([polynomial.deriv(order)(x)])) for order in orders] for x in X[[0, -1]])
    for conditions in (None, (ends[0], ends[1])):
        spline = interpolating_spline(X, polynomial(X)[:, None], degree, conditions)
        for order in range(degree):
            expected = (polynomial.deriv(order) if order else polynomial)(FINE)
            np.testing.assert_allclose(spline(FINE, order)[:, 0], expected, atol=1e-12 * 40.0**order)


def test_a_natural_quintic_spline_has_zero_third_and_fourth_derivatives_at_both_ends() -> None:
    values = np.random.default_rng(1).normal(size=(len(X), 2, 3))
    ends = [(3, np.zeros((2, 3))), (4, np.zeros((2, 3)))]
    spline = interpolating_spline(X, values, 5, (ends, ends))
    np.testing.assert_allclose(spline(X), values, atol=1e-13)
    for order in (3, 4):
        largest = np.max(np.abs(spline(FINE, order)))
        np.testing.assert_allclose(spline(X[[0, -1]], order), 0.0, atol=1e-12 * largest)


def test_a_cubic_spline_without_conditions_has_one_polynomial_in_its_first_two_intervals() -> None:
    values = np.random.default_rng(2).normal(size=len(X))
    spline = interpolating_spline(X, values, 3)
    third = spline(0.5 * (X[1:] + X[:-1]), 3)
    np.testing.assert_allclose(third[[0, -1]], third[[1, -2]], rtol=1e-9)


@pytest.mark.parametrize("count", [2, 3])
def test_few_samples_have_the_polynomial_through_them(count: int) -> None:
    polynomial = np.polynomial.Polynomial([0.3, -1.0, 0.5][:count])
    np.testing.assert_allclose(
        interpolating_spline(X[:count], polynomial(X[:count]), 3)(FINE), polynomial(FINE), atol=1e-12
    )


@pytest.mark.parametrize("x", [X[:1], X[[0, 1, 1, 2, 3, 4]]])
def test_too_few_samples_and_equal_places_are_refused(x: np.ndarray) -> None:
    with pytest.raises(ValueError, match="needs more samples, at ascending places"):
        interpolating_spline(x, np.zeros(len(x)), 3)


@pytest.mark.parametrize(("order", "cutoff"), [(1, 3.0), (2, 6.0), (3, 0.5), (4, 40.0)])
def test_the_gain_of_a_butterworth_filter(order: int, cutoff: float) -> None:
    b, a = butterworth_coefficients(order, cutoff, 100.0)
    frequency = np.linspace(0.5, 49.5, 99)
    z = np.exp(-2j * np.pi * frequency / 100.0)
    gain = np.abs(np.polyval(b[::-1], z) / np.polyval(a[::-1], z))
    ratio = np.tan(np.pi * frequency / 100.0) / np.tan(np.pi * cutoff / 100.0)
    # sums of small numbers of polynomials with the coefficients of the filter: 3e-10 to 5e-10 on four processors
    np.testing.assert_allclose(gain, (1.0 + ratio ** (2 * order)) ** -0.5, rtol=3e-9, atol=1e-15)


def test_two_passes_halve_the_power_at_the_cutoff_and_shift_no_phase() -> None:
    time = np.arange(4000) / 100.0
    b, a = butterworth_coefficients(4, single_cutoff(8.0, 4), 100.0)
    wave = np.stack([np.cos(2 * np.pi * 8.0 * time), np.sin(2 * np.pi * 8.0 * time)], axis=1)
    middle = slice(1500, 2500)
    # Of the prototype; the bilinear transformation moves the frequency of 3 dB a little.
    once = 1.0 / (1.0 + (np.tan(0.08 * np.pi) / np.tan(np.pi * single_cutoff(8.0, 4) / 100.0)) ** 8)
    np.testing.assert_allclose(filtered_both_ways(b, a, wave, 50)[middle], once * wave[middle], atol=1e-12)
    assert once == pytest.approx(0.5**0.5, abs=0.012)  # margin: the bilinear transformation moves the cutoff


def test_straight_lines_pass_the_filter() -> None:
    b, a = butterworth_coefficients(2, 6.0, 100.0)
    line = np.arange(50.0)[:, None] * [1.0, -0.5] + 3.0
    np.testing.assert_allclose(filtered(b, a, np.ones((50, 1)), state_after(b, a, np.ones((2, 1)))), 1.0, rtol=1e-12)
    np.testing.assert_allclose(filtered_both_ways(b, a, line, 40)[20:30], line[20:30], rtol=1e-3)


@pytest.mark.parametrize("freedoms", [1.0, 1.001, 1.37, 1.9, 2.0])
def test_quantiles_of_chi_square(freedoms: float) -> None:
    with mpmath.workdps(30):
        reached = mpmath.gammainc(freedoms / 2, 0, mpmath.mpf(float(quantile(freedoms))) / 2, regularized=True)
        assert_within(float(reached - mpmath.mpf(str(LEVEL))), 1e-15)
