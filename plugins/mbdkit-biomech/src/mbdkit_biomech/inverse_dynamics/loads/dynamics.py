"""Forces of actuators and joints that produce a given motion, from the equations of motion in each frame.

    M a + Phi_q^T lambda = Q + Q_loads + B u

M contains the masses, a the accelerations, Phi_q is the Jacobian of the constraints, Q contains the applied forces of
the model, Q_loads the measured loads, and B the generalized forces of unit actuators. The unknowns are the values u of
the actuators and the multipliers lambda. The projection on the free directions N of the mechanism gives
``N^T B u = N^T (M a - Q - Q_loads)``; then lambda balances the remaining forces. Nothing is divided by masses, so that
bodies with little mass cause no large errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbdkit.base.errors import RunError, SpecError
from mbdkit.base.text import counted
from mbdkit.engine.linear_systems import products, pseudoinverses, singular_values
from mbdkit_biomech.inverse_dynamics.loads.loads import Loads
from mbdkit_biomech.inverse_dynamics.motion.fit import Fitter
from mbdkit_biomech.inverse_dynamics.motion.manifold import Directions, Manifold, Quantities
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Motion
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import NamedActuator

#: A free direction counts as not driven if the effect of the actuators on it, relative to the largest effect, is below
#: this.
WEAK = 1e-8


@dataclass(frozen=True)
class Dynamics:
    """The forces that produce a motion in T frames.

    Attributes
    ----------
    value, power
        (T, U) values [N, N m] and powers [W] of the actuators.
    lam
        (T, m) multipliers of the independent constraint rows.
    unbalanced
        (T, n) generalized forces that the actuators leave unbalanced.
    surplus
        Number of actuators minus the number of degrees of freedom that they drive.
    """

    value: np.ndarray
    power: np.ndarray
    lam: np.ndarray
    unbalanced: np.ndarray
    surplus: int


def solve_dynamics(
    fitter: Fitter, motion: Motion, loads: Loads, actuators: Sequence[NamedActuator], *, report: bool = False
) -> tuple[Dynamics, Balance, np.ndarray]:
    """Return the forces that produce a motion, the `Balance`, and the generalized forces (T, n) that actuators and
    joints supply.

    Parameters
    ----------
    report
        Whether actuators that cannot produce the motion are accepted; the unbalanced forces are then minimised.

    Raises
    ------
    SpecError
        If the actuators cannot produce the motion; the message names bodies that are not driven.
    RunError
        If the mechanism passes a singular position, where reactions are not determined.
    """
    manifold = fitter.manifold
    frames = manifold.frames(motion.time, motion.q, motion.v, forces=True)
    balance = Balance(manifold, motion, actuators, manifold.directions(frames.jacobian))
    rank = _rank(fitter, balance, motion.time, report)
    needed = manifold.mass * motion.a - frames.force - loads.generalized
    value, lam, unbalanced = balance.solved(needed)
    power = value * products(np.swapaxes(balance.columns, 1, 2), motion.v)
    return Dynamics(value, power, lam, unbalanced, len(actuators) - rank), balance, needed


class Balance:
    """Solves for the actuators and multipliers that produce a motion in T frames.

    Parameters
    ----------
    manifold
        The constraints of the mechanism.
    motion
        The motion.
    actuators
        The U actuators.
    directions
        Directions in each frame; computed if they are not given.

    Attributes
    ----------
    columns
        (T, n, U) generalized forces of unit actuators.
    effect
        (T, f, U) effect of unit actuators on the free directions, scaled by the weights of the actuators.

    Raises
    ------
    RunError
        If the mechanism passes a singular position, where reactions are not determined.
    """

    def __init__(
        self,
        manifold: Manifold,
        motion: Motion,
        actuators: Sequence[NamedActuator],
        directions: Directions | None = None,
    ):
        directions = manifold.directions_at(motion.time, motion.q) if directions is None else directions
        if (singular := np.flatnonzero(directions.singular())).size:
            raise RunError(
                f"the mechanism is in a singular position at t = {motion.time[singular[0]]:.6g} s, where the forces of "
                f"its joints are not determined; exclude this time with `time.start` and `time.end`"
            )
        self.directions, self._scale = directions, manifold.scale
        self.columns = columns_of(motion.q, actuators)
        self._free = np.swapaxes(directions.free * manifold.scale[:, None], 1, 2)  # (T, f, n)
        self._weight = weights_of(manifold, actuators)
        self.effect = products(self._free, self.columns) / self._weight

    def solved(self, needed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return values (T, U), multipliers (T, m) and unbalanced forces (T, n) for the generalized forces `needed` (T,
        n).
        """
        inverse, effect = self._inverse, self.effect
        right = products(self._free, needed)
        scaled = products(inverse, right)
        # One step of iterative refinement reduces rounding errors.
        scaled += products(inverse, right - products(effect, scaled))
        value = scaled / self._weight
        pushed = products(self.columns, value)
        left = right - products(effect, scaled)
        size = np.where(self._scale > 0, self._scale, 1.0)
        unbalanced = products(self.directions.free, left) / size
        return value, self.directions.multipliers(pushed - needed), unbalanced

    def as_actuators(self, forces: np.ndarray) -> np.ndarray:
        """Return the values (T, U, M) of actuators that have the same effect as generalized forces (T, n, M)."""
        return np.asarray(products(self._inverse, products(self._free, forces)) / self._weight[:, None])

    @cached_property
    def _inverse(self) -> np.ndarray:
        return pseudoinverses(self.effect, WEAK)


