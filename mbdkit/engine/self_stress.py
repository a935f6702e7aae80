"""Self-stresses: multipliers that push on nothing, ``Phi_q^T lambda = 0``; one for each redundant constraint row.

Only joints in closed loops can have any: a body that a single joint holds is in equilibrium under that joint's forces
alone, so that they vanish, and so on inwards. Chains and trees are done with by that argument.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism

SMALL = 1e-9
"""Singular values of the scaled Jacobian below this count as zero; round-off leaves 1e-15 to 1e-11."""

MOST_DENSE = 300
"""Rows up to which the self-stresses are found by a dense decomposition."""

TRACE = 1e-12
"""Regularisation of the sparse solves: singular values far above its root die out within an iteration."""


def looped_rows(compiled: CompiledMechanism) -> np.ndarray:
    """Return the numbers of the constraint rows of joints that may lie in closed loops, (m',)."""
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
    """Return the matrix with these entries, without its empty columns: dense up to `MOST_DENSE` rows, else sparse."""
    columns, column = np.unique(column, return_inverse=True)
    shape = (m, len(columns))
    if m > MOST_DENSE:
        from scipy.sparse import csr_array

        return csr_array((value, (row, column)), shape=shape)
    dense = np.zeros(shape)
    np.add.at(dense, (row, column), value)
    return dense


def self_stresses(jacobian: Any, expected: int = 0) -> np.ndarray:
    """Return an orthonormal basis (m, r) of the vectors that a matrix annihilates from the left.

    Parameters
    ----------
    jacobian
        (m, n), as `scaled_matrix` makes it, with rows of size about 1. A dense one is decomposed as a whole; for a
        sparse one the basis comes from inverse iteration with sparse factors, in time linear in m for chains of loops
        and few self-stresses.
    expected
        How many there may be.
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

    The matrix is as `scaled_matrix` makes it. With more rows than columns the value is 0.
    """
    m, n = jacobian.shape
    if m > MOST_DENSE and m <= n:
        basis, values = _smallest(jacobian, 16)
        return basis[:, -1], float(values[-1])
    dense = jacobian if isinstance(jacobian, np.ndarray) else jacobian.toarray()
    u, values, _ = np.linalg.svd(dense, full_matrices=m > n)
    return u[:, -1], float(values[-1]) if m <= n else 0.0


def _smallest(jacobian: Any, some: int) -> tuple[np.ndarray, np.ndarray]:
    """Return `some` left singular vectors of the smallest singular values, and those, largest first."""
    from scipy.sparse import block_array, eye_array
    from scipy.sparse.linalg import splu

    m, n = jacobian.shape
    matrix = block_array([[eye_array(n), jacobian.T], [jacobian, -TRACE * eye_array(m)]], format="csc")
    lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options={"SymmetricMode": True})
    x = np.random.default_rng(0).normal(size=(m, some))
    for iteration in range(4):
        x = lu.solve(np.concatenate([np.zeros((n, some)), x]))[n:]
        if iteration % 2:
            x = np.linalg.qr(x)[0]
    _, values, turned = np.linalg.svd(jacobian.T @ x, full_matrices=False)
    return x @ turned.T, values
