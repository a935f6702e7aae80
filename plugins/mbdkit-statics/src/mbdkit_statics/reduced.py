"""Linearised equations along the degrees of freedom: stiffness and damping on the constraint manifold.

A mechanism of up to `DENSE` coordinates is reduced to its degrees of freedom with an orthogonal basis of the null space
of the constraint Jacobian. The equations of larger mechanisms remain sparse, and ARPACK finds a few of their modes by
inverse iteration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import block_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import LinearOperator, eigs, eigsh, splu

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.mechanism.bodies import GROUND
from mbdkit_statics.prepared_mechanism import PreparedMechanism
from mbdkit_statics.states_at_rest import CoupledStates, StatesAtRest, StaticEquations

#: A stiffness counts as zero if it is below this fraction of the sum of the magnitudes of its terms.
NEUTRAL = 1e-11

DENSE = 1500  #: Largest number of coordinates for which the equations are reduced with a dense basis.

#: Tolerance of the search for a negative stiffness, relative to the inverse of the eigenvalue closest to zero.
NEGATIVE = 1e-6

#: An eigenvalue of a dense matrix below this share of the largest one may have a relative rounding error above one per
#: cent.
BLURRED = 1e-10

#: Rounding error of a sum relative to the magnitudes of its terms, and of an eigenvalue per degree of freedom relative
#: to the largest one.
NOISE = 64 * float(np.finfo(float).eps)

#: Share of its diagonal that is added to a damping matrix, which may be singular, before it is factorized.
SHIFT = 1e-12

#: Number of eigenvalues among which the lowest real part is chosen if the stiffness is not symmetric.
NEAREST = 4

#: Two points are held at a constant distance if motions change it by less than this share of what they move.
HELD = 1e-9

PILOTS = 3  #: Number of inverse iterations by which `_pilot` estimates the lowest frequency.


class State(NamedTuple):
    """A state to linearise about: time [s], position, velocity, acceleration (n,) and multipliers (m,)."""

    t: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray


@dataclass(frozen=True)
class Reduced:
    """``y'' + damping y' + stiffness y = 0`` for the motion ``basis y`` about a state.

    Attributes
    ----------
    basis : (n, f) array
        Basis of the degrees of freedom, orthonormal in the mass metric [1/sqrt(kg)].
    stiffness, damping : (f, f) arrays
        Stiffness and damping in this basis [1/s^2, 1/s]. The stiffness is exactly symmetric unless its skew part is
        larger than its rounding errors.
    turning : (n, f) array
        Time derivative of the basis; zero at rest.
    blur : (n, n) array
        Bounds of the rounding errors of the stiffness between two coordinates.
    """

    basis: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    turning: np.ndarray
    blur: np.ndarray

    def blur_along(self, motions: np.ndarray) -> np.ndarray:
        """Return bounds (k,) of the rounding errors of the stiffness along motions (n, k), for unit mass [1/s^2]."""
        ways = np.abs(motions)
        return np.asarray(np.sum(ways * (self.blur @ ways), axis=0))


@dataclass(frozen=True)
class Softness:
    """Motions at rest that no force restores, and those that forces drive on, up to `DENSE` coordinates.

    Attributes
    ----------
    neutral : (n, k) array
        Motions whose stiffness is zero up to rounding errors.
    negative
        Number of independent motions of negative stiffness.
    """

    neutral: np.ndarray
    negative: int


def in_statics(prepared: PreparedMechanism) -> PreparedMechanism:
    """Return a mechanism for statics, in which the first-order states, if there are any, are functions of the
    position.

    Raises
    ------
    SpecError
        If contacts are rigid, or if there are first-order states that this analysis does not support, such as those of
        muscles.
    """
    mechanism = prepared.workspace.mechanism
    if not mechanism.states:
        return prepared
    mechanism.refuse_kinds("statics")
    mechanism.refuse_side_forces("an analysis of a mechanism at rest")
    if prepared.equations.n > DENSE:
        mechanism.refuse_states(f"an analysis of more than {DENSE // 3} bodies")
    return replace(prepared, equations=StaticEquations(prepared.workspace))


def reduce_with_states(prepared: PreparedMechanism, at: State, z: np.ndarray) -> tuple[Reduced, CoupledStates | None]:
    """Return the result of `reduce`, and the small motions of the first-order states `z` (Z,), if any."""
    small = reduce(prepared, at, z)
    if not len(z):
        return small, None
    states = StatesAtRest(prepared.workspace, prepared.equations)
    force, by_state = states.by_states(at.t, at.q, at.v, z)
    by_position, by_velocity = states.rates_by_motion(at.t, at.q, at.v, z)
    moved = by_position @ small.basis + by_velocity @ small.turning
    names = tuple(item.name for item in prepared.workspace.mechanism.inputs)
    by_input, rates = states.by_inputs(at.t, at.q, at.v, z)
    by_input = np.vstack([small.basis.T @ by_input, rates])
    by_velocity = by_velocity @ small.basis
    return small, CoupledStates(states.names, small.basis.T @ force, moved, by_velocity, by_state, names, by_input)


def reduce(prepared: PreparedMechanism, at: State, z: np.ndarray | None = None) -> Reduced:
    """Linearise the equations about a state, along the degrees of freedom; `z` (Z,) are its first-order states.

    M is the mass matrix, Phi are the constraints with the multipliers lam, and Q are the applied forces. A deviation
    ``Z(t) y`` stays tangent to the constraint manifold. The basis Z moves with the mechanism and does not rotate within
    the tangent space, ``Z^T M Z' = 0``. The time derivative ``P = Z'`` is therefore the solution of
    ``Phi_q P = -d(Phi_q v + Phi_t)/dq Z`` with the smallest norm in the mass metric. The stiffness is
    ``Z^T (K Z + C P) - P^T M P`` and the damping ``Z^T C Z``, with ``K = d(Phi_q^T lam - Q)/dq`` and ``C = -dQ/dv``. In
    a state at rest P is zero.
    """
    p, free = prepared.equations, np.flatnonzero(~prepared.held)
    if z is not None:
        prepared.workspace.take_states(z)
    root = np.sqrt(p.mass[free])
    q, r = np.linalg.qr((p.constraint_jacobian(at.t, at.q).toarray()[:, free] / root).T, mode="complete")
    basis = q[:, p.m :] / root[:, None]
    _refuse_side_forces_that_work(prepared, at.q, free, basis)
    tangents = p.tangents(*at)
    k, c = (x.toarray()[np.ix_(free, free)] for x in (tangents.stiffness, tangents.damping))
    turning = 0.5 * tangents.gamma_v.toarray()[:, free] @ basis  # d(Phi_q v + Phi_t)/dq is -gamma_v / 2
    normal = q[:, : p.m] @ np.linalg.solve(r[: p.m].T, turning)  # M^1/2 P
    moved = normal / root[:, None]
    stiffness = basis.T @ (k @ basis + c @ moved) - normal.T @ normal
    size, sized = np.abs(basis), np.abs(normal)
    terms = size.T @ (np.abs(k) @ size + np.abs(c) @ np.abs(moved)) + sized.T @ sized
    if np.all(np.abs(stiffness - stiffness.T) <= NOISE * (terms + terms.T)):
        stiffness = 0.5 * (stiffness + stiffness.T)
    everywhere, turned = np.zeros((2, p.n, basis.shape[1]))
    everywhere[free], turned[free] = basis, moved
    return Reduced(everywhere, stiffness, basis.T @ c @ basis, turned, _blur(tangents.stiffness.toarray(), p.mass))


def _blur(stiffness: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Return bounds (n, n) of the rounding errors of the stiffness of the coordinates.

    A coordinate whose own stiffness is zero has the rounding errors of the terms that cancel in it. They are unknown,
    but at most as large as the translational stiffness of this body; in the angle, by the square of its radius of
    gyration.
    """
    own = np.abs(np.diag(stiffness)).reshape(-1, 3)
    firm = np.repeat(np.max(own[:, :2], axis=1), 3).reshape(-1, 3)
    firm[:, 2] = np.maximum(own[:, 2], firm[:, 2] * (mass[2::3] / mass[::3]))
    return np.asarray(NEUTRAL * np.abs(stiffness) + NOISE * np.diag(firm.ravel()))


