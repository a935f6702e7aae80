"""Runs compiled methods: calls the step loop, collects recorded states, chooses new pivots, and handles failures."""

from __future__ import annotations

import time
from bisect import bisect
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.counters import Counters
from mbdkit.engine.kernels.bundle_types import RECORD, STATE, kept
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import (
    ENDLESS,
    SAME_TIME,
    Failure,
    Goal,
    Moment,
    Nodes,
    Pace,
    StepEvidence,
    StepTaken,
    Stretch,
    Timetable,
    joined,
)
from mbdkit.integrators.loop import step_loop
from mbdkit.integrators.loop.failed_steps import FailedSteps
from mbdkit.integrators.loop.step_watch import guard_evidence
from mbdkit.integrators.loop.switches import look_for_switches
from mbdkit.integrators.run.impulse import DriverImpulse, impulse
from mbdkit.integrators.run.run_plan import SYMMETRIC, RunPlan, guard_limits, new_plan, projection_mode, single_step
from mbdkit.integrators.run.run_state import (
    FACTORIZATIONS,
    INTERVAL_FIELDS,
    ITERATIONS,
    JACOBIANS,
    MODIFIED,
    PROJECTIONS,
    RHS,
    RunState,
    new_run_state,
)
from mbdkit.integrators.run.sampled_control import Sampler, states_at_start
from mbdkit.integrators.run.splitting import margin_of_stops
from mbdkit.integrators.run.step_control import Control, first_step

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mbdkit.integrators.stages.compiled_method import CompiledMethod


MAX_ROWS = 4096
MAX_ROW_BYTES = 1 << 24  #: Limits of the buffers of recorded states and of quadrature nodes: rows, and bytes.

WORK = ("steps", "last_size", "iterations", "iterations_max", "rejected")
#: Columns of the intervals of the step loop that form ``Stretch.intervals``, after its first column, the time.
WORK_COLUMNS = [INTERVAL_FIELDS.index(name) for name in WORK]

CORRECTIONS = ("projections", "position_correction", "velocity_correction", "baumgarte_term")
#: Columns of the intervals of the step loop that form ``Stretch.corrections``.
CORRECTION_COLUMNS = [INTERVAL_FIELDS.index(name) for name in CORRECTIONS]


