"""Fibres of a muscle whose tendon is rigid, and the forces along the tendon that they can exert.

The fibres are pennate. The thickness of the muscle, ``w = optimal_length sin(pennation)``, is constant, so that the
fibres of a muscle with a path of length L have the length ``l = sqrt((L - tendon_length)^2 + w^2)``. With the
activation a, the velocity v of the fibres and the curves f of the muscle, the force along the tendon is

    F = max_force (a f_active(l) f_velocity(v) + f_passive(l)) cos(alpha),   cos(alpha) = (L - tendon_length) / l
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import RunError
from mbdkit_biomech.muscles.force_curves import CURVES
from mbdkit_biomech.muscles.muscle import Muscle


@dataclass(frozen=True)
class Fibers:
    """The fibres of a muscle in T frames; all arrays are (T,).

    Attributes
    ----------
    length, rate
        Length of the fibres [m] and its rate [m/s].
    cosine
        Cosine of the angle between fibres and tendon.
    active
        Active force along the tendon at full activation [N].
    passive
        Force of the passive fibres along the tendon, without damping [N].
    """

    length: np.ndarray
    rate: np.ndarray
    cosine: np.ndarray
    active: np.ndarray
    passive: np.ndarray


def fibers_on_rigid_tendon(name: str, muscle: Muscle, time: np.ndarray, length: np.ndarray, rate: np.ndarray) -> Fibers:
    """Return the fibres of a muscle with a rigid tendon.

    Parameters
    ----------
    name, muscle
        The muscle.
    time
        (T,) times, for messages.
    length, rate
        (T,) length of the path [m] and its rate [m/s].

    Raises
    ------
    RunError
        If the tendon is at least as long as the path. The error states the time.
    """
    along = length - muscle.tendon_length
    if np.any(along <= 0):
        frame = int(np.argmin(along))
        raise RunError(
            f"the tendon of muscle '{name}' is longer ({muscle.tendon_length:.6g} m) than its path "
            f"({length[frame]:.6g} m) at t = {time[frame]:.6g} s; correct `tendon_length`, or the path"
        )
    return fibers_of_length(muscle, along, rate, (muscle.max_force, muscle.optimal_length))


def fibers_of_length(
    muscle: Muscle,
    along: np.ndarray,
    rate: np.ndarray,
    properties: tuple[float | np.ndarray, float | np.ndarray],
    *,
    with_passive: bool = True,
) -> Fibers:
    """Return the fibres of a muscle with a rigid tendon, whose length along the tendon is known.

    Parameters
    ----------
    along
        (...) length of the path without the tendon [m], positive.
    rate
        (...) rate of the length of the path [m/s].
    properties
        Largest isometric force [N] and optimal length of the fibres [m] in place of those of the muscle; numbers or
        arrays like `along`.
    with_passive
        Whether the passive force is computed; otherwise it is 0.
    """
    max_force, optimal = properties
    own = elementary.hypot(along, optimal * float(elementary.sin(muscle.pennation)))
    cosine = along / own
    velocity = rate * cosine
    curves = CURVES[muscle.curves]
    normal = own / optimal
    by_velocity = np.maximum(curves.velocity(velocity / (muscle.max_velocity * optimal))[0], 0.0)
    active = np.maximum(curves.active(normal)[0], 0.0) * by_velocity
    passive = np.maximum(curves.passive(normal)[0], 0.0) if with_passive else np.zeros_like(normal)
    force = max_force * cosine
    return Fibers(own, velocity, cosine, force * active, force * passive)
