"""Warnings about dry friction that a run evaluates mostly below its transition speed, where it is viscous."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.base.plain_data import quoted
from mbdkit.engine.stored_arrays import fill
from mbdkit.mechanism.joint_friction import JointFriction, PinFriction
from mbdkit.runs.run_seams import rows_criterion
from mbdkit.trust.finding import Finding

if TYPE_CHECKING:
    from mbdkit.archive.checkpoint import StoredState
    from mbdkit.archive.measured_values import Integrals
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.quantities.states import States
    from mbdkit.spec import RunSpec
    from mbdkit.trust.energy_record import EnergyRecord

MISSING = 0.1  #: Share of the work of Coulomb friction that may be missing without a warning.

#: Angle of a pin [rad], or path as a share of the mechanism's size, up to which slip below the transition speed counts
#: as rest.
TURN, SHARE = 0.05, 0.01

MATTERS = 1e-3  #: Missing work up to this share of the largest kinetic energy has no effect worth a warning.

RESOLVED = 0.1  #: The recommended transition speed, as a share of the mean speed of the motion, at most.


class FrictionElement(NamedTuple):
    """An element with friction: its name, key and value of its transition speed [m/s], arm [m], and path [m] that is
    rest.
    """

    name: str
    key: str
    transition: float
    arm: float
    rest: float


class SlowFriction:
    """Sums over the recorded states of a run, for each of E elements with friction.

    `take`: function that returns their slip velocities [m/s] and friction powers [W] in T states, (T, E), of any sign.
    """

    def __init__(self, elements: Sequence[FrictionElement], take: Callable[[States], tuple[np.ndarray, np.ndarray]]):
        self._elements, self._take = elements, take
        self._transition = np.array([element.transition for element in elements])
        self._rest = np.array([element.rest for element in elements])
        self._last = np.zeros((0, 5, len(elements)))
        # work of Coulomb friction and its missing part [J]; whole path and path below the transition speed [m]; time
        self._sums = np.zeros((5, len(elements)))
        self._peak = np.zeros(len(elements))

    def add(self, states: States) -> None:
        """Take note of states."""
        speed, power = (np.abs(values) for values in self._take(states))
        self._peak = np.maximum(self._peak, speed.max(axis=0, initial=0.0))
        share = np.minimum(speed / self._transition, 1.0)
        coulomb = np.divide(power, share, out=np.zeros_like(power), where=share > 0.0)
        slow = np.where(share < 1.0, speed, 0.0)
        ones = np.broadcast_to(states.time[:, None], speed.shape)
        rows = np.concatenate([self._last, np.stack([coulomb, coulomb - power, speed, slow, ones], axis=1)])
        self._last = rows[-1:].copy()
        h = np.diff(rows[:, 4:], axis=0)
        values = np.concatenate([rows[:, :4], np.where(rows[:, 3:4] + rows[:, 2:3] > 0, 1.0, 0.0)], axis=1)
        self._sums += np.sum(0.5 * h * (values[1:] + values[:-1]), axis=0)

    def findings(self, energies: EnergyRecord, _integrals: Integrals) -> list[Finding]:
        """Return a doubt for each element that lacks much of its friction."""
        work, missing, path, slow, lasted = self._sums
        lacks = (missing > MISSING * work) & (missing > MATTERS * energies.kinetic) & (slow > self._rest)
        doubts = []
        for index in np.flatnonzero(lacks).tolist():
            element = self._elements[index]
            mean = float(path[index] / lasted[index]) if lasted[index] > 0.0 else element.transition
            advised = min(RESOLVED * mean, 0.1 * element.transition)
            turns = f", at {self._peak[index] / element.arm:.3g} rad/s" if element.arm != 1.0 else ""
            sentence = (
                f"the friction of {element.name} is weaker than Coulomb friction, because "
                f"{slow[index] / path[index]:.0%} of its path is slower than its transition speed of "
                f"{element.transition:g} m/s (fastest slip {self._peak[index]:.3g} m/s{turns}), and lacks "
                f"{missing[index] / work[index]:.0%} of its work; lower "
                f"model.{element.key}.transition_speed, to {advised:.1g} m/s for example"
            )
            doubts.append(Finding("slow-friction", "doubtful", sentence, is_named=False))
        return doubts

    def stored(self) -> StoredState:
        """Return the state as plain values, for a checkpoint."""
        return {"sums": self._sums, "peak": self._peak, "last": self._last}

    def restore(self, state: StoredState) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        self._last = np.zeros((min(1, len(state["last"])), *self._last.shape[1:]))
        for name in ("sums", "peak", "last"):
            fill(getattr(self, f"_{name}"), state[name])


@rows_criterion
def of_joints(spec: RunSpec, compiled: CompiledMechanism, size: float) -> SlowFriction | None:
    """Return the slow friction of the joints of a mechanism; None if none of them has friction."""
    if not compiled.friction:
        return None
    elements = []
    for name in (compiled.joints[number] for number in compiled.friction):
        friction = getattr(spec.mechanism().joints[name], "friction", None)
        assert isinstance(friction, JointFriction)
        arm, rest, key = 1.0, SHARE * size, f"joints.{quoted(name)}.friction"
        if isinstance(friction, PinFriction):
            arm, rest = friction.radius, TURN * friction.radius
        elements.append(FrictionElement(f"joint '{name}'", key, friction.transition_speed, arm, rest))
    columns, arms = compiled.first_friction + np.arange(len(elements)), np.array([element.arm for element in elements])

    def take(states: States) -> tuple[np.ndarray, np.ndarray]:
        rate, value = states.observed.forces[:, columns, 1:3].transpose(2, 0, 1)
        return rate * arms, rate * value

    return SlowFriction(elements, take)