def _refuse_side_forces_that_work(
    prepared: PreparedMechanism, q: np.ndarray, free: np.ndarray, basis: np.ndarray
) -> None:
    """Raise SpecError for the first side force whose points come closer in motions along a basis (f', f).

    The tangents hold reactions constant, and side forces that follow them; this is right where they do no work.
    """
    mechanism = prepared.workspace.mechanism
    for force in mechanism.following:
        slope, points, flat_points = np.zeros((2, len(q))), [], force.joint.flat_points
        for sign, body, point in zip((-1.0, 1.0), force.joint.bodies, (flat_points[:2], flat_points[2:]), strict=True):
            if body == GROUND:
                points.append(np.array(point))
                continue
            i = 3 * mechanism.bodies.index(body)
            c, s = np.cos(q[i + 2]), np.sin(q[i + 2])
            arm = np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])
            points.append(q[i : i + 2] + arm)
            slope[:, i : i + 3] = sign * np.array([[1.0, 0.0, -arm[1]], [0.0, 1.0, arm[0]]])
        along = (points[1] - points[0]) @ slope[:, free]
        if np.any(np.abs(along @ basis) > HELD * (np.abs(along) @ np.abs(basis))):
            raise SpecError(
                f"linearised equations do not include {force.side.name} of joint '{force.name}', whose points are not "
                "held at a constant distance; hold them, or set it to 0",
                key=f"model.joints.{quoted(force.name)}.{force.side.key}",
            )


