"""A run in progress: it advances the method in stretches, passes what the steps give to the record, and concludes."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.finished_run import ArrayWriter, FinishedRun
from mbdkit.archive.run import Run
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base import higher_layers
from mbdkit.base.text import listed, shown
from mbdkit.engine.counters import Counters
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.interface import Advancing, Failure, Stretch
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.integrators.run.impulse import ReactingMemory, reacting_memory
from mbdkit.runs.coarse_steps import coarse_step
from mbdkit.runs.conclusion import NO_STEPS, EndedRun, conclude, log_end
from mbdkit.runs.finish import finish
from mbdkit.runs.preparation import plugin_failure, written_forces
from mbdkit.runs.run_checkpoint import Checkpoints, Parts, why_without
from mbdkit.runs.run_criteria import step_advice
from mbdkit.runs.run_record import TIMES, Continuation, RunRecord, Taken
from mbdkit.runs.run_seams import Progress
from mbdkit.spec import RunSpec
from mbdkit.trust.finding import Doubts

if TYPE_CHECKING:
    from mbdkit.archive.checkpoint import StoredState
    from mbdkit.events.watch import Watch
    from mbdkit.runs.accuracy.chosen_method import Choice
    from mbdkit.runs.accuracy.pilot_run import RecordedPilot

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


class SimulatedRun:
    """A run in progress.

    - `record`: what the run records; it has the spec, the method and the mechanism at its start.
    - `choice`: the method and step chosen for the requested accuracy, if any.
    """

    def __init__(self, record: RunRecord, choice: Choice | None = None):
        self.record, self.choice, self.request, self.interrupted = record, choice, record.request, False
        self.method, self.workspace = record.setup.method, record.setup.workspace
        self.tried = [] if choice is None else [choice]
        self.timings: dict[str, float] = {}
        self.failure: Failure | None = None
        #: When the wall time of the run is over (`time.perf_counter`).
        self.deadline = math.inf
        self.stepper: Advancing | None = None
        self.watch: Watch | None = None
        #: The pilot run that has taken the steps of this run.
        self.replay: RecordedPilot | None = None
        self.cause: BaseException | None = None
        self.accuracy: Accuracy | None = None
        #: Gradients of the measures as JSON; empty if there are none.
        self.gradients = ""
        #: Why the run was interrupted, if not by `interrupt`; see ``status_reason`` of archives.
        self.interrupted_because = ""

    @property
    def spec(self) -> RunSpec:
        """The validated spec of the run."""
        return self.record.setup.spec

    def integrate(self, progress: Progress | None) -> None:
        """Record the initial state, integrate to the end, and check the accuracy; raise what `progress` raises."""
        reporter = None if progress is None else _Reporter(progress, self.interrupt)
        continuation, before = self.request.continuation, dict.fromkeys(TIMES, 0.0)
        if continuation is None:
            self.record_start()
        with self.blaming_the_plugin():
            if self.failure is None:
                self.start()
        if continuation is not None:
            before = self.restore(continuation)
        setup = before["setup_s"] + time.perf_counter() - self.request.since
        wall, cpu = time.perf_counter() - before["wall_s"], time.process_time() - before["cpu_s"]
        self.timings, self.record.integrals_s = {"setup_s": setup}, before["integrals_s"]
        if self.stepper is not None:
            self.advance(self.stepper, reporter, wall, self.checkpoints(wall, cpu))
        self.timings |= {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        if self.replay is not None:
            self.timings["wall_s"] += self.replay.wall
            self.timings["cpu_s"] += self.replay.cpu
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
        """Record the initial state, or note why this fails in `failure`."""
        self.failure = self.record.add_start()

    def start(self) -> None:
        """Create the stepper of the method, or note why this fails in `failure`."""
        self.stepper = self.watch = self.replay = None
        table, final = self.record.table, self.choice.final if self.choice is not None else None
        if final is not None and final.is_run and not (table.nodes or table.single):
            self.replay, self.stepper = final, final.stepper
            return
        try:
            stepper = self.record.setup.stepper(table)
        except SingularSystemError as error:
            name = self.workspace.mechanism.unknown_name(error.index)
            self.failure = Failure("singular", f"the stage equations are singular at the start, near {name}.")
            return
        if table.single:
            from mbdkit.runs.watched_events import watch_events

            self.watch = watch_events(self.spec, self.workspace, stepper)
        self.stepper = self.watch or stepper

    def next_stretch(self, stepper: Advancing) -> Stretch | None:
        """Advance, and return the rows; if the method fails, those before the failure, or None if there are none."""
        stretch: Stretch | None = None
        with self.blaming_the_plugin():
            stretch = stepper.advance()
        return stretch if self.failure is None else stepper.rows_before_error()

    def taken(self, stepper: Advancing, stretch: Stretch) -> Taken:
        """Return what the latest steps have given."""
        compiled, nodes, apart = self.inner_stepper, stepper.taken_nodes() if self.record.needs_nodes else None, 1
        if self.method.traits.is_explicit and isinstance(compiled, CompiledStepper):
            apart = compiled.method.stages  # only the first stage, at the start of the step, is a state of the motion
        if self.watch is None:
            return Taken(stretch, nodes, nodes_apart=apart)
        return Taken(stretch, nodes, self.watch.taken_steps(), self.watch.taken(), apart)

    def add(self, taken: Taken, elapsed: tuple[float, float]) -> None:
        """Record what steps have given; see `RunRecord.add`."""
        self.failure = self.record.add(taken, elapsed) or self.failure

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

    def restore(self, continuation: Continuation) -> dict[str, float]:
        """Restore the state of a checkpoint, and return the times that the run took before the checkpoint [s]."""
        parts, recorder = self.parts(), self.record.recorder
        assert parts is not None
        parts.restore(continuation.state)
        if recorder.kept is not None:
            recorder.kept = continuation.rows()
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
        return Parts(self.workspace, stepper, self.watch, self.record)

    def checkpoints(self, wall: float, cpu: float) -> Checkpoints | None:
        """Return the object that writes the checkpoints of the run; None if its writer keeps none, or parts of it
        cannot be stored.

        The arguments are the wall time and the processor time at which its steps began [s].
        """
        writer, parts = self.record.writer, self.parts()
        if parts is None or not isinstance(writer, ArchiveWriter) or writer.path is None:
            return None

        def state() -> StoredState:
            spent = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
            return {**parts.stored(), "times": {**self.timings, "integrals_s": self.record.integrals_s, **spent}}

        return Checkpoints(writer, state)

    def advance(
        self, stepper: Advancing, progress: Progress | None, begin: float, checkpoints: Checkpoints | None
    ) -> None:
        """Step until the end, a limit, a failure or an interrupt, and record the states."""
        limit, end = self.spec.limits.wall_time, self.spec.time.final
        self.deadline = math.inf if limit is None else begin + limit
        elapsed = time.perf_counter() - begin if self.request.continuation is not None else 0.0
        for taken_before in () if self.replay is None else self.replay.stretches:
            if self.failure is None:
                before, elapsed = elapsed, time.perf_counter() - begin
                self.add(Taken(taken_before), (before, elapsed))
        while not (stepper.finished or stepper.failure or self.failure or self.interrupted):
            since, done = time.perf_counter(), stepper.counters.steps
            if (stretch := self.next_stretch(stepper)) is None:
                break
            now = time.perf_counter() - begin
            self.add(self.taken(stepper, stretch), (elapsed, now))
            self._record_inputs()
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
        if self.record.recorder.last_time < stepper.time and not stepper.finished and not unrecordable:
            self.record.recorder.record(stepper.last_state(), (elapsed, elapsed))
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
            self.record.recorder.record_inputs([*settings, *(inner.sampler.ends(inner.time) if at_end else ())])
            if self.workspace.python is not None:
                self.record.recorder.record_samples(inner.sampler.taken_samples())

    def check_accuracy(self, progress: Progress | None) -> None:
        """Estimate the errors of the recorded rows if the spec asks for it."""
        if (rows := self.record.kept) is not None:
            from mbdkit.runs.accuracy.companion import Budget
            from mbdkit.runs.accuracy.run_estimates import estimate_accuracy

            budget = Budget(self.spec.limits.wall_time, lambda: self.interrupted)
            steps = self.stepper.counters.steps if self.stepper is not None else 0
            self.accuracy = estimate_accuracy(
                self.record, rows, steps, budget, progress, self.memory, choice=self.choice, deadline=self.deadline,
                has_failed=self.failure is not None,
            )  # fmt: skip

    def doubtful_gradients(self) -> Iterator[str]:
        """Yield a sentence about the measures whose gradients fail their checks, if any."""
        gradients = json.loads(self.gradients or "{}")
        failed = [name for name, entry in gradients.items() if not entry.get("check", {"agrees": True})["agrees"]]
        if failed:
            yield f"The check of the gradients failed for {listed(failed, 'and')}; `doubts` of the gradients says why."

    def doubtful_switches(self) -> Iterator[str]:
        """Yield a sentence if forces switched more often than steps can follow."""
        pinned = getattr(self.inner_stepper, "switches", None)
        if pinned is not None and (first := float(pinned.bundle.spell.first[0])) < math.inf:
            names = [self.workspace.mechanism.laws[law][0] for law in pinned.bundle.laws[:, 0]]
            yield (
                f"From t = {first:.6g} s on, {listed(written_forces(self.spec, names), 'or')} switches without end, so "
                "that steps pass over its jumps: the jump holds the motion where it is, as friction given by the sign "
                "of a velocity does. Let the force change over a small range instead, as `tanh` does, or use the "
                "friction of joints or contacts."
            )

    def conclude(self) -> Run | FinishedRun:
        """Conclude the run: finish its archive or its arrays with its status and its verdict."""
        spec, record, stepper, memory = self.spec, self.record, self.stepper, self.memory
        status, reason = self._status()
        steps = NO_STEPS if stepper is None else stepper.evidence
        record.add_impacts(memory, steps)
        totals = record.totals(self.deadline)
        findings = record.findings(totals)
        if self.request.becomes_run and spec.gradients and status == "complete":
            self.gradients = higher_layers.gradients_json(spec)
        doubts, accuracy = Doubts.of(findings, spec.accept), self.accuracy
        notes = () if memory is None else memory.remarks()  # on the treatment of elements, which question no result
        errors = None
        if accuracy is not None:
            from mbdkit.runs.accuracy.run_estimates import estimated_errors

            errors = estimated_errors(record, accuracy, self.tried, self.failure, totals)
        if record.integrals is not None:
            self.timings["integrals_s"] = record.integrals_s
        ended = EndedRun(
            mechanism=self.workspace.mechanism,
            size=record.setup.size,
            doubts=doubts._replace(open=(*doubts.open, *self.doubtful_gradients(), *self.doubtful_switches())),
            warnings=(*map(str, findings), *notes),
            status=status,
            reason=reason,
            counters=Counters() if stepper is None else stepper.counters,
            pivotings=self.workspace.pivotings + record.recorder.workspace.pivotings,
            timings=self.timings,
            errors=errors,
            finer=spec.finer,
            coarse=partial(coarse_step, spec),
        )
        worst = np.zeros(len(self.workspace.mechanism.topology.pairs)) if stepper is None else stepper.worst_pairs
        ending = conclude(ended, record.recorder.extremes(worst, steps))
        log_end(spec, ending)
        ending = replace(ending, accuracy=accuracy, integrals=totals, cause=self.cause, tables=self.request.tables)
        if self.request.becomes_run:
            return finish(record.writer, spec, ending, gradients=self.gradients)
        assert isinstance(record.writer, ArrayWriter)
        return record.writer.finish(ending)

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
        if self.interrupted and (self.record.recorder.kept is not None or self.spec.gradients):
            what = "errors were estimated" if self.record.recorder.kept is not None else "gradients were computed"
            return "interrupted", f"interrupted: stopped by the user after the last step, before {what}."
        stopped = None if self.watch is None else self.watch.stopped
        return "complete", "" if stopped is None else f"event: {stopped}."
