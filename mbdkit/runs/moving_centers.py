"""Warnings about joints whose angle leaves the tables of their moving centers during a run."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.plain_data import quoted
from mbdkit.engine.stored_arrays import fill
from mbdkit.mechanism.joints import Revolute
from mbdkit.runs.run_seams import rows_criterion

if TYPE_CHECKING:
    from mbdkit.archive.checkpoint import StoredState
    from mbdkit.archive.measured_values import Integrals
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.quantities.states import States
    from mbdkit.spec import RunSpec
    from mbdkit.trust.energy_record import EnergyRecord


class MovingCenters:
    """Smallest and largest coordinates of the joints in the recorded states of a run."""

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

    def stored(self) -> StoredState:
        """Return the state as plain values, for a checkpoint."""
        return {"reached": self._reached}

    def restore(self, state: StoredState) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        fill(self._reached, state["reached"])


@rows_criterion
def watch_moving_centers(spec: RunSpec, compiled: CompiledMechanism, _size: float) -> MovingCenters | None:
    """Return the `MovingCenters` of a mechanism; None if no joint has a moving center."""
    return MovingCenters(spec.mechanism()) if len(compiled.topology.centers) else None
