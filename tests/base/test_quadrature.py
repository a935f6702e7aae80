"""Gauss-Legendre quadrature, against integrals of powers and under any decimal context of the caller."""

from __future__ import annotations

import decimal
import math

import numpy as np
import pytest

from mbdkit.base.quadrature import gauss_legendre


@pytest.mark.parametrize("count", [1, 2, 5, 9, 20, 37])
def test_powers_below_twice_the_number_of_nodes_are_integrated_exactly(count: int) -> None:
    nodes, weights = gauss_legendre.__wrapped__(count)
    assert np.allclose(nodes, np.polynomial.legendre.leggauss(count)[0], rtol=0, atol=1e-15)
    # expected: integral of x^k from -1 to 1
    errors = [math.fsum(weights * nodes**k) - (2.0 / (k + 1) if k % 2 == 0 else 0.0) for k in range(2 * count)]
    assert np.abs(errors).max() < 1e-15
    assert (nodes == -nodes[::-1]).all()
    assert (weights == weights[::-1]).all()


@pytest.mark.parametrize("trap", [decimal.FloatOperation, decimal.Inexact, decimal.Rounded])
def test_the_decimal_context_of_the_caller_does_not_matter(trap: type[decimal.DecimalException]) -> None:
    expected = gauss_legendre.__wrapped__(7)
    with decimal.localcontext(prec=3, rounding=decimal.ROUND_UP) as context:
        context.traps[trap] = True
        found = gauss_legendre.__wrapped__(7)
    assert all((one == other).all() for one, other in zip(found, expected, strict=True))
