"""Forces of contacts with planar Coulomb friction."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np

from mbdkit.engine.repeated_call import RepeatedCall
from mbdkit_contact.kernels.cone_sweeps import couple_contacts, sweep_contacts
from mbdkit_contact.kernels.pivoting import Cones, cone_forces, new_cones


class _Storage(threading.local):
    """Arrays for each number of contacts, with the call of the kernel that uses them, in every thread."""

    def __init__(self) -> None:
        self.cones: dict[int, tuple[Cones, RepeatedCall]] = {}


_STORAGE = _Storage()


class Pushed(NamedTuple):
    """Forces, or impulses, of k contacts.

    Attributes
    ----------
    normal, tangent
        (k,) forces.
    is_closed
        (k,) whether the contact is closed: its normal force is a basic variable of the solution by Lemke's method, or
        positive after sweeps.
    is_slipping
        (k,) whether friction is at its limit.
    residual
        Error of the velocities of the contacts, relative to the largest velocity without these forces.
    """

    normal: np.ndarray
    tangent: np.ndarray
    is_closed: np.ndarray
    is_slipping: np.ndarray
    residual: float = 0.0


def coulomb(
    response: np.ndarray,
    normal: np.ndarray,
    tangent: np.ndarray,
    friction: np.ndarray,
    sliding: np.ndarray | float = 0.0,
    pressed: np.ndarray | float = 0.0,
) -> Pushed | None:
    """Return the forces of contacts with Coulomb friction; None if no solution is found.

    Let u be the accelerations of the contacts (or their velocities after an impact). Each normal force N is positive
    only if the contact does not open: ``0 <= N, 0 <= u_n, N u_n = 0``. Each friction force T satisfies ``|T| <= mu N``;
    if u_t is not 0, then T has the magnitude mu N and opposes u_t (D. E. Stewart and J. C. Trinkle, International
    Journal for Numerical Methods in Engineering 39:2673-2691, 1996).

    Parameters
    ----------
    response
        (2 k, 2 k) matrix that maps forces to accelerations; in both, the k normal components come first.
    normal, tangent
        (k,) normal and tangential accelerations without these forces.
    friction
        (k,) coefficients mu.
    sliding
        (k,) directions of slip, 1 or -1, of contacts that slip already; their friction force is -mu N times the
        direction. 0 for other contacts.
    pressed
        (k,) normal forces whose effects `normal` and `tangent` include already. The forces returned are added to them,
        and the limits of friction follow from the sums.
    """
    k, arrays = len(normal), _STORAGE.cones
    if k not in arrays:
        new = new_cones(k)
        arrays[k] = new, RepeatedCall(cone_forces, new, k)
    cones, solve = arrays[k]
    cones.response[:], cones.free[:k], cones.free[k:] = response, normal, tangent
    cones.friction[:], cones.sliding[:], cones.pressed[:] = friction, sliding, pressed
    if not solve():
        return None
    forces = cones.forces.copy()
    return Pushed(forces[:k], forces[k:], cones.closed > 0, cones.slipping > 0)


class Coupled(NamedTuple):
    """How k contacts affect each other; see `mbdkit_contact.kernels.cone_sweeps.sweep_contacts`."""

    start: np.ndarray
    other: np.ndarray
    blocks: np.ndarray


def coupled_by_all(response: np.ndarray) -> Coupled:
    """Return the couplings of k contacts from the full matrix (2 k, 2 k) that maps impulses to velocities, normal
    components first.
    """
    k = len(response) // 2
    blocks = response.reshape(2, k, 2, k).transpose(1, 3, 0, 2).reshape(k * k, 4)
    return Coupled(np.arange(k + 1) * k, np.tile(np.arange(k), k), np.ascontiguousarray(blocks))


def coupled_by_bodies(bodies: np.ndarray, gradients: np.ndarray, lightness: np.ndarray) -> Coupled:
    """Return the couplings of k contacts between bodies that are connected by contacts only.

    Parameters
    ----------
    bodies
        (k, 2) indices of the two bodies of each contact.
    gradients
        (2, k, 6) derivatives of the rates of gap and slip with respect to the velocities of both bodies.
    lightness
        (B + 1, 3) inverse masses and inverse moments of inertia of the bodies; 0 for the ground.
    """
    k = len(bodies)
    degree = np.bincount(bodies.ravel(), minlength=len(lightness))
    begin = np.append(0, np.cumsum(degree))
    members = np.argsort(bodies.ravel(), kind="stable")
    most = int(np.sum(degree[:-1] ** 2))
    start, other, blocks = np.zeros(k + 1, dtype=int), np.zeros(most, dtype=int), np.zeros((most, 4))
    couple_contacts(begin, members, bodies, gradients, lightness, start, other, blocks)
    return Coupled(start, other, blocks)


SWEEPS = 500
"""Largest number of sweeps over the contacts."""
PRECISION, ACCEPTED = 1e-8, 1e-2
"""Limits of the relative change of velocities in a sweep. Sweeps end at `PRECISION`; if they do not reach it, the
result is accepted if the last change is at most `ACCEPTED`.

Changes are relative to the largest velocity without impulses. If more contacts are closed than are needed, sweeps move
forces between them ever more slowly.
"""


def swept(
    coupled: Coupled,
    normal: np.ndarray,
    tangent: np.ndarray,
    friction: np.ndarray,
    guess: np.ndarray,
    precision: float = PRECISION,
) -> Pushed | None:
    """Return the impulses of contacts, found by repeated sweeps over them; None if the sweeps do not converge.

    Parameters
    ----------
    coupled
        How the contacts affect each other.
    normal, tangent, friction
        See `coulomb`.
    guess
        (2, k) impulses with which the sweeps begin, normal ones first.
    precision
        Change in a sweep, relative to the largest velocity, at which the sweeps end. If this is larger than the
        default, the result after `SWEEPS` sweeps is accepted in any case.
    """
    free, impulses = np.stack([normal, tangent], axis=1), np.ascontiguousarray(guess.T)
    size = float(np.max(np.abs(free), initial=0.0))
    changed = sweep_contacts(*coupled, free, np.ascontiguousarray(friction), precision * size, SWEEPS, impulses)
    if changed > ACCEPTED * size and precision <= PRECISION:
        return None
    pushes, rubs = impulses.T
    return Pushed(pushes, rubs, pushes > 0.0, np.abs(rubs) >= friction * pushes, changed / (size or 1.0))
