"""Advances runs with controlled step size in lanes (`mbdkit.stepping.lane_control`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.counters import Counters
from mbdkit.engine.jit.bundle import PinnedBundle
from mbdkit.engine.jit.lane_arrays import Lanes, new_lanes
from mbdkit.engine.jit.lane_width import WIDTH
from mbdkit.engine.workspace import Workspace
from mbdkit.methods.kinds import ExplicitRungeKutta
from mbdkit.stepping.interface import Timetable
from mbdkit.stepping.lane_collocation import StagePivots
from mbdkit.stepping.lane_control import ENDED, accelerate, drive_controlled, new_lane_control
from mbdkit.stepping.lane_stepper import AtStart, LaneResults, LaneStepper, by_run
from mbdkit.stepping.run_plan import smallest_step
from mbdkit.stepping.start import step_control
from mbdkit.stepping.step_control import Control, control_data, first_size

FEW_ROWS = 64
"""Size of the buffer of recorded states at first; it is doubled when it is full."""


def _rows_by_interval(table: Timetable) -> int:
    """Return an upper bound of the number of states recorded by `interval`; 0 if steps are recorded."""
    return 0 if table.interval is None else 2 + math.ceil((table.end - table.start) / table.interval)


class ControlledLaneStepper(LaneStepper):
    """Advances up to `WIDTH` runs with controlled step size, with the topology and the method of the first.

    Parameters
    ----------
    method
        The method, with its tolerances.
    workspace
        Mechanism of the first run; it provides the topology and the schedule of the solver.
    """

    def __init__(self, method: ExplicitRungeKutta, workspace: Workspace):
        super().__init__(method, workspace, FEW_ROWS)
        self.method = method
        self.runs = new_lane_control(self.run, self._control(workspace.mechanism))
        self._pinned = PinnedBundle(self.runs)

    def advance(
        self, starts: Sequence[AtStart], tables: Sequence[Timetable], pivots: Sequence[StagePivots | None] = ()
    ) -> LaneResults:
        """Return the results of the runs; see `LaneStepper.advance`. Their numbers of steps may differ."""
        count = len(starts)
        lanes = [*range(count), *[0] * (WIDTH - count)]  # idle lanes repeat the first run
        chosen, planned = [starts[lane] for lane in lanes], [tables[lane] for lane in lanes]
        while max(map(_rows_by_interval, planned)) > len(self.runs.row_work):
            self._grow()
        self.load(chosen, planned)
        self._load_control([one.mechanism for one in chosen], planned)
        while drive_controlled(self._pinned.address) != ENDED:
            self._grow()
        accepted, rejected = (
            x[0, :count].astype(int).tolist() for x in (self.runs.progress.accepted, self.runs.progress.rejected)
        )
        counters = [Counters(steps=n, accepted=n, rejected=m) for n, m in zip(accepted, rejected, strict=True)]
        rows = self.runs.rows[:count].copy()
        return self.results(counters, rows, by_run(self.runs.row_work[: rows.max()], count))

    def _control(self, mechanism: CompiledMechanism) -> Control:
        control = step_control(self.method.traits, mechanism)
        assert control is not None
        return control

    def _load_control(self, mechanisms: list[CompiledMechanism], tables: list[Timetable]) -> None:
        """Begin the control of the steps of all runs."""
        runs, c = self.runs, self.run
        controls = [self._control(one) for one in mechanisms]
        for lane, (control, table) in enumerate(zip(controls, tables, strict=True)):
            data = control_data(control, smallest_step(table))
            for name in ("rtol", "atol", "min_size", "max_size"):
                getattr(runs.control, name)[..., lane] = getattr(data, name)
        c.times.every[0] = 0 if tables[0].interval is not None else tables[0].every
        runs.interval[0], runs.max_steps[0] = tables[0].interval or 0.0, [table.max_steps for table in tables]
        runs.attempts[0] = runs.rows[:] = 0
        for array in (*runs.progress, runs.work):
            array[...] = 0.0
        runs.progress.running[...] = 1.0
        runs.progress.next_row[...] = 1.0
        runs.progress.time[...] = c.times.start
        runs.progress.next_size[0] = self._first_sizes(controls, tables)

    def _first_sizes(self, controls: list[Control], tables: list[Timetable]) -> list[float]:
        """Return the sizes of the first steps [s]."""
        spans = [table.end - table.start for table in tables]
        sizes = [table.step for table in tables]
        if None in sizes:
            accelerate(self._pinned.address)
            y, rates = (
                by_run(np.concatenate([x[:-3] for x in pair]), WIDTH)
                for pair in ((self.run.q, self.run.v), (self.run.v, self.run.method.accelerations[0]))
            )
            sizes = [
                first_size(*one) if size is None else size
                for size, *one in zip(sizes, y, rates, spans, controls, strict=True)
            ]
        return [min(span, size) for span, size in zip(spans, sizes, strict=True) if size is not None]

    def _grow(self) -> None:
        """Double the buffer of recorded states."""

        def doubled(lanes: np.ndarray) -> Lanes:
            larger = new_lanes(2 * len(lanes), *lanes.shape[1:-1])
            larger[: len(lanes)] = lanes
            return larger

        c: Any = self.run
        names = ("row_time", "row_q", "row_v", "row_energy", "row_interval")
        observed = type(c.observed)(*map(doubled, c.observed))
        self.run = c._replace(observed=observed, **{name: doubled(getattr(c, name)) for name in names})
        self.runs = self.runs._replace(run=self.run, row_work=doubled(self.runs.row_work))
        self._pinned.replace(self.runs)
