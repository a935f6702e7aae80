"""Stability of an equilibrium, from small motions about it.

If the stiffness is symmetric and the damping passive, the energy decides: the equilibrium is stable where the potential
has a minimum, and every direction of negative stiffness is a motion that grows (Kelvin, Tait and Chetaev). Follower
loads, feedback, negative damping and first-order states make the stiffness unsymmetric or supply energy. The stiffness
then decides nothing, and the eigenvalues of the linearised motion are computed.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import eig, matrix_balance

from mbdkit_statics.one_sided import sides_of
from mbdkit_statics.prepared_mechanism import PreparedMechanism
from mbdkit_statics.reduced import (
    DENSE,
    NEUTRAL,
    NOISE,
    State,
    is_conservative,
    least_stiffness,
    lowest,
    reduce,
    reduce_with_states,
    softness,
    stiffness_scale,
)
from mbdkit_statics.states_at_rest import first_order_form

#: Assumed backward error of the eigenvalues of a matrix, relative to its norm after balancing.
ROUNDING = 32 * float(np.finfo(float).eps)

#: If the relative rounding error of an eigenvalue can exceed this, the lowest eigenvalues are computed by inverse
#: iteration as well.
BLURRED = 1e-5

EXAMINED = 8  #: Number of eigenvalues that are computed by inverse iteration.

#: An eigenvalue from inverse iteration counts as growing if its real part is above this share of its magnitude.
#:
#: Measured: 1e-8 of rounding errors for a column whose stiffnesses along and across it differ by a factor of 1e8.
GROWS = 1e-6

#: Smallest number of degrees of freedom for inverse iteration, which finds only a part of the eigenvalues.
LEAST = 10

#: An eigenvalue from inverse iteration counts as zero if its magnitude is below this share of the largest one.
AT_ZERO = 1e-5


@dataclass(frozen=True)
class Stability:
    """Stability of an equilibrium.

    Attributes
    ----------
    verdict
        ``stable``, ``neutral``, ``unstable``, ``corner``, ``unknown`` or ``fixed``; see `Equilibrium.stability`.
    stiffness
        Lowest stiffness along the degrees of freedom, for unit mass [1/s^2]; nan without degrees of freedom.
    growth
        Eigenvalue of the motion that grows fastest [1/s]; 0 if none grows exponentially.
    is_undamped
        Whether it is stable only as far as no motion is damped, although the loads can supply energy.
    is_corner
        Whether a force has a corner there, so that the stiffness depends on the direction.
    neutral : (n, k) array
        Motions that no force restores; none is given for more than `DENSE` coordinates.
    """

    verdict: str
    stiffness: float = float("nan")
    growth: complex = 0.0
    is_undamped: bool = False
    is_corner: bool = False
    neutral: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True)
class SmallMotions:
    """Growing motions about an equilibrium.

    Attributes
    ----------
    growing : complex array
        Eigenvalues of the motions that grow [1/s]; the fastest first. Both eigenvalues of a conjugate pair are listed.
    is_complete
        Whether all eigenvalues were examined; otherwise, only the `EXAMINED` lowest.
    decays
        Whether any motion decays.
    """

    growing: np.ndarray
    is_complete: bool
    decays: bool


def stability_of(dynamic: PreparedMechanism, statics: PreparedMechanism, at: State, z: np.ndarray) -> Stability:
    """Return the stability of an equilibrium.

    Parameters
    ----------
    dynamic, statics
        The mechanism, and the mechanism whose first-order states are functions of the position.
    z
        (Z,) first-order states.
    """
    if statics.freedoms == 0:
        return Stability("fixed")
    if (sides := sides_of(statics, at)) is not None:
        is_decided = not len(z) and (sides.verdict != "stable" or is_conservative(dynamic, at))
        return Stability(
            sides.verdict if is_decided else "corner",
            float(np.min(sides.least)),
            complex(np.sqrt(-sides.along)) if is_decided and sides.verdict == "unstable" else 0.0,
            is_corner=sides.differ,
        )
    stiffness = least_stiffness(statics, at)
    if not len(z) and is_conservative(dynamic, at):
        if statics.equations.n <= DENSE:
            if (soft := softness(statics, at)).neutral.size and not soft.negative:
                return Stability("neutral", 0.0, neutral=soft.neutral)
        elif abs(stiffness) <= NEUTRAL * stiffness_scale(statics, at):
            return Stability("neutral", 0.0)
        if stiffness > 0:
            return Stability("stable", stiffness)
        motions = small_motions(dynamic, at, z) if dynamic.equations.n <= DENSE else None
        growth = complex(np.sqrt(-stiffness)) if motions is None or not len(motions.growing) else motions.growing[0]
        return Stability("unstable", stiffness, growth)
    zeros, free = _free_motions(statics, at) if statics.equations.n <= DENSE else (0, np.zeros((0, 0)))
    motions = small_motions(dynamic, at, z, zeros)
    if len(motions.growing) or zeros > free.shape[1]:
        return Stability("unstable", stiffness, complex(motions.growing[0]) if len(motions.growing) else 0.0)
    if not motions.is_complete:
        return Stability("unknown", stiffness)
    return Stability("neutral" if zeros else "stable", stiffness, is_undamped=not motions.decays, neutral=free)


def unstable_motions(prepared: PreparedMechanism, at: State) -> np.ndarray:
    """Return an eigenvalue [1/s] for each independent motion along which an equilibrium is unstable, (U,).

    If the energy decides, the motions are only counted, and their eigenvalues are nan. If the mechanism is too large to
    be reduced to its degrees of freedom, only one is counted, or the lowest motions are examined.
    """
    if prepared.freedoms == 0:
        return np.zeros(0)
    if is_conservative(prepared, at):
        is_small = prepared.equations.n <= DENSE
        count = softness(prepared, at).negative if is_small else int(least_stiffness(prepared, at) < 0)
        return np.full(count, np.nan)
    return small_motions(prepared, at, np.zeros(0)).growing


def small_motions(prepared: PreparedMechanism, at: State, z: np.ndarray, zeros: int = 0) -> SmallMotions:
    """Return the growing motions about a state of rest.

    Parameters
    ----------
    z
        (Z,) first-order states.
    zeros
        Number of known motions without restoring force, whose eigenvalues have large rounding errors.
    """
    if prepared.equations.n > DENSE:
        few = _lowest_eigenvalues(prepared, at)
        return _small_motions(few, GROWS * np.abs(few), is_complete=False)
    small, states = reduce_with_states(prepared, at, z)
    values, error = eigenvalues_with_errors(first_order_form(small.stiffness, small.damping, states))
    order = np.argsort(np.abs(values))[2 * zeros :]
    is_blurred = bool(np.any(error[order] > BLURRED * np.abs(values[order])))
    if not is_blurred or len(z) or prepared.freedoms < LEAST:
        return _small_motions(values, error, is_complete=not is_blurred)
    few = _lowest_eigenvalues(prepared, at)
    rest = np.abs(values) > np.max(np.abs(few))
    return _small_motions(
        np.concatenate([few, values[rest]]), np.concatenate([GROWS * np.abs(few), error[rest]]), is_complete=True
    )


def _small_motions(values: np.ndarray, error: np.ndarray, *, is_complete: bool) -> SmallMotions:
    growing = values[values.real > error]
    fastest = np.lexsort((-growing.imag, -growing.real))
    return SmallMotions(growing[fastest], is_complete, bool(np.any(values.real < -error)))


def _lowest_eigenvalues(prepared: PreparedMechanism, at: State) -> np.ndarray:
    """Return the lowest eigenvalues by inverse iteration, without those of motions without restoring force."""
    values = lowest(prepared, at, min(EXAMINED, prepared.freedoms // 3))[0]
    return np.asarray(values[np.abs(values) > AT_ZERO * np.max(np.abs(values))])


def shape_of(prepared: PreparedMechanism, at: State, eigenvalue: complex) -> np.ndarray:
    """Return the amplitudes (n,) of all coordinates in the small motion with an eigenvalue [1/s]."""
    if prepared.equations.n > DENSE:
        values, shapes = lowest(prepared, at, EXAMINED)
    else:
        small = reduce(prepared, at)
        values, vectors = eig(first_order_form(small.stiffness, small.damping))
        shapes = small.basis @ vectors[: len(small.stiffness)]
    return np.asarray(np.abs(shapes[:, np.argmin(np.abs(values - eigenvalue))]))


def eigenvalues_with_errors(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues (N,) of a matrix, and bounds of their rounding errors (N,).

    The bound is the backward error times the condition number of the eigenvalue (Wilkinson, The Algebraic Eigenvalue
    Problem, section 2.8), so that the parts of a multiple eigenvalue, into which rounding splits it, are within it.
    """
    balanced, _ = matrix_balance(matrix, permute=False)
    values, left, right = eig(balanced, left=True, right=True)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    with np.errstate(divide="ignore"):
        return values, ROUNDING * np.linalg.norm(balanced, 2) / overlap


def _free_motions(statics: PreparedMechanism, at: State) -> tuple[int, np.ndarray]:
    """Return the number of eigenvalues zero of the stiffness, and the motions (n, k) without restoring force.

    There are fewer motions than zeros if a displacement causes a force along a motion without restoring force, as when
    a hovering body tilts: forces then drive the mechanism along this motion.
    """
    small = reduce(statics, at)
    values, left, right = eig(small.stiffness, left=True, right=True)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    terms = np.sum(np.abs(small.basis @ left) * (small.blur @ np.abs(small.basis @ right)), axis=0)
    zeros = int(np.sum(np.abs(values) * overlap <= terms))
    if not zeros:
        return 0, np.zeros((0, 0))
    _, sizes, ways = np.linalg.svd(small.stiffness)
    return zeros, small.basis @ ways[sizes <= NOISE * len(sizes) * sizes[0]].T
