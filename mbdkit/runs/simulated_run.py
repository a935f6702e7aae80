"""A run in progress: its stretches of steps, the recording, and the end of the run."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.checkpoint import StoredState
from mbdkit.archive.finished_run import ArrayWriter, FinishedRun
from mbdkit.archive.result_table import ResultTable
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import RunWriter
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base import higher_layers
from mbdkit.base.called_functions import returning
from mbdkit.base.text import listed, shown
from mbdkit.engine.assembly import AssembledState
from mbdkit.engine.consistent_start import Starts
from mbdkit.engine.counters import Counters
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.interface import Advancing, ConsecutiveSteps, Failure, Nodes, Stretch
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.integrators.run.impulse import DriverImpulse, ReactingMemory, reacting_memory
from mbdkit.integrators.run.sampled_control import Sampler, states_at_start
from mbdkit.integrators.start import start_method
from mbdkit.measures.reductions import Functional
from mbdkit.mechanism.motion_pieces import share_of_integrals
from mbdkit.methods.kinds import Method
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.registered_kinds import peaks_of
from mbdkit.runs.accuracy.check_run import check_by_pilots, check_run, missed_because, with_asked
from mbdkit.runs.accuracy.chosen_method import Choice
from mbdkit.runs.accuracy.companion import Budget
from mbdkit.runs.accuracy.compared_measures import compared_measures
from mbdkit.runs.accuracy.parameter_errors import with_parameter_errors
from mbdkit.runs.accuracy.pilot_run import Replay
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.runs.conclusion import NO_STEPS, EndedRun, conclude, estimated_errors, log_end
from mbdkit.runs.corners import stops_of
from mbdkit.runs.finish import finish
from mbdkit.runs.integrals import RunIntegrals, compared_loads, expressions_of
from mbdkit.runs.law_ranges import LawRanges, steps_are_rows
from mbdkit.runs.preparation import guards, plugin_failure, size_at_start, timetable
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.runs.recorder import Recorder
from mbdkit.runs.run_checkpoint import TIMES, Checkpoints, Continuation, Parts, why_without
from mbdkit.runs.run_criteria import step_advice
from mbdkit.runs.run_seams import Progress
from mbdkit.runs.state_watchers import StateWatchers
from mbdkit.spec import RunSpec
from mbdkit.trust.finding import Doubts, Finding

if TYPE_CHECKING:
    from mbdkit.events.watch import Found, Watch

#: Failures that smaller steps cannot avoid.
_FINAL = ("wall-time", "max-steps", "plugin-error", "controller-error")


class _Reporter:
    """Calls the `progress` of a user. If it raises an exception, the run is stopped by `stop`, as by Ctrl-C, and
    `progress` is not called again; `error` is then the exception, unless it was KeyboardInterrupt.
    """

    def __init__(self, progress: Progress, stop: Callable[[], None]):
        self.progress, self.stop = progress, stop
        self.stopped = False
        self.error: Exception | None = None

    def __call__(self, reached: float, end: float) -> None:
        if self.stopped:
            return
        try:
            self.progress(reached, end)
        except KeyboardInterrupt:
            self.stopped = True
        except Exception as error:
            self.stopped, self.error = True, error
        if self.stopped:
            self.stop()


@dataclass(frozen=True, eq=False, kw_only=True)
class Request:
    """What is asked of a simulation besides its spec.

    - `begun`: function that returns the writer of a run, given its spec, its method and its start.
    - `begin`: time at which the run was requested [s].
    - `measured_in`: function that evaluates expressions of measures in a comparison run.
    - `path`, `starts`, `measures`, `tables`: see `mbdkit.runs.simulation.simulate`.
    - `continuation`: the state to continue from, if any.
    - `is_open`: whether a program decides when the run ends, so that its number of rows is not known.
    - `becomes_run`: whether the caller gets a `Run`, which Ctrl-C ends early and which shows the rows until then;
      otherwise, only the arrays in its writer are used.
    """

    begun: Callable[[RunSpec, Method, tuple[Workspace, AssembledState]], RunWriter]
    begin: float
    measured_in: Callable[[Sequence[str], RunSpec], Sequence[float] | None]
    path: Path | None = None
    starts: Starts | None = None
    measures: Sequence[str] = ()
    tables: Mapping[str, ResultTable] = field(default_factory=dict)
    continuation: Continuation | None = None
    is_open: bool = False
    becomes_run: bool = True


class Taken(NamedTuple):
    """What some steps have given: rows, nodes of integrals, the steps themselves, and crossings of events."""

    stretch: Stretch
    nodes: Nodes | None = None
    steps: Sequence[ConsecutiveSteps] = ()
    found: Sequence[Found] = ()


class SimulatedRun:
    """A run in progress: the method, the mechanism, and the recorder that writes the archive.

    - `spec`: the validated spec of the run.
    - `workspace`, `start`: the mechanism at its start, and the changes made by assembly.
    - `method`: the method of integration.
    - `writer`: receives the rows and writes them to an open archive, or to arrays in memory.
    - `request`: what is asked of the run.
    - `findings`: findings so far.
    - `choice`: the method and step chosen for the requested accuracy, if any.
    - `functionals`: integrals over time, extrema and values at given times that measures need.
    """

    def __init__(
        self,
        spec: RunSpec,
        workspace: Workspace,
        start: AssembledState,
        method: Method,
        writer: RunWriter,
        request: Request,
        findings: tuple[Finding, ...],
        choice: Choice | None,
        functionals: Sequence[Functional],
    ):
        self.spec, self.workspace, self.start_state, self.method = spec, workspace, start, method
        self.request, self.findings, self.choice, self.interrupted = request, findings, choice, False
        self.tried = [] if choice is None else [choice]
        self.timings: dict[str, float] = {}
        self.size = size_at_start(spec, workspace)
        self.guards = guards(spec, self.size)
        self._functionals = functionals
        self.failure: Failure | None = None
        self.begin_record(writer)
        if self.integrals is not None:
            tolerances, estimate, share = method.traits.tolerances, method.traits.local_error, None
            if tolerances is not None and self.integrals.needs_nodes:
                # methods with steps in Python use a quadrature of order 8 on dense output of order 5 or more
                share = share_of_integrals(tolerances.rtol, 6.0 if estimate is None else estimate.order)
            self.table = timetable(
                spec, self.guards, nodes=self.keeps_nodes, ends=self.integrals.continuous is not None, share=share,
                integrands=[functional.program for functional in functionals],
            )  # fmt: skip
        elif self.keeps_nodes:
            self.table = replace(self.table, nodes=True)
        #: When the wall time of the run is over (`time.perf_counter`).
        self.deadline = math.inf
        self.stepper: Advancing | None = None
        self.watch: Watch | None = None
        self.cause: BaseException | None = None
        self.accuracy: Accuracy | None = None
        #: Gradients of the measures as JSON; empty if there are none.
        self.gradients = ""
        #: Why the run was interrupted, if not by `interrupt`; see ``status_reason`` of archives.
        self.interrupted_because = ""

    def begin_record(self, writer: RunWriter) -> None:
        """Begin to record the run with a writer that has no rows."""
        spec, workspace = self.spec, self.workspace
        between = None if steps_are_rows(spec) else workspace
        stops = spec.limits.law_range == "stop"
        ranges = LawRanges.of(spec.mechanism(), workspace.mechanism, between, stops=stops)
        watchers = StateWatchers(spec, workspace.mechanism, self.size)
        self.writer = writer
        self.table = timetable(spec, self.guards)
        self.recorder = Recorder(workspace, writer, self.table, ranges, watchers, finer=spec.finer)
        if spec.estimates_errors:
            self.recorder.kept = []
        self.integrals: RunIntegrals | None = None
        if self._functionals:
            suits_stiff = self.method.traits.suits_stiff
            self.integrals = RunIntegrals(workspace, self._functionals, self.table, suits_stiff=suits_stiff)

    def begin_record_again(self) -> None:
        """Discard what was recorded, and begin the record anew."""
        table = self.table
        self.writer.abandon()
        self.begin_record(self.request.begun(self.spec, self.method, (self.workspace, self.start_state)))
        self.table = table

    def use_spec(self, spec: RunSpec) -> None:
        """Record the run as one of another spec, which repeats it; comparison runs then have its inputs."""
        self.workspace.schedules = spec.schedules()
        if spec is not self.spec:
            self.spec = spec
            self.writer.use_spec(spec)

    def integrate(self, progress: Progress | None) -> None:
        """Record the initial state, integrate to the end, and check the accuracy; raise what `progress` raises."""
        reporter = None if progress is None else _Reporter(progress, self.interrupt)
        if self.request.continuation is None:
            self.record_start()
        with self.blaming_the_plugin():
            if self.failure is None:
                self.start()
        before = (
            dict.fromkeys(TIMES, 0.0) if self.request.continuation is None else self.take_up(self.request.continuation)
        )
        setup = before["setup_s"] + time.perf_counter() - self.request.begin
        wall, cpu = time.perf_counter() - before["wall_s"], time.process_time() - before["cpu_s"]
        self.timings = {"setup_s": setup}
        if self.integrals is not None:
            self.timings["integrals_s"] = before["integrals_s"]
        if self.stepper is not None:
            self.advance(self.stepper, reporter, wall, self.checkpoints(wall, cpu))
        self.timings |= {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        if isinstance(self.stepper, Replay):  # the steps have been computed by the pilot, before this run
            self.timings["wall_s"] += self.stepper.wall
            self.timings["cpu_s"] += self.stepper.cpu
        begin = time.perf_counter()
        if (python := self.workspace.python) is not None:
            python.stop_calling()
            self.cause = self.cause or python.cause
        self.check_accuracy(reporter)
        if self.accuracy is not None:
            self.timings["check_s"] = time.perf_counter() - begin
        if reporter is not None and reporter.error is not None:
            raise reporter.error

    def interrupt(self) -> None:
        """Stop the run after the current stretch."""
        self.interrupted = True

    @property
    def is_final(self) -> bool:
        """Whether smaller steps are useless: the accuracy is reached, or the user or a limit has ended the run."""
        if self.interrupted or (self.failure is not None and self.failure.code in _FINAL):
            return True
        return self.failure is None and self.accuracy is not None and self.accuracy.is_reached

    @property
    def reached(self) -> float:
        """Estimated error of positions as a share of the mechanism's size; nan if it is not known to the end."""
        return self.accuracy.reached if self.accuracy is not None and self.accuracy.is_complete else math.nan

    def merit(self) -> tuple[float, float]:
        """Return a key, larger for better attempts: the time until which errors are known, and the negative error."""
        if self.accuracy is None or math.isnan(self.accuracy.known_until):
            return -math.inf, -math.inf
        return self.accuracy.known_until, -self.accuracy.reached

    def record_start(self) -> None:
        """Record the initial state."""
        workspace, none = self.workspace, np.zeros(1)
        first = Stretch(
            np.array([workspace.t0]), workspace.q0[None], workspace.v0[None], none, none, np.zeros((1, 6)),
            z=states_at_start(workspace)[None],
        )  # fmt: skip
        self.failure = self.recorder.record(first, (0.0, 0.0), start=True) or Sampler(workspace).failure

    def start(self) -> None:
        """Create the stepper of the method, or note why this fails in `failure`."""
        self.stepper = self.watch = None
        final = self.choice.final if self.choice is not None else None
        if final is not None and final.is_run and not (self.table.nodes or self.table.single):
            self.stepper = Replay(final)
            return
        try:
            stepper = start_method(self.method, self.workspace, self.table)
        except SingularSystemError as error:
            name = self.workspace.mechanism.unknown_name(error.index)
            self.failure = Failure("singular", f"the stage equations are singular at the start, near {name}.")
            return
        if self.table.single:
            from mbdkit.runs.watched_events import watch_events

            self.watch = watch_events(self.spec, self.workspace, stepper)
        self.stepper = self.watch or stepper

    @property
    def keeps_nodes(self) -> bool:
        """Whether states within the steps are needed, in addition to those at their ends."""
        ranges = self.recorder.ranges
        integrals = self.integrals is not None and self.integrals.needs_nodes
        return integrals or (ranges is not None and ranges.needs_nodes)

    def next_stretch(self, stepper: Advancing) -> Stretch | None:
        """Advance, and return the rows; if the method fails, those before the failure, or None if there are none."""
        stretch: Stretch | None = None
        with self.blaming_the_plugin():
            stretch = stepper.advance()
        return stretch if self.failure is None else stepper.rows_before_error()

    def taken(self, stepper: Advancing, stretch: Stretch) -> Taken:
        """Return what the latest steps have given."""
        nodes = stepper.taken_nodes() if self.keeps_nodes else None
        if self.watch is None:
            return Taken(stretch, nodes)
        return Taken(stretch, nodes, self.watch.taken_steps(), self.watch.taken())

    def record(self, taken: Taken, elapsed: tuple[float, float]) -> None:
        """Pass the states of steps, at their ends and within them, to integrals and range checks, and record the rows.

        `elapsed`: wall time since the first step at the start and at the end of these steps [s].
        """
        self._pass_on(taken)
        self.failure = self.recorder.record(taken.stretch, elapsed) or self.failure
        if self.watch is not None:
            self.recorder.record_events(taken.found)

    def _pass_on(self, taken: Taken) -> None:
        stretch, nodes, steps = taken.stretch, taken.nodes, taken.steps
        if self.integrals is not None:
            begin = time.perf_counter()
            if self.integrals.continuous is not None and self.watch is not None:
                self.integrals.continuous.add_steps(steps)
            elif self.integrals.continuous is not None:
                z = np.zeros((len(stretch.time), 0)) if stretch.z is None else stretch.z
                self.integrals.continuous.add_ends(stretch.time, stretch.q, stretch.v, z)
            if nodes is not None and self.integrals.needs_nodes:
                self.integrals.add(nodes)
            self.timings["integrals_s"] += time.perf_counter() - begin
        if nodes is not None and self.recorder.ranges is not None:
            compiled = self.inner_stepper
            # For explicit methods, only the first stage, at the start of the step, is a state of the motion.
            stages = compiled.method.stages if isinstance(compiled, CompiledStepper) else 1
            every = stages if self.method.traits.is_explicit else 1
            self.recorder.ranges.add_between(nodes.part(slice(None, None, every)))

    @contextmanager
    def blaming_the_plugin(self) -> Iterator[None]:
        """Convert any exception of a third-party integrator, including errors of mbdkit, into a failure of the run.

        Exceptions of other integrators are passed on.
        """
        try:
            yield
        except BaseException as error:
            self.failure = plugin_failure(self.spec, error)
            self.cause = error

    def take_up(self, continuation: Continuation) -> Mapping[str, float]:
        """Restore the state of a checkpoint, and return the times that the run took before the checkpoint [s]."""
        parts = self.parts()
        assert parts is not None
        parts.restore(continuation.state)
        if self.recorder.kept is not None:
            self.recorder.kept = continuation.rows()
        continuation.restored()
        return continuation.times

    @property
    def inner_stepper(self) -> Advancing | None:
        """The stepper of the method, without the event detection that may wrap it."""
        return self.stepper if self.watch is None else self.watch.stepper

    @property
    def memory(self) -> ReactingMemory | None:
        """Memory of the reactions of elements, with their impacts so far; None if there are none."""
        return reacting_memory(self.inner_stepper)

    def parts(self) -> Parts | None:
        """Return the parts of the run that a checkpoint stores; None if some of them cannot be stored."""
        stepper = self.inner_stepper
        if why_without(self.spec, self.method) or not isinstance(stepper, CompiledStepper | StepHost):
            return None
        return Parts(self.workspace, stepper, self.watch, self.recorder, self.integrals)

    def checkpoints(self, wall: float, cpu: float) -> Checkpoints | None:
        """Return the object that writes the checkpoints of the run; None if the run has no checkpoints.

        The arguments are the wall time and the processor time at which its steps began [s].
        """
        writer = self.writer
        if not (isinstance(writer, ArchiveWriter) and writer.keeps_checkpoints):
            return None
        parts = self.parts()
        if parts is None:
            return None

        def state() -> StoredState:
            spent = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
            return {**parts.stored(), "times": {**self.timings, **spent}}

        return Checkpoints(writer, state)

    def advance(
        self, stepper: Advancing, progress: Progress | None, begin: float, checkpoints: Checkpoints | None
    ) -> None:
        """Step until the end, a limit, a failure or an interrupt, and record the states."""
        limit, end = self.spec.limits.wall_time, self.spec.time.final
        self.deadline = math.inf if limit is None else begin + limit
        elapsed = time.perf_counter() - begin if self.request.continuation is not None else 0.0
        recorded = self.recorder.last_time
        while not (stepper.finished or stepper.failure or self.failure or self.interrupted):
            since, done = time.perf_counter(), stepper.counters.steps
            stretch = self.next_stretch(stepper)
            if stretch is None:
                break
            now = time.perf_counter() - begin
            self.record(self.taken(stepper, stretch), (elapsed, now))
            self._record_inputs()
            if len(stretch.time):
                recorded = float(stretch.time[-1])
            elapsed = now
            if progress is not None:
                progress(stepper.time, end)
            if checkpoints is not None and not (stepper.finished or stepper.failure or self.failure):
                checkpoints.write_if_due()
            if limit is not None and isinstance(inner := self.inner_stepper, CompiledStepper):
                inner.pace.timed(inner.counters.steps - done, since)  # with the time of integrals and extrema
                now = time.perf_counter() - begin
            if limit is not None and now > limit and not (stepper.finished or stepper.failure or self.failure):
                self.failure = Failure(
                    "wall-time", f"stopped at t = {stepper.time:.6g} s after limits.wall_time = {limit:g} s."
                )
        if self.interrupted and checkpoints is not None and not (stepper.finished or stepper.failure or self.failure):
            checkpoints.write()
        unrecordable = self.failure is not None and self.failure.code not in ("wall-time", "plugin-error")
        self.failure = self.failure or stepper.failure
        if recorded < stepper.time and not stepper.finished and not unrecordable:
            self.recorder.record(stepper.last_state(), (elapsed, elapsed))
        self._record_inputs(at_end=True)

    def _record_inputs(self, *, at_end: bool = False) -> None:
        """Record the settings of inputs since the last call and, at the end, the last values of those that change, and
        the outputs of controllers in Python.
        """
        inner = self.inner_stepper
        if isinstance(inner, CompiledStepper | StepHost) and inner.sampler.is_needed:
            stopped = None if self.watch is None else self.watch.stopped
            until = math.inf if stopped is None else max(stopped.time, math.nextafter(self.workspace.t0, math.inf))
            settings = [setting for setting in inner.sampler.taken() if setting.time < until]  # it ends before a jump
            self.recorder.record_inputs([*settings, *(inner.sampler.ends(inner.time) if at_end else ())])
            if self.workspace.python is not None:
                self.recorder.record_samples(inner.sampler.taken_samples())

    def check_accuracy(self, progress: Progress | None) -> None:
        """Estimate the errors of the recorded rows if the spec asks for it."""
        kept, python = self.recorder.kept, self.workspace.python
        if kept:
            with returning(None if python is None else python.returned):
                self._check_accuracy(kept, progress)

    def _check_accuracy(self, kept: Sequence[ObservedRows], progress: Progress | None) -> None:
        budget = Budget(self.spec.limits.wall_time, lambda: self.interrupted)
        rows, steps = ObservedRows.joined(kept), self.stepper.counters.steps if self.stepper is not None else 0
        choice = self.choice
        if choice is not None and choice.pilots and len(rows.time) > 1 and not self.spec.check:
            estimated = check_by_pilots(self.spec, self.workspace, rows, choice.pilots, choice.setting)
        else:
            estimated = check_run(self.spec, self.method, self.workspace, rows, steps, budget, progress, self.memory)
        self.accuracy = with_asked(estimated, self.spec, self.workspace, self.choice)
        expressions = (
            tuple(dict.fromkeys((*expressions_of(self.spec, self.request.measures), *self.compared_loads())))
            if self.spec.check
            else ()
        )
        if expressions and self.failure is None:
            compared = compared_measures(
                self.spec, self.method, self.workspace, steps, expressions,
                partial(self.request.measured_in, expressions), budget,
            )  # fmt: skip
            self.accuracy = replace(self.accuracy, compared_measures=compared)
        if self.spec.check:
            expressions = () if self.failure else expressions
            self.accuracy = with_parameter_errors(
                self.accuracy, self.spec, self.method, steps, expressions,
                partial(self.request.measured_in, expressions), budget, progress,
            )  # fmt: skip

    def compared_loads(self) -> tuple[str, ...]:
        """Return expressions of the largest loads that are compared with those of other runs."""
        peaks = peaks_of(archive_names(self.workspace.mechanism))
        if self.integrals is None or not peaks:
            return ()
        return compared_loads(self.spec, self.integrals.totals(self.recorder.of_event, self.deadline), peaks)

    def doubtful_gradients(self) -> Iterator[str]:
        """Yield a sentence about the measures whose gradients fail their checks, if any."""
        gradients = json.loads(self.gradients or "{}")
        failed = [name for name, entry in gradients.items() if not entry.get("check", {"agrees": True})["agrees"]]
        if failed:
            yield f"The check of the gradients failed for {listed(failed, 'and')}; `doubts` of the gradients says why."

    def conclude(self) -> Run | FinishedRun:
        """Conclude the run: its archive or its arrays are finished, with status and verdict."""
        stepper, memory, mechanism = self.stepper, self.memory, self.workspace.mechanism
        status, reason = self._status()
        steps = NO_STEPS if stepper is None else stepper.evidence
        of_drivers = [impact for impact in steps.impacts if isinstance(impact, DriverImpulse)]
        drivers = stops_of(self.spec).impacts if of_drivers else {}
        self.recorder.record_impacts(() if memory is None else memory.impacts, of_drivers, drivers)
        totals = {} if self.integrals is None else self.integrals.totals(self.recorder.of_event, self.deadline)
        findings = (*self.findings, *self.recorder.findings(totals))
        if self.request.becomes_run and self.spec.gradients and status == "complete":
            self.gradients = higher_layers.gradients_json(self.spec)
        doubts = Doubts.of(findings, self.spec.accept)
        notes = () if memory is None else memory.remarks()  # on the treatment of elements, which question no result
        errors = None
        if self.accuracy is not None:
            missed = missed_because(self.accuracy, self.tried, self.failure)
            position = PositionMeasure.of(self.spec, self.workspace).known(self.accuracy)
            rows = ObservedRows.joined(self.recorder.kept or [])
            errors = estimated_errors(self.spec, mechanism, rows, self.accuracy, position, missed, totals)
        ended = EndedRun(
            mechanism=mechanism,
            size=self.size,
            doubts=doubts._replace(open=(*doubts.open, *self.doubtful_gradients())),
            warnings=(*map(str, findings), *notes),
            status=status,
            reason=reason,
            counters=Counters() if stepper is None else stepper.counters,
            pivotings=self.workspace.pivotings + self.recorder.workspace.pivotings,
            timings=self.timings,
            errors=errors,
            finer=self.spec.finer,
        )
        worst = np.zeros(len(mechanism.topology.pairs)) if stepper is None else stepper.worst_pairs
        (ending,) = conclude([ended], self.recorder.extremes(worst, steps))
        log_end(self.spec, ending)
        ending = replace(ending, accuracy=self.accuracy, integrals=totals, cause=self.cause, tables=self.request.tables)
        if self.request.becomes_run:
            return finish(self.writer, self.spec, ending, gradients=self.gradients)
        assert isinstance(self.writer, ArrayWriter)
        return self.writer.finish(ending)

    def _status(self) -> tuple[str, str]:
        """Return the status of the run and its reason, as in the archive."""
        stepper, end = self.stepper, self.spec.time.final
        if self.failure is not None:
            advice = step_advice(self.spec, self.failure.code)
            return "failed", shown(f"{self.failure.code}: {self.failure.sentence}{advice}")
        if self.interrupted_because:
            return "interrupted", self.interrupted_because
        if stepper is not None and not stepper.finished:
            return "interrupted", f"interrupted: stopped by the user at t = {stepper.time:.6g} s of {end:.6g} s."
        if self.interrupted and (self.recorder.kept is not None or self.spec.gradients):
            what = "errors were estimated" if self.recorder.kept is not None else "gradients were computed"
            return "interrupted", f"interrupted: stopped by the user after the last step, before {what}."
        stopped = None if self.watch is None else self.watch.stopped
        return "complete", "" if stopped is None else f"event: {stopped}."
