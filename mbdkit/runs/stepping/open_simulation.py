"""Simulations that a program advances step by step, between which it sets inputs and reads values."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Protocol, Self, Unpack

import numpy as np

from mbdkit.archive.part_file import check_target
from mbdkit.archive.run import Run
from mbdkit.base import higher_layers
from mbdkit.base.errors import RunError, SpecError
from mbdkit.base.file_locks import UseLock, one_thread_at_a_time
from mbdkit.base.logs import warn_on_stderr
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import did_you_mean, one_line, shown
from mbdkit.engine.compiled_mechanism import CompiledInput
from mbdkit.engine.consistent_start import Starts
from mbdkit.engine.stored_arrays import restore_solver, stored_solver
from mbdkit.events.event_expression import RunExpression
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.interface import Advancing, Goal, Stretch
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.integrators.run.goal import goal_at
from mbdkit.runs.run_checkpoint import why_without
from mbdkit.runs.run_record import Request, begin_archive, begin_arrays
from mbdkit.runs.simulated_run import SimulatedRun
from mbdkit.runs.simulation import measured_in, simulate, start_run
from mbdkit.runs.stepping.input_history import InputHistory
from mbdkit.runs.stepping.present_values import PresentState, PresentValues
from mbdkit.runs.stepping.record import Record
from mbdkit.runs.stepping.simulation_state import SimulationState, copied
from mbdkit.runs.stored_python_steps import MemoryNotStoredError
from mbdkit.spec import RunSpec, load_spec
from mbdkit.spec.loading import RunSource, Sections

Numbers = Mapping[str, float | str]


class Prepared(Protocol):
    """A spec with other numbers; see `mbdkit.prepare`."""

    def spec_with(self, parameters: Numbers | None, initial: Numbers | None) -> RunSpec:
        """Return the spec with other numbers."""


class Inputs(MutableMapping[str, float]):
    """The inputs of a simulation by name; a value that is set takes effect with the next `Simulation.advance`."""

    def __init__(self, simulation: Simulation):
        self._simulation = simulation

    def __getitem__(self, name: str) -> float:
        return self._simulation.input_value(name)

    def __setitem__(self, name: str, value: float) -> None:
        self._simulation.set_input(name, value)

    def __delitem__(self, name: str) -> None:
        raise SpecError("inputs of a simulation cannot be removed", key=f"inputs.{quoted(name)}")

    def __iter__(self) -> Iterator[str]:
        return iter([one.name for one in self._simulation.mechanism_inputs])

    def __len__(self) -> int:
        return len(self._simulation.mechanism_inputs)

    def __repr__(self) -> str:
        return f"Inputs({dict(self)})"


class Reader:
    """Reads the values of expressions in the present state of a simulation; `Simulation.reader` returns it."""

    def __init__(self, simulation: Simulation, expressions: Sequence[str]):
        self._simulation, self._expressions = simulation, tuple(expressions)
        self._values: PresentValues | None = None
        self._of: object = None

    @property
    def in_use(self) -> UseLock:
        """The lock of the simulation."""
        return self._simulation.in_use

    @one_thread_at_a_time
    def __call__(self) -> np.ndarray:
        """Return the values (n,) in SI units; nan where an expression is undefined."""
        simulation = self._simulation
        simulation.check_open()
        if self._values is None or self._of is not simulation.stepper:
            self._values, self._of = simulation.values_of(self._expressions), simulation.stepper
        return self._values(simulation.time)


class Simulation:
    """A simulation that a program advances; `mbdkit.open` returns it.

    It is a context manager: at the end of the block, the run is finished if that has not been done, and an archive
    keeps what was recorded if an exception ends the block.

    Parameters
    ----------
    spec
        The validated spec. Its end time is the latest time that the simulation can reach.
    archive
        File to which the record is written; by default, it stays in memory.
    overwrite
        Whether an existing archive may be replaced.

    Attributes
    ----------
    spec
        The spec, since the last `reset`.
    inputs
        The inputs of the mechanism by name, as a mapping; assign to them to set them.
    random
        Generator of random numbers for the program, such as noise of sensors. `reset` seeds it, and `state` contains
        its state.
    time
        Time reached [s].
    ended
        Why the simulation cannot go on, such as an event or a failure, as a sentence; empty while it can.
    in_use
        Held by the thread that uses the simulation.
    """

    def __init__(
        self, spec: RunSpec, archive: Path | None = None, *, overwrite: bool = False, starts: Starts | None = None
    ):
        if spec.is_to_be_chosen:
            reason = "`accuracy` chooses a method or a step by whole runs; give the integrator and its step"
            raise spec.placed(SpecError(f"an open simulation cannot be chosen: {reason}", key="accuracy"))
        if spec.limits.wall_time is not None:
            reason = "the program decides when it ends"
            raise spec.placed(SpecError(f"has no meaning in an open simulation: {reason}", key="limits.wall_time"))
        for name, controller in spec.mechanism().controllers.items():
            if controller.python is not None:
                key = f"model.controllers.{quoted(name)}.python"
                advice = "call the function there, and set an input to what it returns"
                raise spec.placed(SpecError(f"the program controls an open simulation; {advice}", key=key))
        if archive is not None:
            check_target(archive, overwrite=overwrite)
        self._archive, self._overwrite = archive, overwrite
        self._starts = starts or Starts()
        self._prepared: Prepared | None = None
        self.in_use = UseLock("another thread is using this simulation; give each thread its own, such as a `fork`")
        self.inputs = Inputs(self)
        self.random = np.random.default_rng()
        self._result: Run | None = None
        self._opened = spec
        self._quick: CompiledStepper | None = None
        self._begin(spec)

    # ---- begin and end ---------------------------------------------------------------------------------------------

    def _begin(self, spec: RunSpec) -> None:
        self.spec = spec
        self._run = self._started(spec)
        self._pivots: object = None
        self._record = Record(self._run)
        self._restart()

    def _started(self, spec: RunSpec) -> SimulatedRun:
        path, since = self._archive, time.perf_counter()
        writer = begin_arrays if path is None else partial(begin_archive, path=path, overwrite=self._overwrite)
        request = Request(
            begin=writer, since=since, measured_in=measured_in, path=path, starts=self._starts, is_open=True
        )
        with one_thread_of_linear_algebra():
            return start_run(spec, request)

    def _restart(self) -> None:
        """Go to the start, with an empty history."""
        run = self._run
        run.workspace.schedules = run.spec.schedules()
        run.failure, self.time, self.ended = None, run.workspace.t0, ""
        self._numbers = {one.name: number for number, one in enumerate(self.mechanism_inputs)}
        self._history = InputHistory(run.workspace.mechanism.inputs, run.workspace.schedules, run.workspace.t0)
        self._before: SimulationState | None = None
        self._start_stepper()

    def _start_stepper(self) -> None:
        """Let the steps begin at the start, with the inputs of the workspace."""
        run = self._run
        run.timings, run.record.integrals_s = {"setup_s": time.perf_counter() - run.request.since}, 0.0
        if run.stepper is not None and self._quick is not None and self._quick.restart():
            return
        if self._pivots is None:
            self._pivots = copied(stored_solver(run.workspace.solver))
        restore_solver(run.workspace, self._pivots)  # those of the start, so that each start has the same bits
        run.workspace.pivotings = 0
        with one_thread_of_linear_algebra():
            run.start()
        failure, stepper = run.failure, run.inner_stepper
        if failure is not None:
            raise RunError(f"{failure.code}: {failure.sentence}")
        assert isinstance(stepper, CompiledStepper | StepHost)
        assert run.stepper is not None
        self.stepper: CompiledStepper | StepHost = stepper
        self._advancing: Advancing = run.stepper
        self._present: PresentValues | None = None
        self._is_fixed: bool = stepper.is_fixed
        record = run.record
        is_plain = run.watch is None and record.integrals is None and not (record.needs_nodes or record.table.single)
        self._quick = stepper if isinstance(stepper, CompiledStepper) and stepper.is_fixed and is_plain else None
        if self._quick is not None:
            self._quick.keep_start()

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        raise TypeError(
            "a simulation cannot be copied or pickled: `fork` copies it, and `state().to_bytes()` takes its state to "
            "another process, where a simulation of the same spec can `restore` it"
        )

    def __enter__(self) -> Self:
        return self

    @one_thread_at_a_time
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._result is not None:
            return
        if self.time <= self._run.workspace.t0:
            self._run.record.writer.abandon()
        elif error is None:
            self.finish()
        else:
            what = "Ctrl-C" if isinstance(error, KeyboardInterrupt) else f"{type(error).__name__} in the program"
            message = f" ({shown(str(error))})" if str(error) else ""
            self._finish(f"interrupted: stopped by {what}{message} at t = {self.time:.6g} s.")

    @one_thread_at_a_time
    def finish(self) -> Run:
        """End the run at the time reached, and return it; its archive gets its final name.

        The spec of the run has the values that were set in its section `inputs`, so that ``mbdkit.run(run.spec)``
        repeats it.

        Raises SpecError if it is finished already or was never advanced, and ResourceError if the archive cannot be
        written.
        """
        self.check_open()
        if self.time <= self._run.workspace.t0:
            raise SpecError("the simulation was never advanced, so there is no run to finish")
        run = self._finish("")
        warn_on_stderr(run.warnings)
        return run

    def _finish(self, reason: str) -> Run:
        run, stepper = self._run, self.stepper
        self._drain()
        spec = self._history.recorded_spec(self.spec, self._final_time(), self._first_step())
        with one_thread_of_linear_algebra():
            try:
                if not self._record.is_whole:
                    run.record.writer.abandon()
                    self._result = simulate(spec, path=self._archive, overwrite=self._overwrite)
                    return self._result
                run.record.use_spec(spec)
                if not self.ended:
                    stepper.finished = not reason
                self._record.flush(self._history, self.time)
                run.failure = run.failure or self._advancing.failure
                run.interrupted_because = reason
                run.timings |= {"wall_s": self._record.seconds, "cpu_s": self._record.cpu_seconds}
                run.check_accuracy(None)
                result = run.conclude()
            finally:
                run.record.writer.abandon()
        assert isinstance(result, Run)
        self._result = result
        return result

    def _final_time(self) -> float:
        """Return the end of the recorded spec: the time reached, or that of the spec if the run could not reach it."""
        watch = self._run.watch
        stopped = watch is not None and watch.stopped is not None
        return self.spec.time.final if self._run.failure is not None or self._failed or stopped else self.time

    @property
    def _failed(self) -> bool:
        return self._advancing.failure is not None

    def _first_step(self) -> float | None:
        """Return the first step of an adaptive method, which depends on the end of the spec [s]."""
        stepper = self.stepper
        if self._is_fixed or self.spec.time.step is not None:
            return self.spec.time.step
        return stepper.first_size

    def check_open(self) -> None:
        """Raise SpecError if the simulation is finished."""
        if self._result is not None:
            raise SpecError(
                "the simulation is finished; its run is what `finish` has returned, and `reset` begins anew"
            )

    # ---- steps -----------------------------------------------------------------------------------------------------

    @one_thread_at_a_time
    def advance(self, dt: float) -> float:
        """Advance by a time [s]; see `advance_to`."""
        return self.advance_to(self.time + dt)

    @one_thread_at_a_time
    def advance_to(self, t: float) -> float:
        """Advance to a time, and return the time reached [s].

        Steps of adaptive methods end at `t`. Fixed steps continue as without the call unless an input is set at `t`:
        between two steps, the state at `t` is that of a shorter step.

        The time reached is earlier if an event with the action ``stop`` or the end time of the spec comes first;
        `ended` then says so.

        Raises SpecError if the simulation is finished, has ended, or `t` is not later than `time`. Raises RunError if a
        step fails; the states before can still be finished as a failed run.
        """
        self.check_open()
        if self.ended:
            raise SpecError(f"the simulation has ended: {self.ended}")
        t = float(t)
        if not self.time < t < math.inf:
            what = "not a finite time" if not math.isfinite(t) else f"not later than the time reached, {self.time!r} s"
            raise SpecError(f"the time to advance to, {t!r} s, is {what}")
        begin = time.perf_counter()
        history = self._history
        if self._before is not None and not history.is_pending:
            self._return(self._before)  # to the start of the whole step
        self._before = None
        stepper = self.stepper
        goal = goal_at(stepper.timetable, t, stepper.passed, is_fixed=self._is_fixed)
        if history.is_pending:
            self._set_states(history.changes(self.time, goal.time))
            stepper = self.stepper
        if goal.pause < math.inf:
            if self._is_fixed:
                self._go_to_grid(goal)
                self._before = None if self.ended else self._state_between(t)
            else:
                history.pauses.append(goal.time)
        if not self.ended:
            stepper.aim(goal)
            if self._quick is None or goal.whole < 0 or not self._quick.takes_steps_to_goal():
                self._go(begin)
        self.time = stepper.time if self.ended else goal.time
        self._record.seconds += time.perf_counter() - begin
        if self._archive is not None and self._record.is_due:
            self._drain()
            with one_thread_of_linear_algebra():
                self._record.flush(history)
        if self._failed or self._run.failure is not None:
            raise RunError(self.ended)
        return self.time

    def _set_states(self, changes: Mapping[int, float]) -> None:
        """Set first-order states from the time reached on; at the start, they belong to the initial state."""
        workspace = self._run.workspace
        if self.time > workspace.t0:
            self.stepper.hold(changes)
        else:
            workspace.schedules = self._history.start_schedules()
            self._start_stepper()

    def _go_to_grid(self, goal: Goal) -> None:
        """Take the fixed steps that end before a goal between two of them."""
        table = self.stepper.timetable
        assert table.step is not None
        whole = math.floor((goal.time - table.start) / table.step)
        if whole > self.stepper.whole:
            end = table.start + whole * table.step
            self.stepper.aim(Goal(end, end, whole))
            self._go(time.perf_counter())
            self.time = end

    def _state_between(self, t: float) -> SimulationState:
        try:
            return self.state()
        except SpecError as error:
            raise SpecError(f"{t!r} s is between the ends of two fixed steps, and {error.message}") from None

    def _go(self, begin: float) -> None:
        """Advance to the goal of the stepper, and keep what the steps give."""
        run, stepper, advancing = self._run, self.stepper, self._advancing
        while not (advancing.finished or advancing.failure or run.failure or stepper.at_goal):
            if (stretch := run.next_stretch(advancing)) is not None:
                self._keep(stretch, begin)
        if (failure := run.failure or advancing.failure) is not None:
            self.ended = f"{failure.code}: {failure.sentence}"
        elif run.watch is not None and run.watch.stopped is not None:
            self.ended = f"event: {run.watch.stopped}."
        elif advancing.finished:
            self.ended = f"its end, time.end = {self.spec.time.final:.6g} s, is reached."

    def _keep(self, stretch: Stretch, begin: float) -> None:
        now = self._record.seconds + time.perf_counter() - begin
        self._record.add(self._run.taken(self._advancing, stretch), now)

    def _drain(self) -> None:
        """Keep the rows that are still in the buffer of the stepper."""
        stepper = self.stepper
        if isinstance(stepper, CompiledStepper):
            stepper.count()
            if rows := int(stepper.run_state.first_row[0]):
                self._keep(stepper.collect(rows), time.perf_counter())

    # ---- values ----------------------------------------------------------------------------------------------------

    @property
    def mechanism_inputs(self) -> tuple[CompiledInput, ...]:
        """The inputs of the compiled mechanism."""
        return self._run.workspace.mechanism.inputs

    @one_thread_at_a_time
    def set_input(self, name: str, value: float) -> None:
        """Set an input from the time reached on; see `inputs`."""
        self.check_open()
        self._history.set(self._number(name), value)

    @one_thread_at_a_time
    def input_value(self, name: str) -> float:
        """Return the value of an input: what the program has set last, otherwise its present value."""
        number = self._number(name)
        given = self._history.value(number)
        return float(PresentState(self.stepper).z[self.mechanism_inputs[number].state]) if given is None else given

    def _number(self, name: str) -> int:
        if (number := self._numbers.get(name)) is None:
            names = [*self._numbers]
            hint = did_you_mean(str(name), names) or ("; it has none" if not names else "")
            raise SpecError(f"the mechanism has no input {name!r}{hint}", key="inputs")
        return number

    def reader(self, expressions: Sequence[str]) -> Reader:
        """Return a function without arguments that reads expressions in the present state.

        The expressions are parsed once; after a `reset`, the function reads the new simulation.

        Parameters
        ----------
        expressions
            Expressions such as ``"joints.knee.force"`` or ``"pole.angle"``, with the quantities of events. Their
            values are in SI units, and are those that are recorded for the state.
        """
        if isinstance(expressions, str):
            raise SpecError(f"give a list of expressions, such as [{expressions!r}], not a text")
        reader = Reader(self, expressions)
        reader()
        return reader

    def read(self, expressions: Sequence[str]) -> np.ndarray:
        """Return the values (n,) of expressions in the present state; see `reader`, which is faster if repeated."""
        return self.reader(expressions)()

    def values_of(self, expressions: Sequence[str]) -> PresentValues:
        """Return a function that evaluates expressions in the present state."""
        mechanism, numbers = self.spec.mechanism(), self.spec.numbers
        parsed = [RunExpression.parse(text, mechanism, numbers, crosses=False) for text in expressions]
        return PresentValues(self._run.workspace, self.stepper, parsed)

    @property
    @one_thread_at_a_time
    def misalignment(self) -> np.ndarray:
        """(J,) misalignment of each joint in the present state [m]."""
        self.check_open()
        if self._present is None:
            self._present = self.values_of(())
        return self._present.misalignment(self.time)

    # ---- states ----------------------------------------------------------------------------------------------------

    @one_thread_at_a_time
    def state(self) -> SimulationState:
        """Return the state of the simulation, to which `restore` returns; plain data and bytes.

        Raises SpecError if the simulation has ended, or the method cannot store its state.
        """
        self.check_open()
        if self.ended:
            raise SpecError(f"the simulation has ended, so that its state is of no use: {self.ended}")
        if (parts := self._run.parts()) is None:
            why = why_without(self.spec, self._run.method) or "its steps are taken by a library that cannot store it"
            raise SpecError(f"the state of this simulation cannot be stored: {why}")
        self._drain()
        try:
            motion = copied(parts.motion())
        except MemoryNotStoredError as error:
            raise SpecError(f"the state of this simulation cannot be stored: {error}") from None
        assert isinstance(motion, dict)
        state = SimulationState(
            self.time, self.spec.run_id(), self._history.stored(), motion, self.random.bit_generator.state, self._before
        )
        self._record.remember(state)
        return state

    @one_thread_at_a_time
    def restore(self, state: SimulationState) -> None:
        """Return to a state of this simulation, or of another one of the same spec; the record ends there.

        Raises SpecError if the state belongs to another spec, or is not valid.
        """
        self.check_open()
        if not isinstance(state, SimulationState):
            raise SpecError(f"give a state that `state` has returned, not {type(state).__name__}")
        if state.run_id != self.spec.run_id():
            raise SpecError("the state belongs to a simulation of another spec, or with other parameters")
        self._return(state)
        self._before = state.before
        self.random.bit_generator.state = state.random

    def _return(self, state: SimulationState) -> None:
        run = self._run
        try:
            self._history.restore(state.history)
            schedules = self._history.start_schedules()
            if schedules != run.workspace.schedules:
                run.workspace.schedules = schedules
                self._start_stepper()
            parts = run.parts()
            assert parts is not None
            for one in (self.stepper, run.watch):
                if one is not None:
                    one.begin_again()
            parts.restore_motion(state.motion)
        except (LookupError, TypeError, AttributeError, ValueError, OverflowError) as error:
            raise SpecError(f"the state is not valid for this simulation ({one_line(error)})") from error
        run.failure, self.ended, self.time = None, "", state.time
        self._record.restore(state)

    @one_thread_at_a_time
    def fork(self, archive: str | Path | None = None, *, overwrite: bool = False) -> Simulation:
        """Return a simulation in the same state that continues independently.

        Parameters
        ----------
        archive, overwrite
            See `mbdkit.open`; without a name, the record of the new simulation stays in memory.
        """
        state = self.state()
        other = Simulation(
            self.spec, None if archive is None else Path(archive), overwrite=overwrite, starts=self._starts
        )
        other.restore(state)
        other._record.adopt(self._record, state)
        return other

    @one_thread_at_a_time
    def reset(self, parameters: Numbers | None = None, initial: Numbers | None = None, seed: int | None = None) -> None:
        """Begin anew at the start, with an empty record; the record so far is discarded.

        Parameters
        ----------
        parameters, initial
            Other values of parameters, and initial values of kinematic quantities; see `mbdkit.prepare`.
            Without them, those of the spec that was opened.
        seed
            Seed of `random`; by default, its sequence continues.

        Raises SpecError if a parameter or a quantity does not exist, or the joints cannot be assembled.
        """
        spec = self._opened
        if parameters or initial:
            if self._prepared is None:
                self._prepared = higher_layers.prepared_run(spec)
            assert self._prepared is not None
            spec = self._prepared.spec_with(parameters, initial)
        if seed is not None:
            self.random = np.random.default_rng(seed)
        is_same = spec is self.spec and self._result is None and self._record.is_untouched
        self._result = None
        if is_same:
            self._restart()
            self._record.clear()
            return
        self._run.record.writer.abandon()
        try:
            self._begin(spec)
        except BaseException:
            self._begin(self._opened)  # so that the simulation can still be used
            raise


def open(  # noqa: A001 (its public name)
    source: RunSource, archive: str | Path | None = None, *, overwrite: bool = False, **sections: Unpack[Sections]
) -> Simulation:
    """Open a simulation that the calling program advances step by step.

    Parameters
    ----------
    source, **sections
        The spec; see `mbdkit.run`. Its end time is the latest time that the simulation can reach.
    archive
        File to which the record is written; by default, it stays in memory.
    overwrite
        Whether an existing archive may be replaced.

    Raises
    ------
    SpecError
        If the input is wrong, or the spec cannot be advanced step by step, as with `accuracy`.
    ResourceError
        If the archive cannot be written.

    Examples
    --------
    >>> import mbdkit
    >>> with mbdkit.open("double-pendulum", time={"end": 1.0, "step": 0.01}) as simulation:
    ...     while simulation.time < 0.5:
    ...         reached = simulation.advance(0.05)
    ...     run = simulation.finish()
    >>> run.time[-1]
    0.5
    """
    spec = load_spec(source, (), **sections)
    return Simulation(spec, None if archive is None else Path(archive), overwrite=overwrite)