def at_rest(prepared: PreparedMechanism, q: np.ndarray, lam: np.ndarray) -> State:
    """Return the state of rest at position `q` (n,) with the multipliers `lam` (m,)."""
    none = np.zeros(prepared.equations.n)
    return State(prepared.equations.t0, q, none, none, lam)


def least_stiffness(prepared: PreparedMechanism, at: State) -> float:
    """Return the lowest eigenvalue of the stiffness along the degrees of freedom, at rest [1/s^2].

    It is the lowest real part if eigenvalues are complex, as under follower loads.

    Nodes of slender beams have so little inertia that the largest eigenvalues can be 1e15 times the lowest one. The
    rounding errors of the large eigenvalues then hide the lowest one, which is found by inverse iteration instead.
    """
    if prepared.equations.n <= DENSE:
        values = _eigenvalues(reduce(prepared, at).stiffness)
        least, largest = float(np.min(values)), float(np.max(np.abs(values)))
        if abs(least) > BLURRED * largest or largest == 0.0:
            return least
    return _least_by_inverse_iteration(prepared, at)


def _eigenvalues(stiffness: np.ndarray) -> np.ndarray:
    if np.array_equal(stiffness, stiffness.T):
        return np.asarray(np.linalg.eigvalsh(stiffness))
    return np.asarray(np.linalg.eigvals(stiffness).real)


