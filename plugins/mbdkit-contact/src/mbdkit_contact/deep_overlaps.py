"""Overlaps of contacts during a run: circles that overlap another shape by a large share of their radius, and rigid
bodies that overlap.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.peak_errors import expression_of_largest
from mbdkit.engine.stored_arrays import fill
from mbdkit.runs.run_seams import rows_criterion
from mbdkit_contact.quantities import contacts_in

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.quantities.states import States
    from mbdkit.spec.run_spec import RunSpec
    from mbdkit.trust.energy_record import EnergyRecord

DEEP = 0.5
"""Overlaps up to this share of the radius of a circle cause no warning.

The laws of compliant contacts assume that overlaps are small. Feet of published models are softer: the spheres of
OpenSim's examples, of 30 mm radius, overlap the ground by up to about a third of their radius.
"""


RIGID, INTERPOLATED = 1e-7, 1e-3
"""Overlaps of rigid contacts up to this share of the size of the mechanism are the errors of a sound run: of open
contacts in recorded states; and of closed ones, and at the peaks that checked runs find between recorded states, where
coarse steps are interpolated.
"""


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
    chosen = compiled.reacting
    if chosen is None:
        return None
    return RigidOverlaps(compiled, spec.finer, size, locates=chosen.section.treatment == "event-driven")