class CompiledStepper:
    """Runs a compiled method over a timetable; implements `mbdkit.integrators.interface.Stepper`.

    - `workspace`: the mechanism and its start, with formulation and stabilization.
    - `timetable`: times of the run, and which states are recorded.
    - `control`: step-size control; None: fixed steps.
    - `first_size`: size of the first step [s], if no stop comes earlier.
    - `switches`: the switching functions at whose zeros controlled steps end; None if there are none.
    - `inserted`: stops that `stop_at` has added to those of the timetable [s].
    - `can_take_back`: whether steps can be taken back by restoring the arrays of the run and of the method.
    """

    can_take_back: ClassVar[bool] = True

    def __init__(
        self, method: CompiledMethod, workspace: Workspace, timetable: Timetable, control: Control | None = None
    ):
        self.method, self.workspace, self.timetable = method, workspace, timetable
        self._planned = timetable  # without stops that are inserted later
        self.controlled, self._control = control is not None, control
        self.counters = Counters()
        self.finished = False
        self.failure: Failure | None = None
        self.time = timetable.start
        self.goal = ENDLESS
        self._at_start: list[np.ndarray] = []
        self._unhandled = OK  # status of `takes_steps_to_goal` that `advance` has to handle
        self.switches: PinnedBundle | None = None
        z0 = states_at_start(workspace)
        rows = max(2, min(MAX_ROWS, MAX_ROW_BYTES // (16 * workspace.mechanism.size)))
        stages = method.stages if timetable.nodes else 0
        nodes = stages * -(-rows // max(1, stages))
        self.pinned_state = PinnedBundle(
            new_run_state(workspace, rows, z0, own_multipliers=method.carries_multipliers, stages=stages, nodes=nodes)
        )
        self.run_state.nodes[0] = method.keep.address if timetable.nodes else 0
        if control is not None:
            dense = method.dense.address if method.dense is not None and method.has_dense_output else 0
            self.switches = look_for_switches(dense, workspace, timetable.end - timetable.start)
        self._state = self._kept(STATE)
        self._first_node = 0  # index of the first node of the last step
        self._new_plan()
        self.worst_pairs = self.run_state.worst
        self.failed_steps = FailedSteps(method, workspace, timetable, self.pinned_state, self.plan)
        workspace.clamp_motions(*timetable.sides(0))
        size = timetable.step
        if control is not None:
            span = timetable.end - timetable.start
            size = min(span, size if size is not None else first_step(workspace, span, control, z0))
        assert size is not None
        self.first_size = size
        if control is not None:  # below tolerances, as in the tail of a pulse, energies have no digits to be compared
            mass = float(np.sum(workspace.mechanism.topology.mass[:-1, 0]))
            self.run_state.guards.kinetic[0] = 0.5 * mass * (control.atol * control.length) ** 2
        progress = self.run_state.progress
        progress.time[0], progress.next_row[0], progress.next_size[0] = timetable.start, 1.0, size
        method.start(self.run_state, size)
        self.failed_steps.take_up_pivots()
        self._dense = method.dense.address if method.dense is not None else 0
        self.mode = projection_mode(workspace.stabilization, controlled=control is not None)
        iterates = method.carries_stages or self.mode == SYMMETRIC
        self.pace = Pace(max(1, min(16 if iterates else 256, 100_000 // workspace.mechanism.size)))
        self.impacts: list[DriverImpulse] = []
        self.inserted: list[float] = []
        self._take_first_samples()
        self.last_step: StepTaken | None = None
        self._before: list[np.ndarray] = []
        self._row_times = np.zeros(0)
        self._last_rows = self.collect(0)
        self.drive(self.pinned_plan, 0)  # compiles or loads the step loop before the first step is timed

    def drive(self, plan: PinnedBundle, budget: int, path: int = 0) -> tuple[int, int]:
        """Attempt up to `budget` steps of a plan in compiled code; return the status and the number of rows written.

        `path` is the address of the `StepPath` that receives the steps, if any.
        """
        method = self.method
        status, rows = step_loop.drive(
            self.pinned_state.address,
            method.pinned.address,
            method.attempt.address,
            self._dense,
            plan.address,
            budget,
            path,
        )
        return int(status), int(rows)

    def _drive_extended(self) -> tuple[int, int]:
        """Attempt one step with an increased limit of iterations; restore the limit if the step is accepted."""
        accepted = self._accepted
        status, rows = self.drive(self.pinned_plan, 1)
        if self._accepted > accepted or self.is_pending:
            self.method.restore_iterations()
        return status, rows

    @property
    def run_state(self) -> RunState:
        """State, work arrays and results of the run."""
        return self.pinned_state.bundle

    @property
    def _accepted(self) -> int:
        return int(self.run_state.progress.accepted[0])

    @property
    def is_pending(self) -> bool:
        """Whether rows of an accepted step have not been written yet."""
        return bool(self.run_state.progress.pending[0])

    @property
    def steps_left(self) -> int:
        """Number of steps left before ``limits.max_steps``."""
        return self.timetable.max_steps - self._accepted

    @property
    def is_fixed(self) -> bool:
        """See `Stepper.is_fixed`."""
        return not self.controlled

    @property
    def whole(self) -> int:
        """See `Stepper.whole`."""
        return int(self.run_state.progress.whole[0])

    @property
    def passed(self) -> int:
        """See `Stepper.passed`."""
        return int(self.run_state.progress.passed[0])

    @property
    def energy(self) -> np.ndarray:
        """See `mbdkit.integrators.run.splitting.Splitting.energy`."""
        return self.run_state.energy

    def begin_again(self) -> None:
        """See `Stepper.begin_again`."""
        self.finished, self.failure, self.goal, self.last_step = False, None, ENDLESS, None
        self._unhandled = OK
        self.run_state.first_row[0] = 0
        self.run_state.nodes[1] = 0
        if self.inserted:
            self.inserted.clear()
            self.timetable = self._planned
            self._new_plan()

    def aim(self, goal: Goal) -> None:
        """See `Stepper.aim`."""
        self.goal = goal
        self.run_state.progress.pause[0] = goal.pause

    @property
    def at_goal(self) -> bool:
        """See `Stepper.at_goal`."""
        progress = self.run_state.progress
        if self._unhandled != OK:
            return False
        if self.goal.whole >= 0:
            return bool(progress.whole[0] >= self.goal.whole and not progress.pending[0])
        return bool(progress.time[0] >= self.goal.reached)

    @property
    def steps_to_goal(self) -> int:
        """See `Stepper.steps_to_goal`."""
        whole = self.goal.whole
        return whole - int(self.run_state.progress.whole[0]) if whole >= 0 else self.steps_left

    def hold(self, values: Mapping[int, float]) -> None:
        """See `Stepper.hold`."""
        c = self.run_state
        for state, value in values.items():
            c.z[state] = value
        c.z_low[self.sampler.held] = 0.0
        c.base_state[0] = MODIFIED
        self.method.forget()

    def takes_steps_to_goal(self) -> bool:
        """Take fixed steps to the goal in one call of compiled code, and leave their rows in the buffer.

        Returns False if something else has to be done before the goal is reached, for which `advance` is to be called.
        The counters are not updated.
        """
        c, whole = self.pinned_state.bundle, self.goal.whole
        progress = c.progress
        steps = min(whole - progress.whole.item(), self.timetable.max_steps - progress.accepted.item())
        if steps <= 0 or progress.after_stop[0] or self.method.is_extended:
            return False
        status, c.first_row[0] = self.drive(self.pinned_plan, steps)
        if status not in (OK, step_loop.AT_STOP):
            self._unhandled = status
            return False
        self.time = progress.time.item()
        return bool(progress.whole[0] == whole) and not progress.pending[0]

    def keep_start(self) -> None:
        """Keep the state at the start, before the first step, for `restart`."""
        if not (self.method.prepares or self.timetable.nodes):
            self._at_start = [x.copy() for x in self._arrays()]

    def restart(self) -> bool:
        """Return to the start, with the inputs that the workspace has now; False if a new stepper is needed for that.

        Explicit methods that have chosen no pivots can return to the start, after `keep_start`.
        """
        workspace, c = self.workspace, self.run_state
        if not self._at_start or workspace.pivotings or workspace.solver.pivoted[0]:
            return False
        for now, then in zip(self._arrays(), self._at_start, strict=True):
            now[...] = then
        workspace.clamp_motions(*self._planned.sides(0))
        self.begin_again()
        self._take_first_samples()
        for z in (c.z, c.from_z, c.before_z):
            z[:] = states_at_start(workspace)
        self.count()
        return True

    def _arrays(self) -> tuple[np.ndarray, ...]:
        return self._kept(STATE, RECORD)

    def _kept(self, *roles: str) -> tuple[np.ndarray, ...]:
        return *kept(self.run_state, *roles).values(), *self.kept_of_method(*roles).values()

    def kept_of_method(self, *roles: str) -> dict[str, np.ndarray]:
        """Return the arrays of the method and of its search for switches that are declared with these roles."""
        own = self.method.kept(*roles)
        return own if self.switches is None else own | kept(self.switches.bundle, *roles)

    def _take_first_samples(self) -> None:
        """Let the sampler store the outputs of the first samples; the initial states include the first changes."""
        workspace = self.workspace
        self.sampler = Sampler(workspace, self.timetable.samples)
        if self.sampler.is_needed:
            self.sampler.passed(workspace.t0, workspace.q0, workspace.v0, workspace.mechanism.initial_states)

    def advance(self) -> Stretch:
        """See `Stepper.advance`."""
        if not self.timetable.single:
            return self._advance(self.pace.steps)
        accepted, t0 = self._accepted, self.time
        self.begin_after_stop()
        self.method.serve()
        self._first_node = int(self.run_state.nodes[1])
        self.last_step, self._before = None, [x.copy() for x in self._memory()]
        stretches = [self._advance(1)]
        while self.is_pending and self.failure is None:
            stretches.append(self._advance(0))
        stretch = joined(stretches)
        if self._accepted > accepted:
            c = self.run_state
            self._row_times, self._last_rows = stretch.time, stretch
            self.last_step = StepTaken(
                t0, self.time, c.before_q.copy(), c.before_v.copy(), c.q.copy(), c.v.copy(), c.before_z.copy(),
                c.z.copy(),
            )  # fmt: skip
        return stretch

    def _advance(self, budget: int) -> Stretch:
        begin = time.perf_counter()
        before = self._attempts()
        stretches: list[Stretch] = []
        is_paused = False
        while True:
            left = min(budget - self._attempts() + before, self.steps_left, self.steps_to_goal)
            if left <= 0 and not self.is_pending and stretches:
                status = OK
                break
            if not is_paused:
                self.begin_after_stop()  # not earlier: the recorded state at a stop is that before its impulse
            status, rows = OK, int(self.run_state.first_row[0])
            if self._unhandled != OK:
                status, self._unhandled = self._unhandled, OK
            elif self.failure is None and (self.steps_left > 0 or self.is_pending):
                status, rows = (
                    self._drive_extended() if self.method.is_extended else self.drive(self.pinned_plan, max(left, 0))
                )
            stretches.append(self.collect(rows))
            is_paused = status == step_loop.PAUSED
            if is_paused:
                self.method.resume()
                if self.timetable.single:  # the step begins with the state after the event
                    self._before = [x.copy() for x in self._memory()]
            elif status != step_loop.AT_STOP:
                break
            status = OK
            if self.at_goal:
                break
        if not self.timetable.single:
            self.pace.timed(self._attempts() - before, begin)
        self.conclude(status)
        return joined(stretches)

    def conclude(self, status: int) -> None:
        """React to the status of the step loop after its last call: count, and handle a failed step or the end."""
        self.count()
        if status != OK:
            self.failure = self.failed_steps.handle(status)
        elif self.failure is not None or self.is_pending:
            pass
        elif self.time >= self.timetable.end:
            self.finished, self.time = True, self.timetable.end
        elif self.steps_left <= 0:
            self.failure = Failure("max-steps", f"stopped after limits.max_steps = {self.timetable.max_steps} steps.")

    def begin_after_stop(self) -> None:
        """At a stop, discard the values that the method stores for the next step, and apply an impulse if there is one.

        The call is repeated before another attempt at the first step after the stop; it then has no effect.
        """
        c, table = self.run_state, self.timetable
        progress = c.progress
        if self._control is not None and table.step_limits:
            t = float(progress.restart[0] if progress.after_stop[0] else progress.time[0])
            self.plan.control.max_size[0] = min(self._control.max_step, table.longest_step(t))
        if not progress.after_stop[0] or progress.pending[0] or progress.retrying[0]:
            return
        c.base_state[0] = MODIFIED
        self.method.forget()
        passed = int(progress.passed[0])
        self.workspace.clamp_motions(*table.sides(passed))
        stop, at = table.stops[passed - 1] if passed else -np.inf, float(progress.restart[0])
        margin = table.stop_margins[passed - 1] if stop == at else 0.0  # otherwise, an open run has paused
        if self.sampler.is_needed:
            c.z[:] = self.sampler.passed(at, c.q, c.v, c.z, margin)
            c.z_low[self.sampler.held] = 0.0
            if (failed := self.sampler.failure) is not None:
                self.failure = failed
                return
        if stop != at:
            return
        if stop in table.impacts and not (self.impacts and self.impacts[-1].time == stop):
            try:
                impact, v = impulse(self.workspace, float(progress.restart[0]), c.q, c.v, stop)
            except StepError as error:
                self.failure = Failure(error.code, f"{error} at the impulse of a driver at t = {stop:.6g} s.")
                return
            self.failed_steps.take_up_pivots()
            c = self.run_state
            c.v[:], c.v_low[:] = v, 0.0
            c.energy[0] += impact.energy
            c.guards.energy[0] = np.nan
            self.impacts.append(impact)

    @property
    def evidence(self) -> StepEvidence:
        """See `Stepper.evidence`."""
        return guard_evidence(self.run_state.guards, self.impacts)

    @property
    def has_dense_output(self) -> bool:
        """Whether states within a step are computed by the method; otherwise, they are interpolated."""
        return self._dense != 0 and self.method.has_dense_output and self.mode != SYMMETRIC

    def _attempts(self) -> int:
        return self._accepted + int(self.run_state.progress.rejected[0])

    def _memory(self) -> tuple[np.ndarray, ...]:
        """Return the arrays of the previous step that the next step reads, and the quadrature nodes stored so far."""
        return *self._state, *self._node_arrays()

    def _recall(self, memory: list[np.ndarray]) -> None:
        for now, then in zip(self._memory(), memory, strict=True):
            now[...] = then

    def inside(self, theta: float) -> Moment:
        """See `Stepper.inside`."""
        step, c = self.last_step, self.run_state
        assert step is not None
        if not self.has_dense_output:
            return self._between(step, theta)
        t, h = float(c.progress.tried_begin[0]), float(c.progress.last_size[0])
        run, method = self.pinned_state.address, self.method.pinned.address
        if step_loop.look_inside(run, method, self._dense, t, h, theta, self.mode) != OK:
            return step.between(theta)
        return c.point_q.copy(), c.point_v.copy(), c.point_z.copy()

    def _between(self, step: StepTaken, theta: float) -> Moment:
        """Return the state at the share `theta` of a step by interpolation.

        First-order states z are interpolated by a parabola, if z' at the start of the step is known.
        """
        q, v, z = step.between(theta)
        rates = getattr(self.method.pinned.bundle, "z_rates", None)
        if rates is not None and len(z):
            z = z + theta * (1.0 - theta) * ((step.t1 - step.t0) * rates[0] + step.z0 - step.z1)
        return q, v, z

    def within(self, theta: float) -> Moment:
        """See `Stepper.within`."""
        step = self.last_step
        assert step is not None
        if theta in (0.0, 1.0):
            return step.between(theta)
        after = [x.copy() for x in self._memory()]
        done = self._retake(step, theta)
        c = self.run_state
        q, v, z = c.q.copy(), c.v.copy(), c.z.copy()
        self._recall(after)
        self.count()
        return (q, v, z) if done else self.inside(theta)

    def _retake(self, step: StepTaken, theta: float) -> bool:
        """Return to the start of the last step and take the share `theta` of it; return whether that succeeded.

        The progress of the run is reset to that before the step, except for the time; `worst` is unchanged.
        """
        c, progress = self.run_state, self.run_state.progress
        begin, size = float(progress.tried_begin[0]), theta * float(progress.last_size[0])
        self._recall(self._before)
        c.base_state[0] = MODIFIED
        due = (self._accepted + 1) % self.workspace.stabilization.every == 0
        plan: RunPlan = single_step(self.plan, begin, size, projected=due)
        counts = progress.counts
        worst, before = c.worst.copy(), [x.copy() for x in counts]
        for x in counts:
            x[0] = 0
        single = PinnedBundle(plan)
        status, _ = self.drive(single, 1)
        if status == step_loop.PAUSED:  # after an event at the start
            status, _ = self.drive(single, 1)
        done = status == OK and self._accepted == 1
        for x, value in zip(counts, before, strict=True):
            x[:] = value
        c.worst[:] = worst
        return done

    def cut(self, theta: float) -> Stretch:
        """See `Stepper.cut`."""
        step, c = self.last_step, self.run_state
        progress, interval = c.progress, c.interval
        assert step is not None
        size, ends = float(progress.last_size[0]), c.energy.copy()
        inner, whole = self.inside(theta), [x.copy() for x in self._node_arrays()]
        if theta > 0.0:
            if not self._retake(step, theta):  # use dense output instead
                self._recall(self._before)
                c.q[:], c.v[:], c.z[:] = inner
                c.energy[:] += theta * (ends - c.energy)
                for now, then in zip(self._node_arrays(), whole, strict=True):
                    now[...] = then
                self._node_arrays()[2][...] *= theta
            progress.accepted[0] += 1
        else:
            self._recall(self._before)
        before = zip(self._memory(), self._before, strict=True)
        interval.values[:] = next(then for now, then in before if now is interval.values)
        progress.pending[0] = 0
        progress.time[0] = step.time(theta)
        # A row recorded earlier in the step contains all counts so far, so that a new interval begins.
        if np.any(self._row_times < step.time(theta)):
            interval.values[:] = 0.0
        if theta > 0.0:
            interval.steps[0] += 1
            interval.last_size[0] = theta * size
        self.count()
        self.finished, self.failure = True, None
        return self.last_state()

    def stop_at(self, t: float) -> None:
        """Let a step end at time `t` [s], which must be later than the last stop that the run has passed."""
        table, margin = self.timetable, margin_of_stops(self.timetable)
        index = bisect(table.stops, t)
        self.inserted.append(t)
        self.timetable = replace(
            table,
            stops=(*table.stops[:index], t, *table.stops[index:]),
            stop_margins=(*table.stop_margins[:index], margin, *table.stop_margins[index:]),
        )
        self._new_plan()

    def _new_plan(self) -> None:
        limits = guard_limits(self.workspace.mechanism, self.timetable.guards)
        self.plan = new_plan(self.timetable, self._control, self.workspace.stabilization, limits)
        self.pinned_plan = PinnedBundle(self.plan)

    def split(self, theta: float) -> tuple[Stretch, list[StepTaken]]:
        """See `mbdkit.integrators.run.splitting.Splitting.split`."""
        step, c = self.last_step, self.run_state
        assert step is not None
        t, close = step.time(theta), SAME_TIME * margin_of_stops(self.timetable)
        stretches, steps = [self._last_rows], [step]
        if step.t1 - t > close:
            self._recall(self._before)
            self.finished, self.failure, self.last_step = False, None, None
            self.count()
            stretches, steps = [self.collect(0)], []
            if t - step.t0 > close:
                self.stop_at(t)
                self.workspace.clamp_motions(*self.timetable.sides(int(c.progress.passed[0])))
                while self.failure is None and self.time < t - close:
                    stretches.append(self.advance())
                    steps += [] if self.last_step is None else [self.last_step]
        return joined(stretches), steps

    def change(self, values: Mapping[int, float]) -> None:
        """See `mbdkit.integrators.run.splitting.Splitting.change`."""
        c = self.run_state
        c.z_low[:], c.progress.retrying[0], c.guards.energy[0] = 0.0, 0, np.nan
        self.hold(values)

    def count(self) -> None:
        """Copy counts and time from the records of the compiled code."""
        counts, counters, progress = self.run_state.counts, self.counters, self.run_state.progress
        counters.rhs_evaluations, counters.jacobian_evaluations = int(counts[RHS]), int(counts[JACOBIANS])
        counters.factorizations, counters.newton_iterations = int(counts[FACTORIZATIONS]), int(counts[ITERATIONS])
        counters.projections = int(counts[PROJECTIONS])
        counters.accepted, counters.rejected = int(progress.accepted[0]), int(progress.rejected[0])
        counters.steps = counters.accepted
        self.time = float(progress.time[0])

    def _stretch(
        self, states: tuple[np.ndarray, ...], energy: np.ndarray, interval: np.ndarray, lam: np.ndarray
    ) -> Stretch:
        """Return recorded rows as a `Stretch`, with copies of their arrays.

        `states` are times, positions, velocities and first-order states. `lam` (T, P, 2) are the multipliers by pair,
        if the method itself computes multipliers.
        """
        time, q, v, z = states
        rows, own = self.workspace.mechanism.rows, None
        if self.method.carries_multipliers:
            own = np.ascontiguousarray(lam[:, [row.pair for row in rows], [row.place for row in rows]])
        work = np.column_stack([time, interval[:, WORK_COLUMNS]])
        stabilized = self.workspace.stabilization.kind != "none"
        corrections = interval[:, CORRECTION_COLUMNS].copy() if stabilized else None
        gain, lost = energy[:, 0].copy(), energy[:, 1].copy()
        return Stretch(time, q, v, gain, lost, work, multipliers=own, corrections=corrections, z=z)

    def collect(self, rows: int) -> Stretch:
        """Return the rows that the step loop has written."""
        c, some = self.run_state, slice(rows)
        c.first_row[0] = 0
        states = c.row_time[some].copy(), c.row_q[some].copy(), c.row_v[some].copy(), c.row_z[some].copy()
        return self._stretch(states, c.row_energy[some], c.row_interval[some], c.row_lam[some])

    def _node_arrays(self) -> tuple[np.ndarray, ...]:
        """Return the number of quadrature nodes that have been stored, and those of the last step."""
        c, some = self.run_state, slice(self._first_node, self._first_node + int(self.run_state.nodes[2]))
        return c.nodes, c.node_time[some], c.node_weight[some], c.node_q[some], c.node_v[some]

    def taken_nodes(self) -> Nodes:
        """See `Stepper.taken_nodes`."""
        c = self.run_state
        some = slice(int(c.nodes[1]))
        c.nodes[1] = 0
        return Nodes(*(x[some].copy() for x in (c.node_time, c.node_weight, c.node_q, c.node_v)))

    def rows_before_error(self) -> Stretch | None:
        """See `Advancing.rows_before_error`."""
        return None

    def last_state(self) -> Stretch:
        """See `Stepper.last_state`."""
        c = self.run_state
        interval = c.interval.values[None].copy()
        c.interval.values[:] = 0.0
        states = np.array([self.time]), c.q[None].copy(), c.v[None].copy(), c.z[None].copy()
        return self._stretch(states, c.energy[None], interval, c.own_lam[None])
