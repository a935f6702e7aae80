"""The record of a run: the writer of its rows, what evaluates them, and the integrals of its motion, as one object."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.archive.checkpoint import StoredState
from mbdkit.archive.finished_run import ArrayWriter
from mbdkit.archive.measured_values import Integrals
from mbdkit.archive.result_table import ResultTable
from mbdkit.archive.run_writer import Origin, RunWriter
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base.frozen import dataclass, field, replace
from mbdkit.engine.consistent_start import Starts
from mbdkit.integrators.interface import ConsecutiveSteps, Failure, Nodes, StepEvidence, Stretch, Timetable
from mbdkit.integrators.run.impulse import DriverImpulse, ReactingMemory
from mbdkit.integrators.run.sampled_control import Sampler, states_at_start
from mbdkit.mechanism.motion_pieces import share_of_integrals
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.registered_kinds import peaks_of
from mbdkit.runs.corners import stops_of
from mbdkit.runs.findings import StateWatchers
from mbdkit.runs.integrals import RunIntegrals, compared_loads, expressions_of, functionals_of, largest_loads_of
from mbdkit.runs.law_ranges import LawRanges, steps_are_rows
from mbdkit.runs.preparation import RunSetup, recorded_arrays
from mbdkit.runs.provenance import provenance
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.runs.recorder import Recorder, shared_forces
from mbdkit.spec import RunSpec
from mbdkit.trust.finding import Finding

if TYPE_CHECKING:
    from mbdkit.events.watch import Found

#: Function that returns the values of expressions of measures in another run; None if that run fails.
MeasuredIn = Callable[[Sequence[str], RunSpec], Sequence[float] | None]


#: Largest tolerance by which steps resolve functions of time if measures may contain forces that the method determines.
#:
#: The error of the motion does not show them at rest, and they are splines of order 6 through the ends of steps. The
#: integrals and extrema of such a spline through a sine are then right within 2e-4.
OF_FORCES = 1e-7

#: Times of a run that a checkpoint contains [s].
TIMES = ("setup_s", "wall_s", "cpu_s", "integrals_s")


@dataclass(frozen=True)
class Continuation:
    """A checkpoint to continue from.

    `state`: the state of the run. `rows`: function that returns states and reactions of the rows before the checkpoint,
    needed to estimate the errors of the run. `restored`: function that is called when the state has been restored.
    """

    state: StoredState
    rows: Callable[[], list[ObservedRows]]
    restored: Callable[[], None]

    @property
    def times(self) -> dict[str, float]:
        """The times in `TIMES` of the run up to the checkpoint [s]; 0 for entries that are missing or not numbers."""
        stored = self.state.get("times")
        known = stored if isinstance(stored, Mapping) else {}
        return {name: seconds if isinstance(seconds, float) else 0.0 for name in TIMES for seconds in [known.get(name)]}


@dataclass(frozen=True, eq=False, kw_only=True)
class Request:
    """What is asked of a simulation besides its spec.

    - `begin`: function that returns the writer of a run, which has no rows, or those before a checkpoint.
    - `since`: time at which the run was requested [s].
    - `measured_in`: function that evaluates expressions of measures in a comparison run.
    - `path`, `starts`, `measures`, `tables`: see `mbdkit.runs.simulation.simulate`.
    - `continuation`: the state to continue from, if any.
    - `is_open`: whether a program decides when the run ends, so that its number of rows is not known.
    - `becomes_run`: whether the caller gets a `Run`, which Ctrl-C ends early and which shows the rows until then;
      otherwise, only the arrays in its writer are used.
    """

    begin: Callable[[RunSetup], RunWriter]
    since: float
    measured_in: MeasuredIn
    path: Path | None = None
    starts: Starts | None = None
    measures: Sequence[str] = ()
    tables: Mapping[str, ResultTable] = field(default_factory=dict)
    continuation: Continuation | None = None
    is_open: bool = False
    becomes_run: bool = True


def begin_archive(
    setup: RunSetup,
    *,
    path: Path | None,
    overwrite: bool,
    part: Path | None = None,
    origin: Mapping[str, str | int | float] | None = None,
) -> ArchiveWriter:
    """Return the writer of the archive of a run; by default, its provenance `origin` is that of this process."""
    spec, mechanism = setup.spec, setup.workspace.mechanism
    return ArchiveWriter(
        path,
        archive_names(mechanism),
        Origin.of(spec, origin or {**provenance(spec), "assembly": setup.start.describe()}),
        arrays=recorded_arrays(spec, setup.method, mechanism),
        overwrite=overwrite,
        part=part,
        shared=shared_forces(mechanism),
    )


def begin_arrays(setup: RunSetup) -> RunWriter:
    """Return a writer that stores the rows of a run in memory."""
    mechanism = setup.workspace.mechanism
    return ArrayWriter(
        archive_names(mechanism),
        recorded_arrays(setup.spec, setup.method, mechanism),
        shared=shared_forces(mechanism),
        assembly=setup.start.describe(),
    )


class Taken(NamedTuple):
    """What some steps have given: rows, nodes of integrals, the steps themselves, and crossings of events.

    The first of the nodes of each step, and every further one after `nodes_apart`, are states of the motion.
    """

    stretch: Stretch
    nodes: Nodes | None = None
    steps: Sequence[ConsecutiveSteps] | None = None
    found: Sequence[Found] = ()
    nodes_apart: int = 1


class RunRecord:
    """What a run records.

    - `setup`, `request`: the run, and what is asked of it.
    - `writer`: receives the rows and writes them to an open archive, or to arrays in memory.
    - `recorder`: evaluates and checks the rows.
    - `integrals`: integrals over time, extrema and values at given times that measures need; None if there are none.
    - `table`: times of the run, which depend on what is recorded.
    - `integrals_s`: wall time that the integrals have taken [s].

    `findings` are those about the spec and the start.
    """

    def __init__(self, setup: RunSetup, request: Request, findings: Iterable[Finding] = ()):
        self.setup, self.request, self._findings = setup, request, tuple(findings)
        peaks = peaks_of(archive_names(setup.workspace.mechanism))
        self._functionals = functionals_of(setup.spec, (*request.measures, *largest_loads_of(setup.spec, peaks)))
        self.integrals_s = 0.0
        self.writer = request.begin(setup)
        try:
            self._begin()
            self.table = self._table()
        except BaseException:
            self.writer.abandon()
            raise

    def _begin(self) -> None:
        setup, spec, workspace = self.setup, self.setup.spec, self.setup.workspace
        between = None if steps_are_rows(spec) else workspace
        ranges = LawRanges.of(spec.mechanism(), workspace.mechanism, between, stops=spec.limits.law_range == "stop")
        watchers = StateWatchers(spec, workspace.mechanism, setup.size)
        table = setup.timetable()
        self.recorder = Recorder(workspace, self.writer, table, ranges, watchers, finer=spec.finer)
        if spec.estimates_errors:
            self.recorder.kept = []
        self.integrals: RunIntegrals | None = None
        if self._functionals:
            self.integrals = RunIntegrals(
                workspace, self._functionals, table,
                suits_stiff=setup.method.traits.suits_stiff, is_controlled=spec.claims.adaptive,
            )  # fmt: skip

    def _table(self) -> Timetable:
        if self.integrals is None:
            return replace(self.recorder.table, nodes=self.needs_nodes)
        traits, share = self.setup.method.traits, None
        if traits.tolerances is not None:
            rtol = traits.tolerances.rtol
            if self.setup.spec.reacting is not None:
                share = share_of_integrals(min(rtol, OF_FORCES), 6.0)
            elif self.integrals.needs_nodes:
                # methods with steps in Python use a quadrature of order 8 on dense output of order 5 or more
                share = share_of_integrals(rtol, 6.0 if traits.local_error is None else traits.local_error.order)
        return self.setup.timetable(
            nodes=self.needs_nodes, ends=self.integrals.continuous is not None, share=share,
            integrands=[functional.program for functional in self._functionals],
        )  # fmt: skip

    def use_spec(self, spec: RunSpec) -> None:
        """Record the run as one of another spec, which repeats it; comparison runs then have its inputs."""
        self.setup.workspace.schedules = spec.schedules()
        if spec is not self.setup.spec:
            self.setup = replace(self.setup, spec=spec)
            self.writer.use_spec(spec)

    @property
    def needs_nodes(self) -> bool:
        """Whether states within the steps are needed, in addition to those at their ends."""
        ranges = self.recorder.ranges
        integrals = self.integrals is not None and self.integrals.needs_nodes
        return integrals or (ranges is not None and ranges.needs_nodes)

    @property
    def kept(self) -> ObservedRows | None:
        """The recorded rows, from which errors are estimated; None if there are none, or none are asked for."""
        return ObservedRows.joined(self.recorder.kept) if self.recorder.kept else None

    def add_start(self) -> Failure | None:
        """Record the initial state; return why this is not possible."""
        workspace, none = self.setup.workspace, np.zeros(1)
        first = Stretch(
            np.array([workspace.t0]), workspace.q0[None], workspace.v0[None], none, none, np.zeros((1, 6)),
            z=states_at_start(workspace)[None],
        )  # fmt: skip
        return self.recorder.record(first, (0.0, 0.0), start=True) or Sampler(workspace).failure

    def add(self, taken: Taken, elapsed: tuple[float, float]) -> Failure | None:
        """Pass the states of steps, at their ends and within them, to integrals and range checks, and record the rows.

        `elapsed`: wall time since the first step at the start and at the end of these steps [s]. Returns why a state
        cannot be recorded.
        """
        if self.integrals is not None:
            begin = time.perf_counter()
            self._integrate(self.integrals, taken)
            self.integrals_s += time.perf_counter() - begin
        if taken.nodes is not None and self.recorder.ranges is not None:
            self.recorder.ranges.add_between(taken.nodes.part(slice(None, None, taken.nodes_apart)))
        failure = self.recorder.record(taken.stretch, elapsed)
        self.recorder.record_events(taken.found)
        return failure

    def _integrate(self, integrals: RunIntegrals, taken: Taken) -> None:
        stretch = taken.stretch
        if integrals.continuous is not None and taken.steps is not None:
            integrals.continuous.add_steps(taken.steps)
        elif integrals.continuous is not None:
            z = np.zeros((len(stretch.time), 0)) if stretch.z is None else stretch.z
            integrals.continuous.add_ends(stretch.time, stretch.q, stretch.v, z)
        if taken.nodes is not None and integrals.needs_nodes:
            integrals.add(taken.nodes)

    def add_impacts(self, memory: ReactingMemory | None, steps: StepEvidence) -> None:
        """Record the impacts of elements and the impulses of drivers in a run that has ended."""
        of_drivers = [impact for impact in steps.impacts if isinstance(impact, DriverImpulse)]
        drivers = stops_of(self.setup.spec).impacts if of_drivers else {}
        self.recorder.record_impacts(() if memory is None else memory.impacts, of_drivers, drivers)

    def totals(self, deadline: float) -> Integrals:
        """Return integrals and extrema so far; `deadline`: see `RunIntegrals.totals`."""
        return {} if self.integrals is None else self.integrals.totals(self.recorder.of_event, deadline)

    def findings(self, totals: Integrals) -> tuple[Finding, ...]:
        """Return what was found about the spec, the start and the recorded states."""
        return (*self._findings, *self.recorder.findings(totals))

    def compared_expressions(self, deadline: float) -> tuple[str, ...]:
        """Return expressions of measures and of largest loads that are compared with those of other runs, if any."""
        spec, peaks = self.setup.spec, peaks_of(archive_names(self.setup.workspace.mechanism))
        if not spec.check:
            return ()
        loads = compared_loads(spec, self.totals(deadline), peaks) if self.integrals is not None and peaks else ()
        return tuple(dict.fromkeys((*expressions_of(spec, self.request.measures), *loads)))

    def stored(self) -> StoredState:
        """Return the state on which later rows depend, as plain values for a checkpoint."""
        integrals = None if self.integrals is None else self.integrals.stored()
        return {"recorder": self.recorder.stored(), "integrals": integrals}

    def restore(self, state: StoredState) -> None:
        """Continue after the rows of a checkpoint; raise ValueError if its values are not valid for this run."""
        self.recorder.restore(state["recorder"])
        if self.integrals is not None:
            self.integrals.restore(state["integrals"])