def symmetric_modes(stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues (f,) and eigenvectors (f, f) of a symmetric stiffness or damping.

    An eigenvalue is zero if only round-off is left of it.

    The lowest eigenvalues of slender beams are lost in the rounding errors of the largest one. They are recomputed by
    the Rayleigh-Ritz method in the space of their eigenvectors, whose errors are the round-off of its terms plus the
    squares of the errors of the eigenvectors.
    """
    squares, vectors = eigh(stiffness)
    largest = np.max(np.abs(squares), initial=0.0)
    lost = np.abs(squares) <= NOISE * len(squares) * largest
    squares[lost], turn = eigh(vectors[:, lost].T @ stiffness @ vectors[:, lost])
    vectors[:, lost] = vectors[:, lost] @ turn
    terms = np.sum(np.abs(vectors) * (np.abs(stiffness) @ np.abs(vectors)), axis=0)
    return np.where(lost & (np.abs(squares) <= NOISE * (terms + NOISE * largest)), 0.0, squares), vectors


def is_conservative(prepared: PreparedMechanism, at: State) -> bool:
    """Return whether the energy decides the stability at rest: its eigenvalues are then not needed.

    This is the case if the stiffness is symmetric and the damping takes no energy from the loads. If the potential has
    no minimum, there may be no gyroscopic forces either, which can stabilise the equilibrium.
    """
    p = prepared.equations
    tangents = p.tangents(*at)
    if p.n > DENSE:
        return _is_symmetric(tangents.stiffness) and _is_passive(tangents.damping)
    if not tangents.damping.count_nonzero() and _is_symmetric(tangents.stiffness):
        return True
    small = reduce(prepared, at)
    if not np.array_equal(small.stiffness, small.stiffness.T):
        return False
    if not np.any(small.damping):
        return True
    symmetric = 0.5 * (small.damping + small.damping.T)
    is_gyroscopic = np.any(np.abs(small.damping - symmetric) > NOISE * np.max(np.abs(small.damping)))
    if is_gyroscopic and np.min(_eigenvalues(small.stiffness)) <= 0:
        return False
    return bool(np.all(symmetric_modes(symmetric)[0] >= 0))


def _is_symmetric(matrix: csr_array) -> bool:
    """Return whether a large matrix is symmetric up to rounding errors relative to the largest entries of its rows."""
    skew = csr_array(abs(matrix - matrix.T)).tocoo()
    size = abs(matrix).max(axis=1).toarray().ravel()
    return bool(np.all(skew.data <= NOISE * np.maximum(size[skew.row], size[skew.col])))


def _is_passive(damping: csr_array) -> bool:
    """Return whether a large damping matrix is symmetric and, by the pivots of its factorization, never negative."""
    if not damping.count_nonzero():
        return True
    diagonal = damping.diagonal()
    if np.any(diagonal < 0) or not _is_symmetric(damping):
        return False
    scale = diags_array(1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)))
    shifted = csc_array(scale @ damping @ scale + SHIFT * diags_array(np.ones(len(diagonal))))
    try:
        lu = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # it is singular
        return False
    return bool(np.array_equal(lu.perm_r, lu.perm_c) and np.all(lu.U.diagonal() > 0))


def softest_motion(prepared: PreparedMechanism, at: State) -> tuple[float, np.ndarray]:
    """Return the lowest stiffness at rest, for unit mass [1/s^2], and the motion (n,) that has this stiffness.

    Only for mechanisms of up to `DENSE` coordinates. If the stiffness is not symmetric, it is the lowest real
    eigenvalue, along whose motion a displacement causes a force; infinite, for the motion zero, if there is none.
    """
    small = reduce(prepared, at)
    if np.array_equal(small.stiffness, small.stiffness.T):
        values, vectors = np.linalg.eigh(small.stiffness)
    else:
        values, vectors = np.linalg.eig(small.stiffness)
        values = np.where(values.imag == 0, values.real, np.inf)
    least = int(np.argmin(values))
    way = small.basis @ vectors[:, least].real
    return float(values[least]), way if np.isfinite(values[least]) else np.zeros_like(way)


def stiffness_scale(prepared: PreparedMechanism, at: State) -> float:
    """Return the largest stiffness of a single coordinate, for unit mass [1/s^2]."""
    p = prepared.equations
    return float(np.max(np.abs(p.tangents(*at).stiffness.diagonal()) / p.mass))


def softness(prepared: PreparedMechanism, at: State) -> Softness:
    """Return the motions without restoring force at rest, and the number of motions of negative stiffness.

    The stiffness must be symmetric. Its rounding errors follow from the bodies that take part in a motion, so that a
    stiff spring elsewhere does not hide a soft one.
    """
    small = reduce(prepared, at)
    values, vectors = symmetric_modes(0.5 * (small.stiffness + small.stiffness.T))
    motions = small.basis @ vectors
    blur = small.blur_along(motions)
    return Softness(motions[:, np.abs(values) <= blur], int(np.sum(values < -blur)))


def lowest(prepared: PreparedMechanism, at: State, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues [1/s] closest to zero, and their shapes (n, k), of a large mechanism at rest.

    ARPACK runs in shift-invert mode on the first-order form; the real shift is half of the estimated lowest frequency.

    Parameters
    ----------
    count
        Number of eigenvalues; both eigenvalues of a conjugate pair are counted.
    """
    p, n = prepared.equations, prepared.equations.n
    prepared.workspace.mechanism.refuse_side_forces("the modes of a large mechanism")
    shift = 0.5 * np.sqrt(_pilot(prepared, at)[0])
    tangents = p.tangents(*at)
    matrix = p.iteration_matrix(*at, mass=shift**2, damping=shift, stiffness=1.0)
    no_rows = np.zeros(p.m)

    def inverse(x: np.ndarray) -> np.ndarray:
        """Solve ``dv - shift dq = f``, ``-K dq - C dv - shift M dv = M g`` for (dq, dv) within the free motions.

        K, C and M are the matrices of stiffness, damping and mass; `x` contains f and g.
        """
        f, g = x[:n], x[n:]
        dq, _ = matrix.solve(-p.mass * (g + shift * f) - tangents.damping @ f, no_rows)
        return np.concatenate([dq, f + shift * dq])

    first = np.concatenate([_pilot(prepared, at)[1]] * 2)
    inverted, vectors = eigs(
        LinearOperator((2 * n, 2 * n), matvec=inverse, dtype=float), k=count, v0=inverse(first), tol=1e-13
    )
    return shift + 1 / inverted, vectors[:n]


def _pilot(prepared: PreparedMechanism, at: State) -> tuple[float, np.ndarray]:
    """Return an estimate of the square of the lowest frequency [1/s^2] and of its mode shape (n,).

    The estimate is the Rayleigh quotient after `PILOTS` inverse iterations from a random vector. A motion without
    stiffness would make the matrix singular; a shift of 1e-9 times the quotient of the start vector prevents this. The
    shift is also the lower bound of the estimate.
    """
    p = prepared.equations
    no_rows = np.zeros(p.m)
    x = np.where(prepared.held, 0.0, np.random.default_rng(0).standard_normal(p.n))
    stiffness = p.tangents(*at).stiffness
    x, _ = p.solve(at.t, at.q, p.mass * x, no_rows)
    square = abs(float(x @ (stiffness @ x)) / float(x @ (p.mass * x)))
    scale = square or 1.0
    for _ in range(PILOTS):
        x, _ = p.iteration_matrix(*at, mass=1e-9 * scale, stiffness=1.0).solve(p.mass * x, no_rows)
        x = x / np.sqrt(float(x @ (p.mass * x)))
        square = abs(float(x @ (stiffness @ x)))
    return max(square, 1e-9 * scale), x


def _least_by_inverse_iteration(prepared: PreparedMechanism, at: State) -> float:
    """Return the lowest eigenvalue of a large mechanism [1/s^2]; if some are negative, the negative one closest to
    zero. If the stiffness is not symmetric, it is the lowest real part of the `NEAREST` eigenvalues closest to zero.

    ARPACK first finds the eigenvalue of the inverse matrix with the largest absolute value. If it is positive, a second
    search looks for the lowest eigenvalue of the inverse. Most eigenvalues of the inverse are close to zero, where a
    relative tolerance would require more accuracy than is needed. The second search therefore shifts all eigenvalues by
    the first one, so that the tolerance `NEGATIVE` is relative to the first one.
    """
    p = prepared.equations
    square, first = _pilot(prepared, at)
    matrix = p.iteration_matrix(*at, mass=0.01 * square, stiffness=1.0)
    root, no_rows = np.sqrt(p.mass), np.zeros(p.m)

    def inverse(x: np.ndarray) -> np.ndarray:
        return np.asarray(root * matrix.solve(root * x, no_rows)[0])

    def extreme(matvec: Callable[[np.ndarray], np.ndarray], which: str, start: np.ndarray, tolerance: float) -> float:
        operator = LinearOperator((p.n, p.n), matvec=matvec, dtype=float)
        return float(eigsh(operator, k=1, which=which, v0=start, tol=tolerance, return_eigenvectors=False)[0])

    if not _is_symmetric(p.tangents(*at).stiffness) and prepared.freedoms > NEAREST + 1:
        operator = LinearOperator((p.n, p.n), matvec=inverse, dtype=float)
        nearest = eigs(operator, k=NEAREST, v0=root * first, tol=1e-12, return_eigenvectors=False)
        return float(np.min((1 / nearest).real)) - 0.01 * square
    result = extreme(inverse, "LM", root * first, 1e-12)
    if result > 0:
        anything = np.random.default_rng(0).standard_normal(p.n)
        least = extreme(lambda x: inverse(x) + result * x, "SA", anything, NEGATIVE) - result
        result = least if least < -10 * NEGATIVE * result else result
    return 1 / result - 0.01 * square


#: Number of inverse iterations used to find the motion for which a matrix is almost singular.
INVERSE_ITERATIONS = 3


def static_matrix(prepared: PreparedMechanism, at: State) -> tuple[csc_array, np.ndarray]:
    """Return the matrix of statics (n + m, n + m), whose rows and columns are scaled so that their largest entries are
    near 1, and the scale factors.

    The angles of point masses, which have no stiffness, are given an artificial stiffness.
    """
    p = prepared.equations
    stiffness = p.tangents(*at).stiffness + diags_array(prepared.held.astype(float))
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
    """Return the motion and the multipliers (n + m,) that solve the homogeneous equations of statics near a singular
    state.
    """
    matrix, factors = static_matrix(prepared, at)
    lu = splu(matrix + 1e-14 * diags_array(np.ones(matrix.shape[0]), format="csc"))
    x = np.random.default_rng(0).standard_normal(matrix.shape[0])
    for _ in range(INVERSE_ITERATIONS):
        x = lu.solve(x)
        x /= np.linalg.norm(x)
    return np.asarray(factors * x)


def distance_to_singular(prepared: PreparedMechanism, at: State, border: np.ndarray) -> float:
    """Return a smooth function of a state that changes its sign where the matrix of statics is singular.

    The matrix is extended by `border` (n + m,) as an additional row and column, and the right-hand side is 1 in the
    last row only. The function is the last unknown; by Cramer's rule, it is the ratio of the two determinants
    (Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria, section 3.2).

    Parameters
    ----------
    border
        Solution of the homogeneous equations near the singular state; see `singular_motion`.
    """
    matrix, factors = static_matrix(prepared, at)
    row = border / factors
    beside = csr_array((row / np.linalg.norm(row))[None])
    bordered = csc_array(block_array([[matrix, beside.T], [beside, None]]))
    right = np.zeros(len(border) + 1)
    right[-1] = 1.0
    return float(splu(bordered).solve(right)[-1])
