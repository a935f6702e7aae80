"""Execution of methods in Python: steps and their control, stops, rows, energies, events and checkpoints."""

from __future__ import annotations

import copy
import math
import time
from dataclasses import replace
from typing import Any

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.counters import HostCounters
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.singularity import describe_nearness
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators import interface
from mbdkit.integrators.host.host_control import HostControl
from mbdkit.integrators.host.host_energies import HostEnergies, HostNodes
from mbdkit.integrators.host.host_last_step import LastStep
from mbdkit.integrators.host.python_projection import StabilizedSteps, Taken
from mbdkit.integrators.interface import (
    SAME_TIME,
    Failure,
    StepEvidence,
    StepTaken,
    Stretch,
    Timetable,
)
from mbdkit.integrators.loop.step_watch import StepWatch
from mbdkit.integrators.run.impulse import DriverImpulse, impulse
from mbdkit.integrators.run.kept_state import kept, protect
from mbdkit.integrators.run.reached import Interval, Planned, Reached, RejectedError, Row
from mbdkit.integrators.run.sampled_control import Sampler, states_at_start
from mbdkit.integrators.run.splitting import margin_of_stops
from mbdkit.integrators.run.step_control import fitted_size
from mbdkit.integrators.run.step_guards import GuardState
from mbdkit.integrators.run.step_results import StepResults, called
from mbdkit.methods.step_methods import ExternalMethod, Step, StepMethod, StepState

SAME_INSTANT = 4e-16
"""Times that differ by less than this, in seconds or relative to their size, are equal."""
_REPEATED = ("newton-failed", "not-finite", "singular")
"""Codes of failures after which a controlled step is repeated with a smaller size."""


