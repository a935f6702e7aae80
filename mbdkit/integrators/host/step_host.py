"""Execution of methods in Python: steps and their control, stops, rows, energies, events and checkpoints."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.counters import HostCounters
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.bundle_types import STATE, kept
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.singularity import describe_nearness
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators import interface
from mbdkit.integrators.host.host_control import HostControl
from mbdkit.integrators.host.host_energies import HostEnergies, HostNodes
from mbdkit.integrators.host.host_rows import HostRows, LastStep
from mbdkit.integrators.host.step_attempts import Attempt, StepAttempts
from mbdkit.integrators.interface import (
    ENDLESS,
    SAME_TIME,
    Failure,
    Goal,
    Moment,
    Nodes,
    StepEvidence,
    StepTaken,
    Stretch,
    Timetable,
)
from mbdkit.integrators.loop.step_watch import StepWatch
from mbdkit.integrators.run.impulse import DriverImpulse, impulse
from mbdkit.integrators.run.reached import NO_HISTORY, IntervalSoFar, Reached, RecordedRow
from mbdkit.integrators.run.sampled_control import Sampler, states_at_start
from mbdkit.integrators.run.splitting import margin_of_stops
from mbdkit.integrators.run.step_guards import GuardState
from mbdkit.integrators.run.step_results import called
from mbdkit.methods.step_methods import ExternalMethod, StepMethod, StepState, Why


class StepHost:
    """Runs a method in Python over a timetable; implements `mbdkit.integrators.run.splitting.Splitting`.

    Corrections by projection are not part of the energies.

    `method`: the method. A library with a loop of its own (`ExternalMethod`) gets a copy for this run. `workspace`: the
    mechanism and its start, with formulation and stabilization. `timetable`: times of the run, and which states are
    recorded. `switches`: the switching functions at whose zeros the steps end; None if there are none. `rows`: the rows
    that are recorded; its `HostRows.next_row` belongs to a checkpoint.
    """

    def __init__(
        self,
        method: StepMethod | ExternalMethod,
        workspace: Workspace,
        timetable: Timetable,
        switches: PinnedBundle | None = None,
    ):
        self.switches = switches
        self.method = copy.copy(method) if isinstance(method, ExternalMethod) else method
        self.workspace, self.timetable = workspace, timetable
        self.counters = HostCounters()
        self.finished = False
        self.failure: Failure | None = None
        self.worst_pairs = np.zeros(len(workspace.mechanism.topology.pairs))
        workspace.clamp_motions(*timetable.sides(0))
        z0 = states_at_start(workspace)
        self.control: HostControl | None = None
        if isinstance(self.method, StepMethod) and method.tolerances is not None:
            self.control = HostControl(method.tolerances, self.method.error_order, workspace, timetable, z0)
        self.use(EquationsOfMotion(workspace, z0))
        self.sampler = Sampler(workspace, timetable.samples)
        if self.sampler.is_needed:  # the initial states include the first changes, but outputs may be delayed
            self.sampler.passed(workspace.t0, workspace.q0, workspace.v0, workspace.mechanism.initial_states)
        begin = StepState(self.equations.q0.copy(), self.equations.v0.copy(), z=z0)
        self.now = Reached(
            done=0, whole=0, passed=0, restart=None, time=timetable.start, state=begin, energy=np.zeros(2),
            energy_low=np.zeros(2), interval=IntervalSoFar(), why="start",
            size=math.inf if self.control is None else self.control.first,
        )  # fmt: skip
        self.time = timetable.start
        self.goal = ENDLESS
        self.impacts: list[DriverImpulse] = []
        self._last: LastStep | None = None
        self._recorded: list[RecordedRow] = []
        self._nodes = HostNodes(workspace.mechanism.size, workspace.scratch.sides)
        self._watch = StepWatch(workspace, timetable.guards, self.worst_pairs, method.advice)

    def use(self, equations: EquationsOfMotion) -> None:
        """Let the method use these equations of motion, with the counters of this run, from its start on."""
        method = self.method
        self.equations, equations.counters = equations, self.counters
        equations.first_step = None if method.tolerances is None else self.timetable.step
        self._energies = HostEnergies(equations, equations.has_power)
        self._attempts = StepAttempts(method, equations, self.timetable, self.control, self._energies)
        fixed, multipliers = self._attempts.is_fixed, method.carries_multipliers
        self.rows = HostRows(equations, self.timetable, is_fixed=fixed, carries_multipliers=multipliers)

    @property
    def evidence(self) -> StepEvidence:
        """See `Advancing.evidence`."""
        return self._watch.evidence(self.impacts)

    @property
    def spell(self) -> dict[str, np.ndarray]:
        """What the search for switches passes from one step to the next, by name."""
        return {} if self.switches is None else kept(self.switches.bundle, STATE)

    @property
    def guards(self) -> GuardState:
        """State of the guards."""
        return self._watch.guards

    @property
    def is_fixed(self) -> bool:
        """See `Stepper.is_fixed`."""
        return self._attempts.is_fixed

    @property
    def whole(self) -> int:
        """See `Stepper.whole`."""
        return self.now.whole

    @property
    def passed(self) -> int:
        """See `Stepper.passed`."""
        return self.now.passed

    @property
    def energy(self) -> np.ndarray:
        """See `mbdkit.integrators.run.splitting.Splitting.energy`."""
        return self.now.energy

    @property
    def first_size(self) -> float | None:
        """See `Stepper.first_size`."""
        return self.timetable.step if self.control is None else self.control.first

    def begin_again(self) -> None:
        """See `Stepper.begin_again`."""
        self.finished, self.failure, self.goal, self._last = False, None, ENDLESS, None
        self._nodes.taken()

    def aim(self, goal: Goal) -> None:
        """See `Stepper.aim`."""
        self.goal, self._attempts.pause = goal, goal.pause

    @property
    def at_goal(self) -> bool:
        """See `Stepper.at_goal`."""
        return self.now.whole >= self.goal.whole if self.goal.whole >= 0 else self.time >= self.goal.reached

    @property
    def steps_to_goal(self) -> int:
        """See `Stepper.steps_to_goal`."""
        return 1

    def hold(self, values: Mapping[int, float]) -> None:
        """See `Stepper.hold`."""
        state, z = self.now.state, self.now.state.z.copy()
        z[[*values]] = [*values.values()]
        self.now = self.now._replace(state=replace(state, z=z, low=state.low[:2]), why="stop")

    def continue_from(self, reached: Reached, next_row: int = 1, library: bytes | None = None) -> None:
        """Continue from a point of the run, that of a checkpoint.

        `reached`: the point. `next_row`: number of the next row that is recorded at an interval. `library`: state of
        the library of an `ExternalMethod`.
        """
        self.rows.next_row = next_row
        self._go_to(reached)
        if reached.why != "start":
            self.equations.first_step = None
        is_at_stop = reached.why == "stop" and self._is_at_listed_stop(reached)
        self.workspace.clamp_motions(*self.timetable.sides(reached.passed - is_at_stop))
        if isinstance(self.method, ExternalMethod) and not reached.why:
            counted = vars(self.counters).copy()
            self._open(reached.begin, reached.state)
            assert library is not None
            called(f"{self._attempts.name}.restore", self.method.restore, library)
            vars(self.counters).update(counted)

    @property
    def first_memory(self) -> Any:
        """The memory that the method has before the first step."""
        return self._attempts.begun(
            self.timetable.start, StepState(self.equations.q0, self.equations.v0), "start"
        ).memory

    # ---- begin of a step -----------------------------------------------------------------------------------------

    def begin_step(self) -> None:
        """Apply an event at which the last step has ended; at a discontinuity, apply an impulse and begin anew."""
        self.apply_event()
        if self.now.why:
            self._begin_anew(self.now.why)

    def apply_event(self) -> None:
        """Apply the event at which the last step has ended, if there is one, such as an impact."""
        now = self.now
        if now.event is not None:
            state = now.event.apply(self.equations, now.begin, now.state)
            self._watch.forget_energy()
            gained = np.array([state.work or 0.0, state.dissipated or 0.0])
            self.now = now._replace(state=state, energy=now.energy + gained, event=None)

    def _is_at_listed_stop(self, now: Reached) -> bool:
        """Return whether a point is at a stop of the timetable; an open run also pauses elsewhere."""
        return now.passed > 0 and self.timetable.stops[now.passed - 1] == now.begin

    def _begin_anew(self, why: Why) -> None:
        now, table, t = self.now, self.timetable, self.now.begin
        state, energy = now.state, now.energy
        if why == "stop":
            self.workspace.clamp_motions(*table.sides(now.passed))
            state = StepState(state.q, state.v, memory=state.memory, low=state.low, z=state.z)
            is_listed = self._is_at_listed_stop(now)
            if is_listed and t in table.impacts and not (self.impacts and self.impacts[-1].time == t):
                impact, new = impulse(self.workspace, t, *_with_ground(state), t)
                self.impacts.append(impact)
                self._watch.forget_energy()
                state = replace(state, v=new[: self.equations.n], low=(state.low[0], 0.0, *state.low[2:]))
                energy, why = energy + np.array([impact.energy, 0.0]), "impact"
            if self.sampler.is_needed:
                margin = table.stop_margins[now.passed - 1] if is_listed else 0.0
                z = self.sampler.passed(t, *_with_ground(state), state.z, margin)
                state = replace(state, z=z, low=state.low[:2])
        if why == "projection" and math.isfinite(now.size):
            self.equations.first_step = now.size
        state = self._attempts.begun(t, state, why)
        self.now = now._replace(state=state, energy=energy, why="", history=NO_HISTORY)
        self._open(t, state)

    def _open(self, t: float, state: StepState) -> None:
        if isinstance(self.method, ExternalMethod):
            stop = self._attempts.next_stop(self.now)[0]
            end = self.timetable.end if stop is None else stop
            if self.equations.first_step is not None:
                self.equations.first_step = min(self.equations.first_step, end - t)
            self.equations.longest_step = self.timetable.longest_step(t)
            called(f"{self._attempts.name}.open", self.method.open, self.equations, t, state, end)
            self.equations.first_step = None

    # ---- steps ---------------------------------------------------------------------------------------------------

    def advance(self) -> Stretch:
        """See `Stepper.advance`."""
        until, table = time.perf_counter() + interface.STRETCH, self.timetable
        self._recorded = rows = []
        self._last = None
        while not self.finished and self.failure is None:
            if self.now.done >= table.max_steps:
                self.failure = Failure("max-steps", f"stopped after limits.max_steps = {table.max_steps} steps.")
                break
            before = self.now
            try:
                self.begin_step()
                if (failed := self.sampler.failure) is not None:
                    self.failure = failed
                    break
                before, attempt = self._attempts.accepted(self.now, self.worst_pairs)
                there = attempt.end
                if there.event is not None and there.event.time <= before.begin:
                    # the event is at the start of the step, which is then taken again
                    self.now = before._replace(state=there.state, restart=before.begin, event=there.event)
                    continue
                rows += self._take(before, attempt)
                self.failure = self._watched(before, attempt)
            except StepError as error:
                where = f"in step {before.done + 1} from t = {before.time:.6g} s"
                near = describe_nearness(self.workspace, before.time, with_ground(before.state.q))
                clauses = [near] if near and error.code in ("singular", "step-too-small") else []
                if not (clauses and self.workspace.mechanism.drivers):
                    clauses.append(self.method.advice)
                self.failure = Failure(error.code, f"{error} {where}; {'; '.join(clauses)}.")
                break
            if table.single or self.at_goal or time.perf_counter() > until:
                break
        return self.rows.stretch(rows)

    def rows_before_error(self) -> Stretch | None:
        """See `Advancing.rows_before_error`."""
        return self.rows.stretch(self._recorded) if self._recorded else None

    def last_state(self) -> Stretch:
        """See `Stepper.last_state`."""
        now, self.now = self.now, self.now.recorded()
        return self.rows.stretch([now.row()])

    def taken_nodes(self) -> Nodes:
        """See `Stepper.taken_nodes`."""
        return self._nodes.taken()

    def _take(self, before: Reached, attempt: Attempt) -> list[RecordedRow]:
        table, there = self.timetable, attempt.end
        self._go_to(there)
        if table.single or table.interval is not None or table.nodes:
            z0 = before.state.z
            if len(z0) and (begin := attempt.inside(0.0)) is not None:
                z0 = begin[2]
            ends = (*_with_ground(before.state), *_with_ground(there.state), z0, there.state.z)
            self._last = LastStep(
                before, attempt, StepTaken(before.time, there.time, *ends), self._energies, self.rows.next_row,
                has_dense_output=not self.workspace.stabilization.symmetric,
            )  # fmt: skip
            self._keep_nodes(self._last, there)
        rows, self.now = self.rows.due(before, self._last, there, finished=self.finished)
        return rows

    def _go_to(self, there: Reached) -> None:
        self.now, self.time = there, there.time
        self.counters.steps = self.counters.accepted = there.done
        table = self.timetable
        self.finished = there.whole == table.steps if self._attempts.is_fixed else there.time >= table.end

    def _keep_nodes(self, last: LastStep, end: Reached, theta: float = 1.0) -> None:
        """Store quadrature nodes in a step, or in its share `theta`, which leads to `end`."""
        if self.timetable.nodes:
            dense = (lambda share: last.inside(theta * share)[:2]) if isinstance(self.method, ExternalMethod) else None
            stages = last.attempt.made.stages if theta == 1.0 else None
            self._nodes.keep_step(self.equations, last.before, end, stages, dense)

    def _watched(self, before: Reached, attempt: Attempt) -> Failure | None:
        there, taken = attempt.end, attempt.taken
        result = None if taken.made is taken.reached else (taken.made.q, taken.made.v)
        states = before.state.q, before.state.v, taken.reached.q, taken.reached.v
        return self._watch.step((before.begin, there.time), *states, there.energy - before.energy, result)

    # ---- the last step -------------------------------------------------------------------------------------------

    @property
    def last_step(self) -> StepTaken | None:
        """See `Stepper.last_step`."""
        return None if self._last is None else self._last.ends

    def inside(self, theta: float) -> Moment:
        """See `Stepper.inside`."""
        assert self._last is not None
        return self._last.inside(theta)

    def within(self, theta: float) -> Moment:
        """See `Stepper.within`."""
        last = self._last
        assert last is not None
        if theta in (0.0, 1.0):
            return last.ends.between(theta)
        there = self._again(last, theta)
        if there is None:
            return last.inside(theta)
        return (*_with_ground(there.state), there.state.z)

    def _again(self, last: LastStep, theta: float) -> Reached | None:
        """Return the end of the last step with the fraction `theta` of its size; None if the method cannot repeat it.

        A library gives this state if it has `ExternalMethod.cut`.
        """
        if not isinstance(self.method, ExternalMethod):
            return self._attempts.shortened(last.before, self.now, theta, self.worst_pairs.copy())
        name, t = self._attempts.name, last.ends.time(theta)
        state = called(f"{name}.cut", self.method.cut, t)
        return None if state is None else self._at(last, theta, self._attempts.results.state(state, "cut"))

    def _at(self, last: LastStep, theta: float, state: StepState) -> Reached:
        """Return the point at the share `theta` of the last step with a given state, projected if steps are."""
        t, size = last.ends.time(theta), theta * (last.ends.t1 - last.ends.t0)
        taken = self._attempts.stabilized.project(t, last.before.state, state, self.now.done)
        return self.now._replace(
            state=taken.reached, energy=last.energy(theta), event=None, time=t, restart=None, why="",
            interval=last.before.interval.after(size, 0, 0, taken.correction),
        )  # fmt: skip

    def _shortened(self, last: LastStep, theta: float) -> Reached:
        """Return the point at the share `theta` of the last step, by a repeated step or else by dense output."""
        there = self._again(last, theta) if theta > 0.0 else last.before
        if there is None:
            q, v, z = last.inside(theta)
            n = self.equations.n
            there = self._at(last, theta, replace(last.before.state, q=q[:n], v=v[:n], z=z, low=(0.0, 0.0)))
        return there._replace(time=last.ends.time(theta))

    def cut(self, theta: float) -> Stretch:
        """See `Stepper.cut`."""
        last = self._last
        assert last is not None
        there = self._shortened(last, theta)
        self._nodes.drop_last()
        if theta > 0.0:
            self._keep_nodes(last, there, theta)
        if self.rows.inner and self.rows.inner[0] < there.time:  # that row has the counts of the step
            there = there._replace(interval=IntervalSoFar())
        self._go_to(there)
        self.finished, self.failure = True, None
        return self.last_state()

    def split(self, theta: float) -> tuple[Stretch, list[StepTaken]]:
        """See `mbdkit.integrators.run.splitting.Splitting.split`."""
        last = self._last
        assert last is not None
        before, step = last.before, last.ends
        t, close = step.time(theta), SAME_TIME * margin_of_stops(self.timetable)
        takens: list[StepTaken] = [step]
        if step.t1 - t <= close:
            there = self.now
        else:
            is_start = t - step.t0 <= close
            there = before if is_start else self._shortened(last, theta)
            self.finished, self.failure = False, None
            self._nodes.drop_last()
            takens = []
            if not is_start:
                there = there._replace(whole=before.whole, passed=before.passed, restart=t, is_event=True, event=None)
                self._keep_nodes(last, there, theta)
                q, v = _with_ground(there.state)
                takens = [replace(step, t1=t, q1=q, v1=v, z1=there.state.z)]
        self.rows.next_row = last.next_row
        self._go_to(there)
        rows: list[RecordedRow] = []
        if takens:
            rows, self.now = self.rows.due(before, last, there, end=t, finished=self.finished)
        self._last = last._replace(ends=takens[0]) if takens else None
        return self.rows.stretch(rows), takens

    def change(self, values: Mapping[int, float]) -> None:
        """See `mbdkit.integrators.run.splitting.Splitting.change`."""
        why: Why = "stop" if self.now.why == "stop" else "event"
        self.hold(values)
        self._watch.forget_energy()
        self.now = self.now._replace(state=replace(self.now.state, multipliers=None), why=why)


def _with_ground(state: StepState) -> tuple[np.ndarray, np.ndarray]:
    return with_ground(state.q), with_ground(state.v)