def require_driven(fitter: Fitter, time: float, q: np.ndarray, actuators: Sequence[NamedActuator]) -> None:
    """Raise SpecError if actuators cannot produce every motion from a pose (n,), as `solve_dynamics` does."""
    motion = Motion(np.array([time]), q[None], *np.zeros((2, 1, len(q))))
    _rank(fitter, Balance(fitter.manifold, motion, actuators), motion.time, report=False)


def columns_of(q: np.ndarray, actuators: Sequence[NamedActuator]) -> np.ndarray:
    """Return the generalized forces (T, n, U) of unit actuators at positions (T, n)."""
    return np.swapaxes(Quantities([actuator.quantity for actuator in actuators]).jacobian(q), 1, 2)


def weights_of(manifold: Manifold, actuators: Sequence[NamedActuator]) -> np.ndarray:
    """Return the weights (U,) of actuators; the weights of torques are divided by the characteristic length."""
    return np.array([actuator.weight / (manifold.length if actuator.unit == "N m" else 1.0) for actuator in actuators])


def _rank(fitter: Fitter, balance: Balance, time: np.ndarray, report: bool) -> int:
    """Return the smallest number of free directions that the actuators drive in a frame.

    Raise SpecError if the actuators do not drive all free directions, unless `report` is True.
    """
    free, effect = balance.directions.free, balance.effect
    if not (freedoms := free.shape[2]):
        return 0
    values = singular_values(effect)
    ranks = np.sum(values > WEAK * np.max(values, axis=1, initial=0.0)[:, None], axis=1)
    frame = int(np.argmin(ranks))
    if (rank := int(ranks[frame])) < freedoms and not report:
        undriven = free[frame] @ np.linalg.svd(effect[frame], full_matrices=True)[0][:, rank:]
        where = "" if np.all(ranks == rank) else f" at t = {time[frame]:.6g} s"
        raise SpecError(
            f"no actuator drives {fitter.names_of(np.abs(undriven).max(axis=1))}{where}: "
            f"{counted(effect.shape[2], 'actuator')} for {counted(freedoms, 'degree')} of freedom; add "
            f"{counted(freedoms - rank, 'actuator')}, or use `unbalanced: report` to report the unbalanced forces",
            key="actuators",
        )
    return rank


def largest_unbalanced(dynamics: Dynamics, bodies: Sequence[str]) -> str:
    """Return a clause that gives the largest unbalanced force and torque, with their bodies."""
    parts = np.abs(dynamics.unbalanced).reshape(len(dynamics.unbalanced), -1, 3)
    force, torque = np.hypot(parts[..., 0], parts[..., 1]).max(axis=0), parts[..., 2].max(axis=0)
    return (
        f"at most {force.max():.4g} N on {bodies[int(np.argmax(force))]} and {torque.max():.4g} N m on "
        f"{bodies[int(np.argmax(torque))]}"
    )
