"""Self-stresses: multipliers without generalized forces, ``Phi_q^T lambda = 0``; one for each redundant row.

Only joints in closed loops can have self-stresses. If a body has a single joint, that joint's force must vanish for the
body to be in equilibrium; the joint can be removed, and the argument applies to the next body. Thus chains and trees
have no self-stresses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism

SMALL = 1e-9
"""Singular values of the scaled Jacobian below this count as zero. Round-off causes values of 1e-15 to 1e-11."""

MOST_DENSE = 300
"""Largest number of rows for which a dense singular value decomposition is used."""

TRACE = 1e-12
"""Regularisation of the sparse solves.

Each iteration suppresses components whose singular values are far above the square root of this value.
"""


MOST_PRODUCTS = 100
"""A Jacobian J is used in the form J J^T only if computing J J^T takes at most this many multiplications per row of J.

If a body has hundreds of joints, J J^T has too many entries to be factorized.
"""


def looped_rows(compiled: CompiledMechanism) -> np.ndarray:
    """Return the indices (m',) of the constraint rows of all joints that can be part of closed loops."""
    ground = len(compiled.bodies)
    ends = [compiled.topology.pairs[members[0], 1:3].tolist() for members in compiled.joint_pairs]
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


def scaled_matrix(m: int, row: np.ndarray, column: np.ndarray, value: np.ndarray) -> Any:
    """Return a matrix with the given entries and without empty columns: dense up to `MOST_DENSE` rows, else sparse."""
    columns, column = np.unique(column, return_inverse=True)
    shape = (m, len(columns))
    if m > MOST_DENSE:
        from scipy.sparse import csr_array

        return csr_array((value, (row, column)), shape=shape)
    dense = np.zeros(shape)
    np.add.at(dense, (row, column), value)
    return dense


def self_stresses(jacobian: Any, expected: int = 0) -> np.ndarray:
    """Return an orthonormal basis (m, r) of the left null space of a matrix.

    Parameters
    ----------
    jacobian
        (m, n) matrix as returned by `scaled_matrix`, with rows of norm about 1. For a dense matrix the singular value
        decomposition is computed. For a sparse matrix inverse iteration with sparse factors is used; its cost is linear
        in m for chains of loops with few self-stresses.
    expected
        Expected number r of basis vectors; determines the initial size of the sparse iteration only.
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
    dense = jacobian if isinstance(jacobian, np.ndarray) else jacobian.toarray()
    u, values, _ = np.linalg.svd(dense, full_matrices=m > n)
    null = np.concatenate([values < SMALL, np.ones(m - len(values), dtype=bool)]) if m > n else values < SMALL
    return u[:, null]


def smallest_stress(jacobian: Any) -> tuple[np.ndarray, float]:
    """Return the left singular vector (m,) of the smallest singular value of a matrix (m, n), and that value.

    The matrix has the format of `scaled_matrix`. If it has more rows than columns, the value is 0.
    """
    m, n = jacobian.shape
    if m > MOST_DENSE and m <= n:
        basis, values = _smallest(jacobian, 16)
        return basis[:, -1], float(values[-1])
    dense = jacobian if isinstance(jacobian, np.ndarray) else jacobian.toarray()
    u, values, _ = np.linalg.svd(dense, full_matrices=m > n)
    return u[:, -1], float(values[-1]) if m <= n else 0.0


def _smallest(jacobian: Any, some: int) -> tuple[np.ndarray, np.ndarray]:
    """Return left singular vectors of the `some` smallest singular values, and these values, in descending order."""
    from scipy.sparse import block_array, eye_array
    from scipy.sparse.linalg import splu

    m, n = jacobian.shape
    on_column = np.bincount(jacobian.indices, minlength=n)
    # J J^T, without unknowns for the coordinates, is positive definite and needs no pivoting, which would cause much
    # fill. If it has too many entries, a larger matrix with unknowns for the coordinates is used.
    without_coordinates = np.sum(on_column**2) <= MOST_PRODUCTS * m
    if without_coordinates:
        matrix, threshold = (jacobian @ jacobian.T + TRACE * eye_array(m)).tocsc(), 0.0
    else:
        matrix = block_array([[eye_array(n), jacobian.T], [jacobian, -TRACE * eye_array(m)]], format="csc")
        threshold = 0.01
    lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=threshold, options={"SymmetricMode": True})
    x = np.random.default_rng(0).normal(size=(m, some))
    for iteration in range(4):
        x = lu.solve(x) if without_coordinates else lu.solve(np.concatenate([np.zeros((n, some)), x]))[n:]
        if iteration % 2:
            x = np.linalg.qr(x)[0]
    _, values, turned = np.linalg.svd(jacobian.T @ x, full_matrices=False)
    return x @ turned.T, values
