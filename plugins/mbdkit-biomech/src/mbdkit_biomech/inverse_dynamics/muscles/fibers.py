"""Fibres of muscles: on rigid tendons, with the forces that they can exert, and in equilibrium with elastic tendons.

The fibres are pennate. The thickness of the muscle, ``w = optimal_length sin(pennation)``, is constant, so that the
fibres of a muscle with a path of length L have the length ``l = sqrt((L - tendon_length)^2 + w^2)``. With the
activation a, the velocity v of the fibres and the curves f of the muscle, the force along the tendon is

    F = max_force (a f_active(l) f_velocity(v) + f_passive(l)) cos(alpha),   cos(alpha) = (L - tendon_length) / l

The tension F of a muscle with an *elastic* tendon determines the length of its tendon, and thus the length l(F) of its
fibres; frames are solved in order. The velocity of the fibres is the change of l since the previous frame, divided by
the time between both frames. The activation with which they exert the tension is

    a(F) = (F / (max_force cos(alpha)) - f_passive(l)) / (f_active(l) f_velocity(v))

In each frame, the cost of the activations a(F) is minimised over the tensions F. The minimum is found by a sequence of
convex programmes in which F is linear in a, with the slope at the activations found by the previous programme. Once
two programmes find the same activations, the optimality conditions of the programme are those of the original problem.
In the first frame, the velocity of the fibres is computed with tendons of constant length.
"""

from __future__ import annotations

from collections.abc import Callable
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
    active
        Active force along the tendon at full activation [N].
    passive
        Force of the passive fibres along the tendon, without damping [N].
    """

    length: np.ndarray
    rate: np.ndarray
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
    return Fibers(own, velocity, force * active, force * passive)


ITERATIONS = 60  #: Largest number of programmes for one frame; 4 to 8 are usual.
#: The programmes of a frame end when the change of the tensions, relative to `max_force`, is below this.
SETTLED = 1e-12
FARTHEST = 0.2  #: Largest change of a tension from one programme to the next, relative to `max_force`.
#: Smallest tension, relative to `max_force`. Muscles whose fibres cannot exert an active force have this tension.
LEAST = 1e-9
#: Fibres whose active force at full activation, relative to `max_force`, is below this count as unable to exert a
#: force.
WEAK = 1e-6
SMALLEST = 0.05  #: Smallest share of a change of the tensions that is applied.
#: Tensions are reduced if their factor of the force-velocity curve is below the first value, or their activation above
#: the second.
SLOWEST, STRONGEST = 0.05, 1.5


@dataclass(frozen=True)
class MuscleEquilibrium:
    """Equilibrium of M muscles with tensions F; all arrays are (M,).

    Attributes
    ----------
    tension
        Tensions [N].
    length, rate
        Lengths of the fibres [m] and their rates [m/s].
    activation, stiffness
        Activations with which the fibres exert the tensions, and derivatives of the tensions with respect to the
        activations [N].
    by_velocity
        Factors of the force-velocity curve; zero where fibres exert no active force at any activation.
    """

    tension: np.ndarray
    length: np.ndarray
    rate: np.ndarray
    activation: np.ndarray
    stiffness: np.ndarray
    by_velocity: np.ndarray


class ElasticMuscles:
    """M muscles with elastic tendons.

    Parameters
    ----------
    muscles
        The muscles by name.
    with_passive
        Whether the force of passive fibres is included.
    """

    def __init__(self, muscles: dict[str, Muscle], *, with_passive: bool):
        self.names, self._muscles, self._with_passive = tuple(muscles), tuple(muscles.values()), with_passive
        self.max_force = np.array([muscle.max_force for muscle in self._muscles])
        self._optimal = np.array([muscle.optimal_length for muscle in self._muscles])
        self._tendon = np.array([muscle.tendon_length for muscle in self._muscles])
        self._thickness = np.array([muscle.thickness for muscle in self._muscles])
        self._speed = self._optimal * np.array([muscle.max_velocity for muscle in self._muscles])

    def _curve(self, name: str, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the values and slopes (M,) of a curve, of each muscle at its component of the arguments x (M,)."""
        value, slope = np.empty_like(x), np.empty_like(x)
        for kind in dict.fromkeys(muscle.curves for muscle in self._muscles):
            own = np.array([muscle.curves == kind for muscle in self._muscles])
            value[own], slope[own] = getattr(CURVES[kind], name)(x[own])
        return value, slope

    def at(
        self, tension: np.ndarray, path: np.ndarray, before: np.ndarray | None, step: float, rate: np.ndarray
    ) -> MuscleEquilibrium:
        """Return the equilibrium with tensions (M,).

        Parameters
        ----------
        path, rate
            Lengths of the paths [m] and their rates [m/s].
        before
            Lengths of the fibres in the previous frame [m]; None in the first frame.
        step
            Time since the previous frame [s]; not used in the first frame.
        """
        share = tension / self.max_force
        stretch, compliance = self._curve("stretch", share)
        along = path - self._tendon * stretch
        d_along = -self._tendon * compliance / self.max_force
        length = elementary.hypot(along, self._thickness)
        cosine = along / length
        d_length = cosine * d_along
        d_cosine = (d_along - cosine * d_length) / length
        velocity = rate * cosine if before is None else (length - before) / step
        d_velocity = 0.0 * d_length if before is None else d_length / step
        active, d_active = self._curve("active", length / self._optimal)
        by_velocity, d_by_velocity = self._curve("velocity", velocity / self._speed)
        passive, d_passive = self._curve("passive", length / self._optimal)
        if not self._with_passive:
            passive, d_passive = 0.0 * passive, 0.0 * d_passive
        is_idle = active * by_velocity < WEAK
        active, by_velocity = np.where(is_idle, 1.0, active), np.where(is_idle, 1.0, by_velocity)
        full = active * by_velocity
        activation = (share / cosine - passive) / full
        slope = (1.0 / self.max_force - share * d_cosine / cosine) / cosine - d_passive * d_length / self._optimal
        slope = slope / full - activation * (
            d_active / active * d_length / self._optimal + d_by_velocity / by_velocity * d_velocity / self._speed
        )
        stiffness = np.where(is_idle, 0.0, 1.0 / slope)
        return MuscleEquilibrium(tension, length, velocity, activation, stiffness, np.where(is_idle, 0.0, by_velocity))

    def towards(
        self,
        start: np.ndarray,
        tension: np.ndarray,
        path: np.ndarray,
        before: np.ndarray | None,
        step: float,
        rate: np.ndarray,
    ) -> MuscleEquilibrium:
        """Return the equilibrium with given tensions (M,), or with tensions nearer to `start` (M,) for muscles whose
        fibres cannot exert the given ones; see `at` for the parameters.
        """
        equilibrium = self.at(tension, path, before, step, rate)
        for _ in range(60):
            is_beyond = (equilibrium.by_velocity < SLOWEST) | (equilibrium.activation > STRONGEST)
            if not np.any(is_beyond & (tension > start)):
                break
            tension = np.where(is_beyond & (tension > start), start + 0.5 * (tension - start), tension)
            equilibrium = self.at(tension, path, before, step, rate)
        return equilibrium


