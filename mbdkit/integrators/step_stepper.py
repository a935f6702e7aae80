"""Drives a method that is written in Python: one step after the other, checked, booked and recorded."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.engine.problem import Problem
from mbdkit.engine.system import NOT_FINITE, OK
from mbdkit.engine.view import example_problem
from mbdkit.integrators import stepping
from mbdkit.integrators.fixed_step import Beginning, FixedStepper, State
from mbdkit.integrators.iteration_matrix import vector
from mbdkit.integrators.projection import StabilizedSteps, Taken
from mbdkit.integrators.step_method import StepError, StepMethod, StepState
from mbdkit.integrators.step_problem import StepProblem, call_everything
from mbdkit.integrators.stepping import Failure, Pace, Stretch, Timetable

if TYPE_CHECKING:
    from collections.abc import Sequence


@cache
def _load_kernels() -> None:
    """Load every kernel once in a process, before the first step is timed."""
    call_everything(StepProblem(example_problem()))


class StepStepper(FixedStepper):
    """Runs a `StepMethod` over a timetable.

    Work and dissipated energy that the method does not book are integrated by Simpson's rule, of order 4, over the
    cubic through both ends of the step, with the powers under the index-1 multipliers; its three solves a step count.
    Projections are made around the method's steps, and book nothing.
    """

    def __init__(self, method: StepMethod, problem: Problem, timetable: Timetable):
        super().__init__(problem, timetable, hint=method.hint)
        self.method = method
        self.view = StepProblem(problem)
        self.now = StepState(self.view.q0.copy(), self.view.v0.copy())
        self.pace = Pace(1)
        self.low = np.zeros(2)
        """Low parts of the sums of work and dissipated energy."""
        self.row_multipliers = np.zeros(
            (len(self.state.row_q), len(problem.mechanism.rows) if method.carries_multipliers else 0)
        )
        self.stabilized = StabilizedSteps(self._own_step, self.view)
        stabilized = problem.stabilization.kind != "none"
        self.row_corrections = np.zeros((len(self.state.row_q) if stabilized else 0, 4))
        self.raised: BaseException | None = None
        self.view.counters = self.counters
        _load_kernels()

    def advance(self) -> Stretch:
        """Go on for about `stepping.STRETCH` seconds; what the method raised comes out after the rows before it."""
        if self.raised is not None:
            raise self.raised
        return super().advance()

    def steps(self, h: float, t0: float, first: int, last: int, every: int, state: State) -> tuple[int, int, int]:
        """Take steps until time is up; see `FixedStepper.steps`."""
        rows, k, n = 0, first, self.view.n
        until = time.perf_counter() + stepping.STRETCH
        counters, view = self.counters, self.view
        while k < last:
            before = counters.newton_iterations
            t, end = t0 + k * h, t0 + (k + 1) * h
            try:
                taken = self.stabilized.take(t, end, self.now, h, self.done + k - first + 1)
                new, q, v = taken.reached, taken.reached.q, taken.reached.v
                if not view.arrive(end, q, v, self.worst_pairs):
                    raise StepError("not-finite", "positions or velocities overflowed")
                if self.has_power:
                    self._book(t, h, taken)
            except StepError as error:
                where = f"in step {self.done + k - first + 1} from t = {t:.6g} s"
                self.failure = Failure(error.code, f"{error} {where}; {self.hint}.")
                break
            except (Exception, SystemExit) as error:
                self.raised = error if isinstance(error, Exception) else RuntimeError("SystemExit")
                break
            self.now = new
            k += 1
            iterations = counters.newton_iterations - before
            state.iterations += (iterations, 0)
            state.iterations[1] = max(state.iterations[1], iterations)
            if k % every == 0:
                state.row_q[rows, :n], state.row_v[rows, :n] = q, v
                state.row_energy[rows] = state.energy
                state.row_iterations[rows] = state.iterations
                state.iterations[:] = 0
                if self.row_corrections.size:
                    self.row_corrections[rows] = self.stabilized.corrections()
                if new.multipliers is not None and self.method.carries_multipliers:
                    self.row_multipliers[rows] = view.recorded_multipliers(t0 + k * h, q, new.multipliers)
                rows += 1
            if time.perf_counter() > until:
                break
        state.q[:n], state.v[:n] = self.now.q, self.now.v
        return (OK if self.failure is None and self.raised is None else NOT_FINITE), k, rows

    def memory(self) -> tuple[StepState, np.ndarray]:
        """Return the state as the method has it, and the low parts of the sums."""
        return self.now, self.low.copy()

    def recall(self, memory: tuple[StepState, np.ndarray]) -> None:
        """Go back to the state that `memory` returned."""
        self.now, self.low = memory[0], memory[1].copy()

    def _again(self, begin: Beginning, theta: float) -> State | None:
        failure = self.failure
        state = super()._again(begin, theta)
        if self.raised is not None:
            raise self.raised
        self.failure = failure
        return state

    def _own_step(self, t: float, state: StepState, h: float) -> StepState:
        """Return what the method makes of a step, checked; raises TypeError or ValueError by name."""
        new = self.method.step(self.view, t, state, h)
        name, view = type(self.method).__name__, self.view
        if not isinstance(new, StepState):
            raise TypeError(f"{name}.step returned {type(new).__name__}, not a StepState")
        wanted: list[tuple[str, Any, int]] = [("q", new.q, view.n), ("v", new.v, view.n)]
        if self.method.carries_multipliers:
            wanted.append(("multipliers", new.multipliers, view.m))
        found: list[np.ndarray] = []
        for field, value, size in wanted:
            try:
                found.append(vector(value, size))
            except (TypeError, ValueError) as error:
                raise ValueError(f"{name}.step returned `{field}` amiss: {error}") from None
        if len(found) == 3 and not np.all(np.isfinite(found[2])):
            raise StepError("not-finite", "multipliers overflowed")
        return new if found[0] is new.q and found[1] is new.v else replace(new, q=found[0], v=found[1])

    def _book(self, t: float, h: float, taken: Taken) -> None:
        """Add the work and the dissipated energy of the method's own step, with compensation; projections add none."""
        gains: Sequence[float | None] = (taken.made.work, taken.made.dissipated)
        if None in gains:
            ours = self._gains(t, h, taken)
            gains = [own if own is not None else gain for own, gain in zip(gains, ours, strict=True)]
        y = np.array(gains) + self.low
        total = self.state.energy + y
        self.low = y - (total - self.state.energy)
        self.state.energy[:] = total

    def _gains(self, t: float, h: float, taken: Taken) -> np.ndarray:
        """Return work and dissipated energy of a step by Simpson's rule over the cubic through its ends."""
        view, old, new = self.view, taken.begin, taken.made
        a0, lam0 = view.accelerations(t, old.q, old.v)
        a1, lam1 = view.accelerations(t + h, new.q, new.v)
        q = 0.5 * (old.q + new.q) + h / 8 * (old.v - new.v)
        v = 0.5 * (old.v + new.v) + h / 8 * (a0 - a1)
        _, lam = view.accelerations(t + h / 2, q, v)
        begin = np.array(view.powers(t, old.q, old.v, lam0))
        middle = np.array(view.powers(t + h / 2, q, v, lam))
        return h / 6 * (begin + 4 * middle + np.array(view.powers(t + h, new.q, new.v, lam1)))

    def _run(self, h: float, t0: float, last: int, every: int) -> int:
        _, self.done, rows = self.steps(h, t0, self.done, last, every, self.state)
        self.counters.steps = self.counters.accepted = self.done
        return rows

    def _run_last(self, t0: float) -> None:
        _, reached, _ = self.steps(self.timetable.last_step, t0, 0, 1, 2, self.state)
        self.done += reached
        self.counters.steps = self.counters.accepted = self.done

    def _collect(self, rows: int) -> Stretch:
        stretch = super()._collect(rows)
        if self.row_multipliers.size:
            stretch = replace(stretch, multipliers=self.row_multipliers[:rows].copy())
        if self.row_corrections.size:
            stretch = replace(stretch, corrections=self.row_corrections[:rows].copy())
        return stretch

    def last_state(self) -> Stretch:
        """Return the state reached as one row; see `Stepper.last_state`."""
        row, own = super().last_state(), self.now.multipliers
        if self.method.carries_multipliers and own is not None:
            row = replace(row, multipliers=self.view.recorded_multipliers(self.time, self.now.q, own)[None])
        if self.row_corrections.size:
            row = replace(row, corrections=self.stabilized.corrections()[None])
        return row
