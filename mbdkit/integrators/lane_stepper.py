"""Runs that are advanced together in the lanes of SIMD vectors: preparation, stepping, and results.

`mbdkit.integrators.lanes.lane_loop` has the compiled loop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from mbdkit.base.frozen import dataclass, fields, replace
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.consistent_start import MechanismAtStart
from mbdkit.engine.counters import Counters
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.native.number_arrays import Lanes, new_lanes
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Guards, StepEvidence, Timetable
from mbdkit.integrators.lanes.lane_collocation import StagePivoting, StagePivots, load_stage_pivots
from mbdkit.integrators.lanes.lane_control import ENDED, accelerate, new_lane_control
from mbdkit.integrators.lanes.lane_mechanisms import fill_lanes
from mbdkit.integrators.lanes.lane_run import BY_LANE, LaneRun, new_lane_run
from mbdkit.integrators.run.run_plan import guard_limits, smallest_step
from mbdkit.integrators.run.run_state import FACTORIZATIONS, ITERATIONS, JACOBIANS, RHS
from mbdkit.integrators.run.step_control import Control, control_data, first_size
from mbdkit.integrators.run.step_guards import new_guard_state
from mbdkit.integrators.start import step_control
from mbdkit.methods.kinds import Method
from mbdkit.trust.criteria import BranchSuspicion


@dataclass(frozen=True)
class LaneResults:
    """Results of W runs that were advanced in SIMD lanes, with up to T recorded states each, the initial one first.

    If the step size is controlled, a run may have fewer than T recorded states; its last one is then repeated.
    """

    #: (W,) whether a run must be repeated outside the lanes; its other values are then not valid.
    lost: np.ndarray
    time: np.ndarray  #: (W, T) times [s].
    q: np.ndarray  #: (W, T, 3 (B + 1)) positions, ground last.
    v: np.ndarray
    z: np.ndarray  #: (W, T, Z) first-order states.
    energy: np.ndarray  #: (W, T, 2) work and dissipated energy [J].
    worst: np.ndarray  #: (W, P) largest squared misalignments.
    #: (W, T, 2) iterations since the previous recorded state, and the largest number of iterations in one of the
    #: steps since then.
    iterations: np.ndarray
    rows: np.ndarray  #: (W,) number of recorded states of each run.
    observed: Observed  #: Values computed for the recorded states; arrays (W, T, ...).
    #: (W, T, 3) number of steps since the previous recorded state, size of the last step [s], and number of rejected
    #: steps; None if the steps are fixed.
    work: np.ndarray | None
    counters: Mapping[str, np.ndarray]  #: (W,) counters of the runs, by the names of `Counters`.
    #: (W, 3) largest kinetic energy [J], largest change of the energy balance in a step [J], and its time [s].
    guards: np.ndarray
    turns: Sequence[list[list[float]]]  #: Sharp turns of each run; see `BranchSuspicion`.

    def evidence_of(self, run: int) -> StepEvidence:
        """Return the quantities observed over all steps of a run."""
        kinetic, jump, jump_time = self.guards[run].tolist()
        return StepEvidence(jump, jump_time, kinetic, tuple(BranchSuspicion(*turn) for turn in self.turns[run]))

    def of(self, runs: np.ndarray) -> LaneResults:
        """Return the results of some of the runs, given by their indices."""
        own: dict[str, Any] = {name: getattr(self, name)[runs] for name in _BY_RUN}
        return replace(
            self,
            **own,
            observed=Observed(*(values[runs] for values in self.observed)),
            work=None if self.work is None else self.work[runs],
            counters={name: values[runs] for name, values in self.counters.items()},
            turns=[self.turns[run] for run in runs.tolist()],
        )


_BY_RUN = ("lost", "time", "q", "v", "z", "energy", "worst", "iterations", "rows", "guards")


AtStart = MechanismAtStart | Workspace  #: A mechanism at its consistent initial state.


@dataclass(frozen=True, eq=False)
class VariedStarts:
    """Runs of mechanisms that differ in floating-point numbers only, at their starts.

    - `mechanism`: one of the mechanisms.
    - `numbers`: arrays (R, ...) of those fields of its topology that differ.
    - `lengths`: (R,) characteristic lengths [m].
    - `q`, `v`: (R, 3 (B + 1)) consistent positions and velocities.
    - `pivots`: pivots of each run, with equal keys; none if the method is explicit.
    - `mechanisms`: the mechanism of each run, if they exist.
    """

    mechanism: CompiledMechanism
    numbers: Mapping[str, np.ndarray]
    lengths: np.ndarray
    q: np.ndarray
    v: np.ndarray
    pivots: Sequence[StagePivots] = ()
    mechanisms: Sequence[CompiledMechanism] = ()

    @classmethod
    def of_starts(cls, starts: Sequence[AtStart], pivots: Sequence[StagePivots | None] = ()) -> VariedStarts:
        """Return runs of mechanisms for which `topology_of` is equal, with the pivots of each."""
        mechanisms = [start.mechanism for start in starts]
        numbers = {}
        for name, first in mechanisms[0].topology._asdict().items():
            arrays = [getattr(one.topology, name) for one in mechanisms]
            if any(array is not first and array.tobytes() != first.tobytes() for array in arrays):
                numbers[name] = np.stack(arrays)
        q, v = (np.stack([getattr(start, name) for start in starts]) for name in ("q0", "v0"))
        own = [one for one in pivots if one is not None]
        return cls(mechanisms[0], numbers, np.array([one.length for one in mechanisms]), q, v, own, mechanisms)

    def of(self, runs: Sequence[int]) -> VariedStarts:
        """Return some of the runs."""
        numbers = {name: values[runs] for name, values in self.numbers.items()}
        lengths, q, v = (x[runs] for x in (self.lengths, self.q, self.v))
        pivots = [self.pivots[run] for run in runs] if self.pivots else ()
        mechanisms = [self.mechanisms[run] for run in runs] if self.mechanisms else ()
        return VariedStarts(self.mechanism, numbers, lengths, q, v, pivots, mechanisms)

    def mechanism_of(self, run: int) -> CompiledMechanism:
        """Return the mechanism of a run."""
        if self.mechanisms:
            return self.mechanisms[run]
        own, length = {name: values[run] for name, values in self.numbers.items()}, float(self.lengths[run])
        is_same = not own and length == self.mechanism.length
        return self.mechanism if is_same else self.mechanism.with_numbers(own, length)


class LaneStepper:
    """Advances up to `WIDTH` runs with fixed steps and the same method.

    `topology_of` must be equal for the mechanisms of all runs.
    """

    tolerances_by_size: ClassVar[bool] = False  #: Whether tolerances depend on the lengths of the mechanisms.

    def __init__(self, method: Method, workspace: Workspace, rows: int, pivots: StagePivots | None = None):
        assert method.traits.lanes is not None
        self._in_lanes = method.traits.lanes()
        control = step_control(method.traits, workspace.mechanism)
        self.run = new_lane_run(self._in_lanes.bundle(method, workspace, pivots, control), workspace, rows)
        self._pinned = PinnedBundle(self.run)
        #: The mechanism whose numbers are in the lanes, and the names of those that are replaced for each run.
        self._loaded: tuple[CompiledMechanism, list[str]] | None = None
        #: The bundle, and views of its values by run; see `_collect`.
        self._views: tuple[LaneRun, dict[str, np.ndarray], dict[str, np.ndarray]] | None = None
        self._guards = [new_guard_state(workspace.mechanism) for _ in range(WIDTH)]
        self._pinned_guards = [PinnedBundle(guard) for guard in self._guards]
        self.run.watch.guards[:] = [pinned_guard.address for pinned_guard in self._pinned_guards]

    def advance(
        self, varied: VariedStarts, tables: Sequence[Timetable], guards: Sequence[Guards] | None = None
    ) -> LaneResults:
        """Return the results of runs, whose timetables have equal numbers of steps.

        `guards`: limits of the runs; by default, those of their timetables.
        """
        count, collected = len(varied.q), _Collected(len(varied.q))
        limits = _limits(varied.mechanism, [table.guards for table in tables] if guards is None else guards)
        for first in range(0, count, WIDTH):
            last = min(count, first + WIDTH)
            lanes = [*range(first, last), *[first] * (first + WIDTH - last)]  # idle lanes repeat the first run
            self._load(varied, lanes, limits)
            needs_own = self._guards[0].has_loops[0] or varied.mechanism.states or self.tolerances_by_size
            if varied.mechanisms or (needs_own and varied.numbers):
                mechanisms = [varied.mechanism_of(lane) for lane in lanes]
            else:
                mechanisms = [varied.mechanism] * WIDTH
            planned = [tables[lane] for lane in lanes]
            self._reset(mechanisms, planned)
            steps, rows, work = self._drive(
                mechanisms, planned, [varied.pivots[lane] for lane in lanes if varied.pivots]
            )
            self._collect(collected, slice(first, last), steps, rows, work)
        return collected.results()

    def _load(self, varied: VariedStarts, lanes: list[int], limits: tuple[np.ndarray, np.ndarray]) -> None:
        """Load starts, numbers and limits of runs into the lanes."""
        c, mechanism = self.run, varied.mechanism
        if self._loaded is None or self._loaded[0] is not mechanism or self._loaded[1] != [*varied.numbers]:
            fill_lanes(c.top, slice(None), mechanism.topology)
            self._loaded = mechanism, [*varied.numbers]
        for name, values in varied.numbers.items():
            own, chosen = getattr(c.top, name), values[lanes]
            own[...] = chosen if name in BY_LANE else chosen.transpose(*range(1, chosen.ndim), 0)
        c.q[...], c.v[...] = varied.q[lanes].T, varied.v[lanes].T
        c.squared_misalignment[...], c.energy_share[...] = (one[:, lanes] for one in limits)

    def _drive(
        self, mechanisms: list[CompiledMechanism], tables: list[Timetable], pivots: list[StagePivots]
    ) -> tuple[Mapping[str, np.ndarray], np.ndarray, np.ndarray | None]:
        """Take the steps of the runs that are loaded, and return their numbers of steps by the names of `Counters`,
        their numbers of recorded states, and lanes of `LaneResults.work`; lists have an item for each lane.
        """
        times = self.run.times
        for name in ("step", "last_step"):
            getattr(times, name)[0] = [getattr(table, name) for table in tables]
        times.steps[0] = tables[0].steps
        if pivots:
            load_stage_pivots(self.run.method, pivots)
        self._in_lanes.drive(self._pinned.address)
        made = np.full(WIDTH, tables[0].steps)
        return {"steps": made, "accepted": made}, np.full(WIDTH, len(self.run.row_time)), None

    def _reset(self, mechanisms: list[CompiledMechanism], tables: list[Timetable]) -> None:
        """Begin the runs of `WIDTH` mechanisms, whose numbers are in the lanes."""
        c = self.run
        for name in ("start", "end"):
            getattr(c.times, name)[0] = [getattr(table, name) for table in tables]
        c.every[0] = tables[0].every
        if len(c.z):
            c.z[...] = np.stack([one.initial_states for one in mechanisms], axis=-1)
        c.w.source[: len(c.q) - 3] = c.top.mass[:-1].reshape(-1, WIDTH)
        zeros = c.q_low, c.v_low, c.z_low, c.energy, c.energy_low, c.gain, c.worst, c.counts, c.interval, c.lost, c.near
        for array in (*zeros, *c.guards):
            array[...] = 0.0
        c.has_power[0] = int(any(one.has_power for one in mechanisms))
        c.watch.has_loops[0] = int(self._guards[0].has_loops[0])
        if c.watch.has_loops[0]:
            c.watch.mass[:] = [one.topology.mass for one in mechanisms]
            fresh = {id(mechanism): new_guard_state(mechanism) for mechanism in mechanisms}
            for guards, mechanism in zip(self._guards, mechanisms, strict=True):
                for array, values in zip(guards, fresh[id(mechanism)], strict=True):
                    array[...] = values

    def _collect(
        self, collected: _Collected, runs: slice, steps: Mapping[str, np.ndarray], rows: np.ndarray,
        work: np.ndarray | None,
    ) -> None:  # fmt: skip
        """Collect the results of the runs in the first lanes; see `_drive`."""
        c, count = self.run, runs.stop - runs.start
        if self._views is None or self._views[0] is not c:
            single = {"worst": c.worst, "lost": c.lost, "counts": c.counts}
            single |= {name: getattr(c.guards, name) for name in ("kinetic", "jump", "jump_time")}
            by_row = {
                "time": c.row_time, "q": c.row_q, "v": c.row_v, "z": c.row_z, "energy": c.row_energy,
                "iterations": c.row_interval, **c.observed._asdict(),
            }  # fmt: skip
            self._views = c, _views_by_run(single), _views_by_run(by_row)
        _, single, by_row = self._views
        single = {**single, **steps, "rows": rows}
        by_row = by_row if work is None else by_row | {"work": _by_run(work)}
        collected.add(runs, single, by_row, int(rows[:count].max()))
        collected.turns += [one.turns[: int(one.turn_count[0])].tolist() for one in self._guards[:count]]


class _Collected:
    """The results of R runs, which are added vector by vector.

    - `single`, `by_row`: arrays (R, ...) and (R, T, ...) by name. `turns`: see `LaneResults`.
    """

    def __init__(self, count: int):
        self.count, self.turns = count, list[list[list[float]]]()
        self.single: dict[str, np.ndarray] = {}
        self.by_row: dict[str, np.ndarray] = {}

    def add(self, runs: slice, single: Mapping[str, np.ndarray], by_row: Mapping[str, np.ndarray], rows: int) -> None:
        """Add the values (WIDTH, ...) and the first `rows` values (WIDTH, T, ...) of the runs in the first lanes."""
        count = runs.stop - runs.start
        if count == self.count:
            self.single = {name: own[:count].copy() for name, own in single.items()}
            self.by_row = {name: own[:count, :rows].copy() for name, own in by_row.items()}
            return
        for name, own in single.items():
            if name not in self.single:
                self.single[name] = np.empty((self.count, *own.shape[1:]), own.dtype)
            self.single[name][runs] = own[:count]
        for name, lanes in by_row.items():
            own, values = lanes[:count, :rows], self.by_row.get(name)
            if values is None:
                self.by_row[name] = values = np.empty((self.count, *own.shape[1:]), own.dtype)
            elif rows > values.shape[1]:
                more = np.repeat(values[:, -1:], rows - values.shape[1], axis=1)
                self.by_row[name] = values = np.hstack([values, more])
            values[runs, :rows], values[runs, rows:] = own, own[:, -1:]

    def results(self) -> LaneResults:
        """Return the results of all runs."""
        single, by_row = self.single, dict(self.by_row)
        counted = {name: single["counts"][:, place].astype(int) for name, place in _COUNTED.items()}
        names = [one.name for one in fields(Counters)]
        none = dict.fromkeys(names, np.zeros(self.count, int))
        observed = Observed(*(by_row.pop(name) for name in Observed._fields))
        return LaneResults(
            lost=single["lost"][:, 0] != 0.0,
            worst=single["worst"],
            rows=single["rows"],
            observed=observed,
            work=by_row.pop("work", None),
            counters={**none, **counted, **{name: single[name] for name in names if name in single}},
            guards=np.hstack([single[name] for name in ("kinetic", "jump", "jump_time")]),
            turns=self.turns,
            **by_row,
        )


def _limits(mechanism: CompiledMechanism, guards: Sequence[Guards]) -> tuple[np.ndarray, np.ndarray]:
    """Return the fields `squared_misalignment` and `energy_jump` of `guard_limits` of R runs, (P, R) and (1, R)."""
    limits = np.array([(one.misalignment, one.angle_misalignment, one.energy_jump) for one in guards]).T
    # pairs whose residuals are angles: only these have the limit of angles
    has_angles = guard_limits(mechanism, Guards(0.0, 1.0)).squared_misalignment[:, None] > 0.0
    with np.errstate(over="ignore"):  # an infinite limit is never exceeded
        squared = np.where(has_angles, limits[1] ** 2, limits[0] ** 2)
    return squared, np.where(mechanism.is_locked, np.inf, limits[2:])


_COUNTED = {
    "rhs_evaluations": RHS, "jacobian_evaluations": JACOBIANS, "factorizations": FACTORIZATIONS,
    "newton_iterations": ITERATIONS,
}  # fmt: skip


def _by_run(lanes: np.ndarray) -> np.ndarray:
    """Return a view of the values (..., WIDTH) of lanes as an array (WIDTH, ...)."""
    return np.moveaxis(lanes.view(np.ndarray), -1, 0)


def _views_by_run(lanes: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: _by_run(values) for name, values in lanes.items()}


class PivotsAtStart:
    """Chooses the pivots of runs; runs with the same mechanism and method share working arrays."""

    def __init__(self) -> None:
        self._latest: tuple[tuple[object, ...], StagePivoting] | None = None

    def of(self, method: Any, start: AtStart, table: Timetable) -> StagePivots | None:
        """Return the pivots of a run; None if its method needs none.

        Raises
        ------
        mbdkit.engine.elimination_order.SingularSystemError
            If the equations of the first step are singular, or need the pivoted solver.
        """
        if method.traits.is_explicit:
            return None
        shared = method, start.mechanism, table.start
        if self._latest is None or any(a is not b for a, b in zip(shared, self._latest[0], strict=True)):
            workspace = Workspace(start.mechanism, table.start, start.q0, start.v0)
            self._latest = shared, StagePivoting(method, workspace)
        pivoting, size = self._latest[1], table.step
        control = step_control(method.traits, start.mechanism)
        if control is not None:
            size = pivoting.first_step(start.q0, start.v0, size, table.end - table.start, control)
        assert size is not None
        try:
            return pivoting.pivots(start.q0, start.v0, size)
        except SingularSystemError:
            self._latest = None
            raise


FEW_ROWS = 64  #: Initial number of rows of the buffer of recorded states; it is doubled when it is full.


class ControlledLaneStepper(LaneStepper):
    """Advances up to `WIDTH` runs with controlled step size and the same method.

    `topology_of` must be equal for the mechanisms of all runs.
    """

    tolerances_by_size: ClassVar[bool] = True

    def __init__(self, method: Method, workspace: Workspace, pivots: StagePivots | None = None):
        super().__init__(method, workspace, FEW_ROWS, pivots)
        self.method = method
        self.runs = new_lane_control(self.run, self._control(workspace.mechanism))
        self._pinned = PinnedBundle(self.runs)

    def _drive(
        self, mechanisms: list[CompiledMechanism], tables: list[Timetable], pivots: list[StagePivots]
    ) -> tuple[Mapping[str, np.ndarray], np.ndarray, np.ndarray | None]:
        """See `LaneStepper`; the runs may take different numbers of steps."""
        # upper bounds of the numbers of rows at fixed intervals
        rows = [2 + math.ceil((one.end - one.start) / one.interval) for one in tables if one.interval is not None]
        while max(rows, default=0) > len(self.runs.row_work):
            self._grow()
        if pivots:
            load_stage_pivots(self.run.method, pivots)
        self._load_control(mechanisms, tables, [pivot.size for pivot in pivots])
        while self._in_lanes.drive_controlled(self._pinned.address) != ENDED:
            self._grow()
        accepted, rejected = (
            x[0].view(np.ndarray).astype(int) for x in (self.runs.progress.accepted, self.runs.progress.rejected)
        )
        return {"steps": accepted, "accepted": accepted, "rejected": rejected}, self.runs.rows, self.runs.row_work

    def _control(self, mechanism: CompiledMechanism) -> Control:
        control = step_control(self.method.traits, mechanism)
        assert control is not None
        return control

    def _load_control(
        self, mechanisms: list[CompiledMechanism], tables: list[Timetable], sizes: Sequence[float]
    ) -> None:
        """Initialize the step-size control of all runs; `sizes` are those of the first steps, if they are known [s]."""
        runs, c = self.runs, self.run
        controls = [self._control(mechanism) for mechanism in mechanisms]
        for lane, (control, table) in enumerate(zip(controls, tables, strict=True)):
            longest = min(control.max_step, table.longest_step(table.start))
            data = control_data(replace(control, max_step=longest), smallest_step(table))
            for name in ("rtol", "atol", "min_size", "max_size"):
                getattr(runs.control, name)[..., lane] = getattr(data, name)
        c.every[0] = 0 if tables[0].interval is not None else tables[0].every
        runs.interval[0], runs.max_steps[0] = tables[0].interval or 0.0, [table.max_steps for table in tables]
        runs.attempts[0] = runs.rows[:] = 0
        for array in (*runs.progress, runs.work):
            array[...] = 0.0
        runs.running[...] = 1.0
        runs.progress.next_row[...] = 1.0
        runs.progress.time[...] = c.times.start
        runs.progress.next_size[0] = sizes or self._first_sizes(controls, tables)

    def _first_sizes(self, controls: list[Control], tables: list[Timetable]) -> list[float]:
        """Return the sizes of the first steps of all runs [s]."""
        spans = [table.end - table.start for table in tables]
        sizes = [table.step for table in tables]
        if None in sizes:
            accelerate(self._pinned.address)
            y, rates = (
                np.ascontiguousarray(_by_run(np.concatenate([x[:-3] for x in pair])))
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
        names = ("row_time", "row_q", "row_v", "row_z", "row_energy", "row_interval")
        observed = type(c.observed)(*map(doubled, c.observed))
        self.run = c._replace(observed=observed, **{name: doubled(getattr(c, name)) for name in names})
        self.runs = self.runs._replace(run=self.run, row_work=doubled(self.runs.row_work))
        self._pinned.replace(self.runs)
