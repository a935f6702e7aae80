"""Kernels of the distance to singularity: inverse iteration with two vectors, started from the previous recorded row.

The distance is the square root of the smallest eigenvalue of ``D Phi_q M^-1 Phi_q^T D^T`` for the rows that are solved
for, where ``D^-1`` is the Cholesky factor L of the 2 x 2 diagonal blocks of ``Phi_q M^-1 Phi_q^T``. Each iteration
applies the inverse of this operator to both vectors with the existing factors of the index-1 system, so that nothing is
factorized again. The smaller Ritz value of the subspace of the two images approximates the eigenvalue (Parlett, The
Symmetric Eigenvalue Problem, 1998, ch. 4, 11 and 14). See `mbdkit.engine.singularity`.

The vectors of one recorded state are a good start for the next, because the mechanism has moved little in between. The
second vector makes the iteration converge if the two smallest eigenvalues are close together or exchange their order.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from mbdkit.engine.kernels.bundle_types import RealMatrix, RealVector
from mbdkit.engine.kernels.engine_bundles import load_engine
from mbdkit.engine.kernels.lu import substitute
from mbdkit.engine.kernels.schur import diagonal_block
from mbdkit.engine.kernels.system import prepare, solved_rows
from mbdkit.engine.native.arithmetic import any_of, where
from mbdkit.engine.native.functions import inlined, kernel, overload, subkernel

#: Residual of the Ritz vector, relative to its Ritz value, at which the iteration ends; chosen. It bounds the relative
#: error of the eigenvalue, which is the square of the distance. Recorded distances of the packaged examples differ from
#: the smallest singular value by 2e-4 at most, because the error of a Ritz value is of second order in that of its Ritz
#: vector.
CLOSE = 0.03

#: Largest number of iterations; chosen. After that the current Ritz value is used, which is an upper bound.
MOST_ITERATIONS = 40

FEWEST_AT_FIRST = 4  #: Smallest number of iterations if there are no vectors from a previous row; chosen.

#: Weight of a fixed vector that is added to the second vector; chosen. Without it, a direction that both vectors lack
#: would never be found, however small its eigenvalue becomes.
NOISE = 0.1

#: If the squared norm of the second image shrinks below this fraction when it is orthogonalized against the first, the
#: remainder is rounding error, and only the first vector is used; chosen.
INDEPENDENT = 1e-12

#: First columns of the parts of `near` (P, 11), and the number of columns. The array is reused from one recorded row to
#: the next. For each pair of constraint rows it holds two entries of the vectors x and y and of their images, and the
#: entries of the Cholesky factor L of the pair.
X, Y, X_IMAGE, Y_IMAGE, L_XX, L_YX, L_YY, COLUMNS = 0, 2, 4, 6, 8, 9, 10, 11


@subkernel
def _pair_factors(top, jac, near):
    """Write the Cholesky factor of each pair's diagonal block into `near`; return the number of pairs with rows.

    Rows that are not solved for have the factor 1, which leaves their zero entries unchanged.
    """
    rows = top.rows
    count = 0
    for k in range(len(top.pairs)):
        d00, d01, d11 = diagonal_block(top, jac, k)
        near[k, L_XX] = near[k, L_YY] = 1.0
        near[k, L_YX] = 0.0
        if rows[k] > 0:
            near[k, L_XX] = sqrt(d00)
        if rows[k] == 2:
            near[k, L_YX] = d01 / near[k, L_XX]
            near[k, L_YY] = sqrt(max(d11 - near[k, L_YX] * near[k, L_YX], 0.0))
        if rows[k] > 0:
            count += 1
    return count


@inlined
def _noise(n, multiplier):
    """Return term `n` of the additive recurrence ``frac((n + 1) multiplier) - 0.5``, equidistributed over (-0.5, 0.5).

    It replaces random numbers, because a repeated run must give the same bits.
    """
    x = (n + 1) * multiplier
    return x - np.floor(x) - 0.5


@subkernel
def _disturb(rows, near):
    """Add noise to the second vector, and fill the first if it is zero; return whether it was non-zero on entry."""
    # The two multipliers are the reciprocals of the plastic number and of the golden ratio.
    known = 0.0
    for k in range(len(rows)):
        known += near[k, X] * near[k, X] + near[k, X + 1] * near[k, X + 1]
    for k in range(len(rows)):
        for r in range(rows[k]):
            near[k, X + r] = where(known == 0.0, _noise(2 * k + r, 0.7548776662466927), near[k, X + r])
            near[k, Y + r] += NOISE * _noise(2 * k + r, 0.6180339887498949)
    return known > 0.0


@subkernel
def _scale(near):
    """Write the right-hand sides ``D^-1 x = L x`` and ``L y`` into the columns of the images."""
    for k in range(len(near)):
        l00, l10, l11 = near[k, L_XX], near[k, L_YX], near[k, L_YY]
        for c in (X, Y):
            near[k, X_IMAGE - X + c] = l00 * near[k, c]
            near[k, X_IMAGE - X + c + 1] = l10 * near[k, c] + l11 * near[k, c + 1]


@subkernel
def _solve_both(schur, near):
    """Solve with the Schur complement for both right-hand sides in place; see `mbdkit.engine.kernels.schur.solve`.

    Both are solved in one pass, which reads the factors once.
    """
    start, row, diagonal, below = schur.start, schur.row, schur.diagonal, schur.below
    n = len(diagonal)
    for k in range(n):
        x0, x1, y0, y1 = near[k, X_IMAGE], near[k, X_IMAGE + 1], near[k, Y_IMAGE], near[k, Y_IMAGE + 1]
        for e in range(start[k], start[k + 1]):
            i = row[e]
            b00, b01, b10, b11 = below[e, 0], below[e, 1], below[e, 2], below[e, 3]
            near[i, X_IMAGE] -= b00 * x0 + b01 * x1
            near[i, X_IMAGE + 1] -= b10 * x0 + b11 * x1
            near[i, Y_IMAGE] -= b00 * y0 + b01 * y1
            near[i, Y_IMAGE + 1] -= b10 * y0 + b11 * y1
    for k in range(n - 1, -1, -1):
        d00, d01, d11 = diagonal[k, 0], diagonal[k, 1], diagonal[k, 2]
        x0, x1 = (
            d00 * near[k, X_IMAGE] + d01 * near[k, X_IMAGE + 1],
            d01 * near[k, X_IMAGE] + d11 * near[k, X_IMAGE + 1],
        )
        y0, y1 = (
            d00 * near[k, Y_IMAGE] + d01 * near[k, Y_IMAGE + 1],
            d01 * near[k, Y_IMAGE] + d11 * near[k, Y_IMAGE + 1],
        )
        for e in range(start[k], start[k + 1]):
            i = row[e]
            b00, b01, b10, b11 = below[e, 0], below[e, 1], below[e, 2], below[e, 3]
            x0 -= b00 * near[i, X_IMAGE] + b10 * near[i, X_IMAGE + 1]
            x1 -= b01 * near[i, X_IMAGE] + b11 * near[i, X_IMAGE + 1]
            y0 -= b00 * near[i, Y_IMAGE] + b10 * near[i, Y_IMAGE + 1]
            y1 -= b01 * near[i, Y_IMAGE] + b11 * near[i, Y_IMAGE + 1]
        near[k, X_IMAGE], near[k, X_IMAGE + 1], near[k, Y_IMAGE], near[k, Y_IMAGE + 1] = x0, x1, y0, y1


@subkernel
def _solve_pivoted(top, w, solver, near):
    """Solve with the pivoted system for both right-hand sides in place.

    With zero forces and -b in the constraint rows, the multipliers of the index-1 system are ``S^-1 b``.
    """
    rows, row_index, right, solution = top.rows, solver.row_index, w.right, w.solution
    for c in (X_IMAGE, Y_IMAGE):
        right[:] = 0.0
        for k in range(len(near)):
            for r in range(rows[k]):
                right[row_index[k, r]] = -near[k, c + r]
        substitute(solver.pattern, solver.factors, right, solution)
        for k in range(len(near)):
            for r in range(rows[k]):
                near[k, c + r] = solution[row_index[k, r]]


@subkernel
def _products(rows, near):
    """Scale the solutions by ``L^T`` to the images; return three Gram matrices, each as its entries 00, 01 and 11.

    The matrices contain the products of the vectors, of the images, and of the vectors with the images. The last one is
    symmetric up to rounding errors and is symmetrized.
    """
    x00 = x01 = x11 = y00 = y01 = y11 = h00 = h01 = h11 = 0.0
    for k in range(len(near)):
        l00, l10, l11 = near[k, L_XX], near[k, L_YX], near[k, L_YY]
        a0, a1, b0, b1 = near[k, X], near[k, X + 1], near[k, Y], near[k, Y + 1]
        p0, p1 = l00 * near[k, X_IMAGE] + l10 * near[k, X_IMAGE + 1], l11 * near[k, X_IMAGE + 1]
        q0, q1 = l00 * near[k, Y_IMAGE] + l10 * near[k, Y_IMAGE + 1], l11 * near[k, Y_IMAGE + 1]
        if rows[k] < 2:
            p1 = q1 = 0.0
            if rows[k] == 0:
                p0 = q0 = 0.0
        near[k, X_IMAGE], near[k, X_IMAGE + 1], near[k, Y_IMAGE], near[k, Y_IMAGE + 1] = p0, p1, q0, q1
        x00 += a0 * a0 + a1 * a1
        x01 += a0 * b0 + a1 * b1
        x11 += b0 * b0 + b1 * b1
        y00 += p0 * p0 + p1 * p1
        y01 += p0 * q0 + p1 * q1
        y11 += q0 * q0 + q1 * q1
        h00 += a0 * p0 + a1 * p1
        h01 += 0.5 * (a0 * q0 + a1 * q1 + b0 * p0 + b1 * p1)
        h11 += b0 * q0 + b1 * q1
    return x00, x01, x11, y00, y01, y11, h00, h01, h11


@subkernel
def _turn(near, along, size0, size1, z0, z1, turning):
    """Orthonormalize the images, rotate them by (z0, z1) and store them as the next vectors, where `turning` holds.

    The first vector is then the Ritz vector of the smaller Ritz value.
    """
    for k in range(len(near)):
        for r in range(2):
            e0 = near[k, X_IMAGE + r]
            e1 = (near[k, Y_IMAGE + r] - along * e0) * size1
            e0 = e0 * size0
            near[k, X + r] = where(turning, z0 * e0 + z1 * e1, near[k, X + r])
            near[k, Y + r] = where(turning, z0 * e1 - z1 * e0, near[k, Y + r])


def solve_images(top, w, solver, near):
    """Solve for both right-hand sides in place, with the pivots of `solver` or with its Schur complement."""
    if solver.pivoted[0] != 0:
        _solve_pivoted(top, w, solver, near)
    else:
        _solve_both(solver.schur, near)


@overload(solve_images)
def _solve_images(top, w, solver, near):
    if "pivoted" not in solver.bundle.fields:  # lanes
        return lambda top, w, solver, near: _solve_both(solver.schur, near)
    return solve_images


@subkernel
def _ritz(rows, near):
    """Return the data of the smaller Ritz value: (value, squared residual, z0, z1, along, size0, size1).

    The inverse operator B maps the vectors (x, y) to the images (Bx, By). The Ritz values of the operator on the
    subspace of the images follow from Gram matrices alone, because the operator maps the images back to the vectors.
    The value is 0 or NaN if an image is not finite or zero.
    """
    x00, x01, x11, y00, y01, y11, h00, h01, h11 = _products(rows, near)
    is_sound = (y00 > 0.0) & (y00 < np.inf) & (y11 >= 0.0) & (y11 < np.inf)
    # Gram-Schmidt: orthogonalize the second image against the first, and combine the vectors likewise
    along = y01 / y00
    rest = y11 - along * y01
    size0 = 1.0 / sqrt(y00)
    has_second = rest > INDEPENDENT * y11
    size1 = where(has_second, 1.0 / sqrt(where(has_second, rest, 1.0)), 0.0)
    g00 = h00 * size0 * size0
    g01 = (h01 - along * h00) * size0 * size1
    g11 = (h11 - 2.0 * along * h01 + along * along * h00) * size1 * size1
    # determinant over larger eigenvalue: the difference of mean and root would cancel
    half = 0.5 * (g00 - g11)
    smaller = (g00 * g11 - g01 * g01) / (0.5 * (g00 + g11) + sqrt(half * half + g01 * g01))
    e00, e11 = abs(g00 - smaller), abs(g11 - smaller)
    larger = max(e00, e11)
    length = sqrt(larger * larger + g01 * g01)
    turns = has_second & (length > 0.0)
    is_first = e11 >= e00
    inverse = 1.0 / where(turns, length, 1.0)
    z0 = where(turns, where(is_first, e11, -g01) * inverse, 1.0)
    z1 = where(turns, where(is_first, -g01, e00) * inverse, 0.0)
    smallest = where(is_sound, where(has_second, smaller, g00), 0.0)
    c0 = z0 * size0 - along * z1 * size1
    c1 = z1 * size1
    # ||A z - theta z||^2 / theta^2 = ||A z||^2 / theta^2 - 1 for the unit Ritz vector z, theta = z^T A z
    off = (c0 * c0 * x00 + 2.0 * c0 * c1 * x01 + c1 * c1 * x11) / (smallest * smallest) - 1.0
    return smallest, off, z0, z1, along, size0, size1


@inlined
def singularity_distance(top, w, solver, near):
    """Return the distance to singularity at the position of the last `solve_accelerations`.

    The distance is 1 with fewer than two pairs, and 0 if an image or a Ritz value is not finite or not positive. `near`
    (P, 11) carries the vectors from one recorded state to the next. Overwrites ``w.right`` and ``w.solution``. In
    lanes, those that have converged keep their values while the iteration continues for others.
    """
    distance = 1.0
    if _pair_factors(top, w.jac, near) > 1:
        fewest = where(_disturb(top.rows, near), 1.0, FEWEST_AT_FIRST)
        is_active = True
        for iteration in range(MOST_ITERATIONS):
            _scale(near)
            solve_images(top, w, solver, near)
            smallest, off, z0, z1, along, size0, size1 = _ritz(top.rows, near)
            is_fine = (smallest > 0.0) & (smallest < np.inf)
            is_lost, is_turning = is_active & (not is_fine), is_active & is_fine
            _turn(near, along, size0, size1, z0, z1, is_turning)
            if any_of(is_lost):
                for k in range(len(near)):
                    for c in range(L_XX):
                        near[k, c] = where(is_lost, 0.0, near[k, c])
            distance = where(is_turning, min(sqrt(where(is_fine, smallest, 1.0)), 1.0), where(is_lost, 0.0, distance))
            is_active = is_turning & (not ((iteration + 1.0 >= fewest) & (off <= CLOSE * CLOSE)))
            if not any_of(is_active):
                break
    return distance


@kernel
def independent_jacobian(engine: int, t: float, q: RealVector, v: RealVector, near: RealMatrix) -> None:
    """Evaluate the Jacobian of the rows that are solved for into ``w.jac``, and the pairs' factors L into `near`."""
    h = load_engine(engine)
    top, w = h.top, h.w
    prepare(top, w, t, q)
    solved_rows(top, w, q, v)
    _pair_factors(top, w.jac, near)
