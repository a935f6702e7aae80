"""Rows that a method in Python records: at the ends of its steps, or at an interval by dense output."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.integrators.interface import Moment, Nodes, StepTaken, Stretch, Timetable
from mbdkit.integrators.run.reached import Reached, Row
from mbdkit.methods.step_methods import ExternalMethod, Step, StepMethod, StepState

if TYPE_CHECKING:
    from mbdkit.engine.equations_of_motion import EquationsOfMotion
    from mbdkit.engine.workspace import Workspace
    from mbdkit.integrators.host.host_energies import HostEnergies, HostNodes
    from mbdkit.integrators.run.step_results import StepResults


class HostRows(ABC):
    """Base class of `mbdkit.integrators.host.step_host.StepHost`: its rows."""

    method: StepMethod | ExternalMethod
    equations: EquationsOfMotion
    workspace: Workspace
    timetable: Timetable
    now: Reached
    finished: bool
    last_step: StepTaken | None
    next_row: int
    _before: Reached
    _made: Step
    _states: int
    _results: StepResults
    _energies: HostEnergies
    _nodes: HostNodes
    _inner_rows: list[float]
    _is_fixed: bool

    @abstractmethod
    def inside(self, theta: float) -> Moment:
        """See `Stepper.inside`."""

    def last_state(self) -> Stretch:
        """See `Stepper.last_state`."""
        return self._stretch([self._recorded()])

    def taken_nodes(self) -> Nodes:
        """See `Stepper.taken_nodes`."""
        return self._nodes.taken()

    def _due(self, end: float = math.inf) -> list[Row]:
        """Return the rows to be recorded after the last step, or up to the time `end` within it."""
        table, now = self.timetable, self.now
        if table.interval is None:
            count = now.whole if self._is_fixed else now.done
            is_new = now.whole > self._before.whole or not self._is_fixed
            is_due = (is_new and count % table.every == 0) or self.finished
            return [self._recorded()] if is_due else []
        rows: list[Row] = []
        begins_at_impact = self._before.passed > 0 and table.stops[self._before.passed - 1] in table.impacts
        # A row at a stop with an impact shows the right-hand limit.
        earliest = table.sides(self._before.passed)[0] if begins_at_impact else -math.inf
        inner = math.ceil((table.end - table.start) / table.interval - 1e-9)  # the end is always recorded
        while self.next_row < inner and (at := table.start + self.next_row * table.interval) <= min(now.time, end):
            rows.append(self._inner_row(max(at, earliest)))
            self.next_row += 1
        self._inner_rows = [row.time for row in rows]
        if self.finished:
            rows.append(self._recorded())
        return rows

    def _inner_row(self, at: float) -> Row:
        """Return a row at a time within the last step."""
        before, step = self._before, self.last_step
        assert step is not None
        recorded = self._recorded()
        theta = (at - step.t0) / (step.t1 - step.t0)
        if theta >= 1.0:
            return recorded
        q, v, z = self.inside(theta)
        own, own_before = self.now.state.multipliers, before.state.multipliers
        if own is not None and own_before is not None:
            own = own_before + theta * (own - own_before)
        n = self.equations.n
        energy = self._energies.at(theta, before, self.now, self._made, self._results)
        return Row(at, StepState(q[:n], v[:n], own, z=z), energy, recorded.interval)

    def _recorded(self) -> Row:
        """Return the current point as a row to be recorded, and start a new interval."""
        now = self.now
        self.now = now.recorded()
        return Row(now.time, now.state, now.energy, now.interval)

    def _with_ground(self, state: StepState) -> tuple[np.ndarray, np.ndarray]:
        return with_ground(state.q), with_ground(state.v)

    def _stretch(self, rows: list[Row]) -> Stretch:
        """Return recorded states as a `Stretch`."""
        n, count = self.equations.n, len(rows)
        q, v = np.zeros((2, count, self.workspace.mechanism.size))
        intervals = np.zeros((count, 6))
        energy, corrections = np.zeros((count, 2)), np.zeros((count, 4))
        own = np.zeros((count, len(self.workspace.mechanism.rows))) if self.method.carries_multipliers else None
        for i, row in enumerate(rows):
            q[i, :n], v[i, :n] = row.state.q, row.state.v
            energy[i], corrections[i] = row.energy, row.interval.correction
            took = row.interval
            intervals[i] = row.time, took.steps, took.size, took.iterations, took.most_iterations, took.rejected
            if own is not None and row.state.multipliers is not None:
                own[i] = self.equations.recorded_multipliers(row.time, row.state.q, row.state.multipliers)
        return Stretch(
            intervals[:, 0].copy(),
            q,
            v,
            energy[:, 0].copy(),
            energy[:, 1].copy(),
            intervals,
            multipliers=own,
            corrections=corrections if self.workspace.stabilization.kind != "none" else None,
            z=np.array([row.state.z for row in rows]).reshape(count, self._states),
        )
