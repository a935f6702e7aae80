"""Forces of contacts with planar Coulomb friction."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np

from mbdkit.engine.repeated_call import RepeatedCall
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
        (k,) whether the contact is closed: its normal force is a basic variable of the solution by Lemke's method.
    is_slipping
        (k,) whether friction is at its limit.
    """

    normal: np.ndarray
    tangent: np.ndarray
    is_closed: np.ndarray
    is_slipping: np.ndarray


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
