"""The last step of a method in Python, and the rows that the method records at ends of steps or at an interval."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.kernels.interpolation import fade
from mbdkit.integrators.host.host_energies import HostEnergies
from mbdkit.integrators.host.step_attempts import Attempt
from mbdkit.integrators.interface import ROUNDING, Moment, StepTaken, Stretch, Timetable, closeness
from mbdkit.integrators.run.reached import Reached, RecordedRow
from mbdkit.methods.step_methods import StepState

if TYPE_CHECKING:
    from mbdkit.engine.equations_of_motion import EquationsOfMotion


class LastStep(NamedTuple):
    """A step that has been accepted."""

    before: Reached  #: Its start, with the size of the step that was accepted.
    attempt: Attempt
    ends: StepTaken
    energies: HostEnergies
    next_row: int  #: Number of the next row by interval at its start.
    has_dense_output: bool

    def inside(self, theta: float) -> Moment:
        """Return the state at the share `theta` of the step; see `Stepper.inside`."""
        taken = self.attempt.taken
        inner = self.attempt.inside(theta) if self.has_dense_output and theta not in (0.0, 1.0) else None
        if inner is None:
            return self.ends.between(theta)
        q, v, z = inner[:3]
        if taken.made is not taken.reached:
            share = fade(theta)
            q, v = q + share * (taken.reached.q - taken.made.q), v + share * (taken.reached.v - taken.made.v)
        return with_ground(q), with_ground(v), z

    def energy(self, theta: float) -> np.ndarray:
        """Return work and dissipated energy (2,) [J] at the share `theta` of the step."""
        return self.energies.at(theta, self.before, self.attempt.end, self.attempt.inside)

    def row(self, at: float, now: Reached) -> RecordedRow:
        """Return a row at a time within the step, with the statistics of the point `now` that it has reached."""
        theta = (at - self.ends.t0) / (self.ends.t1 - self.ends.t0)
        if theta >= 1.0:
            return now.row()._replace(time=at)
        q, v, z = self.inside(theta)
        own, own_before = now.state.multipliers, self.before.state.multipliers
        if own is not None and own_before is not None:
            own = own_before + theta * (own - own_before)
        return RecordedRow(at, StepState(q[:-3], v[:-3], own, z=z), self.energy(theta), now.interval)


class HostRows:
    """Chooses and collects the rows of a run.

    - `equations`: the equations of motion.
    - `timetable`: which states are recorded.
    - `is_fixed`: whether steps have a fixed size.
    - `carries_multipliers`: whether the method computes multipliers, which are then recorded.
    - `next_row`: number of the next row that is recorded at an interval.
    - `inner`: times of the rows within the last step [s].
    """

    def __init__(
        self, equations: EquationsOfMotion, timetable: Timetable, *, is_fixed: bool, carries_multipliers: bool
    ):
        self._equations, self._timetable, self._is_fixed = equations, timetable, is_fixed
        self._carries_multipliers = carries_multipliers
        self.next_row = 1
        self.inner: list[float] = []

    def due(
        self, before: Reached, last: LastStep | None, now: Reached, end: float = math.inf, *, finished: bool
    ) -> tuple[list[RecordedRow], Reached]:
        """Return the rows of the step from `before` to `now`, or up to `end` [s], and `now` with its new interval."""
        table = self._timetable
        if table.interval is None:
            count = now.whole if self._is_fixed else now.done
            is_new = now.whole > before.whole or not self._is_fixed
            is_due = (is_new and count % table.every == 0) or finished
            return ([now.row()], now.recorded()) if is_due else ([], now)
        assert last is not None
        rows: list[RecordedRow] = []
        # a row at an event or a stop is the limit from before
        is_jump = now.why or now.is_event or now.event is not None
        near = closeness(now.time) if is_jump else ROUNDING * max(abs(table.start), abs(table.end))
        until = min(now.time, end) + near
        inner = math.ceil((table.end - table.start) / table.interval - 1e-9)  # the end is always recorded
        while self.next_row < inner and (at := table.start + self.next_row * table.interval) <= until:
            rows.append(last.row(at, now))
            now = now.recorded()
            self.next_row += 1
        self.inner = [row.time for row in rows]
        if finished:
            rows.append(now.row())
            now = now.recorded()
        return rows, now

    def stretch(self, rows: list[RecordedRow]) -> Stretch:
        """Return recorded states as a `Stretch`."""
        equations, count = self._equations, len(rows)
        mechanism, n = equations.workspace.mechanism, equations.n
        q, v = np.zeros((2, count, mechanism.size))
        intervals = np.zeros((count, 6))
        energy, corrections = np.zeros((count, 2)), np.zeros((count, 4))
        own = np.zeros((count, len(mechanism.rows))) if self._carries_multipliers else None
        for i, (time, state, gained, took) in enumerate(rows):
            q[i, :n], v[i, :n] = state.q, state.v
            energy[i], corrections[i] = gained, took.correction
            intervals[i] = time, took.steps, took.size, took.iterations, took.most_iterations, took.rejected
            if own is not None and state.multipliers is not None:
                own[i] = equations.recorded_multipliers(time, state.q, state.multipliers)
        return Stretch(
            intervals[:, 0].copy(),
            q,
            v,
            energy[:, 0].copy(),
            energy[:, 1].copy(),
            intervals,
            multipliers=own,
            corrections=corrections if equations.stabilization.kind != "none" else None,
            z=np.array([row.state.z for row in rows]).reshape(count, len(equations.z0)),
        )
