"""Sparse LU by rows with pivots chosen beforehand, for real and complex matrices of a fixed pattern.

Rows and columns were ordered once, with numerical pivoting (`mbdkit.engine.analysis`); here the values change and the
order stays. A pivot that has become small against its row, or a poor residual, asks for a new choice of pivots.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.engine.cache import inlined

SMALL_PIVOT = 1e-9
"""A pivot this much smaller than its row of the matrix asks for new pivots."""


class Pattern(NamedTuple):
    """Pattern of A with rows and columns in pivot order, and of its factors; n unknowns."""

    a_start: np.ndarray
    a_column: np.ndarray
    l_start: np.ndarray
    l_column: np.ndarray
    u_start: np.ndarray
    u_column: np.ndarray
    row_of: np.ndarray
    """(n,) original row at each pivot position."""
    column_of: np.ndarray
    """(n,) original unknown at each pivot position."""


class Factors(NamedTuple):
    """Values that go with a `Pattern`; all of one dtype."""

    a: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    pivot: np.ndarray
    """(n,) inverse pivots."""
    work: np.ndarray


@inlined
def factorize(p, f):
    """Factorize the matrix whose values stand in ``f.a``; return the pivot position that became too small, or -1."""
    a_start, a_column = p.a_start, p.a_column
    l_start, l_column, u_start, u_column = p.l_start, p.l_column, p.u_start, p.u_column
    a, lower, upper, pivot, w = f.a, f.lower, f.upper, f.pivot, f.work
    for i in range(len(pivot)):
        for x in range(l_start[i], l_start[i + 1]):
            w[l_column[x]] = 0.0
        w[i] = 0.0
        for x in range(u_start[i], u_start[i + 1]):
            w[u_column[x]] = 0.0
        largest = 0.0
        for x in range(a_start[i], a_start[i + 1]):
            w[a_column[x]] = a[x]
            largest = max(largest, abs(a[x].real) + abs(a[x].imag))
        for x in range(l_start[i], l_start[i + 1]):
            k = l_column[x]
            m = w[k] * pivot[k]
            lower[x] = m
            for y in range(u_start[k], u_start[k + 1]):
                w[u_column[y]] -= m * upper[y]
        d = w[i]
        if not abs(d.real) + abs(d.imag) > SMALL_PIVOT * largest:
            return i
        pivot[i] = 1.0 / d
        for x in range(u_start[i], u_start[i + 1]):
            upper[x] = w[u_column[x]]
    return -1


@inlined
def substitute(p, f, b, x):
    """Solve A x = b with the factors; `b` and `x` (n,) in original order."""
    l_start, l_column, u_start, u_column = p.l_start, p.l_column, p.u_start, p.u_column
    row_of, column_of = p.row_of, p.column_of
    lower, upper, pivot, w = f.lower, f.upper, f.pivot, f.work
    n = len(pivot)
    for i in range(n):
        y = b[row_of[i]]
        for k in range(l_start[i], l_start[i + 1]):
            y -= lower[k] * w[l_column[k]]
        w[i] = y
    for i in range(n - 1, -1, -1):
        y = w[i]
        for k in range(u_start[i], u_start[i + 1]):
            y -= upper[k] * w[u_column[k]]
        w[i] = y * pivot[i]
        x[column_of[i]] = w[i]


@inlined
def residual(p, f, b, x, r):
    """Write b - A x into `r` (n,) and return the largest component relative to |A| |x| + |b| of its row."""
    worst = 0.0
    for i in range(len(p.row_of)):
        t = b[p.row_of[i]]
        size = abs(t)
        for k in range(p.a_start[i], p.a_start[i + 1]):
            term = f.a[k] * x[p.column_of[p.a_column[k]]]
            t -= term
            size += abs(term)
        r[p.row_of[i]] = t
        if not abs(t) <= worst * size:
            worst = abs(t) / size
    return worst