def _relaxation(size: float, last: np.ndarray, change: np.ndarray) -> float:
    """Return the share of a change that is applied, by Aitken's method; `size` is the share of the `last` change.

    Force-velocity curves bend sharply where fibres begin to lengthen, so that full changes could oscillate.
    """
    bend = last - change
    if not np.any(last) or not np.any(bend):
        return size
    return float(np.clip(size * np.sum(last * bend) / np.sum(bend * bend), SMALLEST, 1.0))


#: Function that returns the activations (M,) of a frame; nan if there is no solution.
#:
#: Tensions are linear in the activations. The arguments are the number of the frame, the slopes (M,) of the tensions,
#: and the tensions (M,) at zero activation.
Share = Callable[[int, np.ndarray, np.ndarray], np.ndarray]


def in_equilibrium(
    elastic: ElasticMuscles, time: np.ndarray, path: np.ndarray, rate: np.ndarray, share: Share
) -> list[MuscleEquilibrium]:
    """Return the equilibrium with the optimal tensions in each of T frames.

    Parameters
    ----------
    path, rate
        (T, M) lengths of the paths [m], longer than the tendons, and their rates [m/s].
    share
        Solves the programme of a frame. In frames without a solution, the last tensions are returned.

    Raises
    ------
    RunError
        If the programmes of a frame do not converge.
    """
    equilibriums: list[MuscleEquilibrium] = []
    tension = 0.05 * elastic.max_force
    for frame in range(len(time)):
        before = equilibriums[-1].length if equilibriums else None
        step = time[frame] - time[frame - 1] if equilibriums else 1.0
        given = path[frame], before, step, rate[frame]
        own = elastic.towards(LEAST * elastic.max_force, tension, *given)
        last, size = np.zeros(len(elastic.names)), 1.0
        for _ in range(ITERATIONS):
            activation = share(frame, own.stiffness, own.tension - own.stiffness * own.activation)
            if not np.all(np.isfinite(activation)):
                break
            force = own.tension / elastic.max_force
            change = np.maximum(own.stiffness * (activation - own.activation) / elastic.max_force, LEAST - force)
            change = np.where(own.by_velocity == 0, LEAST - force, change)
            if np.max(np.abs(change)) < SETTLED:
                break
            size = _relaxation(size, last, change)
            last = change
            force = np.maximum(force + np.clip(size * change, -FARTHEST, FARTHEST), LEAST)
            own = elastic.towards(np.minimum(own.tension, elastic.max_force * force), elastic.max_force * force, *given)
        else:
            raise RunError(
                f"the elastic tendons of the muscles have no equilibrium at t = {time[frame]:.6g} s with tensions that "
                "are optimal; use `tendon: rigid`, or more frames per second"
            )
        equilibriums.append(own)
        tension = own.tension
    return equilibriums
