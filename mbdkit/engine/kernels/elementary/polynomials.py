"""Polynomials with given coefficients."""

from __future__ import annotations

from mbdkit.engine.native.functions import inlined


@inlined
def polynomial(x, coefficients):
    """Return the polynomial in `x` with these coefficients, from the last to the first (Horner)."""
    total = 0.0
    for coefficient in coefficients:
        total = total * x + coefficient
    return total
