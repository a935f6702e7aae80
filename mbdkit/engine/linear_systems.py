"""Linear systems whose pivots are chosen by their size, least squares, and products of small matrices.

SuperLU, which SciPy offers, and LAPACK call BLAS, whose rounding errors depend on the processor. Those of kernels, and
of NumPy's sums, do not.

Those of stacks of small matrices, one matrix in each of T frames, replace ``@`` and `numpy.linalg`, whose rounding
errors depend on the processor.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels import column_lu, stacks
from mbdkit.engine.kernels.orthogonal import rotate_to_singular_rows, singular_values_of_each, solve_each_least_squares
from mbdkit.engine.native.bundle import PinnedBundle

ROOM = 4  #: Initial number of entries of each factor, relative to those of the matrix.


class SparseFactors:
    """LU factors of a real or complex sparse matrix.

    `row`, `column`, `value`: (nnz,) row, column and value of each entry; values of the same entry are added. `order`:
    (n,) order in which the columns are eliminated. `threshold`: entries of the diagonal are preferred as pivots if they
    have at least this share of the largest entry of their column; with 0, always unless they are zero. Raises
    numpy.linalg.LinAlgError if the matrix is singular, or an entry is not a number.
    """

    def __init__(self, row: np.ndarray, column: np.ndarray, value: np.ndarray, order: np.ndarray, threshold: float):
        self._is_complex = np.iscomplexobj(value)
        self._dtype = np.complex128 if self._is_complex else np.float64
        n, room = len(order), ROOM * len(value) + len(order)
        sort = np.lexsort((row, column))
        start = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=n))]).astype(np.int64)
        matrix = (start, row[sort].astype(np.int64), value[sort].astype(self._dtype))
        while True:
            empty = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
            lower, upper, work = (
                self._empty(n, room),
                self._empty(n, room),
                (np.zeros(n, self._dtype), np.zeros(n, self._dtype)),
            )
            search = np.zeros((n, 4), dtype=np.int64)
            factors = column_lu.ColumnFactors(*matrix, order.astype(np.int64), *empty, *lower, *upper, *work, search)
            self._pinned = PinnedBundle(factors)
            status = (column_lu.factorize_complex_columns if self._is_complex else column_lu.factorize_columns)(
                self._pinned.address, float(threshold)
            )
            if status != column_lu.NO_ROOM:
                break
            room *= 2
        if status != column_lu.DONE:
            raise np.linalg.LinAlgError(f"the matrix is singular at column {order[status]}")
        self.row_of, self.column_of = factors.row_of, factors.column_of  #: (n,) row and column at each pivot position.
        #: Number of entries of both factors, with the diagonal.
        self.entries = int(factors.l_start[-1] + factors.u_start[-1]) + n

    def _empty(self, n: int, room: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.zeros(n + 1, dtype=np.int64), np.empty(room, dtype=np.int64), np.empty(room, self._dtype)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solutions (K, n) for the rows of `right` (K, n)."""
        x: np.ndarray = np.array(right, dtype=self._dtype, order="C")
        (column_lu.solve_complex_by_columns if self._is_complex else column_lu.solve_by_columns)(
            self._pinned.address, x
        )
        return x

    def solve_refined(self, right: np.ndarray) -> np.ndarray:
        """Return the solution (n,) of a real system for one right-hand side (n,), with one step of refinement."""
        x, work = np.empty(len(right)), np.empty(len(right))
        column_lu.solve_refined_by_columns(self._pinned.address, right, x, work)
        return x

    def norm_of_inverse(self) -> float:
        """Return an estimate of the 1-norm of the inverse, hardly ever less than a third of it.

        Source: N. J. Higham, ACM Trans. Math. Softw. 14 (1988) 381-396.
        """
        n = len(self.row_of)
        x, largest = np.full(n, 1.0 / n), 0.0
        for _ in range(5):
            y = self.solve(x[None])[0]
            size = np.abs(y)
            if not (norm := float(np.sum(size))) > largest:
                break
            largest = norm
            slope = np.conj(np.where(size > 0.0, y / np.where(size > 0.0, size, 1.0), 1.0))
            (column_lu.solve_complex_transposed if self._is_complex else column_lu.solve_transposed)(
                self._pinned.address, slope
            )
            index = int(np.argmax(np.abs(slope)))
            if np.abs(slope[index]) <= np.abs(np.sum(slope * x)):
                break
            x = np.zeros(n)
            x[index] = 1.0
        # A second vector detects matrices for which the first ones fail by coincidence.
        other = np.where(np.arange(n) % 2, -1.0, 1.0) * (1.0 + np.arange(n) / max(n - 1, 1))
        return max(largest, 2.0 * float(np.sum(np.abs(self.solve(other[None])))) / (3.0 * n))


def factors_of(matrix: np.ndarray) -> SparseFactors:
    """Return the factors of a dense matrix (n, n) by partial pivoting.

    Raises numpy.linalg.LinAlgError if the matrix is singular, or an entry is not a number.
    """
    row, column = np.nonzero(matrix)
    return SparseFactors(row, column, matrix[row, column], np.arange(len(matrix)), 1.0)


