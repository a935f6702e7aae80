"""Products and orthogonal decompositions of stacks of small matrices, one matrix in each of T frames.

Inner loops run over the columns of a row, so that the compiler vectorizes them without another order of the sums.
Source of the decomposition: G. H. Golub and C. F. Van Loan, Matrix Computations, 2013, sections 5.1 and 5.2.
"""

from __future__ import annotations

from math import sqrt

from mbdkit.engine.kernels.bundle_types import RealCube, RealMatrix, RealVector
from mbdkit.engine.native.functions import kernel, subkernel


@kernel
def multiply_each(a: RealCube, b: RealCube, out: RealCube) -> None:
    """Write the products of `a` (T, I, K) and `b` (T, K, J) into `out` (T, I, J), with sums in the order of K.

    A stack of a single matrix is the same factor in all frames.
    """
    count, columns = b.shape[1], b.shape[2]
    for t in range(len(out)):
        x, y = a[t if len(a) > 1 else 0], b[t if len(b) > 1 else 0]
        for i in range(out.shape[1]):
            sums = out[t, i]
            for j in range(columns):
                sums[j] = 0.0
            k = 0
            while k + 4 <= count:  # four terms at once save loads and stores, in the same order
                p, q, r, s = x[i, k], x[i, k + 1], x[i, k + 2], x[i, k + 3]
                for j in range(columns):
                    sums[j] = (((sums[j] + p * y[k, j]) + q * y[k + 1, j]) + r * y[k + 2, j]) + s * y[k + 3, j]
                k += 4
            while k < count:
                p = x[i, k]
                for j in range(columns):
                    sums[j] += p * y[k, j]
                k += 1


@subkernel
def reflect(rows, first, vector, factor, sums):
    """Apply the reflection ``1 - factor v v^T`` to the columns from `first` on of the rows from ``len(rows) - len(v)``
    on.
    """
    above, columns = len(rows) - len(vector), rows.shape[1]
    for j in range(first, columns):
        sums[j] = 0.0
    for i in range(len(vector)):
        x = vector[i]
        for j in range(first, columns):
            sums[j] += x * rows[above + i, j]
    for j in range(first, columns):
        sums[j] *= factor
    for i in range(len(vector)):
        x = vector[i]
        for j in range(first, columns):
            rows[above + i, j] -= x * sums[j]


@kernel
def decompose_each(a: RealCube, q: RealCube, vectors: RealMatrix, factors: RealVector, sums: RealVector) -> None:
    """Write the orthogonal factors of complete QR decompositions into `q` (T, I, I); R overwrites `a` (T, I, J).

    Columns are not exchanged.

    Parameters
    ----------
    vectors, factors, sums
        (J, I), (J,) and (I or J,) work arrays; `sums` has the larger number of elements.
    """
    rows, columns = a.shape[1], a.shape[2]
    steps = min(rows, columns)
    for t in range(len(a)):
        r, own = a[t], q[t]
        for k in range(steps):
            v = vectors[k, : rows - k]
            square = 0.0
            for i in range(k + 1, rows):
                v[i - k] = r[i, k]
                square += r[i, k] * r[i, k]
            factors[k] = 0.0
            # the column is reduced already; a reflection would divide by zero
            if square == 0.0:
                continue
            size = sqrt(square + r[k, k] * r[k, k])
            alpha = -size if r[k, k] > 0.0 else size
            v[0] = r[k, k] - alpha
            factors[k] = -1.0 / (alpha * v[0])
            reflect(r, k + 1, v, factors[k], sums)
            r[k, k] = alpha
            for i in range(k + 1, rows):
                r[i, k] = 0.0
        for i in range(rows):
            for j in range(rows):
                own[i, j] = 1.0 if i == j else 0.0
        # from the last reflection to the first, so that zeros of the unit matrix need no arithmetic
        for k in range(steps - 1, -1, -1):
            if factors[k] != 0.0:
                reflect(own, k, vectors[k, : rows - k], factors[k], sums)


@kernel
def solve_upper_each(r: RealCube, x: RealMatrix) -> bool:
    """Replace right-hand sides `x` (T, M) by the solutions of systems of upper triangular matrices `r` (T, M, M).

    Returns whether all diagonal entries differ from zero.
    """
    size, is_regular = r.shape[1], True
    for t in range(len(r)):
        for i in range(size - 1, -1, -1):
            value = x[t, i]
            for j in range(i + 1, size):
                value -= r[t, i, j] * x[t, j]
            is_regular = is_regular and r[t, i, i] != 0.0
            x[t, i] = value / r[t, i, i]
    return is_regular


@kernel
def solve_upper_transposed_each(r: RealCube, x: RealMatrix) -> bool:
    """Replace right-hand sides `x` (T, M) by the solutions of systems of the transposed upper triangular matrices.

    Returns whether all diagonal entries differ from zero.
    """
    size, is_regular = r.shape[1], True
    for t in range(len(r)):
        for i in range(size):
            is_regular = is_regular and r[t, i, i] != 0.0
            x[t, i] /= r[t, i, i]
            for j in range(i + 1, size):
                x[t, j] -= r[t, i, j] * x[t, i]
    return is_regular
