"""Execution of methods written in Python: steps, checks of their results, integration of energies, recording."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.base.errors import MbdkitError, StepError, in_this_process
from mbdkit.base.text import one_line
from mbdkit.engine.compiled_mechanism import CompiledMechanism, with_ground
from mbdkit.engine.counters import Counters
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.iteration_matrix import vector
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators import interface
from mbdkit.integrators.contact_state import ContactState, HeldForces
from mbdkit.integrators.event_driven import SAME_INSTANT, EventDriven
from mbdkit.integrators.impulse import DriverImpulse, impulse
from mbdkit.integrators.interface import (
    SAME_TIME,
    Failure,
    KeptNodes,
    Moment,
    Nodes,
    StepEvidence,
    StepTaken,
    Stretch,
    Timetable,
)
from mbdkit.integrators.kept_state import kept, protect
from mbdkit.integrators.python_projection import StabilizedSteps, Taken
from mbdkit.integrators.step_guards import GuardState
from mbdkit.integrators.step_watch import StepWatch
from mbdkit.methods.kinds import StepMethod, StepState

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, slots=True)
class Interval:
    """Statistics since the last recorded row.

    Number of steps, size of the last step [s], number of iterations, largest number of iterations in a step, and
    corrections (4,) as in `Stretch`.
    """

    steps: int = 0
    size: float = 0.0
    iterations: int = 0
    most_iterations: int = 0
    correction: np.ndarray = field(default_factory=lambda: np.zeros(4))

    def after(self, size: float, iterations: int, correction: np.ndarray) -> Interval:
        """Return the interval extended by one step."""
        largest = np.maximum(self.correction, correction)
        largest[0] = self.correction[0] + correction[0]
        most = max(self.most_iterations, iterations)
        return Interval(self.steps + 1, size, self.iterations + iterations, most, largest)


@dataclass(frozen=True, slots=True)
class Reached:
    """A point of the run between two steps, with all data needed to continue from it."""

    done: int
    """Number of steps so far."""
    whole: int
    """Number of fixed steps completed; a step that is divided at stops counts once."""
    passed: int
    """Number of stops that the run has passed."""
    restart: float | None
    """Time at which the next step starts if this point is a stop or an event of contacts [s]; else None."""
    time: float
    state: StepState
    energy: np.ndarray
    """(2,) work of loads and drivers, and dissipated energy [J]; `energy_low` has the compensation terms of these sums.
    """
    energy_low: np.ndarray
    interval: Interval
    is_event: bool = False
    """Whether the step ended at an event of contacts, before its planned end."""


@dataclass(frozen=True, slots=True)
class _Planned:
    """The next step.

    Its start and size [s], the time of a row at its end [s], whether it ends at a stop, and whether it ends a fixed
    step (which stops can divide).
    """

    begin: float
    size: float
    reached: float
    is_at_stop: bool
    is_whole: bool


def refuse_states(mechanism: CompiledMechanism) -> None:
    """Raise SpecError if a mechanism has first-order states that do not belong to rigid contacts."""
    if len(mechanism.states) > HeldForces(mechanism).count:
        what = "a method that takes its steps in Python, with positions and velocities only,"
        mechanism.refuse_states(what, "gauss and dop853 include them")


class PythonStepper:
    """Runs a `StepMethod` over a timetable; implements `mbdkit.integrators.interface.Stepper`.

    Work and dissipated energy that the method does not return are integrated by Simpson's rule, of order 4, over the
    cubic through both ends of the step, with the index-1 multipliers; its three solves per step are counted.
    Corrections by projection are not part of the energies.
    """

    def __init__(self, method: StepMethod, workspace: Workspace, timetable: Timetable):
        self.method, self.workspace, self.timetable = method, workspace, timetable
        self.counters = Counters()
        self.finished = False
        self.failure: Failure | None = None
        self.last_step: StepTaken | None = None
        self.raised: Exception | None = None
        self.worst_pairs = np.zeros(len(workspace.mechanism.topology.pairs))
        self.has_power = workspace.mechanism.has_power
        workspace.clamp_motions(*timetable.sides(0))
        self._held = HeldForces(workspace.mechanism)
        refuse_states(workspace.mechanism)
        self.equations = EquationsOfMotion(workspace)
        self.equations.counters = self.counters
        self.stabilized = StabilizedSteps(self._own_step, self.equations)
        begin = StepState(self.equations.q0.copy(), self.equations.v0.copy())
        self.now = Reached(0, 0, 0, None, timetable.start, begin, np.zeros(2), np.zeros(2), Interval())
        self.impacts: list[DriverImpulse] = []
        self.time = timetable.start
        self._before = self.now
        self._nodes = KeptNodes(workspace.mechanism.size, workspace.scratch.sides)
        self._watch = StepWatch(workspace, timetable.guards, self.worst_pairs, method.hint)

    @property
    def evidence(self) -> StepEvidence:
        """See `Advancing.evidence`."""
        return self._watch.evidence(self.impacts)

    @property
    def guards(self) -> GuardState:
        """State of the guards."""
        return self._watch.guards

    def continue_from(self, reached: Reached) -> None:
        """Continue from a point of the run, for example that of a checkpoint."""
        self._before = reached
        self._go_to(reached)

    @property
    def contact_state(self) -> ContactState | None:
        """Data of rigid contacts with their impacts so far; None if the method does not treat rigid contacts."""
        memory = self.now.state.memory
        return memory if isinstance(memory, ContactState) else None

    def _begin_after_stop(self) -> None:
        """At a stop, discard values that the method stores for the next step, and apply the impulse if any."""
        if isinstance(self.method, EventDriven) and self.contact_state is not None and self.contact_state.event:
            self._apply_event(self.method)
        now, table = self.now, self.timetable
        if now.restart is None or now.is_event:
            return
        contacts, energy = self.contact_state, now.energy
        memory = None if contacts is None else contacts.after_stop()
        state = StepState(now.state.q, now.state.v, memory=memory, low=now.state.low)
        self.workspace.clamp_motions(*table.sides(now.passed))
        stop = table.stops[now.passed - 1]
        if stop in table.impacts and not (self.impacts and self.impacts[-1].time == stop):
            q, v = self._with_ground(state)
            impact, new = impulse(self.workspace, now.restart, q, v, stop)
            self.impacts.append(impact)
            self._watch.forget_energy()
            state = StepState(state.q, new[: self.equations.n], memory=memory, low=(state.low[0], 0.0))
            energy = energy + np.array([impact.energy, 0.0])
        self.now = replace(now, state=state, energy=energy)

    def _apply_event(self, method: EventDriven) -> None:
        """Apply the event of contacts at which the last step ended, such as an impact."""
        now = self.now
        state = method.after_event(self.equations, now.time if now.restart is None else now.restart, now.state)
        self._watch.forget_energy()
        self.now = replace(now, state=state, energy=now.energy + np.array([state.work, state.dissipated]))

    def advance(self) -> Stretch:
        """See `Stepper.advance`. An exception of the method is raised by the next call, so that the rows before it are
        not lost.
        """
        if self.raised is not None:
            raise self.raised
        until, table = time.perf_counter() + interface.STRETCH, self.timetable
        rows: list[Reached] = []
        self.last_step = None
        while not self.finished and self.failure is None:
            if self.now.done >= table.max_steps:
                self.failure = Failure("max-steps", f"stopped after limits.max_steps = {table.max_steps} steps.")
                break
            before = self.now
            try:
                self._begin_after_stop()
                before = self.now
                there, taken = self._after(before, 1.0, self.worst_pairs)
                begin = before.time if before.restart is None else before.restart
                # the event is at the start of the step, which is then taken again
                if there.is_event and there.time <= begin:
                    self.now = replace(before, state=there.state, restart=begin, is_event=True)
                    continue
                self._go_to(there)
                self.failure = self._watched(before, there, taken)
                self._keep_nodes(before, there)
            except StepError as error:
                where = f"in step {before.done + 1} from t = {before.time:.6g} s"
                self.failure = Failure(error.code, f"{error} {where}; {self.method.hint}.")
                break
            except Exception as error:
                self.raised = error
                break
            is_whole = self.now.whole > before.whole
            if (is_whole and self.now.whole % table.every == 0) or self.finished:
                rows.append(self._recorded())
            if table.single:
                self._before = before
                ends = (*self._with_ground(before.state), *self._with_ground(self.now.state))
                is_over_step = self.contact_state is not None and self.contact_state.is_over_step
                is_over_step |= before.state.memory is None  # forces and modes at the start of a run are unknown
                states = (self._held.of(one.state.memory) for one in (self.now if is_over_step else before, self.now))
                self.last_step = StepTaken(before.time, self.now.time, *ends, *states)
            if table.single or time.perf_counter() > until:
                break
        return self._stretch(rows)

    def inside(self, theta: float) -> Moment:
        """See `Stepper.inside`."""
        assert self.last_step is not None
        return self.last_step.between(theta)

    def within(self, theta: float) -> Moment:
        """See `Stepper.within`."""
        step = self.last_step
        assert step is not None
        if theta in (0.0, 1.0):
            return step.between(theta)
        there = self._again(theta)
        if there is None:
            return self.inside(theta)
        return (*self._with_ground(there.state), self._held.of(there.state.memory))

    def cut(self, theta: float) -> Stretch:
        """See `Stepper.cut`."""
        assert self.last_step is not None
        before, after, table = self._before, self.now, self.timetable
        there = self._again(theta) if theta > 0.0 else before
        if there is None:  # use dense output instead
            q, v = (x[: self.equations.n] for x in self.inside(theta)[:2])
            there = replace(
                after,
                state=replace(before.state, q=q, v=v),
                energy=before.energy + theta * (after.energy - before.energy),
                interval=before.interval.after(theta * self._next(before).size, 0, np.zeros(4)),
            )
        if table.nodes:
            self._nodes.drop_last()
            if theta > 0.0:
                self._keep_nodes(before, there)
        self._go_to(replace(there, time=self.last_step.time(theta)))
        self.finished, self.failure = True, None
        return self.last_state()

    def last_state(self) -> Stretch:
        """See `Stepper.last_state`."""
        return self._stretch([self._recorded()])

    def taken_nodes(self) -> Nodes:
        """See `Stepper.taken_nodes`."""
        return self._nodes.taken()

    def _keep_nodes(self, before: Reached, there: Reached) -> None:
        """Store quadrature nodes in a step, on the quintic polynomial through states and accelerations at its ends."""
        if not self.timetable.nodes:
            return
        begin = before.time if before.restart is None else before.restart
        end = there.time if there.restart is None else there.restart
        ends = (*self._with_ground(before.state), *self._with_ground(there.state))
        accelerations = []
        for t, state in ((begin, before.state), (end, there.state)):
            if self._held.count:
                self.equations.hold(self._held.of(state.memory))
            accelerations.append(with_ground(self.equations.accelerations(t, state.q, state.v)[0]))
        self._nodes.keep(begin, end, StepTaken(begin, end, *ends).quintic(*accelerations))

    def _next(self, begin: Reached) -> _Planned:
        """Return the plan of the step that starts at `begin`."""
        table = self.timetable
        assert table.step is not None
        n = begin.whole + 1
        end = table.start + n * table.step if n < table.steps else table.end
        t = begin.time if begin.restart is None else begin.restart
        if begin.passed < len(table.stops):
            stop = table.stops[begin.passed]
            is_end = abs(stop - end) <= SAME_TIME * table.stop_margins[begin.passed]
            if stop < end or is_end:
                before = table.sides(begin.passed)[1]  # so that a row there shows the left-hand limit
                is_on_grid = is_end and stop not in table.impacts
                return _Planned(t, stop - t, end if is_on_grid else before, True, is_end)
        size = table.last_step if n == table.steps else table.step
        return _Planned(t, size if begin.restart is None else end - t, end, False, True)

    def _watched(self, before: Reached, there: Reached, taken: Taken) -> Failure | None:
        """Apply the guards to a step; return the reason why the run has to stop, or None."""
        begin = before.time if before.restart is None else before.restart
        made = None if taken.made is taken.reached else (taken.made.q, taken.made.v)
        states = before.state.q, before.state.v, taken.reached.q, taken.reached.v
        return self._watch.step((begin, there.time), *states, there.energy - before.energy, made)

    def _after(self, begin: Reached, theta: float, worst: np.ndarray) -> tuple[Reached, Taken]:
        """Return the point after the fraction `theta` of the step from `begin`.

        The largest squared misalignments `worst` (P,) are updated. Raises StepError, and any exception of the method.
        """
        table, equations, iterations = self.timetable, self.equations, self.counters.newton_iterations
        assert table.step is not None
        done, plan = begin.done + 1, self._next(begin)
        t, h = plan.begin, theta * plan.size
        # a sum of steps would accumulate rounding errors
        end = table.start + (begin.whole + 1) * table.step if h == table.step else t + h
        taken = self.stabilized.take(t, end, begin.state, h, done)
        new = taken.reached
        is_event = isinstance(new.memory, ContactState) and new.memory.time < t + h - SAME_INSTANT * max(abs(end), 1.0)
        if is_event:
            end = new.memory.time
            h = end - t
        if not equations.arrive(end, new.q, new.v, worst):
            raise StepError("not-finite", "positions or velocities overflowed")
        energy, low = begin.energy, begin.energy_low
        if self.has_power:
            energy, low = self._booked(begin, t, h, taken)
        interval = begin.interval.after(h, self.counters.newton_iterations - iterations, taken.correction)
        if is_event:
            return Reached(done, begin.whole, begin.passed, end, end, new, energy, low, interval, True), taken
        if not plan.is_at_stop or theta < 1.0:
            whole = begin.whole + 1
            reached = table.end if whole == table.steps else end
            return Reached(done, whole, begin.passed, None, reached, new, energy, low, interval), taken
        whole, restart = begin.whole + plan.is_whole, table.stops[begin.passed]
        return Reached(done, whole, begin.passed + 1, restart, plan.reached, new, energy, low, interval), taken

    def _again(self, theta: float) -> Reached | None:
        """Repeat the last step with the fraction `theta` of its size; return None if this raises StepError.

        Any other exception of the method is passed on.
        """
        plan, share = self._next(self._before), 1.0
        if self.now.is_event:  # the step ended earlier than planned
            share = (self.now.time - plan.begin) / plan.size
        try:
            return self._after(self._before, theta * share, self.worst_pairs.copy())[0]
        except StepError:
            return None

    def _go_to(self, there: Reached) -> None:
        self.now, self.time = there, there.time
        self.counters.steps = self.counters.accepted = there.done
        self.finished = there.whole == self.timetable.steps

    def _recorded(self) -> Reached:
        """Return the current point as a row to be recorded, and start a new interval."""
        recorded = self.now
        self.now = replace(recorded, interval=Interval())
        return recorded

    def _with_ground(self, state: StepState) -> tuple[np.ndarray, np.ndarray]:
        return with_ground(state.q), with_ground(state.v)

    def _own_step(self, t: float, state: StepState, h: float) -> StepState:
        """Take a step of the method, check its result, and return the result with copies of its arrays.

        StepError and ordinary exceptions of the method are passed on. Other errors of mbdkit, and exits, become
        RuntimeError. An invalid result raises TypeError or ValueError; multipliers that overflow raise StepError.
        """
        name, equations = type(self.method).__name__, self.equations
        protect(state)
        try:
            with in_this_process():
                new = self.method.step(equations, t, state, h)
        except (KeyboardInterrupt, StepError):
            raise
        except BaseException as error:  # a plugin may raise any exception, including SystemExit
            if isinstance(error, ValueError) and "read-only" in str(error):
                raise ValueError(f"{name}.step changes an array in place that belongs to a state ({error})") from error
            if isinstance(error, Exception) and not isinstance(error, MbdkitError):
                raise
            raise RuntimeError(one_line(error)) from error
        if not isinstance(new, StepState):
            raise TypeError(f"{name}.step returned {type(new).__name__}, not a StepState")
        wanted: list[tuple[str, Any, int]] = [("q", new.q, equations.n), ("v", new.v, equations.n)]
        if self.method.carries_multipliers:
            wanted.append(("multipliers", new.multipliers, equations.m))
        found: list[np.ndarray] = []
        for field_name, value, size in wanted:
            try:
                found.append(vector(value, size))
            except (TypeError, ValueError) as error:
                raise ValueError(f"{name}.step returned an invalid `{field_name}`: {error}") from None
        if len(found) == 3 and not np.all(np.isfinite(found[2])):
            raise StepError("not-finite", "multipliers overflowed")
        # The method may reuse its arrays; without copies, recorded states and those of a checkpoint would change later.
        q, v, *own = (array.copy() for array in found)
        multipliers = own[0] if own else kept(new.multipliers)
        return StepState(q, v, multipliers, kept(new.memory), new.work, new.dissipated, kept(new.low))

    def _booked(self, begin: Reached, t: float, h: float, taken: Taken) -> tuple[np.ndarray, np.ndarray]:
        """Return total work and dissipated energy after a step of the method, computed by compensated summation."""
        gains: Sequence[float | None] = (taken.made.work, taken.made.dissipated)
        if None in gains:
            ours = self._gains(t, h, taken)
            gains = [own if own is not None else gain for own, gain in zip(gains, ours, strict=True)]
        y = np.array(gains) + begin.energy_low
        total = begin.energy + y
        return total, y - (total - begin.energy)

    def _gains(self, t: float, h: float, taken: Taken) -> np.ndarray:
        """Return the work and the dissipated energy of one step, by Simpson's rule on the cubic through its ends."""
        equations, old, new = self.equations, taken.begin, taken.made
        a0, lam0 = equations.accelerations(t, old.q, old.v)
        a1, lam1 = equations.accelerations(t + h, new.q, new.v)
        q = 0.5 * (old.q + new.q) + h / 8 * (old.v - new.v)
        v = 0.5 * (old.v + new.v) + h / 8 * (a0 - a1)
        _, lam = equations.accelerations(t + h / 2, q, v)
        begin = np.array(equations.powers(t, old.q, old.v, lam0))
        middle = np.array(equations.powers(t + h / 2, q, v, lam))
        return h / 6 * (begin + 4 * middle + np.array(equations.powers(t + h, new.q, new.v, lam1)))

    def _stretch(self, rows: list[Reached]) -> Stretch:
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
            intervals[i, :5] = row.time, took.steps, took.size, took.iterations, took.most_iterations
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
            z=np.array([self._held.of(row.state.memory) for row in rows]).reshape(count, self._held.count),
        )
