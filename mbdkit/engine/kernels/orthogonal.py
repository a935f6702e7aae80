"""Dense orthogonal decompositions: least squares of least norm, null spaces and singular vectors.

LAPACK has faster routines for large matrices, but its results depend on the processor. Those of kernels do not.

Matrices are stored by columns: ``columns[j, i]`` is row i of column j. Sources: G. H. Golub and C. F. Van Loan, Matrix
Computations, 2013, sections 5.4.2 (column pivoting) and 5.5 (least norm); J. Demmel and K. Veselic, SIAM J. Matrix
Anal. Appl. 13 (1992) 1204-1245 (one-sided Jacobi rotations, and their high accuracy).
"""

from __future__ import annotations

from math import sqrt

from mbdkit.engine.kernels.bundle_types import IntVector, RealCube, RealMatrix, RealVector
from mbdkit.engine.native.functions import kernel, subkernel

MOST_SWEEPS = 40  #: Largest number of sweeps of Jacobi rotations. Random matrices of 100 rows need 8.

#: Rows count as orthogonal if the cosine of their angle is at most this times the square root of their length.
ORTHOGONAL = 1e-15

#: Rows whose squared norm is below this share of that of the matrix are rounding errors, and count as orthogonal to all
#: others.
VANISHED = 1e-32


@subkernel
def reduce_columns(columns, order, right, shape, least):
    """Reduce the matrix to triangular form by reflections with exchange of columns; return its rank.

    ``columns[j, i]`` is then row i of column j of the triangular matrix, whose column in the given matrix is
    ``order[j]``, and `right` the transformed right-hand side. The rank is the number of columns whose remainder has at
    least the share `least` of the norm of the largest column. The rows and columns from the rank on hold the remainder.

    Parameters
    ----------
    columns, order, right
        Arrays of at least (count, rows), (count,) and (rows,) elements.
    shape
        Numbers of columns and rows to use, (count, rows).
    """
    a, b = columns, right
    count, rows = shape
    for j in range(count):
        order[j] = j
    first = 0.0
    for k in range(min(count, rows)):
        # the remaining norms are computed anew: updating them loses the small ones, which decide the rank
        best, largest = k, -1.0
        for j in range(k, count):
            square = 0.0
            for i in range(k, rows):
                square += a[j, i] * a[j, i]
            if square > largest:
                best, largest = j, square
        if k == 0:
            first = largest
        if not largest > least * least * first:
            return k
        order[k], order[best] = order[best], order[k]
        for i in range(rows):
            a[k, i], a[best, i] = a[best, i], a[k, i]
        # the sign that avoids a difference of nearly equal numbers
        alpha = sqrt(largest) if a[k, k] <= 0.0 else -sqrt(largest)
        half = largest - alpha * a[k, k]
        a[k, k] -= alpha
        for j in range(k + 1, count):
            product = 0.0
            for i in range(k, rows):
                product += a[k, i] * a[j, i]
            for i in range(k, rows):
                a[j, i] -= product / half * a[k, i]
        product = 0.0
        for i in range(k, rows):
            product += a[k, i] * b[i]
        for i in range(k, rows):
            b[i] -= product / half * a[k, i]
        a[k, k] = alpha
    return min(count, rows)


@subkernel
def solve_triangle(a, rank, right, x):
    """Solve the triangular system of the first columns, whose right-hand side may be the solution `x` itself."""
    for i in range(rank - 1, -1, -1):
        value = right[i]
        for j in range(i + 1, rank):
            value -= a[j, i] * x[j]
        x[i] = value / a[i, i]


@subkernel
def solve_least_norm(a, order, b, x, lean, count, rank):
    """Write the least-squares solution of least norm into `x` (count,), after `reduce_columns`.

    Of all solutions, ``y - S z`` with ``S = R11^-1 R12`` and the other components z, that of least norm satisfies
    ``(I + S^T S) z = S^T y``. `lean` is a work array of at least (count, count) elements; `a` and `b`, which has at
    least (count,) elements, are overwritten.
    """
    solve_triangle(a, rank, b, x)
    extra = count - rank
    for e in range(extra):
        solve_triangle(a, rank, a[rank + e], lean[e])
        b[e] = 0.0
        for i in range(rank):
            b[e] += lean[e, i] * x[i]
    for e in range(extra):  # Cholesky factors, beside the columns of S
        for f in range(e + 1):
            value = 1.0 if e == f else 0.0
            for i in range(rank):
                value += lean[e, i] * lean[f, i]
            for g in range(f):
                value -= lean[e, rank + g] * lean[f, rank + g]
            lean[e, rank + f] = sqrt(value) if e == f else value / lean[f, rank + f]
        # forward substitution in the same pass
        for f in range(e):
            b[e] -= lean[e, rank + f] * b[f]
        b[e] /= lean[e, rank + e]
    for e in range(extra - 1, -1, -1):
        for f in range(e + 1, extra):
            b[e] -= lean[f, rank + e] * b[f]
        b[e] /= lean[e, rank + e]
    for e in range(extra):
        x[rank + e] = b[e]
        for i in range(rank):
            x[i] -= lean[e, i] * b[e]
    for j in range(count):
        b[j] = x[j]
    # undo the exchange of columns, by way of the free right-hand side
    for j in range(count):
        x[order[j]] = b[j]


