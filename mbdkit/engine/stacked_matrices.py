"""Products, decompositions and least squares of stacks of small matrices, one matrix in each of T frames.

They replace ``@`` and `numpy.linalg`, whose rounding errors depend on the processor.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.orthogonal import singular_values_of_each, solve_each_least_squares
from mbdkit.engine.kernels.stacks import (
    decompose_each,
    multiply_each,
    solve_upper_each,
    solve_upper_transposed_each,
)


def products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the products (T, I, J) of matrices `a` (T, I, K) and `b` (T, K, J), or (T, I) with vectors `b` (T, K).

    A single matrix (1, I, K) or (I, K) multiplies all frames.
    """
    one, other = a[None] if a.ndim == 2 else a, b[..., None] if b.ndim == 2 else b
    out = np.empty((max(len(one), len(other)) if len(one) and len(other) else 0, one.shape[1], other.shape[2]))
    multiply_each(_contiguous(one), _contiguous(other), out)
    return out[..., 0] if b.ndim == 2 else out


def complete_qr(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the orthogonal factors (T, I, I) and the upper triangular factors (T, I, J) of matrices (T, I, J)."""
    frames, rows, columns = matrices.shape
    r, q = np.array(matrices, dtype=float, order="C"), np.empty((frames, rows, rows))
    decompose_each(r, q, np.empty((columns, rows)), np.empty(columns), np.empty(max(rows, columns)))
    return q, r


def solve_triangles(triangles: np.ndarray, right: np.ndarray, *, transposed: bool = False) -> np.ndarray:
    """Return the solutions (T, M) of systems of upper triangular matrices (T, M, M), or of their transposes.

    Raises numpy.linalg.LinAlgError if a matrix is singular.
    """
    x: np.ndarray = np.array(right, dtype=float, order="C")
    if not (solve_upper_transposed_each if transposed else solve_upper_each)(_contiguous(triangles), x):
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
