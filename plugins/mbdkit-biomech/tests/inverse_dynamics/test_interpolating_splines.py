"""Splines through samples: they reproduce polynomials of their degree, and satisfy their end conditions."""

from __future__ import annotations

import numpy as np
import pytest

from mbdkit_biomech.inverse_dynamics.signals.interpolating_splines import interpolating_spline

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
