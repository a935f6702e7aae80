"""The criteria of mbdkit that watch the recorded states of a run, except that on beams.

`mbdkit.builtin_features` lists them. They are about joints that leave the tables of their moving centers, about dry
friction that is mostly viscous, and about forces between two points that meet, where their direction is undefined.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from mbdkit.archive.checkpoint import StoredState
from mbdkit.archive.measured_values import Integrals
from mbdkit.base.plain_data import quoted
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.stored_arrays import fill
from mbdkit.mechanism.checks import line_of_undefined_direction
from mbdkit.mechanism.joint_friction import JointFriction, PinFriction
from mbdkit.mechanism.joints import Revolute
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.quantities.states import States
from mbdkit.runs.law_ranges import steps_are_rows
from mbdkit.runs.run_seams import rows_criterion
from mbdkit.spec import RunSpec
from mbdkit.trust.energy_record import EnergyRecord
from mbdkit.trust.finding import Finding

MISSING = 0.1  #: Share of the work of Coulomb friction that may be missing without a warning.

#: Angle of a pin [rad], or path as a share of the mechanism's size, up to which slip below the transition speed counts
#: as rest.
TURN, SHARE = 0.05, 0.01

MATTERS = 1e-3  #: Missing work up to this share of the largest kinetic energy has no effect worth a warning.

RESOLVED = 0.1  #: The recommended transition speed, as a share of the mean speed of the motion, at most.

#: The direction of a force reverses if the cosine of the angle by which it turns in a step is below this (150 degrees).
#:
#: Measured at a mass that passes the anchor of a spring at distances of 0.1 to 30 mm: steps that an adaptive method
#: accepted at tolerances of 1e-6 turn the direction by at most 145 degrees, and the motion remains accurate.
REVERSED = -0.866


class WatchedArrays:
    """Base class of watchers whose state consists of arrays, those of the attributes in `kept`.

    The array ``_last`` has the values in the last state, if there was one; it has no rows before.
    """

    kept: ClassVar[tuple[str, ...]]
    _last: np.ndarray

    def stored(self) -> StoredState:
        """Return the state as plain values, for a checkpoint."""
        return {name: getattr(self, name) for name in self.kept}

    def restore(self, state: StoredState) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        for name in self.kept:
            if name == "_last":
                self._last = np.zeros((min(1, len(state[name])), *self._last.shape[1:]))
            fill(getattr(self, name), state[name])


class MovingCenters(WatchedArrays):
    """Smallest and largest coordinates of the joints in the recorded states of a run."""

    kept = ("_reached",)

    def __init__(self, mechanism: Mechanism):
        self._joints = mechanism.joints
        self._reached = np.tile([[np.inf], [-np.inf]], len(self._joints))

    def add(self, states: States) -> None:
        """Take note of states."""
        low, high = self._reached
        np.minimum(low, states.coordinate.min(axis=0, initial=np.inf), out=low)
        np.maximum(high, states.coordinate.max(axis=0, initial=-np.inf), out=high)

    def findings(self, _energies: EnergyRecord, _integrals: Integrals) -> tuple[str, ...]:
        """Return a sentence for each end of a table that was passed."""
        warnings = []
        for (name, joint), reached in zip(self._joints.items(), self._reached.T.tolist(), strict=True):
            if not isinstance(joint, Revolute) or joint.center is None:
                continue
            for angle in reached:
                if math.isfinite(angle) and (outside := joint.center.outside(angle)) is not None:
                    key, table = outside
                    first, last = table.span
                    warnings.append(
                        f"joint '{name}' turned to {angle:.6g} rad, beyond the table at "
                        f"model.joints.{quoted(name)}.center.{key}, which covers {first:.6g} rad to {last:.6g} rad and "
                        f"is extrapolated there by its first or last polynomial"
                    )
        return tuple(warnings)


@rows_criterion
def watch_moving_centers(spec: RunSpec, compiled: CompiledMechanism, _size: float) -> MovingCenters | None:
    """Return the `MovingCenters` of a mechanism; None if no joint has a moving center."""
    return MovingCenters(spec.mechanism()) if len(compiled.topology.centers) else None


class FrictionElement(NamedTuple):
    """An element with friction: its name, key and value of its transition speed [m/s], arm [m], and path [m] that is
    rest.
    """

    name: str
    key: str
    transition: float
    arm: float
    rest: float


class SlowFriction(WatchedArrays):
    """Sums over the recorded states of a run, for each of E elements with friction.

    `take`: function that returns their slip velocities [m/s] and friction powers [W] in T states, (T, E), of any sign.
    """

    kept = ("_sums", "_peak", "_last")

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


@rows_criterion
def watch_joint_friction(spec: RunSpec, compiled: CompiledMechanism, size: float) -> SlowFriction | None:
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


class CoincidentEnds(WatchedArrays):
    """Watches K forces between two points over the steps of a run.

    If the ends meet, or pass each other so closely that a step does not resolve it, the force reverses within a step.
    The relative velocity of the ends is assumed to be constant in this step. For lengths s_0 and s_1 and rates s_0' and
    s_1' at its ends, the scalar product of the distance vectors is then ``s_0^2 + h s_0 s_0' = s_1^2 - h s_1 s_1'``,
    with the step h. It gives the angle by which the direction turns.

    `names`: names of the forces. `columns`: indices of the forces among the force elements.
    """

    kept = ("_first", "_last")

    def __init__(self, names: list[str], columns: list[int]):
        self._names, self._columns = names, columns
        self._first = np.full(len(names), np.inf)
        self._last = np.zeros((0, len(names), 4))

    def add(self, states: States) -> None:
        """Take note of states."""
        values = np.concatenate([self._last, self._values(states.time, states.observed.forces)])
        self._last = values[-1:].copy()
        self._first = np.minimum(self._first, self._times(values).min(axis=0, initial=np.inf))

    def found_in(self, time: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return whether there would be a finding in each of R runs, (R,).

        `time`: (R, T) times [s]. `forces`: (R, T, F, 5) values of all force elements.
        """
        values = self._values(time, forces)
        return np.asarray(np.isfinite(self._times(values.swapaxes(0, 1))).any(axis=(0, 2)))

    def _values(self, time: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return length, rate and force of the watched elements, and the time, (..., 4)."""
        values = np.empty((*time.shape, len(self._names), 4))
        values[..., :3], values[..., 3] = forces[..., self._columns, :3], time[..., None]
        return values

    @staticmethod
    def _times(values: np.ndarray) -> np.ndarray:
        """Return the times (T - 1, ...) at which ends meet, infinite if they do not, from values (T, ..., 4)."""
        (s0, rate0, force0, t0), (s1, rate1, force1, t1) = (np.moveaxis(x, -1, 0) for x in (values[:-1], values[1:]))
        h = t1 - t0
        turned = (s0 + h * rate0 < REVERSED * s1) & (s1 - h * rate1 < REVERSED * s0) | (s1 == 0.0)
        met = turned & (np.where(s0 < s1, force0, force1) != 0.0)  # a slack rope has no force to reverse
        with np.errstate(invalid="ignore"):  # 0 / 0 if the ends stay together
            return np.asarray(np.where(met, t0 + h * np.nan_to_num(s0 / (s0 + s1)), np.inf))

    def findings(self, _energies: EnergyRecord, _integrals: Integrals) -> tuple[str, ...]:
        """Return a sentence for each force whose ends have met."""
        return tuple(
            f"the two ends of force '{name}' meet at t = {time:.6g} s, or pass each other too closely for the step; "
            f"the direction of the force reverses there, and the motion depends on the step: keep the ends apart, or "
            f"use a spring-damper with free_length 0"
            for name, time in zip(self._names, self._first.tolist(), strict=True)
            if time < np.inf
        )


@rows_criterion
def watch_coincident_ends(spec: RunSpec, compiled: CompiledMechanism, _size: float) -> CoincidentEnds | None:
    """Return the forces that are watched in a run; None if there are none, or if rows skip ends of steps."""
    columns = {force.name: column for column, force in enumerate(compiled.forces)}
    forces = spec.mechanism().forces
    names = [name for name, force in forces.items() if line_of_undefined_direction(force) is not None]
    return CoincidentEnds(names, [columns[name] for name in names]) if names and steps_are_rows(spec) else None
