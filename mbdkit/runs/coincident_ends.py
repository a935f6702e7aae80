"""Warnings about forces between two points that meet during a run, where the direction of the force is undefined.

If the points meet, or pass each other so closely that a step does not resolve it, the force reverses within a step. The
relative velocity of the points is assumed to be constant in this step. For lengths s_0 and s_1 and rates s_0' and s_1'
at its ends, the scalar product of the distance vectors is then ``s_0^2 + h s_0 s_0' = s_1^2 - h s_1 s_1'``, with the
step h. It gives the angle by which the direction turns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.stored_arrays import fill
from mbdkit.mechanism.checks import line_of_undefined_direction
from mbdkit.runs.law_ranges import steps_are_rows
from mbdkit.runs.run_seams import rows_criterion

if TYPE_CHECKING:
    from mbdkit.archive.checkpoint import StoredState
    from mbdkit.archive.measured_values import Integrals
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.quantities.states import States
    from mbdkit.spec import RunSpec
    from mbdkit.trust.energy_record import EnergyRecord


#: The direction of a force reverses if the cosine of the angle by which it turns in a step is below this (150 degrees).
#:
#: Measured at a mass that passes the anchor of a spring at distances of 0.1 to 30 mm: steps that an adaptive method
#: accepted at tolerances of 1e-6 turn the direction by at most 145 degrees, and the motion remains accurate.
REVERSED = -0.866


class CoincidentEnds:
    """Watches K forces between two points over the steps of a run.

    `names`: names of the forces. `columns`: indices of the forces among the force elements.
    """

    def __init__(self, names: list[str], columns: list[int]):
        self._names, self._columns = names, columns
        self._first = np.full(len(names), np.inf)
        self._last = np.zeros((0, len(names), 4))

    def add(self, states: States) -> None:
        """Take note of states."""
        values = np.empty((len(states.time), len(self._names), 4))  # length, rate, force, time
        values[..., :3], values[..., 3] = states.observed.forces[:, self._columns, :3], states.time[:, None]
        values = np.concatenate([self._last, values])
        self._last = values[-1:].copy()
        self._first = np.minimum(self._first, self._times(values).min(axis=0, initial=np.inf))

    def found_in(self, time: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return whether there would be a finding in each of R runs, (R,).

        `time`: (R, T) times [s]. `forces`: (R, T, F, 5) values of all force elements.
        """
        values = np.empty((*time.shape, len(self._names), 4))
        values[..., :3], values[..., 3] = forces[:, :, self._columns, :3], time[:, :, None]
        return np.asarray(np.isfinite(self._times(values.swapaxes(0, 1))).any(axis=(0, 2)))

    @staticmethod
    def _times(values: np.ndarray) -> np.ndarray:
        """Return the times (T - 1, ...) at which ends meet, infinite if they do not, from values (T, ..., 4)."""
        (s0, rate0, force0, t0), (s1, rate1, force1, t1) = (
            np.moveaxis(values[:-1], -1, 0),
            np.moveaxis(values[1:], -1, 0),
        )
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

    def stored(self) -> StoredState:
        """Return the state as plain values, for a checkpoint."""
        return {"first": self._first, "last": self._last}

    def restore(self, state: StoredState) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        self._last = np.zeros((min(1, len(state["last"])), len(self._names), 4))
        fill(self._first, state["first"])
        fill(self._last, state["last"])


@rows_criterion
def watch_coincident_ends(spec: RunSpec, compiled: CompiledMechanism, _size: float) -> CoincidentEnds | None:
    """Return the forces that are watched in a run; None if there are none, or if rows skip ends of steps."""
    columns = {force.name: column for column, force in enumerate(compiled.forces)}
    forces = spec.mechanism().forces
    names = [name for name, force in forces.items() if line_of_undefined_direction(force) is not None]
    return CoincidentEnds(names, [columns[name] for name in names]) if names and steps_are_rows(spec) else None
