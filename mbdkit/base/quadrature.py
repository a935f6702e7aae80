"""Gauss-Legendre quadrature, with nodes and weights rounded once, the same on every machine; Lagrange weights."""

from __future__ import annotations

import math
from decimal import MAX_EMAX, MIN_EMIN, ROUND_HALF_EVEN, Context, Decimal, getcontext, localcontext
from functools import lru_cache

import numpy as np

DIGITS = 30


def digits(count: int) -> Context:
    """Return a decimal context with a number of digits, which does not depend on that of the caller."""
    return Context(prec=count, rounding=ROUND_HALF_EVEN, Emin=MIN_EMIN, Emax=MAX_EMAX, capitals=1, clamp=0, traps=[])


def legendre_roots(count: int) -> list[Decimal]:
    """Return the roots of the Legendre polynomial of degree `count` in ascending order, in decimal's precision."""
    roots = []
    for i in range(count, 0, -1):
        if 2 * i == count + 1:
            roots.append(Decimal(0))
            continue
        x = Decimal(math.cos(math.pi * (i - 0.25) / (count + 0.5)))
        change = Decimal(1)
        while abs(change) > Decimal(10) ** (-getcontext().prec // 2):  # the next change is smaller by the square
            value, slope = _legendre(count, x)
            change = value / slope
            x -= change
        value, slope = _legendre(count, x)
        roots.append(x - value / slope)
    return roots


@lru_cache(maxsize=16)
def gauss_legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes and weights (count,) of Gauss-Legendre quadrature over [-1, 1]."""
    with localcontext(digits(DIGITS)):
        nodes = legendre_roots(count)
        weights = [2 / ((1 - x * x) * _legendre(count, x)[1] ** 2) for x in nodes]
    return np.array(nodes, dtype=float), np.array(weights, dtype=float)


def gauss_on_unit(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes and weights (count,) of Gauss-Legendre quadrature over [0, 1], of order 2 `count`."""
    nodes, weights = gauss_legendre(count)
    return 0.5 * (1.0 + nodes), 0.5 * weights


def lagrange(times: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the (G, K) weights of values at `times` (K,) in their polynomial at the times `at` (G,)."""
    own = np.eye(len(times), dtype=bool)
    factors = (at[:, None, None] - times) / np.where(own, 1.0, times[:, None] - times)
    return np.asarray(np.prod(np.where(own, 1.0, factors), axis=2))


def _legendre(degree: int, x: Decimal) -> tuple[Decimal, Decimal]:
    """Return the Legendre polynomial of a degree, at least 1, and its derivative, inside (-1, 1)."""
    before, value = Decimal(1), x
    for k in range(2, degree + 1):
        before, value = value, ((2 * k - 1) * x * value - (k - 1) * before) / k
    return value, degree * (before - x * value) / (1 - x * x)
