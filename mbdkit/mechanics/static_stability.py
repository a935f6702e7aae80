"""Stability of equilibria from the matrix of statics: the number of unstable motions, and where it changes.

The matrix of statics, ``[K, Phi_q^T; Phi_q, 0]`` with the stiffness K, is singular where an equilibrium loses or
regains its stability along a motion. The number of its negative eigenvalues is the number of unstable motions plus the
number of constraint rows, for any masses (H. Maddocks, 1985).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal, ldl
from scipy.sparse import block_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from mbdkit.mechanics.reduced import DENSE, SYMMETRIC, State, least_stiffness, reduce
from mbdkit.mechanics.source import PreparedMechanism

INVERSE_ITERATIONS = 3
"""Inverse iterations that find the motion along which a matrix is almost singular."""


def unstable_motions(prepared: PreparedMechanism, at: State) -> int:
    """Return the number of independent motions along which an equilibrium is unstable.

    For mechanisms of more than `DENSE` coordinates: 1 if there are any, or else 0. Follower forces make the stiffness
    unsymmetric; the eigenvalues with negative real part are counted then.
    """
    if not prepared.freedoms:
        return 0
    if prepared.equations.n > DENSE:
        return int(least_stiffness(prepared, at) < 0)
    matrix = static_matrix(prepared, at)[0].toarray()
    if np.max(np.abs(matrix - matrix.T)) > SYMMETRIC * np.max(np.abs(matrix)):
        return int(np.sum(np.linalg.eigvals(reduce(prepared, at).stiffness).real < 0))
    _, blocks, _ = ldl(
        0.5 * (matrix + matrix.T)
    )  # eigenvalues of the blocks of one or two rows; the number of negative ones is the same
    signs = eigvalsh_tridiagonal(np.diag(blocks).copy(), np.diag(blocks, 1).copy())
    return int(np.sum(signs < 0)) - prepared.equations.m


def static_matrix(prepared: PreparedMechanism, at: State) -> tuple[csc_array, np.ndarray]:
    """Return the matrix of statics (n + m, n + m), scaled to largest entries near 1, and the factors of its columns.

    The angles of point masses, which have no stiffness, get one.
    """
    p = prepared.equations
    stiffness = p.tangents(at.t, at.q, at.v, at.a, at.lam).stiffness + diags_array(prepared.held.astype(float))
    jacobian = p.constraint_jacobian(at.t, at.q)
    matrix = csr_array(block_array([[stiffness, jacobian.T], [jacobian, None]]))
    factors = np.ones(matrix.shape[0])
    for _ in range(2):  # D. Ruiz, A scaling algorithm to equilibrate both rows and columns norms in matrices (2001)
        largest = abs(matrix).max(axis=1).toarray().ravel()
        scale = 1 / np.sqrt(np.where(largest > 0, largest, 1.0))
        factors *= scale
        matrix = diags_array(scale) @ matrix @ diags_array(scale)
    return csc_array(matrix), factors


def singular_motion(prepared: PreparedMechanism, at: State) -> np.ndarray:
    """Return the solution (n + m,) of the homogeneous equations of statics near a singular state."""
    matrix, factors = static_matrix(prepared, at)
    lu = splu(matrix + 1e-14 * diags_array(np.ones(matrix.shape[0]), format="csc"))
    x = np.random.default_rng(0).standard_normal(matrix.shape[0])
    for _ in range(INVERSE_ITERATIONS):
        x = lu.solve(x)
        x /= np.linalg.norm(x)
    return np.asarray(factors * x)


def distance_to_singular(prepared: PreparedMechanism, at: State, border: np.ndarray) -> float:
    """Return a smooth function of a state that changes its sign where the matrix of statics is singular.

    It is the last unknown of the matrix with `border` (n + m,) as a further row and column, with a right-hand side that
    is 1 in the last row only; by Cramer's rule, it is the ratio of the determinants (Govaerts, Numerical Methods for
    Bifurcations of Dynamical Equilibria, section 3.2).

    Parameters
    ----------
    border
        The solution of the homogeneous equations in a singular state nearby; see `singular_motion`.
    """
    matrix, factors = static_matrix(prepared, at)
    row = border / factors
    beside = csr_array((row / np.linalg.norm(row))[None])
    bordered = csc_array(block_array([[matrix, beside.T], [beside, None]]))
    right = np.zeros(len(border) + 1)
    right[-1] = 1.0
    return float(splu(bordered).solve(right)[-1])
