"""Runs a spec: builds the mechanism, integrates it in stretches of steps, and writes the archive."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import h5py
import numpy as np

from mbdkit.accuracy.asked_accuracy_result import missed_because, with_asked
from mbdkit.accuracy.check_by_pilots import check_by_pilots
from mbdkit.accuracy.check_run import check_run
from mbdkit.accuracy.chosen_method import MOST_ATTEMPTS, Choice, choose_method, other_method
from mbdkit.accuracy.position_measure import PositionMeasure
from mbdkit.accuracy.recorded_pilot import Replay
from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.finished_run import ArrayWriter, FinishedRun
from mbdkit.archive.hdf5 import set_text
from mbdkit.archive.layout import GRADIENTS
from mbdkit.archive.part_file import check_target
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import Ending, RunWriter
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.engine.assembly import AssembledState
from mbdkit.engine.consistent_start import Starts
from mbdkit.engine.counters import Counters
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.workspace import Workspace
from mbdkit.interrupts import interrupts_noted
from mbdkit.logs import logger_of
from mbdkit.measures.take import take_all
from mbdkit.methods.kinds import Method
from mbdkit.one_thread import one_thread_of_linear_algebra
from mbdkit.progress_bars import in_notebook, progress_bar
from mbdkit.provenance import provenance
from mbdkit.recorded_columns import ObservedRows
from mbdkit.recorder import Recorder, archive_names, shared_forces
from mbdkit.run_checkpoint import TIMES, Checkpoints, Continuation, Parts, why_without
from mbdkit.run_corners import check_jumps
from mbdkit.run_evidence import estimated_errors, evidence_of_run
from mbdkit.run_integrals import RunIntegrals, integrands_of
from mbdkit.run_preparation import (
    build,
    caution,
    check_disk_space,
    guards,
    make_method,
    optional_arrays,
    plugin_failure,
    size_at_start,
    timetable,
)
from mbdkit.run_warnings import center_warnings, doubts, start_warnings
from mbdkit.spec import RunSpec, load_spec
from mbdkit.spec.run_source import RunSource, Sections
from mbdkit.stepping.compiled_stepper import CompiledStepper
from mbdkit.stepping.interface import Advancing, Failure, Stepper, Stretch
from mbdkit.stepping.start import start_method
from mbdkit.stepping.warm_up import to_stderr
from mbdkit.text import one_line, shown
from mbdkit.trust.criteria import judge

if TYPE_CHECKING:
    from mbdkit.events.watch import Watch

_Start = tuple[Workspace, AssembledState]

Progress = Callable[[float, float], None]
"""Called with the time reached and the end time [s]; see `run`."""

_LOG = logger_of(__name__)

_FINAL = ("wall-time", "max-steps", "plugin-error")
"""Failures that smaller steps do not avoid."""


def run(
    source: RunSource,
    *,
    archive: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    **sections: Unpack[Sections],
) -> Run:
    """Run a spec.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism with its `sections`.
    archive
        File to which results are written during the run; by default, they are kept in memory.
    overwrite
        Whether an existing archive may be replaced.
    progress
        Called with the time reached and the end time [s], several times per second; companion runs of a check begin
        again at the start. If it raises KeyboardInterrupt, the run ends as by Ctrl-C, with the status ``interrupted``.
        After any other exception, the archive is removed, and the exception is raised. By default, notebooks show a
        progress bar.
    **sections
        Sections of the spec, such as ``integrator={"name": "gauss", "stages": 2}``; they replace those of `source`.

    Returns
    -------
    Run
        The results. If the run stopped early, `Run.status` and `Run.status_reason` say why, and `Run.check` raises.

    Raises
    ------
    SpecError
        If the input is wrong or the joints cannot be assembled; no file is left behind.
    PluginError
        If a plugin fails.

    Examples
    --------
    >>> import mbdkit
    >>> run = mbdkit.run("pendulum", integrator={"name": "gauss", "stages": 3}, time={"end": 1.0, "step": 0.01})
    >>> run.status
    'complete'
    >>> run.misalignment_max < 1e-9
    True
    """
    spec = load_spec(source, (), **sections)
    path = None if archive is None else Path(archive)
    is_shown = progress is None and in_notebook()
    with progress_bar(spec.title or spec.model_item.name, quiet=not is_shown) as bar:
        return simulate(spec, path=path, overwrite=overwrite, progress=progress or bar)


def simulate(
    spec: RunSpec,
    *,
    path: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    notify: Callable[[str], None] = to_stderr,
    measures: Sequence[str] = (),
) -> Run:
    """Run a validated spec; see `run`.

    Parameters
    ----------
    path
        Final name of the archive; None keeps it in memory.
    overwrite
        Whether an existing archive may be replaced.
    progress
        As for `run`.
    notify
        Called with a message before long operations, such as the first compilation after installation.
    measures
        Expressions that will be evaluated for the run, beside the measures of the spec. Their time integrals are
        computed with the run, see `mbdkit.run_integrals`.
    """
    begin = time.perf_counter()
    if path is not None:
        check_target(path, overwrite=overwrite)
    begun = partial(_begun_archive, path=path, overwrite=overwrite)
    prepare = partial(_prepared, begun=begun, path=path, notify=notify, begin=begin, measures=measures)
    return _ended(spec, prepare, notify, progress).run()


def simulate_on(
    spec: RunSpec,
    continuation: Continuation,
    begun: Callable[[RunSpec, Method, _Start], RunWriter],
    *,
    progress: Progress | None = None,
    notify: Callable[[str], None] = to_stderr,
) -> Run:
    """Continue a run from a checkpoint.

    Parameters
    ----------
    continuation
        The state to continue from.
    begun
        Returns a writer that holds the rows up to this state.
    progress, notify
        As for `simulate`.
    """
    prepare = partial(_prepared, begun=begun, path=None, notify=notify, begin=time.perf_counter())
    return _ended(spec, partial(prepare, continuation=continuation), notify, progress).run()


def simulate_arrays(
    spec: RunSpec,
    *,
    notify: Callable[[str], None] = to_stderr,
    starts: Starts | None = None,
    measures: Sequence[str] = (),
) -> FinishedRun:
    """Run a validated spec without writing an archive, and return its arrays with the hash that the archive would have.

    Parameters
    ----------
    notify, measures
        As for `simulate`.
    starts
        Keeps compiled mechanisms for further runs, if given.
    """
    begin = time.perf_counter()
    prepare = partial(
        _prepared, begun=_begun_arrays, path=None, notify=notify, begin=begin, starts=starts, measures=measures
    )
    simulation = _ended(spec, prepare, notify, None)
    assert isinstance(simulation.writer, ArrayWriter)
    assert simulation.writer.finished is not None
    return replace(simulation.writer.finished, cause=simulation.cause)


def _ended(
    spec: RunSpec,
    prepare: Callable[..., _Simulation],
    notify: Callable[[str], None],
    progress: Progress | None,
) -> _Simulation:
    """Carry out a spec to its end, and return the simulation, whose writer is finished."""
    method = "a method to be chosen" if spec.choose == "method" else spec.integrator_item.id
    if _LOG.isEnabledFor(logging.INFO):
        _LOG.info("run %s begins: %s with %s", spec.run_id(), spec.model_item.id, method)
    with one_thread_of_linear_algebra():
        if spec.is_to_be_chosen:
            return _with_accuracy(spec, prepare, notify, progress)
        with _finished_or_abandoned(prepare(spec)) as simulation:
            simulation.integrate(progress)
            simulation.finish()
            return simulation


def _with_accuracy(
    spec: RunSpec, prepare: Callable[..., _Simulation], notify: Callable[[str], None], progress: Progress | None
) -> _Simulation:
    """Choose method and step for the accuracy of a spec, and run it; again with smaller steps while it is missed.

    If no attempt reaches the accuracy, the best one is returned, and its verdict says so.
    """
    check_jumps(spec)
    workspace, _ = build(spec, notify)
    choice = choose_method(spec, workspace, progress)
    tried: list[tuple[tuple[float, float], Choice]] = []
    while True:
        with _finished_or_abandoned(prepare(choice.settle(spec), choice=choice)) as simulation:
            simulation.integrate(progress)
            tried.append((simulation.merit(), choice))
            best = max(tried, key=lambda attempt: attempt[0])[1]
            following = None if simulation.is_settled else _following(spec, workspace, simulation, len(tried))
            simulation.tried = [one for _, one in tried]
            if simulation.is_settled or (following is None and best is choice):
                simulation.finish()
                return simulation
        prepare = partial(prepare, notify=_silent)  # the warnings would be the same
        if following is None:
            # repeated, because only one archive is written at a time; the same settings give the same numbers
            with _finished_or_abandoned(prepare(best.settle(spec), choice=best)) as simulation:
                simulation.integrate(progress)
                simulation.tried = [one for _, one in tried]
                simulation.finish()
                return simulation
        choice = following


def _following(spec: RunSpec, workspace: Workspace, simulation: _Simulation, attempts: int) -> Choice | None:
    """Return the choice for the next attempt after one that missed the accuracy; None if there is none."""
    choice = simulation.choice
    assert spec.accuracy is not None
    assert choice is not None
    if choice.limited:
        return None if math.isnan(simulation.reached) else other_method(spec, workspace, choice)
    return None if attempts >= MOST_ATTEMPTS else choice.tightened(spec, spec.accuracy, simulation.reached)


def _silent(message: str) -> None:
    """Discard a message."""


def _begun_archive(spec: RunSpec, method: Method, start: _Start, *, path: Path | None, overwrite: bool) -> RunWriter:
    """Begin the archive of a run."""
    workspace, assembled = start
    return ArchiveWriter(
        path,
        archive_names(workspace.mechanism),
        spec.canonical_json(),
        spec.sha256(),
        spec.run_id(),
        {**provenance(spec), "assembly": assembled.describe()},
        quantities=spec.output.recorded,
        extra_datasets=optional_arrays(spec, method, workspace.mechanism),
        overwrite=overwrite,
        shared=shared_forces(workspace.mechanism),
    )


def _begun_arrays(spec: RunSpec, method: Method, start: _Start) -> RunWriter:
    """Return what keeps the rows of a run in memory."""
    workspace, assembled = start
    return ArrayWriter(
        archive_names(workspace.mechanism),
        quantities=spec.output.recorded,
        extra_datasets=optional_arrays(spec, method, workspace.mechanism),
        shared=shared_forces(workspace.mechanism),
        assembly=assembled.describe(),
    )


def _prepared(
    spec: RunSpec,
    *,
    begun: Callable[[RunSpec, Method, _Start], RunWriter],
    path: Path | None,
    notify: Callable[[str], None],
    begin: float,
    choice: Choice | None = None,
    continuation: Continuation | None = None,
    starts: Starts | None = None,
    measures: Sequence[str] = (),
) -> _Simulation:
    """Return a simulation whose writer is begun by `begun`; see `simulate`."""
    method = make_method(spec)
    check_jumps(spec)
    if spec.gradients:
        from mbdkit.gradients.gradient import check_gradients

        check_gradients(spec, method)
    cautions = caution(spec, method)
    _warn(cautions, notify)
    workspace, start = build(spec, notify, starts)
    moves = start_warnings(spec, start)
    _warn(moves, notify)
    if _LOG.isEnabledFor(logging.DEBUG):
        _LOG.debug("mechanism: %s; start: %s", workspace.mechanism.freedoms(), start.describe())
    check_disk_space(spec, workspace.mechanism, path)
    integrands = integrands_of(spec, measures)
    noted: list[bool] = []
    noting = interrupts_noted if begun is not _begun_arrays else _not_noted
    with noting(lambda: noted.append(True)):  # an archive that nobody knows of could not be removed
        writer = begun(spec, method, (workspace, start))
        try:
            simulation = _Simulation(spec, workspace, method, writer, begin, (*cautions, *moves), choice)
        except BaseException:
            writer.abandon()
            raise
    simulation.interrupted, simulation.continuation = bool(noted), continuation
    if integrands:
        simulation.integrals = RunIntegrals(spec, workspace, integrands)
    return simulation


def _warn(warnings: Iterable[str], notify: Callable[[str], None]) -> None:
    """Tell and log warnings about a run."""
    for warning in warnings:
        notify(f"warning: {warning}")
        _LOG.warning("%s", shown(warning))


def _not_noted(note: Callable[[], None]) -> AbstractContextManager[None]:
    """Let Ctrl-C raise KeyboardInterrupt: there is no archive that keeps the rows of an interrupted run."""
    return nullcontext()


@contextmanager
def _finished_or_abandoned(simulation: _Simulation) -> Iterator[_Simulation]:
    """Remove the archive of a simulation that is not finished; handle Ctrl-C by ending the run."""
    try:
        noting = _not_noted if isinstance(simulation.writer, ArrayWriter) else interrupts_noted
        with noting(simulation.interrupt):
            yield simulation
    except BaseException as error:
        _LOG.warning("run %s is abandoned: %s", simulation.spec.run_id(), one_line(error))
        raise
    finally:
        simulation.writer.abandon()


class _Told:
    """Calls the callback of a user; if it raises an exception, the run is stopped and the callback not called again.

    Parameters
    ----------
    stop
        Stops the run, as Ctrl-C does.

    Attributes
    ----------
    error
        The exception, unless it was KeyboardInterrupt.
    """

    def __init__(self, progress: Progress, stop: Callable[[], None]):
        self.progress, self.stop = progress, stop
        self.stopped, self.error = False, None

    error: Exception | None

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


class _Simulation:
    def __init__(
        self,
        spec: RunSpec,
        workspace: Workspace,
        method: Method,
        writer: RunWriter,
        begin: float,
        warnings: tuple[str, ...],
        choice: Choice | None,
    ):
        self.spec, self.workspace, self.method, self.writer, self.begin = spec, workspace, method, writer, begin
        self.warnings, self.choice = warnings, choice
        self.tried = [] if choice is None else [choice]
        self.timings: dict[str, float] = {}
        self.file: h5py.File | None = None
        self.integrals: RunIntegrals | None = None
        self.size = size_at_start(spec, workspace)
        self.guards = guards(spec, self.size)
        self.recorder = Recorder(workspace, writer, self.guards)
        self.stepper: Advancing | None = None
        self.watch: Watch | None = None
        self.failure: Failure | None = None
        self.cause: BaseException | None = None
        self.interrupted = False
        self.accuracy: Accuracy | None = None
        self.continuation: Continuation | None = None
        if spec.estimates_errors:
            self.recorder.kept = []

    def integrate(self, progress: Progress | None) -> None:
        """Record the initial state, integrate to the end, and check the accuracy; raise what `progress` raises."""
        told = None if progress is None else _Told(progress, self.interrupt)
        if self.continuation is None:
            self.record_start()
        with self._blaming_the_plugin():
            if self.failure is None:
                self.start()
        before = dict.fromkeys(TIMES, 0.0) if self.continuation is None else self.take_up(self.continuation)
        setup = before["setup_s"] + time.perf_counter() - self.begin
        wall, cpu = time.perf_counter() - before["wall_s"], time.process_time() - before["cpu_s"]
        self.timings = {"setup_s": setup}
        if self.stepper is not None:
            self.advance(self.stepper, told, wall, self.checkpoints(wall, cpu))
        self.timings = {
            "setup_s": setup,
            "wall_s": time.perf_counter() - wall,
            "cpu_s": time.process_time() - cpu,
        }
        if isinstance(self.stepper, Replay):  # its steps were taken before
            self.timings["wall_s"] += self.stepper.wall
            self.timings["cpu_s"] += self.stepper.cpu
        self.check_accuracy(told)
        if told is not None and told.error is not None:
            raise told.error

    def interrupt(self) -> None:
        """Stop the run after the current stretch."""
        self.interrupted = True

    @property
    def is_settled(self) -> bool:
        """Whether smaller steps would not help: the accuracy is reached, or the user or a limit has ended the run."""
        if self.interrupted or (self.failure is not None and self.failure.code in _FINAL):
            return True
        return self.failure is None and self.accuracy is not None and self.accuracy.is_reached

    @property
    def reached(self) -> float:
        """Estimated error of positions in the measure of the accuracy asked; nan if it is not known to the end."""
        return self.accuracy.reached if self.accuracy is not None and self.accuracy.is_complete else math.nan

    def merit(self) -> tuple[float, float]:
        """Return a merit that orders attempts: the time until which errors are known, and their negative size."""
        if self.accuracy is None or math.isnan(self.accuracy.known_until):
            return -math.inf, -math.inf
        return self.accuracy.known_until, -self.accuracy.reached

    def record_start(self) -> None:
        """Record the initial state."""
        workspace, none = self.workspace, np.zeros(1)
        first = Stretch(np.array([workspace.t0]), workspace.q0[None], workspace.v0[None], none, none, np.zeros((1, 6)))
        self.failure = self.recorder.record(first, (0.0, 0.0), start=True)

    def start(self) -> None:
        """Create the stepper of the method."""
        final = self.choice.final if self.choice is not None else None
        if final is not None and final.is_run and self.integrals is None:
            self.stepper = Replay(final)
            return
        try:
            table = timetable(self.spec, self.guards, nodes=self.integrals is not None)
            stepper = start_method(self.method, self.workspace, table)
        except SingularSystemError as error:
            name = self.workspace.mechanism.unknown_name(error.index)
            self.failure = Failure("singular", f"the stage equations are singular at the start, near {name}.")
            return
        if self.spec.events:
            self.watch = _watch(self.spec, self.workspace, stepper)
        self.stepper = self.watch or stepper

    @contextmanager
    def _blaming_the_plugin(self) -> Iterator[None]:
        """Convert whatever a third-party integrator raises, errors of mbdkit included, into a failure of the run."""
        try:
            yield
        except BaseException as error:
            self.failure = plugin_failure(self.spec, error)
            self.cause = error

    def take_up(self, continuation: Continuation) -> Mapping[str, float]:
        """Restore the state of a checkpoint, and return the times that the run took before it [s]."""
        parts = self.parts()
        assert parts is not None
        parts.restore(continuation.state)
        if self.recorder.kept is not None:
            self.recorder.kept = continuation.rows()
        continuation.restored()
        return continuation.times

    def parts(self) -> Parts | None:
        """Return the parts of the run whose state makes a checkpoint; None if it has parts that cannot be stored."""
        stepper = self.stepper if self.watch is None else self.watch.stepper
        if why_without(self.spec, self.method) or not isinstance(stepper, CompiledStepper):
            return None
        return Parts(self.workspace, stepper, self.watch, self.recorder, self.integrals)

    def checkpoints(self, wall: float, cpu: float) -> Checkpoints | None:
        """Return the checkpoints of the run, whose steps began at these times [s]; None if it has none."""
        writer = self.writer
        if not (isinstance(writer, ArchiveWriter) and writer.keeps_checkpoints):
            return None
        parts = self.parts()
        if parts is None:
            return None

        def state() -> Mapping[str, Any]:
            spent = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
            return {**parts.stored(), "times": {**self.timings, **spent}}

        return Checkpoints(writer, state)

    def advance(
        self, stepper: Advancing, progress: Progress | None, begin: float, checkpoints: Checkpoints | None
    ) -> None:
        """Step until the end, a limit, a failure or an interrupt, and record the states."""
        limit, end = self.spec.limits.wall_time, self.spec.time.final
        elapsed = time.perf_counter() - begin if self.continuation is not None else 0.0
        recorded = self.recorder.last_time
        while not (stepper.finished or stepper.failure or self.failure or self.interrupted):
            with self._blaming_the_plugin():
                stretch = stepper.advance()
            if self.failure is not None:
                break
            now = time.perf_counter() - begin
            self.failure = self.recorder.record(stretch, (elapsed, now))
            if self.watch is not None:
                self.recorder.record_events(self.watch.taken())
            if self.integrals is not None:
                self.integrals.add(stepper.taken_nodes())
            if len(stretch.time):
                recorded = float(stretch.time[-1])
            elapsed = now
            if progress is not None:
                progress(stepper.time, end)
            if checkpoints is not None and not (stepper.finished or stepper.failure or self.failure):
                checkpoints.write_if_due()
            if limit is not None and now > limit and not (stepper.finished or stepper.failure or self.failure):
                self.failure = Failure(
                    "wall-time", f"stopped at t = {stepper.time:.6g} s after limits.wall_time = {limit:g} s."
                )
        unrecordable = self.failure is not None and self.failure.code not in ("wall-time", "plugin-error")
        self.failure = self.failure or stepper.failure
        if recorded < stepper.time and not stepper.finished and not unrecordable:
            self.recorder.record(stepper.last_state(), (elapsed, elapsed))

    def check_accuracy(self, progress: Progress | None) -> None:
        """Estimate the errors of the recorded rows if the spec asks for it."""
        kept = self.recorder.kept
        if not kept:
            return
        rows, steps = ObservedRows.joined(kept), self.stepper.counters.steps if self.stepper is not None else 0
        choice = self.choice
        if choice is not None and choice.pilots and len(rows.time) > 1 and not self.spec.check:
            found = check_by_pilots(self.spec, self.workspace, rows, choice.pilots, choice.setting)
        else:
            found = check_run(self.spec, self.method, self.workspace, rows, steps, lambda: self.interrupted, progress)
        self.accuracy = with_asked(found, self.spec, self.workspace, self.choice)

    def measured(self, file: h5py.File) -> str:
        """Return the measures of the run in a file, as its archive stores them."""
        found = take_all(Run(file), self.spec)
        for name, reason in found.reasons.items():
            _LOG.warning("measure %s: %s", name, reason)
        if self.spec.gradients and self.failure is None and not self.interrupted:
            from mbdkit.gradients.gradient import gradients_json

            set_text(file, GRADIENTS, gradients_json(self.spec))
        return found.to_json()

    def finish(self) -> None:
        """Finish the archive with the final status."""
        stepper = self.stepper
        counters = dict(vars(stepper.counters if stepper is not None else Counters()))
        counters["factorizations"] += self.workspace.pivotings + self.recorder.workspace.pivotings
        pairs = len(self.workspace.mechanism.topology.pairs)
        status, reason = "complete", ""
        if self.failure is not None:
            status, reason = "failed", shown(f"{self.failure.code}: {self.failure.sentence}")
        elif stepper is not None and not stepper.finished:
            status, reason = "interrupted", f"interrupted: stopped by the user at t = {stepper.time:.6g} s."
        elif self.watch is not None and self.watch.stopped is not None:
            reason = f"event: {self.watch.stopped}."
        misalignment_max = self.recorder.misalignment_max(
            stepper.worst_pairs if stepper is not None else np.zeros(pairs)
        )
        ending = status, reason
        steps = None if stepper is None else stepper.evidence
        mechanism = self.spec.mechanism()
        self.warnings = (*self.warnings, *center_warnings(mechanism, self.recorder.reached))
        questions = doubts(self.spec, self.warnings)
        evidence = evidence_of_run(self.recorder, steps, ending, misalignment_max, self.size, questions)
        errors = None
        if self.accuracy is not None:
            missed = missed_because(self.accuracy, self.tried, self.failure)
            position = PositionMeasure.of(self.spec, self.workspace).known(self.accuracy)
            errors = estimated_errors(self.recorder, self.accuracy, position, missed)
        judgement = judge(evidence, errors)
        told = f"{status}: {reason.removeprefix('interrupted: ')}" if reason else status
        level = logging.WARNING if status == "failed" else logging.INFO
        if _LOG.isEnabledFor(level):
            _LOG.log(level, "run %s ends: %s, verdict %s", self.spec.run_id(), told, judgement.level)
        _LOG.debug("counters: %s; timings: %s", counters, self.timings)
        ended = Ending(
            status,
            reason,
            {**counters, **self.timings},
            misalignment_max,
            judgement,
            self.warnings,
            self.accuracy,
            {} if self.integrals is None else self.integrals.totals(),
        )
        self.file = self.writer.finish(ended, measured=self.measured if self.spec.measures else None)

    def run(self) -> Run:
        """Return the run, once its archive is finished."""
        if self.file is not None:
            run = Run(self.file)
        else:
            assert self.writer.path is not None
            run = load(self.writer.path)
        run.cause = self.cause
        return run


def _watch(spec: RunSpec, workspace: Workspace, stepper: Stepper) -> Watch:
    """Wrap the stepper to detect the events of a spec."""
    from mbdkit.events.watch import Watch, Watched

    found = [
        Watched(name, expression, spec.events[name].direction, spec.events[name].action)
        for name, expression in spec.watched().items()
    ]
    return Watch(stepper, workspace, found)
