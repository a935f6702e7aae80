"""Prepare runs for lanes (`mbdkit.stepping.lane_driver`), advance them, and return their states and recorded values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.counters import Counters
from mbdkit.engine.jit.bundle import JIT_DISABLED, PinnedBundle
from mbdkit.engine.jit.lane_types import Lanes
from mbdkit.engine.jit.lane_width import WIDTH
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.system import Topology
from mbdkit.engine.workspace import Workspace
from mbdkit.methods.kinds import ExplicitRungeKutta
from mbdkit.stepping.interface import StepEvidence, Timetable
from mbdkit.stepping.lane_driver import drive_lanes
from mbdkit.stepping.lane_run import BY_LANE, new_lane_run
from mbdkit.stepping.run_plan import guard_limits
from mbdkit.stepping.run_state import FACTORIZATIONS, RHS
from mbdkit.stepping.step_guards import new_guard_state
from mbdkit.stepping.step_watch import guard_evidence


@dataclass(frozen=True)
class LaneResults:
    """Runs that were advanced in lanes: W runs with T recorded states each, the initial one first."""

    lost: np.ndarray
    """(W,) whether a run must be repeated alone; its other values are not valid."""
    time: np.ndarray
    """(W, T) times [s]."""
    q: np.ndarray
    """(W, T, 3 (B + 1)) positions, ground last."""
    v: np.ndarray
    energy: np.ndarray
    """(W, T, 2) work and dissipated energy [J]."""
    observed: Observed
    """Arrays (W, T, ...)."""
    worst: np.ndarray
    """(W, P) largest squared misalignments."""
    evidence: tuple[StepEvidence, ...]
    counters: Counters
    """Those of each run."""


class AtStart(Protocol):
    """A mechanism at its consistent start; a `Workspace` is one."""

    @property
    def mechanism(self) -> CompiledMechanism:
        """The compiled mechanism."""
        ...

    @property
    def q0(self) -> np.ndarray:
        """(3 (B + 1),) positions, ground last."""
        ...

    @property
    def v0(self) -> np.ndarray:
        """(3 (B + 1),) velocities, ground last."""
        ...


def topology_of(mechanism: CompiledMechanism) -> tuple[object, ...]:
    """Return a key that is equal for mechanisms that differ in numbers only; their runs may be lanes of one loop."""
    shapes = tuple((x.shape, x.tobytes() if x.dtype.kind == "i" else b"") for x in mechanism.topology)
    return shapes, mechanism.order, mechanism.names


def suits_lanes(method: Any, mechanism: CompiledMechanism, table: Timetable) -> bool:
    """Return whether a run of index-1 equations without stabilization can be advanced in lanes.

    Its method must be explicit with fixed steps, without events and rows by interval, and the Schur complement must do.
    """
    return (
        not JIT_DISABLED
        and isinstance(method, ExplicitRungeKutta)
        and table.interval is None
        and table.step is not None
        and not table.single
        and not table.stops
        and table.steps <= table.max_steps
        and not mechanism.needs_pivots
        and len(mechanism.topology.spare) == 0
    )


class LaneStepper:
    """Advances up to `WIDTH` runs with the topology and the method of the first.

    Parameters
    ----------
    method
        The explicit method.
    workspace
        Mechanism of the first run; it provides the topology and the schedule of the solver.
    rows
        Number of recorded states, the initial one included.
    """

    def __init__(self, method: ExplicitRungeKutta, workspace: Workspace, rows: int):
        self.run = new_lane_run(method, workspace, rows)
        self._pinned = PinnedBundle(self.run)
        self._guards = [new_guard_state(workspace.mechanism) for _ in range(WIDTH)]
        self._pinned_guards = [PinnedBundle(one) for one in self._guards]
        self.run.watch.guards[:] = [one.address for one in self._pinned_guards]

    def advance(self, starts: Sequence[AtStart], tables: Sequence[Timetable]) -> LaneResults:
        """Return the results of the runs.

        Parameters
        ----------
        starts, tables
            At most `WIDTH` mechanisms at their starts, and the timetables of the runs, with equal numbers of steps.
        """
        count = len(starts)
        lanes = [*range(count), *[0] * (WIDTH - count)]  # idle lanes repeat the first run
        self._load([starts[lane] for lane in lanes], [tables[lane] for lane in lanes])
        drive_lanes(self._pinned.address)
        return self._results(count)

    def _load(self, starts: list[AtStart], tables: list[Timetable]) -> None:
        c = self.run
        mechanisms = [one.mechanism for one in starts]
        _fill(c.top, [one.topology for one in mechanisms])
        _put(c.q, [one.q0 for one in starts])
        _put(c.v, [one.v0 for one in starts])
        limits = [guard_limits(one, table.guards) for one, table in zip(mechanisms, tables, strict=True)]
        _put(c.squared_misalignment, [one.squared_misalignment for one in limits])
        _put(c.energy_share, [one.energy_jump for one in limits])
        for name in ("start", "end", "step", "last_step"):
            getattr(c.times, name)[0] = [getattr(table, name) for table in tables]
        c.times.steps[0], c.times.every[0] = tables[0].steps, tables[0].every
        for array in (c.q_low, c.v_low, c.energy, c.energy_low, c.gain, c.worst, c.lost, c.near, *c.guards):
            array[...] = 0.0
        c.counts[:] = 0
        c.has_power[0] = int(any(one.has_power for one in mechanisms))
        c.watch.has_loops[0] = int(self._guards[0].has_loops[0])
        if c.watch.has_loops[0]:
            c.watch.mass[:] = [one.topology.mass for one in mechanisms]
            for guards, mechanism in zip(self._guards, mechanisms, strict=True):
                for array, fresh in zip(guards, new_guard_state(mechanism), strict=True):
                    array[...] = fresh

    def _results(self, count: int) -> LaneResults:
        c = self.run
        steps = int(c.times.steps[0])
        work = {"rhs_evaluations": int(c.counts[RHS]), "factorizations": int(c.counts[FACTORIZATIONS])}
        arrays = (c.row_time, c.row_q, c.row_v, c.row_energy, *c.observed, c.worst)
        time, q, v, energy, *observed, worst = (np.ascontiguousarray(np.moveaxis(x, -1, 0)[:count]) for x in arrays)
        for lane, guards in enumerate(self._guards):
            for name in ("kinetic", "jump", "jump_time"):
                getattr(guards, name)[0] = getattr(c.guards, name)[0, lane]
        evidence = tuple(guard_evidence(guards, []) for guards in self._guards[:count])
        counters = Counters(steps=steps, accepted=steps, **work)
        lost = np.asarray(c.lost[0, :count] != 0.0)
        return LaneResults(lost, time, q, v, energy, Observed(*observed), worst, evidence, counters)


def _put(lanes: np.ndarray, arrays: list[np.ndarray]) -> None:
    """Copy one array for each lane into an array of lanes."""
    lanes[...] = np.stack(arrays, axis=-1)


def _fill(top: Topology, topologies: list[Topology]) -> None:
    """Copy the numbers of one mechanism for each lane; integers are the same for all."""
    for name, lanes in zip(Topology._fields, top, strict=True):
        arrays = [getattr(one, name) for one in topologies]
        if name in BY_LANE:
            lanes[...] = arrays
        elif isinstance(lanes, Lanes):
            _put(lanes, arrays)
