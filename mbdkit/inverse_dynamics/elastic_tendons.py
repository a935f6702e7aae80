"""Recruitment of muscles with elastic tendons: fibres and tendons are in equilibrium, frame after frame.

The tension F of a muscle determines the length of its tendon, and thus the length l(F) of its fibres. The velocity of
the fibres is the change of l since the previous frame, divided by the time between both frames. The activation with
which they exert the tension is

    a(F) = (F / (max_force cos(alpha)) - f_passive(l)) / (f_active(l) f_velocity(v))

The optimum of each frame is that of the tensions a(F). It is found by convex programmes in which F is linear in a, with
the slope at the activations that the previous programme found. Once two programmes find the same activations, the
conditions of optimality are those of the problem itself. In the first frame, tendons have constant lengths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mbdkit.base.errors import RunError
from mbdkit.mechanism.muscles import Muscle
from mbdkit.muscles.force_curves import CURVES

ITERATIONS = 60
"""Largest number of programmes of one frame; 4 to 8 are usual."""
SETTLED = 1e-12
"""Change of the tensions, in `max_force`, at which the programmes of a frame end."""
FARTHEST = 0.2
"""Largest change of a tension from one programme to the next, in `max_force`."""
LEAST = 1e-9
"""Least tension, in `max_force`, also of muscles whose fibres are too short to exert any."""
WEAK = 1e-6
"""Active force at full activation, in `max_force`, below which fibres exert none."""
SMALLEST = 0.05
"""Smallest share of a change of the tensions that is made."""
SLOWEST, STRONGEST = 0.05, 1.5
"""Least factor of force by velocity, and largest activation, that programmes use."""


@dataclass(frozen=True)
class Equilibrium:
    """Muscles with tensions F, all arrays (M,).

    Attributes
    ----------
    tension
        Tensions [N].
    length, rate
        Lengths of the fibres [m] and their rates [m/s].
    activation, stiffness
        Activations with which the fibres exert the tensions, and derivatives of the tensions by them [N].
    by_velocity
        Factors of force by velocity; zero where fibres exert no active force at any activation.
    """

    tension: np.ndarray
    length: np.ndarray
    rate: np.ndarray
    activation: np.ndarray
    stiffness: np.ndarray
    by_velocity: np.ndarray

    @property
    def offset(self) -> np.ndarray:
        """Tensions of the linear functions of the activations where these are zero [N]."""
        return np.asarray(self.tension - self.stiffness * self.activation)


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
        self.max_force = np.array([one.max_force for one in self._muscles])
        self._optimal = np.array([one.optimal_length for one in self._muscles])
        self._tendon = np.array([one.tendon_length for one in self._muscles])
        self._thickness = np.array([one.thickness for one in self._muscles])
        self._speed = self._optimal * np.array([one.max_velocity for one in self._muscles])

    def _curve(self, name: str, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the values of a curve of each muscle and its slopes, for one argument each."""
        value, slope = np.empty_like(x), np.empty_like(x)
        for kind in dict.fromkeys(one.curves for one in self._muscles):
            own = np.array([one.curves == kind for one in self._muscles])
            value[own], slope[own] = getattr(CURVES[kind], name)(x[own])
        return value, slope

    def at(
        self, tension: np.ndarray, path: np.ndarray, before: np.ndarray | None, step: float, rate: np.ndarray
    ) -> Equilibrium:
        """Return the equilibrium with tensions (M,).

        Parameters
        ----------
        path, rate
            Lengths of the paths and their rates.
        before, step
            Lengths of the fibres in the frame before, and the time since then; None in the first frame.
        """
        share = tension / self.max_force
        stretch, compliance = self._curve("stretch", share)
        along = path - self._tendon * stretch
        d_along = -self._tendon * compliance / self.max_force
        length = np.hypot(along, self._thickness)
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
        return Equilibrium(tension, length, velocity, activation, stiffness, np.where(is_idle, 0.0, by_velocity))

    def towards(
        self,
        start: np.ndarray,
        tension: np.ndarray,
        path: np.ndarray,
        before: np.ndarray | None,
        step: float,
        rate: np.ndarray,
    ) -> Equilibrium:
        """Return an equilibrium with these tensions, or nearer to `start` where fibres cannot exert them; see `at`."""
        found = self.at(tension, path, before, step, rate)
        for _ in range(60):
            is_beyond = (found.by_velocity < SLOWEST) | (found.activation > STRONGEST)
            if not np.any(is_beyond & (tension > start)):
                break
            tension = np.where(is_beyond & (tension > start), start + 0.5 * (tension - start), tension)
            found = self.at(tension, path, before, step, rate)
        return found

    def require_room(self, time: np.ndarray, path: np.ndarray) -> None:
        """Raise RunError for the first muscle whose tendon is longer than its path (T, M)."""
        for index, name in enumerate(self.names):
            frame = int(np.argmin(path[:, index]))
            if path[frame, index] <= self._tendon[index]:
                raise RunError(
                    f"the tendon of muscle '{name}' is longer ({self._tendon[index]:.6g} m) than its path "
                    f"({path[frame, index]:.6g} m) at t = {time[frame]:.6g} s; correct `tendon_length`, or the path"
                )


def _relaxation(size: float, last: np.ndarray, change: np.ndarray) -> float:
    """Return the share of a change that is made, by Aitken's method, from the share of the last change.

    Curves of force by velocity bend sharply where fibres begin to lengthen, so that whole changes would alternate.
    """
    bend = last - change
    if not np.any(last) or not np.any(bend):
        return size
    return float(np.clip(size * (last @ bend) / (bend @ bend), SMALLEST, 1.0))


Share = Callable[[int, np.ndarray, np.ndarray], np.ndarray]
"""Returns the activations (M,) of a frame with tensions that are linear in them, from the slopes and the tensions at
zero; nan where there is no solution."""


def in_equilibrium(
    elastic: ElasticMuscles, time: np.ndarray, path: np.ndarray, rate: np.ndarray, share: Share
) -> list[Equilibrium]:
    """Return the equilibrium in each of T frames with the optimal tensions.

    Parameters
    ----------
    path, rate
        (T, M) lengths of the paths and their rates.

    Raises
    ------
    RunError
        If a tendon is longer than its path, or the programmes of a frame do not agree.
    """
    elastic.require_room(time, path)
    found: list[Equilibrium] = []
    tension = 0.05 * elastic.max_force
    for frame in range(len(time)):
        before = found[-1].length if found else None
        step = time[frame] - time[frame - 1] if found else 1.0
        given = path[frame], before, step, rate[frame]
        least = LEAST * elastic.max_force
        own = elastic.towards(least, tension, *given)
        last, size = np.zeros(len(elastic.names)), 1.0
        for _ in range(ITERATIONS):
            activation = share(frame, own.stiffness, own.offset)
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
        found.append(own)
        tension = own.tension
    return found
