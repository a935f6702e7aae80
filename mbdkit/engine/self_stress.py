"""Self-stresses: multipliers without generalized forces, ``Phi_q^T lambda = 0``; one for each redundant row.

Only joints in closed loops can have self-stresses. If a body has a single joint, that joint's force must vanish for the
body to be in equilibrium; the joint can be removed, and the argument applies to the next body. Thus chains and trees
have no self-stresses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.elimination_order import symmetric_order
from mbdkit.engine.kernels.orthogonal import nearly_null_rows, orthonormalize_rows, rotate_to_singular_rows
from mbdkit.engine.kernels.table_rows import BODIES
from mbdkit.engine.linear_systems import SparseFactors

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from mbdkit.engine.compiled_mechanism import CompiledMechanism

#: Singular values of the scaled Jacobian below this count as zero. Round-off causes values of 1e-15 to 1e-11.
SMALL = 1e-9

#: Combinations of rows below this relative size are examined for self-stresses. The triangular decomposition that finds
#: them can miss a singular value only if it is smaller by the ratio of both, which does not occur for such matrices.
CANDIDATE = 1e-5

MOST_DENSE = 300  #: Largest number of rows for which dense matrices are used.

#: Regularisation of the sparse solves.
#:
#: Each iteration suppresses components whose singular values are far above the square root of this value.
TRACE = 1e-12


#: The coordinates are eliminated first only if computing J J^T takes at most this many multiplications per row of J.
#:
#: If a body has hundreds of joints, J J^T has too many entries to be factorized.
MOST_PRODUCTS = 100


def looped_rows(compiled: CompiledMechanism) -> np.ndarray:
    """Return the indices (m',) of the constraint rows of all joints that can be part of closed loops."""
    ground = len(compiled.bodies)
    ends = [compiled.topology.pairs[members[0], BODIES].tolist() for members in compiled.joint_pairs]
    on_body: dict[int, set[int]] = {}
    for joint, bodies in enumerate(ends):
        for body in bodies:
            on_body.setdefault(body, set()).add(joint)
    left = set(range(len(ends)))
    leaves = [body for body, joints in on_body.items() if len(joints) == 1 and body != ground]
    while leaves:
        body = leaves.pop()
        if len(on_body[body]) != 1:
            continue
        joint = on_body[body].pop()
        left.discard(joint)
        first, second = ends[joint]
        other = second if first == body else first
        on_body[other].discard(joint)
        if len(on_body[other]) == 1 and other != ground:
            leaves.append(other)
    kept = {pair for joint in left for pair in compiled.joint_pairs[joint]}
    return np.array([i for i, row in enumerate(compiled.rows) if row.pair in kept], dtype=np.int64)


def scaled_matrix(m: int, row: np.ndarray, column: np.ndarray, value: np.ndarray) -> np.ndarray | csr_array:
    """Return a matrix with the given entries and without empty columns: dense up to `MOST_DENSE` rows, else sparse."""
    columns, column = np.unique(column, return_inverse=True)
    shape = (m, len(columns))
    if m > MOST_DENSE:
        from scipy.sparse import csr_array

        return csr_array((value, (row, column)), shape=shape)
    dense = np.zeros(shape)
    np.add.at(dense, (row, column), value)
    return dense


def self_stresses(jacobian: np.ndarray | csr_array, expected: int = 0) -> np.ndarray:
    """Return an orthonormal basis (m, r) of the left null space of a matrix.

    - `jacobian`: (m, n) matrix as returned by `scaled_matrix`, with rows of norm about 1. For a dense matrix a
      triangular decomposition with column pivoting is computed, and the singular values of what is nearly dependent.
      For a sparse matrix inverse iteration with sparse factors is used; its cost is linear in m for chains of loops
      with few self-stresses.
    - `expected`: expected number r of basis vectors; determines the initial size of the sparse iteration only.
    """
    m, n = jacobian.shape
    if m == 0:
        return np.zeros((0, 0))
    some = expected + 16
    while m > MOST_DENSE and 4 * some < m:
        basis, values = _smallest(jacobian, some)
        if values[0] >= SMALL:
            return basis[:, values < SMALL]
        some *= 4
    dense = np.array(jacobian if isinstance(jacobian, np.ndarray) else jacobian.toarray())
    y, z = np.zeros((m, m)), np.zeros((m, n))
    count = nearly_null_rows(dense, np.zeros(m, dtype=np.int64), np.zeros(n), y, z, CANDIDATE)
    basis, values = _singular_vectors(y[:count].copy(), z[:count].copy())
    return basis[:, values < SMALL]


def smallest_stress(jacobian: np.ndarray | csr_array) -> tuple[np.ndarray, float]:
    """Return the left singular vector (m,) of the smallest singular value of a matrix (m, n), and that value.

    The matrix has the format of `scaled_matrix`. If it has more rows than columns, the value is 0.
    """
    m, n = jacobian.shape
    if m > MOST_DENSE and m <= n:
        basis, values = _smallest(jacobian, 16)
    else:
        dense = jacobian if isinstance(jacobian, np.ndarray) else jacobian.toarray()
        basis, values = _singular_vectors(np.eye(m), np.array(dense))
    return basis[:, -1], float(values[-1]) if m <= n else 0.0


def _singular_vectors(y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return left singular vectors (m, K) of a matrix J, and singular values in descending order.

    They are those of the subspace of the rows of `y` (K, m), which are linearly independent; `z` (K, n) holds ``y J``,
    or these vectors after a rotation. Both are overwritten.
    """
    values = np.empty(len(y))
    orthonormalize_rows(y, z)
    if not rotate_to_singular_rows(y, z, values):
        raise np.linalg.LinAlgError("singular vectors did not converge")
    order = np.argsort(-values, kind="stable")
    return np.ascontiguousarray(y[order].T), values[order]


def _smallest(jacobian: csr_array, some: int) -> tuple[np.ndarray, np.ndarray]:
    """Return left singular vectors of the `some` smallest singular values, and these values, in descending order.

    The sparse matrix ``[I, J^T; J, -TRACE]`` is factorized for inverse iteration with ``J J^T + TRACE``.
    """
    m, n = jacobian.shape
    row, column, value = np.repeat(np.arange(m), np.diff(jacobian.indptr)), jacobian.indices.astype(int), jacobian.data
    on_column = np.bincount(column, minlength=n)
    diagonal = np.arange(n + m)
    parts = np.concatenate([diagonal, n + row, column]), np.concatenate([diagonal, column, n + row])
    entries = np.concatenate([np.ones(n), np.full(m, -TRACE), value, value])
    # After the coordinates, J J^T + TRACE is left, which is positive definite and needs no exchange of pivots, which
    # would cause much fill. If J J^T has too many entries, any order is allowed.
    if np.sum(on_column**2) <= MOST_PRODUCTS * m:
        product = (abs(jacobian) @ abs(jacobian).T).tocoo()  # its pattern
        order, threshold = np.concatenate([diagonal[:n], n + symmetric_order(m, product.row, product.col)]), 0.0
    else:
        order, threshold = symmetric_order(n + m, *parts), 0.01
    factors = SparseFactors(*parts, entries, order, threshold)
    x = np.random.default_rng(0).normal(size=(some, m))
    for _ in range(4):
        x = -factors.solve(np.concatenate([np.zeros((some, n)), x], axis=1))[:, n:]
        orthonormalize_rows(x, np.zeros((some, 0)))
    z = np.stack([np.bincount(column, value * one[row], minlength=n) for one in x])
    return _singular_vectors(x, z)