class StepHost(LastStep):
    """Runs a method in Python over a timetable; implements `mbdkit.integrators.run.splitting.Splitting`.

    Corrections by projection are not part of the energies.

    Parameters
    ----------
    method
        The method. A library with a loop of its own (`ExternalMethod`) gets a copy for this run.
    workspace
        The mechanism and its start, with formulation and stabilization.
    timetable
        Times of the run, and which states are recorded.
    """

    def __init__(self, method: StepMethod | ExternalMethod, workspace: Workspace, timetable: Timetable):
        self.method = copy.copy(method) if isinstance(method, ExternalMethod) else method
        self.workspace, self.timetable = workspace, timetable
        self._is_external = isinstance(method, ExternalMethod)
        self._is_fixed = method.tolerances is None and not self._is_external  # otherwise steps are controlled
        self.counters = HostCounters()
        self.finished = False
        self.failure: Failure | None = None
        self.last_step: StepTaken | None = None
        self.worst_pairs = np.zeros(len(workspace.mechanism.topology.pairs))
        workspace.clamp_motions(*timetable.sides(0))
        z0 = states_at_start(workspace)
        self._states = len(z0)
        self.use(EquationsOfMotion(workspace, z0))
        self.sampler = Sampler(workspace)
        if workspace.mechanism.controllers:  # the initial states include the first sample, whose outputs may be delayed
            self.sampler.passed(workspace.t0, workspace.q0, workspace.v0, workspace.mechanism.initial_states)
        self.control: HostControl | None = None
        if isinstance(self.method, StepMethod) and method.tolerances is not None:
            self.control = HostControl(method.tolerances, self.method.error_order, workspace, timetable)
        begin = StepState(self.equations.q0.copy(), self.equations.v0.copy(), z=z0)
        size = math.inf if self.control is None else self.control.first
        self.now = Reached(
            0, 0, 0, None, timetable.start, begin, np.zeros(2), np.zeros(2), Interval(), why="start", size=size
        )  # fmt: skip
        self.impacts: list[DriverImpulse] = []
        self.time = timetable.start
        self._before, self._made, self._taken = self.now, Step(begin), None
        self._judged, self._from = (size, 0.0), self.now
        self._retrying, self._rejected, self.next_row = False, 0, 1
        self._rows_before: tuple[int, Interval] = (1, Interval())
        self._inner_rows: list[float] = []
        self._rows: list[Row] = []
        self._nodes = HostNodes(workspace.mechanism.size, workspace.scratch.sides)
        self._watch = StepWatch(workspace, timetable.guards, self.worst_pairs, method.advice)

    def use(self, equations: EquationsOfMotion) -> None:
        """Let the method use these equations of motion, with the counters of this run."""
        method = self.method
        self._name = type(method).__name__
        self.equations, equations.counters = equations, self.counters
        equations.first_step = None if method.tolerances is None else self.timetable.step
        self._results = StepResults(self._name, equations, self._states, method.carries_multipliers)
        self.stabilized = StabilizedSteps(self._own_step, self._after_projection, equations)
        self._energies = HostEnergies(equations, equations.has_power)

    @property
    def evidence(self) -> StepEvidence:
        """See `Advancing.evidence`."""
        return self._watch.evidence(self.impacts)

    @property
    def guards(self) -> GuardState:
        """State of the guards."""
        return self._watch.guards

    def continue_from(self, reached: Reached, next_row: int = 1, library: bytes | None = None) -> None:
        """Continue from a point of the run, that of a checkpoint.

        Parameters
        ----------
        reached
            The point.
        next_row
            Number of the next row that is recorded at an interval.
        library
            State of the library of an `ExternalMethod`.
        """
        self._before, self.next_row = reached, next_row
        self._go_to(reached)
        if reached.why != "start":
            self.equations.first_step = None
        self.workspace.clamp_motions(*self.timetable.sides(reached.passed - (reached.why == "stop")))
        if isinstance(self.method, ExternalMethod) and not reached.why:
            counted = vars(self.counters).copy()
            self._open(reached.begin, reached.state)
            assert library is not None
            called(f"{self._name}.restore", self.method.restore, library)
            vars(self.counters).update(counted)

    @property
    def first_memory(self) -> Any:
        """The memory that the method has before the first step."""
        return self._begun(self.timetable.start, StepState(self.equations.q0, self.equations.v0), "start").memory

    # ---- begin of a step -----------------------------------------------------------------------------------------

    def begin_step(self) -> None:
        """Apply an event at which the last step has ended; at a discontinuity, apply an impulse and begin anew."""
        self.apply_event()
        if self.now.why:
            self._begin_anew()

    def apply_event(self) -> None:
        """Apply the event at which the last step has ended, if there is one, such as an impact."""
        now = self.now
        if now.event is not None:
            state = now.event.apply(self.equations, now.begin, now.state)
            self._watch.forget_energy()
            self.now = now._replace(state=state, energy=now.energy + _gain(state), event=None)

    def _begin_anew(self) -> None:
        now, table, t = self.now, self.timetable, self.now.begin
        state, energy, why = now.state, now.energy, now.why
        if why == "stop":
            self.workspace.clamp_motions(*table.sides(now.passed))
            stop = table.stops[now.passed - 1]
            state = StepState(state.q, state.v, memory=state.memory, low=state.low, z=state.z)
            if stop in table.impacts and not (self.impacts and self.impacts[-1].time == stop):
                impact, new = impulse(self.workspace, t, *self._with_ground(state), stop)
                self.impacts.append(impact)
                self._watch.forget_energy()
                state = replace(state, v=new[: self.equations.n], low=(state.low[0], 0.0, *state.low[2:]))
                energy, why = energy + np.array([impact.energy, 0.0]), "impact"
            if stop in table.samples:
                z = self.sampler.passed(stop, *self._with_ground(state), state.z)
                state = replace(state, z=z, low=state.low[:2])
        if why == "projection" and math.isfinite(now.size):
            self.equations.first_step = now.size
        state = self._begun(t, state, why)
        self.now = now._replace(state=state, energy=energy, why="", error=0.0)
        self._open(t, state)

    def _open(self, t: float, state: StepState) -> None:
        """Start the library of an `ExternalMethod` from a state at the present stop."""
        table, passed = self.timetable, self.now.passed
        if isinstance(self.method, ExternalMethod):
            end = table.stops[passed] if passed < len(table.stops) else table.end
            if self.equations.first_step is not None:
                self.equations.first_step = min(self.equations.first_step, end - t)
            called(f"{self._name}.open", self.method.open, self.equations, t, state, end)
            self.equations.first_step = None

    def _begun(self, t: float, state: StepState, why: Any) -> StepState:
        """Return a state with the memory for a step that begins anew."""
        if not isinstance(self.method, StepMethod):
            return state
        protect(state)
        memory = called(f"{self._name}.begin", self.method.begin, self.equations, t, state, why)
        return replace(state, memory=kept(memory))

    def _after_projection(self, t: float, state: StepState) -> StepState:
        return (
            state
            if getattr(type(self.method), "begin", None) is StepMethod.begin
            else self._begun(t, state, "projection")
        )

    # ---- steps ---------------------------------------------------------------------------------------------------

    def advance(self) -> Stretch:
        """See `Stepper.advance`."""
        until, table = time.perf_counter() + interface.STRETCH, self.timetable
        self._rows = rows = []
        self.last_step = None
        while not self.finished and self.failure is None:
            if self.now.done >= table.max_steps:
                self.failure = Failure("max-steps", f"stopped after limits.max_steps = {table.max_steps} steps.")
                break
            before = self.now
            try:
                self.begin_step()
                before, there, taken = self._accepted(self.now)
                if there.event is not None and there.event.time <= before.begin:
                    # the event is at the start of the step, which is then taken again
                    self.now = before._replace(state=there.state, restart=before.begin, event=there.event)
                    continue
                self._take(before, there, taken)
                rows += self._due()
                self.failure = self._watched(before, there, taken)
            except StepError as error:
                where = f"in step {before.done + 1} from t = {before.time:.6g} s"
                near = describe_nearness(self.workspace, before.time, with_ground(before.state.q))
                near = f"; {near}" if near and error.code in ("singular", "step-too-small") else ""
                self.failure = Failure(error.code, f"{error} {where}{near}; {self.method.advice}.")
                break
            if table.single or time.perf_counter() > until:
                break
        return self._stretch(rows)

    def rows_before_error(self) -> Stretch | None:
        """See `Advancing.rows_before_error`."""
        return self._stretch(self._rows) if self._rows else None

    def _take(self, before: Reached, there: Reached, taken: Taken) -> None:
        """Continue from the end of an accepted step."""
        self._rows_before = self.next_row, before.interval
        self._before, self._taken = before, taken
        self._go_to(there)
        table = self.timetable
        if table.single or table.interval is not None or table.nodes:
            z0 = before.state.z
            if self._states and (begin := self._results.within(self._made, 0.0)) is not None:
                z0 = begin[2]
            ends = (*self._with_ground(before.state), *self._with_ground(there.state), z0, there.state.z)
            self.last_step = StepTaken(before.time, there.time, *ends)
        self._keep_nodes(before, there)

    def _accepted(self, begin: Reached) -> tuple[Reached, Reached, Taken]:
        """Take a step, with as many attempts as it needs, each of at most nine tenths of the size of the one before.

        Returns its start, with the size of the step that was accepted, and its end.
        """
        self._retrying, self._rejected = False, self.counters.rejected
        while True:
            self._from = begin
            try:
                return begin, *self._after(begin, self._next(begin), self.worst_pairs)
            except RejectedError as rejected:
                tried = self._next(begin).size
                if not rejected.size < tried:
                    raise ValueError(
                        f"{self._name} rejects a step of {tried!r} s and asks for one of {rejected.size!r} s, no "
                        "smaller one"
                    ) from None
                self.counters.rejected += 1
                begin, self._retrying = begin._replace(size=min(rejected.size, 0.9 * tried)), True
                if not rejected.size > 4.0 * margin_of_stops(self.timetable):
                    if rejected.reason is not None:
                        raise rejected.reason from None
                    raise StepError("step-too-small", "no step is small enough to be accepted") from None

    def _next(self, begin: Reached) -> Planned:
        """Return the plan of the step that starts at `begin`."""
        table, t = self.timetable, begin.begin
        stop = table.stops[begin.passed] if begin.passed < len(table.stops) else None
        if not self._is_fixed:
            end = table.end if stop is None else stop
            size = end - t if self._is_external else float(fitted_size(t, begin.size, end))
            is_last = t + size >= end or size == end - t
            if is_last and stop is not None:
                return Planned(t, end - t, table.sides(begin.passed)[1], True, False)
            return Planned(t, size, table.end if is_last else t + size, False, is_last)
        assert table.step is not None
        n = begin.whole + 1
        end = table.start + n * table.step if n < table.steps else table.end
        plan: Planned | None = None
        if stop is not None:
            is_end = abs(stop - end) <= SAME_TIME * table.stop_margins[begin.passed]
            if stop < end or is_end:
                before = table.sides(begin.passed)[1]  # so that a row there shows the left-hand limit
                is_on_grid = is_end and stop not in table.impacts
                plan = Planned(t, stop - t, end if is_on_grid else before, True, is_end)
        if plan is None:
            size = table.last_step if n == table.steps else table.step
            plan = Planned(t, size if begin.restart is None else end - t, end, False, True)
        if begin.size < plan.size and (size := float(fitted_size(t, begin.size, t + plan.size))) < plan.size:
            return Planned(t, size, t + size, False, False, is_part=True)
        return plan

    def _after(self, begin: Reached, plan: Planned, worst: np.ndarray, theta: float = 1.0) -> tuple[Reached, Taken]:
        """Return the point after the fraction `theta` of a planned step from `begin`.

        The largest squared misalignments `worst` (P,) are updated. Raises StepError, RejectedError, and any exception
        of the method.
        """
        table, counters = self.timetable, self.counters
        iterations = counters.newton_iterations
        done, t, h = begin.done + 1, plan.begin, theta * plan.size
        # a sum of steps would accumulate rounding errors
        is_grid = self._is_fixed and h == table.step
        end = table.start + (begin.whole + 1) * h if is_grid else t + h
        taken = self.stabilized.take(t, end, begin.state, h, done)
        new, is_short = taken.reached, taken.end != end
        if is_short:
            end = taken.end
            h = end - t
        if not self.equations.arrive(end, new.q, new.v, worst):
            raise self._unsolved(h, StepError("not-finite", "positions or velocities overflowed"))
        energy, low = self._energies.booked(begin, t, h, taken, self._made, self._results)
        iterations, rejected = counters.newton_iterations - iterations, counters.rejected - self._rejected
        interval = begin.interval.after(h, iterations, rejected, taken.correction)
        made, (size, error) = self._made, self._judged
        if plan.is_at_stop and not self._retrying:
            size = max(size, begin.size)  # the stop has shortened the step, not its error
        whole, passed, restart, why = begin.whole, begin.passed, None, ""
        if self._is_external and new is not taken.made:
            why = "projection"  # the library continues from the projected state, but only after this step has been used
        is_part = is_short or plan.is_part
        if is_part and self._is_fixed:
            restart = end
        elif not is_part and plan.is_at_stop and theta == 1.0:
            whole, passed = whole + plan.is_whole, passed + 1
            restart, why, end = table.stops[begin.passed], "stop", plan.reached
        elif not is_part:
            whole += 1
            is_over = plan.is_whole if not self._is_fixed else whole == table.steps
            end = table.end if is_over and theta == 1.0 else end
        # positional arguments, because this is done in every step
        return Reached(
            done, whole, passed, restart, end, new, energy, low, interval, is_part, why, size, error, made.next_order,
            made.event,
        ), taken  # fmt: skip

    def _own_step(self, t: float, state: StepState, h: float, end: float) -> tuple[StepState, float]:
        """Take a step of the method; return the new state, and the time at which the step has ended.

        Raises StepError, RejectedError, any ordinary exception of the method, and TypeError or ValueError for an
        invalid result.
        """
        method, name, what = self.method, self._name, "advance" if self._is_external else "step"
        protect(state)
        try:
            if isinstance(method, ExternalMethod):
                new = called(f"{name}.advance", method.advance)
            else:
                new = called(f"{name}.step", method.step, self.equations, t, state, h)
            made, new = self._results.step(new, what)
        except StepError as error:
            raise self._unsolved(h, error) from None
        self._judged = math.inf, 0.0
        if self.control is not None:
            self._judged = self.control.judge(made, new, h, self._from, retrying=self._retrying)
        elif not made.accepted and self._is_external:
            raise ValueError(f"{name}.advance returned a step that is not accepted")
        elif not made.accepted:
            raise RejectedError(0.5 * h if made.next_step is None else made.next_step)
        elif made.next_step is not None:
            self._judged = made.next_step, 0.0
        self._made = made
        if made.event is not None:
            ended = made.event.time
        elif made.time is not None:
            ended = float(made.time)
            if not t < ended <= end + 4.0 * margin_of_stops(self.timetable):
                raise ValueError(
                    f"{name}.{what} returned time = {ended!r}, which is not later than the start of the step, {t!r}, "
                    f"and at most its end, {end!r}"
                )
        elif self._is_external:
            raise ValueError(f"{name}.advance returned a Step without `time`")
        else:
            return new, end
        return new, ended if ended < t + h - SAME_INSTANT * max(abs(end), 1.0) else end

    def _unsolved(self, h: float, error: StepError) -> Exception:
        """Return the exception for a step that could not be taken; a controlled one is repeated with a smaller size."""
        if self.control is None or error.code not in _REPEATED:
            return error
        return RejectedError(self.control.after_failure(h), error)

    def _watched(self, before: Reached, there: Reached, taken: Taken) -> Failure | None:
        """Apply the guards to a step; return the reason why the run has to stop, or None."""
        made = None if taken.made is taken.reached else (taken.made.q, taken.made.v)
        states = before.state.q, before.state.v, taken.reached.q, taken.reached.v
        return self._watch.step((before.begin, there.time), *states, there.energy - before.energy, made)


def _gain(state: StepState) -> np.ndarray:
    """Return (2,) the work and the dissipated energy of a state [J]."""
    return np.array([state.work or 0.0, state.dissipated or 0.0])
