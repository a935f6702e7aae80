"""Overlaps of contacts during a run: circles that overlap another shape by a large share of their radius, and rigid
bodies that overlap.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mbdkit.archive.peak_errors import expression_of_largest
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.stored_arrays import fill
from mbdkit.quantities.states import States
from mbdkit.runs.run_seams import rows_criterion
from mbdkit.spec.run_spec import RunSpec
from mbdkit.trust.energy_record import EnergyRecord
from mbdkit_contact.contact import ContactPair
from mbdkit_contact.contact_kinematics import arms_of, shapes_of
from mbdkit_contact.kernels.uneven_ground import EDGE
from mbdkit_contact.quantities import contacts_in

#: Overlaps up to this share of the radius of a circle cause no warning.
#:
#: The laws of compliant contacts assume that overlaps are small. Feet of published models are softer: the spheres of
#: OpenSim's examples, of 30 mm radius, overlap the ground by up to about a third of their radius.
DEEP = 0.5

#: Largest way of bodies in a fixed step, relative to the way on which two shapes overlap when they pass through each
#: other, that causes no warning.
PASSING = 0.25

#: Overlaps of rigid contacts up to this share of the size of the mechanism are the errors of a sound run: of open
#: contacts in recorded states; and of closed ones, and at the peaks that checked runs find between recorded states,
#: where coarse steps are interpolated.
RIGID, INTERPOLATED = 1e-7, 1e-3


class DeepOverlaps:
    """Largest overlaps of C contacts in the recorded states of a run.

    Parameters
    ----------
    compiled
        The compiled mechanism.
    finer
        See `mbdkit.spec.run_spec.RunSpec.finer`.
    """

    def __init__(self, compiled: CompiledMechanism, finer: str):
        self._pairs = [contact.pair for contact in compiled.extensions["contacts"]]
        self._is_rigid, self._finer = compiled.reacting is not None, finer
        self._depth, self._time = np.zeros((2, len(self._pairs)))

    def add(self, states: States) -> None:
        """Take note of states."""
        if len(states.time):
            self._note(states.time, states.of(contacts_in)["gap"])

    def _note(self, time: np.ndarray, gap: np.ndarray) -> None:
        row = np.argmin(gap, axis=0)
        depth = -gap[row, np.arange(len(row))]
        self._time = np.where(depth > self._depth, time[row], self._time)
        self._depth = np.maximum(self._depth, depth)

    def findings(self, _energies: EnergyRecord, _integrals: Mapping[str, object]) -> tuple[str, ...]:
        """Return a sentence for each circle that overlaps too much."""
        sentences = []
        for pair, depth, time in zip(self._pairs, self._depth.tolist(), self._time.tolist(), strict=True):
            if pair.radius > 0.0 and depth > DEEP * pair.radius:
                advice = f"use {self._finer}" if self._is_rigid else f"increase {pair.key}.compliance.stiffness"
                sentences.append(
                    f"contact '{pair.name}' overlaps by {depth:.3g} m at t = {time:.6g} s, {depth / pair.radius:.0%} "
                    f"of the radius of its circle, but contact laws assume small overlaps; {advice}"
                )
        return tuple(sentences)

    def stored(self) -> dict[str, object]:
        """Return the state as plain values, for a checkpoint."""
        return {"depth": self._depth, "time": self._time}

    def restore(self, state: Mapping[str, object]) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        fill(self._depth, state["depth"])
        fill(self._time, state["time"])


@rows_criterion
def watch_deep_overlaps(spec: RunSpec, compiled: CompiledMechanism, _size: float) -> DeepOverlaps | None:
    """Return the `DeepOverlaps` of a mechanism; None if it has no contacts of circles."""
    has_circles = any(one.pair.radius > 0.0 for one in compiled.extensions["contacts"])
    return DeepOverlaps(compiled, spec.finer) if has_circles else None


class LongSteps(DeepOverlaps):
    """Ways of bodies in a fixed step beside compliant contacts that they may jump over: ``depth`` is their excess over
    the way through the contact, of which a step may go `PASSING`.
    """

    def __init__(self, compiled: CompiledMechanism, finer: str, step: float, every: int):
        super().__init__(compiled, finer)
        self._step, self._every = step, every
        self._through = np.array([_way_through(pair) for pair in self._pairs])
        shapes = shapes_of(compiled.extensions["contacts"], len(compiled.bodies), 0.0)
        self._arms = np.where(np.isinf(arms_of(shapes)), 0.0, arms_of(shapes))
        self._bodies = shapes.contacts[:, :2]

    def add(self, states: States) -> None:
        """See `DeepOverlaps.add`."""
        if len(states.time):
            v = states.v.reshape(len(states.time), -1, 3)[:, self._bodies]  # (T, C, 2, 3)
            speed = np.hypot(*np.moveaxis(v[:, :, 1, :2] - v[:, :, 0, :2], 2, 0))
            way = self._step * (speed + np.sum(np.abs(v[..., 2]) * self._arms, axis=2))
            is_near = states.of(contacts_in)["gap"] <= self._every * way
            self._note(states.time, np.where(is_near, PASSING * self._through - way, 0.0))

    def findings(self, _energies: EnergyRecord, _integrals: Mapping[str, object]) -> tuple[str, ...]:
        """Return a sentence for each contact that a step may jump over."""
        sentences, values = dict[str, str](), (self._depth.tolist(), self._time.tolist(), self._through.tolist())
        for pair, depth, time, through in sorted(zip(self._pairs, *values, strict=True), key=lambda row: row[1]):
            if depth > 0.0:
                way = depth + PASSING * through
                sentences[pair.key] = (
                    f"at t = {time:.6g} s, the shapes of contact '{pair.name}' move by {way:.3g} m in a step, but they "
                    f"touch along at most {through:.3g} m of their way, so that they may pass through each other; use "
                    "a smaller time.step, or an adaptive method"
                )
        return tuple(sentences.values())


def _way_through(pair: ContactPair) -> float:
    """Return the way on which two shapes overlap while one moves straight through the other at its thinnest [m];
    infinite for lines, polylines and holes.
    """
    numbers, kind = pair.numbers, pair.kind[0]
    if kind == "circles":
        return 2.0 * (numbers[2] + numbers[5])
    if kind not in ("edge", "inside"):
        return np.inf
    edges = np.reshape(numbers[-EDGE * pair.kind[1] :], (-1, EDGE))
    heights = np.sum((edges[:, None, :2] - edges[None, :, :2]) * edges[None, :, 2:4], axis=2)
    return float(np.min(np.max(-heights, axis=0))) + 2.0 * pair.radius


@rows_criterion
def watch_long_steps(spec: RunSpec, compiled: CompiledMechanism, _size: float) -> LongSteps | None:
    """Return the `LongSteps` of a run with compliant contacts and fixed steps."""
    step, contacts = spec.time.step, compiled.extensions["contacts"]
    if step is None or spec.claims.adaptive or compiled.reacting is not None or not contacts:
        return None
    return LongSteps(compiled, spec.finer, step, spec.output.every or 1)


class RigidOverlaps(DeepOverlaps):
    """Overlaps of rigid contacts, which have none in a sound run.

    Parameters
    ----------
    compiled, finer
        See `DeepOverlaps`.
    size
        Size of the mechanism [m].
    locates
        Whether the treatment locates impacts, so that there are no overlaps between recorded states either.
    """

    def __init__(self, compiled: CompiledMechanism, finer: str, size: float, *, locates: bool):
        super().__init__(compiled, finer)
        self._size, self._locates = size, locates

    def add(self, states: States) -> None:
        """See `DeepOverlaps.add`."""
        if len(states.time):
            values = states.of(contacts_in)
            is_sound = (values["mode"] > 0.0) & (values["gap"] > -INTERPOLATED * self._size)
            self._note(states.time, np.where(is_sound, 0.0, values["gap"]))

    def findings(self, _energies: EnergyRecord, integrals: Mapping[str, object]) -> tuple[str, ...]:
        """Return a sentence for each contact that overlaps beyond its tolerance."""
        sentences = []
        for pair, depth, time in zip(self._pairs, self._depth.tolist(), self._time.tolist(), strict=True):
            peak = integrals.get(expression_of_largest("-contacts.gap", pair.name), 0.0) if self._locates else 0.0
            deepest, when = depth, f"at t = {time:.6g} s"
            if depth <= RIGID * self._size:
                deepest, when = peak, "between recorded states"
            if deepest > (RIGID if deepest == depth else INTERPOLATED) * self._size:
                sentences.append(
                    f"The shapes of the rigid contact '{pair.name}' overlap by {deepest:.3g} m {when}: an impact was "
                    f"missed, or steps are too long; use {self._finer}."
                )
        return tuple(sentences)


@rows_criterion
def watch_rigid_overlaps(spec: RunSpec, compiled: CompiledMechanism, size: float) -> RigidOverlaps | None:
    """Return the `RigidOverlaps` of a mechanism; None if its contacts are compliant."""
    if (chosen := compiled.reacting) is None:
        return None
    return RigidOverlaps(compiled, spec.finer, size, locates=chosen.section.treatment == "event-driven")
