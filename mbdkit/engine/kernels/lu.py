"""Sparse LU by rows with pivots chosen beforehand, for real and complex matrices of a fixed pattern.

`mbdkit.engine.elimination_order` orders rows and columns once, with numerical pivoting; here the values change and the
order stays. A pivot that has become small against its row, or a poor residual, asks for a new choice of pivots.
"""

from __future__ import annotations

from typing import NamedTuple

from mbdkit.engine.jit.decorators import inlined
from mbdkit.engine.kernels.bundle_types import IntVector, NumberVector, RealVector

WORN = 1e-6
"""A pivot that has shrunk to this, relative to its size when it was chosen, asks for new pivots."""


class Pattern(NamedTuple):
    """Pattern of A with rows and columns in pivot order, and of its factors; n unknowns."""

    a_start: IntVector
    a_column: IntVector
    l_start: IntVector
    l_column: IntVector
    u_start: IntVector
    u_column: IntVector
    row_of: IntVector
    """(n,) original row at each pivot position."""
    column_of: IntVector
    """(n,) original unknown at each pivot position."""
    row_scale: RealVector
    """(n,) factors that equilibrate the rows, powers of two, in original order."""
    column_scale: RealVector
    """(n,) factors that equilibrate the columns."""
    weight: RealVector
    """(nnz,) product of both for every entry of A."""


class Factors(NamedTuple):
    """Values that go with a `Pattern`; all of one dtype."""

    a: NumberVector
    lower: NumberVector
    upper: NumberVector
    pivot: NumberVector
    """(n,) inverse pivots."""
    reference: RealVector
    """(n,) sizes of the pivots in the first factorization after they were chosen; 0 until then."""
    work: NumberVector


@inlined
def factorize(p, f):
    """Factorize the scaled matrix whose values stand in ``f.a``; return the pivot position that wore out, or -1."""
    a_start, a_column = p.a_start, p.a_column
    l_start, l_column, u_start, u_column = p.l_start, p.l_column, p.u_start, p.u_column
    a, lower, upper, pivot, reference, w = f.a, f.lower, f.upper, f.pivot, f.reference, f.work
    for i in range(len(pivot)):
        for x in range(l_start[i], l_start[i + 1]):
            w[l_column[x]] = 0.0
        w[i] = 0.0
        for x in range(u_start[i], u_start[i + 1]):
            w[u_column[x]] = 0.0
        for x in range(a_start[i], a_start[i + 1]):
            w[a_column[x]] = a[x]
        for x in range(l_start[i], l_start[i + 1]):
            k = l_column[x]
            m = w[k] * pivot[k]
            lower[x] = m
            for y in range(u_start[k], u_start[k + 1]):
                w[u_column[y]] -= m * upper[y]
        d = w[i]
        size = abs(d.real) + abs(d.imag)
        if not size > WORN * reference[i]:
            return i
        if reference[i] == 0.0:
            reference[i] = size
        pivot[i] = 1.0 / d
        for x in range(u_start[i], u_start[i + 1]):
            upper[x] = w[u_column[x]]
    return -1


@inlined
def substitute(p, f, b, x):
    """Solve A x = b with the factors; `b` and `x` (n,) in original order."""
    l_start, l_column, u_start, u_column = p.l_start, p.l_column, p.u_start, p.u_column
    row_of, column_of, row_scale, column_scale = p.row_of, p.column_of, p.row_scale, p.column_scale
    lower, upper, pivot, w = f.lower, f.upper, f.pivot, f.work
    n = len(pivot)
    for i in range(n):
        y = b[row_of[i]] * row_scale[row_of[i]]
        for k in range(l_start[i], l_start[i + 1]):
            y -= lower[k] * w[l_column[k]]
        w[i] = y
    for i in range(n - 1, -1, -1):
        y = w[i]
        for k in range(u_start[i], u_start[i + 1]):
            y -= upper[k] * w[u_column[k]]
        w[i] = y * pivot[i]
        x[column_of[i]] = w[i] * column_scale[column_of[i]]


@inlined
def residual(p, f, b, x, r):
    """Write b - A x into `r` (n,) and return the largest scaled residual, relative to the largest row of terms."""
    worst = 0.0
    largest = 0.0
    for i in range(len(p.row_of)):
        row = p.row_of[i]
        t = b[row] * p.row_scale[row]
        size = abs(t)
        for k in range(p.a_start[i], p.a_start[i + 1]):
            column = p.column_of[p.a_column[k]]
            term = f.a[k] * (x[column] / p.column_scale[column])
            t -= term
            size += abs(term)
        r[row] = t / p.row_scale[row]
        largest = max(largest, size)
        if not abs(t) <= worst:
            worst = abs(t)
    return worst / largest if worst > 0.0 else worst


@inlined
def solve_refined(p, f, b, x, r):
    """Solve A x = b with one step of iterative refinement; return the largest relative residual, see `residual`.

    `b`, `x` and the scratch array `r` are (n,), in original order.
    """
    substitute(p, f, b, x)
    residual(p, f, b, x, r)
    substitute(p, f, r, r)
    for i in range(len(x)):
        x[i] += r[i]
    return residual(p, f, b, x, r)
