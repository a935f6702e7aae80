"""Sparse LU factorization that chooses pivots by their size, column by column.

Source: J. R. Gilbert and T. Peierls, SIAM J. Sci. Stat. Comput. 9 (1988) 862-874. A depth-first search in the columns
of L finds the nonzero entries of the next column, and an order in which they can be computed. The time is proportional
to the number of multiplications.

Unlike `mbdkit.engine.kernels.lu`, which repeats a factorization in a known order, this one searches for pivots and
needs room for entries that are not known beforehand. `mbdkit.engine.linear_systems` calls it from Python. Matrices are
real or complex.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from mbdkit.engine.kernels.bundle_types import (
    ComplexMatrix,
    ComplexVector,
    IntMatrix,
    IntVector,
    NumberVector,
    RealMatrix,
    RealVector,
    example_of,
)
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import kernel, subkernel

DONE, NO_ROOM = -1, -2  #: Results of a factorization that succeeded, and of one whose factors need more room.

#: Columns of `ColumnFactors.search`: the last column that reached a row; rows of the search; the position in each of
#: their columns; rows of the present column, in the order of computation.
MARK, STACK, PLACE, REACHED = 0, 1, 2, 3


class ColumnFactors(NamedTuple):
    """A matrix (n, n) in compressed columns, and its factors."""

    start: IntVector
    row: IntVector
    value: NumberVector
    column_of: IntVector  #: (n,) column at each pivot position.
    row_of: IntVector  #: (n,) row at each pivot position.
    place: IntVector  #: (n,) pivot position of each row, -1 before it has one.
    l_start: IntVector
    l_row: IntVector  #: Rows of the entries of L; its unit diagonal is not stored.
    lower: NumberVector
    u_start: IntVector
    u_place: IntVector  #: Pivot positions of the rows of the entries of U above its diagonal.
    upper: NumberVector
    pivot: NumberVector  #: (n,) diagonal of U.
    work: NumberVector
    search: Annotated[IntMatrix, 4]


load_real_factors = bundle_loader(lambda: example_of(ColumnFactors))
load_complex_factors = bundle_loader(lambda: example_of(ColumnFactors, np.complex128))


@subkernel
def _reach(factors, k):
    """Write the rows of column k of the factors into ``search[top:, REACHED]``, and return `top`."""
    s, place, l_start, l_row = factors.search, factors.place, factors.l_start, factors.l_row
    column = factors.column_of[k]
    top = len(s)
    for e in range(factors.start[column], factors.start[column + 1]):
        if s[factors.row[e], MARK] == k:
            continue
        depth = 0
        s[0, STACK] = factors.row[e]
        s[factors.row[e], MARK] = k
        s[0, PLACE] = 0
        while depth >= 0:
            row = s[depth, STACK]
            p, is_deeper = place[row], False
            if p >= 0:
                for x in range(l_start[p] + s[depth, PLACE], l_start[p + 1]):
                    below = l_row[x]
                    if s[below, MARK] != k:
                        s[depth, PLACE] = x + 1 - l_start[p]
                        depth += 1
                        s[depth, STACK], s[depth, PLACE] = below, 0
                        s[below, MARK] = k
                        is_deeper = True
                        break
            if not is_deeper:
                top -= 1
                s[top, REACHED] = row
                depth -= 1
    return top


@subkernel
def _size(x):
    """Return a bound of the absolute value of a number, which for complex ones needs no root."""
    return abs(x.real) + abs(x.imag)


@subkernel
def _factorize(factors, threshold):
    """Factorize the matrix with its columns in the order ``factors.column_of``.

    The pivot of a column is its diagonal entry if this has at least the share `threshold` of the largest entry that is
    available, otherwise the first of the largest entries. Returns DONE; NO_ROOM, if `lower` or `upper` is too short; or
    the pivot position at which all entries are zero or one is not a number.
    """
    s, place, w, lower, upper = factors.search, factors.place, factors.work, factors.lower, factors.upper
    n, l_count, u_count = len(place), 0, 0
    for i in range(n):
        place[i] = s[i, MARK] = -1
    factors.l_start[0] = factors.u_start[0] = 0
    for k in range(n):
        top, column = _reach(factors, k), factors.column_of[k]
        if l_count + n - top > len(lower) or u_count + n - top > len(upper):
            return NO_ROOM
        for x in range(top, n):
            w[s[x, REACHED]] = 0.0
        # several terms may have the same entry
        for e in range(factors.start[column], factors.start[column + 1]):
            w[factors.row[e]] += factors.value[e]
        best, largest, is_sound = -1, 0.0, True
        for x in range(top, n):
            row = s[x, REACHED]
            p, entry = place[row], w[row]
            if p >= 0:
                factors.u_place[u_count], upper[u_count] = p, entry
                u_count += 1
                for e in range(factors.l_start[p], factors.l_start[p + 1]):
                    w[factors.l_row[e]] -= lower[e] * entry
            else:
                size = _size(entry)
                if size > largest:
                    best, largest = row, size
                is_sound = is_sound and size >= 0.0
        # a NaN is neither larger nor smaller than another entry, and must not become or hide a pivot
        if best < 0 or not is_sound:
            return k
        # the diagonal is preferred: it keeps the fill that the order of the columns was chosen for
        if s[column, MARK] == k and place[column] < 0 and w[column] != 0.0 and _size(w[column]) >= threshold * largest:
            best = column
        factors.row_of[k], place[best], factors.pivot[k] = best, k, w[best]
        for x in range(top, n):
            row = s[x, REACHED]
            if place[row] < 0:
                factors.l_row[l_count], lower[l_count] = row, w[row] / w[best]
                l_count += 1
        factors.l_start[k + 1], factors.u_start[k + 1] = l_count, u_count
    return DONE


@subkernel
def _solve(factors, right):
    w, row_of = factors.work, factors.row_of
    n = len(row_of)
    for k in range(n):
        x = right[row_of[k]]
        for e in range(factors.l_start[k], factors.l_start[k + 1]):
            right[factors.l_row[e]] -= factors.lower[e] * x
    for k in range(n - 1, -1, -1):
        x = right[row_of[k]] / factors.pivot[k]
        w[k] = x
        for e in range(factors.u_start[k], factors.u_start[k + 1]):
            right[row_of[factors.u_place[e]]] -= factors.upper[e] * x
    for k in range(n):
        right[factors.column_of[k]] = w[k]


@subkernel
def _solve_each(factors, right):
    for row in range(len(right)):
        _solve(factors, right[row])


@subkernel
def _solve_refined(factors, right, x, r):
    n = len(x)
    for i in range(n):
        x[i], r[i] = right[i], right[i]
    _solve(factors, x)
    for j in range(n):
        for e in range(factors.start[j], factors.start[j + 1]):
            r[factors.row[e]] -= factors.value[e] * x[j]
    _solve(factors, r)
    for i in range(n):
        x[i] += r[i]


@subkernel
def _solve_transposed(factors, right):
    w, row_of = factors.work, factors.row_of
    n = len(row_of)
    for k in range(n):
        x = right[factors.column_of[k]]
        for e in range(factors.u_start[k], factors.u_start[k + 1]):
            x -= factors.upper[e] * w[factors.u_place[e]]
        w[k] = x / factors.pivot[k]
    for k in range(n - 1, -1, -1):
        for e in range(factors.l_start[k], factors.l_start[k + 1]):
            w[k] -= factors.lower[e] * w[factors.place[factors.l_row[e]]]
    for k in range(n):
        right[row_of[k]] = w[k]


@kernel
def factorize_columns(factors: int, threshold: float) -> int:
    """Factorize the real matrix at an address; see `_factorize`."""
    return _factorize(load_real_factors(factors), threshold)


@kernel
def factorize_complex_columns(factors: int, threshold: float) -> int:
    """Factorize the complex matrix at an address; see `_factorize`."""
    return _factorize(load_complex_factors(factors), threshold)


@kernel
def solve_by_columns(factors: int, b: RealMatrix) -> None:
    """Replace right-hand sides, the rows of `b` (K, n), by the solutions."""
    _solve_each(load_real_factors(factors), b)


@kernel
def solve_complex_by_columns(factors: int, b: ComplexMatrix) -> None:
    """Replace complex right-hand sides, the rows of `b` (K, n), by the solutions."""
    _solve_each(load_complex_factors(factors), b)


@kernel
def solve_refined_by_columns(factors: int, right: RealVector, x: RealVector, r: RealVector) -> None:
    """Write the solution into `x` (n,), with one step of iterative refinement; `r` (n,) is a work array."""
    _solve_refined(load_real_factors(factors), right, x, r)


@kernel
def solve_transposed(factors: int, b: RealVector) -> None:
    """Replace a right-hand side (n,) by the solution of the system of the transposed matrix."""
    _solve_transposed(load_real_factors(factors), b)


@kernel
def solve_complex_transposed(factors: int, b: ComplexVector) -> None:
    """Replace a complex right-hand side (n,) by the solution of the system of the transposed matrix."""
    _solve_transposed(load_complex_factors(factors), b)