@kernel
def solve_each_least_squares(
    columns: RealCube, right: RealMatrix, x: RealMatrix, order: IntVector, lean: RealMatrix, least: float
) -> int:
    """Write the solutions of least norm of T least-squares problems into `x`; return the smallest rank.

    Parameters
    ----------
    columns
        (T, M, N) matrices, by columns; overwritten.
    right
        (T, L) right-hand sides, of which the first N numbers are used; L is at least M and N. Overwritten.
    x
        (T, M) solutions.
    order, lean
        (M,) and (M, M) work arrays.
    least
        Relative size below which the remainder of a column counts as zero.
    """
    count, rows = columns.shape[1], columns.shape[2]
    smallest = count
    for t in range(len(columns)):
        rank = reduce_columns(columns[t], order, right[t], (count, rows), least)
        solve_least_norm(columns[t], order, right[t], x[t], lean, count, rank)
        smallest = min(smallest, rank)
    return smallest


@kernel
def nearly_null_rows(
    columns: RealMatrix, order: IntVector, right: RealVector, y: RealMatrix, z: RealMatrix, least: float
) -> int:
    """Find combinations of columns that nearly vanish, which are linearly independent; return their number.

    Parameters
    ----------
    columns
        (M, N) matrix by columns; overwritten.
    order, right
        (M,) and (N,) work arrays.
    y
        (M, M) zeros; the first rows become the combinations.
    z
        (M, N) zeros; the first rows become the vectors that the combinations yield, in rotated coordinates.
    least
        Relative size below which the remainder of a column counts as small.
    """
    count, rows = columns.shape
    for i in range(rows):
        right[i] = 0.0
    rank = reduce_columns(columns, order, right, (count, rows), least)
    for e in range(count - rank):
        solve_triangle(columns, rank, columns[rank + e], right)
        for i in range(rank):
            y[e, order[i]] = -right[i]
        y[e, order[rank + e]] = 1.0
        for i in range(rank, rows):
            z[e, i] = columns[rank + e, i]
    return count - rank


@subkernel
def inner_product(x, y):
    """Return the inner product of two vectors."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@subkernel
def combine(x, y, c, s):
    """Replace the vectors x and y by ``c x - s y`` and ``s x + c y``."""
    for i in range(len(x)):
        first = c * x[i] - s * y[i]
        y[i] = s * x[i] + c * y[i]
        x[i] = first


@subkernel
def scale_vector(x, factor):
    """Multiply a vector by a number."""
    for i in range(len(x)):
        x[i] *= factor


@kernel
def orthonormalize_rows(y: RealMatrix, z: RealMatrix) -> None:
    """Make the linearly independent rows of `y` (K, M) orthonormal, and combine those of `z` (K, N) likewise.

    Gram-Schmidt orthogonalization is applied twice, which makes the rows orthogonal to rounding.
    """
    for e in range(len(y)):
        for _ in range(2):
            for f in range(e):
                along = inner_product(y[f], y[e])
                for i in range(y.shape[1]):
                    y[e, i] -= along * y[f, i]
                for i in range(z.shape[1]):
                    z[e, i] -= along * z[f, i]
            size = 1.0 / sqrt(inner_product(y[e], y[e]))
            scale_vector(y[e], size)
            scale_vector(z[e], size)


@subkernel
def rotate_rows(y, z, values):
    """See `rotate_to_singular_rows`."""
    count, turned = len(z), True
    sweep, least = 0, 0.0
    for p in range(count):
        least += VANISHED * inner_product(z[p], z[p])
    while turned and sweep < MOST_SWEEPS:
        turned, sweep = False, sweep + 1
        for p in range(count):
            for q in range(p + 1, count):
                alpha, beta, gamma = 0.0, 0.0, 0.0
                for i in range(z.shape[1]):
                    alpha += z[p, i] * z[p, i]
                    beta += z[q, i] * z[q, i]
                    gamma += z[p, i] * z[q, i]
                if min(alpha, beta) <= least or abs(gamma) <= ORTHOGONAL * sqrt(z.shape[1] * alpha * beta):
                    continue
                turned = True
                # the smaller of the two angles that make both rows orthogonal, which guarantees convergence
                zeta = (beta - alpha) / (2.0 * gamma)
                tangent = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + sqrt(1.0 + zeta * zeta))
                c = 1.0 / sqrt(1.0 + tangent * tangent)
                combine(z[p], z[q], c, c * tangent)
                combine(y[p], y[q], c, c * tangent)
    for p in range(count):
        values[p] = sqrt(inner_product(z[p], z[p]))
    return not turned


@kernel
def rotate_to_singular_rows(y: RealMatrix, z: RealMatrix, values: RealVector) -> bool:
    """Rotate the rows of `z` (K, N) among each other until they are orthogonal, and those of `y` (K, M) likewise.

    If ``z = y A`` with orthonormal rows of `y`, these become left singular vectors of A, if they span all of them. The
    norms of the rows of `z`, which are the singular values in no particular order, are written into `values` (K,).
    Returns whether the rows are orthogonal to rounding.
    """
    return rotate_rows(y, z, values)


@kernel
def singular_values_of_each(z: RealCube, none: RealMatrix, values: RealMatrix) -> bool:
    """Write the singular values of matrices `z` (T, K, N), with K at most N, into `values` (T, K), in no order.

    `z` is overwritten, and `none` is an array (K, 0). Returns whether all iterations have converged.
    """
    converged = True
    for t in range(len(z)):
        converged = rotate_rows(none, z[t], values[t]) and converged
    return converged