def inverse_of(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse of a real or complex matrix (n, n).

    Raises numpy.linalg.LinAlgError if the matrix is singular, or an entry is not a number.
    """
    return np.ascontiguousarray(factors_of(matrix).solve(np.eye(len(matrix))).T)


def least_norm(matrix: np.ndarray, right: np.ndarray, least: float) -> np.ndarray:
    """Return the least-squares solution (K,) of least norm.

    `matrix`, `right`: (I, K) matrix and (I,) right-hand side. `least`: remainders of columns below this share of the
    norm of the largest column count as zero.
    """
    return least_norms(matrix[None], right[None], least)[0]


def symmetric_eigenvectors(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues (n,) of a symmetric matrix (n, n) in ascending order, and its eigenvectors as columns.

    They are the singular vectors of the matrix plus a multiple of the identity matrix that makes it positive definite.
    Errors are relative to the norm of the matrix.
    """
    y = np.eye(len(matrix))
    z = matrix + 1.5 * float(np.max(np.sum(np.abs(matrix), axis=1), initial=0.0)) * y
    if not rotate_to_singular_rows(y, z, np.empty(len(matrix))):
        raise np.linalg.LinAlgError("eigenvectors did not converge")
    values = np.sum(y * product(y, matrix), axis=1)
    order = np.argsort(values, kind="stable")
    return values[order], y[order].T


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return ``a @ b`` without BLAS, for a matrix `a` (I, K) and a vector or matrix `b` (K,) or (K, J)."""
    return np.asarray(np.sum(a * b, axis=-1) if b.ndim == 1 else np.sum(a[..., None] * b, axis=-2))


def products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the products (T, I, J) of matrices `a` (T, I, K) and `b` (T, K, J), or (T, I) with vectors `b` (T, K).

    A single matrix (1, I, K) or (I, K) multiplies all frames.
    """
    one, other = a[None] if a.ndim == 2 else a, b[..., None] if b.ndim == 2 else b
    out = np.empty((max(len(one), len(other)) if len(one) and len(other) else 0, one.shape[1], other.shape[2]))
    stacks.multiply_each(_contiguous(one), _contiguous(other), out)
    return out[..., 0] if b.ndim == 2 else out


def complete_qr(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the orthogonal factors (T, I, I) and the upper triangular factors (T, I, J) of matrices (T, I, J)."""
    frames, rows, columns = matrices.shape
    r, q = np.array(matrices, dtype=float, order="C"), np.empty((frames, rows, rows))
    stacks.decompose_each(r, q, np.empty((columns, rows)), np.empty(columns), np.empty(max(rows, columns)))
    return q, r


def solve_triangles(triangles: np.ndarray, right: np.ndarray, *, transposed: bool = False) -> np.ndarray:
    """Return the solutions (T, M) of systems of upper triangular matrices (T, M, M), or of their transposes.

    Raises numpy.linalg.LinAlgError if a matrix is singular.
    """
    x: np.ndarray = np.array(right, dtype=float, order="C")
    if not (stacks.solve_upper_transposed_each if transposed else stacks.solve_upper_each)(_contiguous(triangles), x):
        raise np.linalg.LinAlgError("a triangular matrix is singular")
    return x


def least_norms(matrices: np.ndarray, right: np.ndarray, least: float) -> np.ndarray:
    """Return the least-squares solutions (T, K) of least norm.

    `matrices`, `right`: (T, I, K) matrices and (T, I) right-hand sides. `least`: remainders of columns below this share
    of the norm of the largest column count as zero.
    """
    frames, rows, count = matrices.shape
    x, padded = np.zeros((frames, count)), np.zeros((frames, max(rows, count)))
    padded[:, :rows] = right
    order, work = np.empty(count, dtype=np.int64), np.empty((count, count))
    columns = np.array(np.swapaxes(matrices, 1, 2), dtype=float, order="C")
    solve_each_least_squares(columns, padded, x, order, work, least)
    return x


def pseudoinverses(matrices: np.ndarray, least: float) -> np.ndarray:
    """Return the pseudoinverses (T, K, I) of matrices (T, I, K); see `least_norms` for `least`."""
    solution = np.empty((len(matrices), *matrices.shape[:0:-1]))
    for row, unit in enumerate(np.eye(matrices.shape[1])):
        solution[:, :, row] = least_norms(matrices, unit, least)
    return solution


def singular_values(matrices: np.ndarray) -> np.ndarray:
    """Return the singular values (T, K) of matrices (T, I, J) in descending order; K is the smaller of I and J."""
    is_tall = matrices.shape[1] > matrices.shape[2]
    z = np.array(np.swapaxes(matrices, 1, 2) if is_tall else matrices, dtype=float, order="C")
    values = np.empty(z.shape[:2])
    if not singular_values_of_each(z, np.empty((z.shape[1], 0)), values):
        raise np.linalg.LinAlgError("singular values did not converge")
    return -np.sort(-values, axis=1)


def _contiguous(x: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(x, dtype=float)
