"""The Python side of every compiled method: stretches, rows, new pivots, failures, and looks inside steps."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.jit.bundle import PinnedBundle
from mbdkit.engine.kernels.system import DIVERGED, NOT_FINITE, OK, REPIVOT, REPIVOT_STAGES
from mbdkit.engine.singularity import describe_nearness, nearest_singularity
from mbdkit.engine.workspace import Workspace
from mbdkit.stepping import driver
from mbdkit.stepping.interface import Counters, Failure, Pace, StepTaken, Stretch, Timetable, joined
from mbdkit.stepping.projected_step import NO_PROJECTION, PLAIN, SYMMETRIC
from mbdkit.stepping.run_state import ALTERED, FACTORIZATIONS, ITERATIONS, JACOBIANS, PROJECTIONS, RHS, new_common
from mbdkit.stepping.step_control import FIXED_STEPS, Control, first_step

if TYPE_CHECKING:
    from mbdkit.stepping.compiled_method import Family

SINGULAR, REGULAR = 1e-6, 1e-2
"""Distance to singularity of a state that counts as singular, and of one where nothing singular is near."""

MOST_ROWS = 4096
ROW_BYTES = 1 << 24
"""Bounds on the buffer of recorded states: rows, and bytes."""

FLOOR = 16 * float(np.finfo(float).eps)
"""The least size of a step, relative to the largest time of the run."""


class CompiledStepper:
    """Runs a compiled method over a timetable; see `mbdkit.stepping.interface.Stepper`.

    Parameters
    ----------
    family
        The method, of its family.
    workspace
        The mechanism and its start, with formulation and stabilization.
    timetable
        When, and what is recorded.
    control
        How the size of steps is controlled; None: fixed steps.
    """

    def __init__(self, family: Family, workspace: Workspace, timetable: Timetable, control: Control | None = None):
        self.family, self.workspace, self.timetable = family, workspace, timetable
        self.controlled, self.control = control is not None, control or FIXED_STEPS
        self.counters = Counters()
        self.finished = False
        self.failure: Failure | None = None
        self.time = timetable.start
        rows = max(2, min(MOST_ROWS, ROW_BYTES // (16 * workspace.mechanism.size)))
        self.common = new_common(workspace, rows, own_multipliers=family.carries_multipliers)
        self.hold = PinnedBundle(self.common)
        self.worst_pairs = self.common.worst
        self.numbers = np.zeros(4, dtype=np.int64)
        clock = self.common.clock
        clock[driver.TIME], clock[driver.NEXT_ROW] = timetable.start, 1.0
        self._renewed: set[tuple[int, int]] = set()
        span = timetable.end - timetable.start
        self.floor = FLOOR * max(abs(timetable.start), abs(timetable.end), span)
        size = timetable.step
        if self.controlled:
            size = min(span, size if size is not None else first_step(workspace, span, self.control))
        assert size is not None
        clock[driver.SIZE] = size
        family.start(self.common, size)
        self._take_up_pivots()
        self._dense = family.dense.address if family.dense is not None else 0
        self.mode, stab = NO_PROJECTION, workspace.stabilization
        if stab.kind == "projection":
            self.mode = SYMMETRIC if stab.symmetric else PLAIN
        iterates = family.carries_stages or self.mode == SYMMETRIC
        self.pace = Pace(max(1, min(16 if iterates else 256, 100_000 // workspace.mechanism.size)))
        self.last_step: StepTaken | None = None
        self._before: list[np.ndarray] = []
        self._row_times = np.zeros(0)
        self._drive(0)

    def _drive(self, budget: int) -> tuple[int, int]:
        """Take up to `budget` steps in compiled code; return (status, rows)."""
        table, control, family, stab = self.timetable, self.control, self.family, self.workspace.stabilization
        step = table.step or 0.0
        status, rows = driver.drive(
            self.hold.address, family.hold.address, family.attempt.address, self._dense, self.numbers,
            budget, self.controlled,
            table.start, step, table.end, table.steps, step if self.controlled else table.last_step,
            0 if table.interval is not None else table.every, table.interval or 0.0,
            control.inner_rtol, control.inner_atol, control.exponent, control.share, control.estimates, self.floor,
            self.mode, stab.every, stab.bound or 0.0, stab.kind == "baumgarte", table.single,
        )  # fmt: skip
        return int(status), int(rows)

    @property
    def _allowed(self) -> int:
        """How many more steps may be taken."""
        return self.timetable.max_steps - int(self.numbers[driver.ACCEPTED])

    def advance(self) -> Stretch:
        """Go on for about `STRETCH` seconds, or for one step; see `Stepper.advance`."""
        if not self.timetable.single:
            return self._advance(self.pace.steps)
        accepted, t0 = int(self.numbers[driver.ACCEPTED]), self.time
        self.last_step, self._before = None, [x.copy() for x in self._memory()]
        stretches = [self._advance(1)]
        while self.numbers[driver.PENDING] and self.failure is None:  # rows inside the step are still to be written
            stretches.append(self._advance(1))
        stretch = joined(stretches)
        if self.numbers[driver.ACCEPTED] > accepted:
            c = self.common
            self._row_times = stretch.time
            self.last_step = StepTaken(t0, self.time, c.before_q.copy(), c.before_v.copy(), c.q.copy(), c.v.copy())
        return stretch

    def _advance(self, budget: int) -> Stretch:
        begin = time.perf_counter()
        before = int(self.numbers.sum())
        if self._allowed > 0 or self.numbers[driver.PENDING]:
            status, rows = self._drive(min(budget, max(self._allowed, 0)))
        else:
            status, rows = OK, 0
        if not self.timetable.single:
            self.pace.timed(int(self.numbers[:2].sum()) - before, begin)
        self._count()
        stretch = self._collect(rows)
        if status != OK:
            self._handle(status)
        elif self.time >= self.timetable.end and not self.numbers[driver.PENDING]:
            self.finished, self.time = True, self.timetable.end
        elif self._allowed <= 0 and not self.numbers[driver.PENDING]:
            self.failure = Failure("max-steps", f"stopped after limits.max_steps = {self.timetable.max_steps} steps.")
        return stretch

    def _memory(self) -> tuple[np.ndarray, ...]:
        """Return the arrays that a step starts from, and those that it leaves for looks inside."""
        c = self.common
        return (
            c.tally, self.numbers, c.clock, c.moved, c.q, c.q_low, c.v, c.v_low, c.energy, c.energy_low,
            c.from_q, c.from_v, c.shift_q, c.shift_v, c.mu, c.nu, *self.family.memory,
        )  # fmt: skip

    def _recall(self, memory: list[np.ndarray]) -> None:
        for now, then in zip(self._memory(), memory, strict=True):
            now[...] = then

    def inside(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        """Return a state in the last step by dense output, or the cubic through its ends; see `Stepper.inside`."""
        step, c = self.last_step, self.common
        assert step is not None
        if self._dense == 0 or not self.family.has_dense_output or self.mode == SYMMETRIC:
            return step.hermite(theta)
        h = float(c.clock[driver.TAKEN])
        status = driver.look_inside(self.hold.address, self.family.hold.address, self._dense, step.t0, h, theta)
        if status != OK:
            return step.hermite(theta)
        q, v = c.point_q.copy(), c.point_v.copy()
        if self.mode == PLAIN:
            fade = theta * theta * (3.0 - 2.0 * theta)
            q, v = q + fade * c.shift_q, v + fade * c.shift_v
        return q, v

    def within(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        """Return a state in the last step by a step of the method to there; see `Stepper.within`."""
        step = self.last_step
        assert step is not None
        if theta in (0.0, 1.0):
            return (step.q1, step.v1) if theta else (step.q0, step.v0)
        after = [x.copy() for x in self._memory()]
        done = self._again(step, theta)
        q, v = self.common.q.copy(), self.common.v.copy()
        self._recall(after)
        self._count()
        return (q, v) if done else self.inside(theta)

    def _again(self, step: StepTaken, theta: float) -> bool:
        """Go back before the last step and take a share of it instead; return whether that succeeded."""
        c, stab, family = self.common, self.workspace.stabilization, self.family
        size = theta * float(c.clock[driver.TAKEN])
        self._recall(self._before)
        c.moved[0] = ALTERED
        due = (self.numbers[driver.ACCEPTED] + 1) % stab.every == 0
        worst, numbers = c.worst.copy(), np.zeros(4, dtype=np.int64)
        status, _ = driver.drive(  # a run of one fixed step
            self.hold.address, family.hold.address, family.attempt.address, self._dense, numbers, 1, False,
            step.t0, size, step.t0 + size, 1, size, 2, 0.0, 1.0, 1.0, 1.0, 0.0, 1, 0.0,
            self.mode, 1 if due else 2, stab.bound or 0.0, False, False,
        )  # fmt: skip
        c.worst[:] = worst
        return bool(status == OK and numbers[driver.ACCEPTED] == 1)

    def cut(self, theta: float) -> Stretch:
        """End the run within the last step; see `Stepper.cut`."""
        step, c = self.last_step, self.common
        assert step is not None
        size, ends = float(c.clock[driver.TAKEN]), c.energy.copy()
        inner = self.inside(theta)
        if theta > 0.0:
            if not self._again(step, theta):  # the step that led here could be taken, but none to this place
                self._recall(self._before)
                c.q[:], c.v[:] = inner
                c.energy[:] += theta * (ends - c.energy)
            self.numbers[driver.ACCEPTED] += 1
        else:
            self._recall(self._before)
        c.tally[:] = self._before[0]
        self.numbers[driver.PENDING] = 0
        c.clock[driver.TIME] = step.time(theta)
        if np.any(self._row_times < step.time(theta)):  # rows inside the step have told of what was before it
            c.tally[:] = 0.0
        if theta > 0.0:
            c.tally[driver.STEPS] += 1
            c.tally[driver.LAST_SIZE] = theta * size
        self._count()
        self.finished, self.failure = True, None
        return self.last_state()

    def _count(self) -> None:
        counts, counters = self.common.counts, self.counters
        counters.rhs_evaluations, counters.jacobian_evaluations = int(counts[RHS]), int(counts[JACOBIANS])
        counters.factorizations, counters.newton_iterations = int(counts[FACTORIZATIONS]), int(counts[ITERATIONS])
        counters.projections = int(counts[PROJECTIONS])
        counters.accepted = int(self.numbers[driver.ACCEPTED])
        counters.rejected = int(self.numbers[driver.ALL_REJECTED])
        counters.steps = counters.accepted
        self.time = float(self.common.clock[driver.TIME])

    def _size_tried(self) -> float:
        """Return the size of the step that is being tried."""
        if self.controlled:
            return float(self.common.clock[driver.SIZE])
        table = self.timetable
        assert table.step is not None
        return table.step if self.numbers[driver.ACCEPTED] < table.steps - 1 else table.last_step

    def _handle(self, status: int) -> None:
        """Renew pivots once a step, try a smaller step where steps are controlled, or note why the run stops."""
        done = int(self.numbers[driver.ACCEPTED])
        where = f"in step {done + 1} from t = {self.time:.6g} s"
        if unusable := self._unusable():
            if not (self.controlled and status != driver.TOO_SMALL and self._shrink()):
                self.failure = Failure("not-finite", f"{unusable} {where}.")
            return
        if status in (REPIVOT, REPIVOT_STAGES) and not self.workspace.is_finite():
            status = DIVERGED if self.family.carries_stages else NOT_FINITE
        singular: SingularSystemError | None = None
        if status != NOT_FINITE and (done, status) not in self._renewed:
            try:
                if self._renew(status):
                    self._renewed = {pair for pair in self._renewed if pair[0] == done} | {(done, status)}
                    return
            except SingularSystemError as error:
                singular = error
        apart = (done, -1)
        if status not in (driver.TOO_SMALL, NOT_FINITE) and self.mode != SYMMETRIC and apart not in self._renewed:
            self._renewed.add(apart)
            solved = self.family.solve_apart(self.common, self.time, self._size_tried())
            self._take_up_pivots()
            if solved:
                return
        if self.controlled and status != driver.TOO_SMALL and self._shrink():
            return
        self.failure = self._failure(status, singular, where)
        near = "" if self.failure.code == "not-finite" else describe_nearness(self.workspace, self.time, self.common.q)
        if near:
            self.failure = replace(self.failure, sentence=f"{self.failure.sentence.rstrip('.')}; {near}.")

    def _unusable(self) -> str:
        """Return which force or motion was not finite where it was evaluated last; empty where all were."""
        if not self.workspace.motions_are_finite():
            return "a driver or load is not a finite number"
        if force := self.workspace.unusable_law():
            return f"the law of force '{force}' gives no finite number"
        return ""

    def _renew(self, status: int) -> bool:
        """Choose new pivots after `status`; return whether that can help. Raises SingularSystemError."""
        if status == driver.TOO_SMALL:
            return False
        self.common.moved[0] = ALTERED
        if status == REPIVOT:
            self.workspace.use_pivots()
            self.family.forget()
            self._take_up_pivots()
            return True
        helped = self.family.renew(self.common, self.time, self._size_tried())
        self._take_up_pivots()
        return helped

    def _take_up_pivots(self) -> None:
        """Go on with the workspace's solver as it is now."""
        self.common = self.common._replace(solver=self.workspace.solver)
        self.hold.replace(self.common)

    def _shrink(self) -> bool:
        """Count the step that is being tried as rejected, and try a smaller one; return whether there is room."""
        clock = self.common.clock
        clock[driver.SIZE] *= driver.AFTER_FAILURE
        self.numbers[driver.ALL_REJECTED] += 1
        self.common.tally[driver.REJECTED] += 1
        self.common.moved[0] = ALTERED
        self._renewed.clear()
        return bool(clock[driver.SIZE] > self.floor)

    def _failure(self, status: int, singular: SingularSystemError | None, where: str) -> Failure:
        """Return why the run stops."""
        hint, workspace = self.family.hint, self.workspace
        distance, _ = nearest_singularity(workspace, self.time, self.common.q)
        if status == driver.TOO_SMALL:
            if distance < SINGULAR:
                return Failure("singular", f"steps became smaller without end {where}.")
            return Failure(
                "step-too-small", f"the step fell below {self.floor:.2g} s {where}; looser tolerances may help."
            )
        if status == NOT_FINITE:
            return Failure("not-finite", f"numbers overflowed {where}; {hint}.")
        if status == DIVERGED:
            return Failure("newton-failed", f"{where}{self.family.describe_divergence(self.common.report)}; {hint}.")
        if singular is not None:
            name = workspace.mechanism.unknown_name(singular.index)
        else:
            index, column = int(workspace.solver.failed[0]), workspace.solver.pattern.column_of
            name = workspace.mechanism.unknown_name(int(column[index]) if 0 <= index < len(column) else -1)
        if self.family.carries_stages and distance > REGULAR:
            what = f"{where}: the stage iteration strayed to where no independent equations are left at {name}"
            return Failure("newton-failed", f"{what}; {hint}.")
        return Failure("singular", f"no independent equations are left at {name} {where}; {hint}.")

    def _intervals(self, times: np.ndarray, tally: np.ndarray) -> np.ndarray:
        """Return (T, 6) what each recorded interval took, from the driver's tallies (T, 9)."""
        d = driver
        return np.column_stack([times, tally[:, [d.STEPS, d.LAST_SIZE, d.SUM, d.MOST, d.REJECTED]]])

    def _corrections(self, tally: np.ndarray) -> np.ndarray | None:
        if self.workspace.stabilization.kind == "none":
            return None
        d = driver
        return tally[:, [d.CORRECTIONS, d.POSITION, d.VELOCITY, d.ACCELERATION]].copy()

    def _own(self, lam: np.ndarray) -> np.ndarray | None:
        """Return the multipliers of the method by constraint row, from those by pair (T, P, 2)."""
        if not self.family.carries_multipliers:
            return None
        rows = self.workspace.mechanism.rows
        return np.ascontiguousarray(lam[:, [row.pair for row in rows], [row.place for row in rows]])

    def _collect(self, rows: int) -> Stretch:
        c = self.common
        times, tally = c.row_time[:rows].copy(), c.row_tally[:rows]
        return Stretch(
            times,
            c.row_q[:rows].copy(),
            c.row_v[:rows].copy(),
            c.row_energy[:rows, 0].copy(),
            c.row_energy[:rows, 1].copy(),
            self._intervals(times, tally),
            multipliers=self._own(c.row_lam[:rows]),
            corrections=self._corrections(tally),
        )

    def last_state(self) -> Stretch:
        """Return the state reached as one row; see `Stepper.last_state`."""
        c = self.common
        times, tally = np.array([self.time]), c.tally[None].copy()
        c.tally[:] = 0.0
        return Stretch(
            times,
            c.q[None].copy(),
            c.v[None].copy(),
            c.energy[:1].copy(),
            c.energy[1:].copy(),
            self._intervals(times, tally),
            multipliers=self._own(c.own_lam[None]),
            corrections=self._corrections(tally),
        )
