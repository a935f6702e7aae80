"""Sparse row-wise LU factorization with a fixed pivot order, for real and complex matrices of a fixed pattern.

`mbdkit.engine.elimination_order` chooses the order of rows and columns once, with numerical pivoting. The kernels reuse
this order for new values, which avoids pivot searches and allocation. The order can become unsuitable as the values
change. Two checks detect this: a pivot that has become small relative to its size when the order was chosen (`WORN`),
and a large residual of the solution. If one of them fails, the caller chooses new pivots.
"""

from __future__ import annotations

from typing import NamedTuple

from mbdkit.engine.kernels.bundle_types import IntVector, NumberVector, RealVector
from mbdkit.engine.native.arithmetic import is_refused, usable, where
from mbdkit.engine.native.functions import inlined

WORN = 1e-6  #: If a pivot shrinks to this fraction of its original size, new pivots are chosen.


class Pattern(NamedTuple):
    """Sparsity patterns of A, L and U in compressed rows, with rows and columns in pivot order; n unknowns.

    L has a unit diagonal, which is not stored; the diagonal of U is stored apart, inverted, in ``Factors.pivot``.
    """

    a_start: IntVector
    a_column: IntVector
    l_start: IntVector
    l_column: IntVector
    u_start: IntVector
    u_column: IntVector
    row_of: IntVector  #: (n,) original row at each pivot position.
    column_of: IntVector  #: (n,) original unknown at each pivot position.
    #: (n,) factors that equilibrate the rows, in original order; powers of two, so that scaling is exact.
    row_scale: RealVector
    column_scale: RealVector  #: (n,) factors that equilibrate the columns, also powers of two.
    weight: RealVector  #: (nnz,) product of row and column factor for every entry of A.


class Factors(NamedTuple):
    """Values of A, L and U in the order of a `Pattern`; all number arrays have the same dtype."""

    a: NumberVector
    lower: NumberVector
    upper: NumberVector
    pivot: NumberVector  #: (n,) inverse pivots.
    reference: RealVector  #: (n,) sizes of the pivots in the first factorization after they were chosen; 0 before it.
    work: NumberVector  #: (n,) one row during the factorization, the intermediate solution during substitution.


@inlined
def factorize(pattern, factors):
    """Factorize the scaled matrix in ``factors.a``; return the position of a pivot that is too small, or -1.

    Row-wise elimination (IKJ order): each row is expanded into the dense array ``factors.work``, all earlier rows that
    it depends on are subtracted, and the result is stored in the patterns of L and U. These patterns include the
    fill-in, so the entries to be used are set to zero first. The size of a complex number is taken as ``|re| + |im|``,
    which needs no root.
    """
    a_start, a_column = pattern.a_start, pattern.a_column
    l_start, l_column, u_start, u_column = pattern.l_start, pattern.l_column, pattern.u_start, pattern.u_column
    a, lower, upper, pivot = factors.a, factors.lower, factors.upper, factors.pivot
    reference, w = factors.reference, factors.work
    for i in range(len(pivot)):
        for x in range(l_start[i], l_start[i + 1]):  # clear only the entries in the pattern of this row
            w[l_column[x]] = 0.0
        w[i] = 0.0
        for x in range(u_start[i], u_start[i + 1]):
            w[u_column[x]] = 0.0
        for x in range(a_start[i], a_start[i + 1]):
            w[a_column[x]] = a[x]
        # subtract earlier rows in ascending order: each one completes the entries that the next needs
        for x in range(l_start[i], l_start[i + 1]):
            k = l_column[x]
            m = w[k] * pivot[k]
            lower[x] = m
            for y in range(u_start[k], u_start[k + 1]):
                w[u_column[y]] -= m * upper[y]
        d = w[i]
        size = abs(d.real) + abs(d.imag)
        sound = size > WORN * reference[i]  # false if the size is NaN
        if is_refused(sound):
            return i
        reference[i] = where(reference[i] == 0.0, size, reference[i])  # first factorization with these pivots
        pivot[i] = usable(1.0, sound) / d
        for x in range(u_start[i], u_start[i + 1]):
            upper[x] = w[u_column[x]]
    return -1


@inlined
def substitute(pattern, factors, b, x):
    """Solve A x = b with the factors; `b` and `x` (n,) are unscaled, in original order, and may be the same array."""
    l_start, l_column, u_start, u_column = pattern.l_start, pattern.l_column, pattern.u_start, pattern.u_column
    row_of, column_of = pattern.row_of, pattern.column_of
    row_scale, column_scale = pattern.row_scale, pattern.column_scale
    lower, upper, pivot, w = factors.lower, factors.upper, factors.pivot, factors.work
    n = len(pivot)
    for i in range(n):
        # scales are powers of two, so that solving the scaled system costs no accuracy
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
def residual(pattern, factors, b, x, r):
    """Write b - A x into `r` (n,) and return the largest residual of a row relative to the largest row sum.

    The row sum is the sum of the absolute values of all terms of a row, including b. Residuals and row sums are those
    of the scaled system. Returns NaN if a residual is NaN.
    """
    worst = 0.0
    largest = 0.0
    for i in range(len(pattern.row_of)):
        row = pattern.row_of[i]
        t = b[row] * pattern.row_scale[row]
        size = abs(t)
        for k in range(pattern.a_start[i], pattern.a_start[i + 1]):
            column = pattern.column_of[pattern.a_column[k]]
            # terms of the scaled system, which is the one that was factorized
            term = factors.a[k] * (x[column] / pattern.column_scale[column])
            t -= term
            size += abs(term)
        r[row] = t / pattern.row_scale[row]
        largest = max(largest, size)
        if not abs(t) <= worst:  # unlike `max`, this keeps a NaN
            worst = abs(t)
    return worst / largest if worst > 0.0 else worst


@inlined
def solve_refined(pattern, factors, b, x, r):
    """Solve A x = b with one step of iterative refinement; return the largest relative residual, see `residual`.

    The refinement compensates for pivots that are no longer optimal for the current values. `b`, `x` and the scratch
    array `r` are (n,), in original order; `r` holds the final residual on return.
    """
    substitute(pattern, factors, b, x)
    residual(pattern, factors, b, x, r)
    substitute(pattern, factors, r, r)
    for i in range(len(x)):
        x[i] += r[i]
    return residual(pattern, factors, b, x, r)
