"""Warnings about dry friction that a run evaluates mostly below its transition speed, where it is viscous."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbdkit.base.plain_data import quoted
from mbdkit.engine.stored_arrays import fill
from mbdkit.mechanism.joint_friction import JointFriction, PinFriction

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.quantities.states import States
    from mbdkit.spec import RunSpec
    from mbdkit.trust.energy_record import EnergyRecord

MISSING = 0.1
"""Share of the work of Coulomb friction that may be missing without a warning."""

TURN, SHARE = 0.05, 0.01
"""Angle of a pin [rad], or path as a share of the mechanism's size, up to which slip below the transition speed counts
as rest.
"""

MATTERS = 1e-3
"""Missing work up to this share of the largest kinetic energy has no effect worth a warning."""

RESOLVED = 0.1
"""The recommended transition speed, as a share of the mean speed of the motion, at most."""


class _Element(NamedTuple):
    """A friction element: its name, key and value of its transition speed [m/s], arm [m], and path [m] that is rest."""

    name: str
    key: str
    transition: float
    arm: float
    rest: float


class SlowFriction:
    """Sums over the recorded states of a run, for each of E friction elements: joints with friction and compliant
    contacts.

    Parameters
    ----------
    mechanism, compiled
        The mechanism, and its compiled form.
    size
        Size of the mechanism [m].
    """

    def __init__(self, mechanism: Mechanism, compiled: CompiledMechanism, size: float):
        first = compiled.first_friction
        self._columns = list(range(first, first + len(compiled.friction)))
        self._elements = []
        for name in (compiled.joints[number] for number in compiled.friction):
            friction = getattr(mechanism.joints[name], "friction", None)
            assert isinstance(friction, JointFriction)
            arm, rest, key = 1.0, SHARE * size, f"joints.{quoted(name)}.friction"
            if isinstance(friction, PinFriction):
                arm, rest = friction.radius, TURN * friction.radius
            self._elements.append(_Element(f"joint '{name}'", key, friction.transition_speed, arm, rest))
        self._contacts = [] if compiled.contact_treatment.is_rigid else list(mechanism.contacts)
        for name in self._contacts:
            own = mechanism.contacts[name].compliance
            assert own is not None
            key = f"contacts.{quoted(name)}.compliance"
            self._elements.append(_Element(f"contact '{name}'", key, own.transition_speed, 1.0, SHARE * size))
        self._transition, self._arm, self._rest = (
            np.array([getattr(one, key) for one in self._elements]) for key in ("transition", "arm", "rest")
        )
        self._last = np.zeros((0, 5, len(self._elements)))
        # work of Coulomb friction and its missing part [J]; whole path and path below the transition speed [m]; time
        self._sums = np.zeros((5, len(self._elements)))
        self._peak = np.zeros(len(self._elements))

    @classmethod
    def of(cls, spec: RunSpec, compiled: CompiledMechanism, size: float) -> SlowFriction | None:
        """Return the `SlowFriction` of a mechanism; None if it has no friction that depends on the slip velocity."""
        mechanism = spec.mechanism()
        has_contacts = bool(mechanism.contacts) and not compiled.contact_treatment.is_rigid
        return cls(mechanism, compiled, size) if compiled.friction or has_contacts else None

    def add(self, states: States) -> None:
        """Take note of states."""
        time, forces, count = states.time, states.observed.forces, len(self._contacts)
        slip, friction = (states.of_contacts(name).reshape(len(time), -1) for name in ("slip", "friction_force"))
        rate, value = forces[:, self._columns, 1], forces[:, self._columns, 2]
        speed = np.abs(np.hstack([rate * self._arm[: rate.shape[1]], slip[:, :count]]))
        power = np.abs(np.hstack([rate * value, (slip * friction)[:, :count]]))
        self._peak = np.maximum(self._peak, speed.max(axis=0, initial=0.0))
        share = np.minimum(speed / self._transition, 1.0)
        coulomb = np.divide(power, share, out=np.zeros_like(power), where=share > 0.0)
        slow = np.where(share < 1.0, speed, 0.0)
        ones = np.broadcast_to(time[:, None], speed.shape)
        rows = np.concatenate([self._last, np.stack([coulomb, coulomb - power, speed, slow, ones], axis=1)])
        self._last = rows[-1:].copy()
        h = np.diff(rows[:, 4:], axis=0)
        values = np.concatenate([rows[:, :4], np.where(rows[:, 3:4] + rows[:, 2:3] > 0, 1.0, 0.0)], axis=1)
        self._sums += np.sum(0.5 * h * (values[1:] + values[:-1]), axis=0)

    def findings(self, energies: EnergyRecord) -> tuple[str, ...]:
        """Return a sentence for each element that lacks much of its friction."""
        work, missing, path, slow, lasted = self._sums
        found = (missing > MISSING * work) & (missing > MATTERS * energies.kinetic) & (slow > self._rest)
        told = []
        for place in np.flatnonzero(found).tolist():
            one = self._elements[place]
            mean = float(path[place] / lasted[place]) if lasted[place] > 0.0 else one.transition
            advised = min(RESOLVED * mean, 0.1 * one.transition)
            turns = f", at {self._peak[place] / one.arm:.3g} rad/s" if one.arm != 1.0 else ""
            told.append(
                f"the friction of {one.name} is weaker than Coulomb friction, because {slow[place] / path[place]:.0%} "
                f"of its path is slower than its transition speed of {one.transition:g} m/s (fastest slip "
                f"{self._peak[place]:.3g} m/s{turns}), and lacks {missing[place] / work[place]:.0%} of its work; lower "
                f"model.{one.key}.transition_speed, to {advised:.1g} m/s for example"
            )
        return tuple(told)

    def stored(self) -> dict[str, Any]:
        """Return the state as plain values, for a checkpoint."""
        return {"sums": self._sums, "peak": self._peak, "last": self._last}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        self._last = np.zeros((min(1, len(state["last"])), *self._last.shape[1:]))
        for name in ("sums", "peak", "last"):
            fill(getattr(self, f"_{name}"), state[name])
