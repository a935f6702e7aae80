"""The Python side of every method in fixed steps: stretches, the shorter last step, rows, new pivots and failures."""

from __future__ import annotations

import copy
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbdkit.engine.analysis import SingularSystemError
from mbdkit.engine.cache import part
from mbdkit.engine.problem import Problem
from mbdkit.engine.system import DIVERGED, NOT_FINITE, OK, REPIVOT, REPIVOT_STAGES, Topology
from mbdkit.integrators.stepping import Counters, Failure, Pace, StepTaken, Stretch, Timetable, joined

MOST_ROWS = 4096
ROW_BYTES = 1 << 24
"""Bounds on the buffer of recorded states: rows, and bytes."""


@part
def note_misalignment(phi, worst):
    """Raise `worst` (P,) to the squared norm of each pair's `phi` (P, 2) where that is larger."""
    for k in range(len(phi)):
        gap = phi[k, 0] * phi[k, 0] + phi[k, 1] * phi[k, 1]
        if gap > worst[k]:
            worst[k] = gap


@part
def book_energies(h, b, energy, low):
    """Add a step's work and dissipated energy by the method's own weights, with compensation.

    `energy` holds the two sums, then the two powers of every stage.
    """
    for m in range(2):
        gain = 0.0
        for i in range(len(b)):
            gain += b[i] * energy[2 + 2 * i + m]
        y = h * gain + low[m]
        new = energy[m] + y
        low[m] = y - (new - energy[m])
        energy[m] = new


def has_power(top: Topology) -> bool:
    """Return whether loads, drivers, dampers or laws act, so that work and dissipated energy change."""
    return bool(len(top.loads) or np.any(top.pairs[:, 3] >= 0) or np.any(top.linear[:, 1]) or len(top.laws))


@dataclass
class State:
    """The state of a fixed-step run, with the low parts of its compensated sums, and the rows recorded from it."""

    q: np.ndarray
    v: np.ndarray
    rows: int
    q_low: np.ndarray = field(init=False)
    v_low: np.ndarray = field(init=False)
    energy: np.ndarray = field(init=False)
    """(2,) work of loads and drivers, and dissipated energy [J]."""
    energy_low: np.ndarray = field(init=False)
    row_q: np.ndarray = field(init=False)
    row_v: np.ndarray = field(init=False)
    row_energy: np.ndarray = field(init=False)
    iterations: np.ndarray = field(init=False)
    """(2,) sum and maximum of the iterations a step since the last recorded state."""
    row_iterations: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.q_low, self.v_low = np.zeros_like(self.q), np.zeros_like(self.v)
        self.energy, self.energy_low = np.zeros(2), np.zeros(2)
        self.row_q, self.row_v = np.zeros((self.rows, len(self.q))), np.zeros((self.rows, len(self.q)))
        self.row_energy = np.zeros((self.rows, 2))
        self.iterations, self.row_iterations = np.zeros(2, dtype=np.int64), np.zeros((self.rows, 2), dtype=np.int64)

    def copied(self) -> State:
        """Return a copy that may be stepped by itself; the buffers of rows are shared."""
        own = copy.copy(self)
        for name in ("q", "v", "q_low", "v_low", "energy", "energy_low", "iterations"):
            setattr(own, name, getattr(self, name).copy())
        return own


@dataclass(frozen=True)
class Beginning:
    """Where the last step began: all that it takes to take it again."""

    time: float
    size: float
    done: int
    recorded: int
    state: State
    memory: Any


class FixedStepper(ABC):
    """Base of the steppers in fixed steps; a family brings `steps`.

    Parameters
    ----------
    problem
        The mechanism and its consistent start.
    timetable
        With a fixed step.
    hint
        What a user may try when numbers run away.
    """

    def __init__(self, problem: Problem, timetable: Timetable, *, hint: str):
        self.problem, self.timetable, self.hint = problem, timetable, hint
        self.counters = Counters()
        self.overflow = NOT_FINITE
        self.finished = False
        self.failure: Failure | None = None
        self.time = timetable.start
        self.last_step: StepTaken | None = None
        self._beginning: Beginning | None = None
        top = problem.mechanism.topology
        self.has_power = has_power(top)
        self.worst_pairs = np.zeros(len(top.pairs))
        rows = max(2, min(MOST_ROWS, ROW_BYTES // (16 * problem.mechanism.size)))
        self.state = State(problem.q0.copy(), problem.v0.copy(), rows)
        self.done = 0
        self.recorded = 0
        self.pace = Pace(max(1, min(16, 100_000 // problem.mechanism.size)))
        self._renewed: set[tuple[int, int]] = set()

    @abstractmethod
    def steps(self, h: float, t0: float, first: int, last: int, every: int, state: State) -> tuple[int, int, int]:
        """Take steps `first` to `last - 1` of size `h`, step k from ``t0 + k h``; return (status, next, rows)."""

    def load_kernel(self) -> None:
        """Take no steps: the compiled loop is loaded before the first step is timed."""
        self.steps(self.timetable.step or 0.0, self.timetable.start, 0, 0, 1, self.state)

    def renew(self, status: int) -> bool:
        """Choose new pivots after `status`; return whether that can help. Raises SingularSystemError."""
        if status != REPIVOT:
            return False
        self.problem.use_pivots()
        return True

    def describe_divergence(self) -> str:
        """Return where the stage equations failed to converge; implicit families know."""
        return ""

    def memory(self) -> Any:
        """Return what a step hands to the next beside the state, as `recall` takes it; families know."""
        return None

    def recall(self, memory: Any) -> None:  # noqa: B027 - most families remember nothing
        """Go back to what `memory` returned."""

    def advance(self) -> Stretch:
        """Go on for about `STRETCH` seconds, or for one step; see `Stepper.advance`."""
        if not self.timetable.single:
            return self._advance()
        self.last_step, self.pace.steps = None, 1
        size = self.timetable.last_step if self.done == self.timetable.steps - 1 else (self.timetable.step or 0.0)
        t0 = self.timetable.start + self.done * (self.timetable.step or 0.0)
        begin = Beginning(t0, size, self.done, self.recorded, self.state.copied(), self.memory())
        stretch = self._advance()
        if self.done > begin.done:
            self._beginning = begin
            old, new = begin.state, self.state
            self.last_step = StepTaken(t0, self.time, old.q, old.v, new.q.copy(), new.v.copy())
        return stretch

    def inside(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        """Return a state in the last step by the cubic through its ends; see `Stepper.inside`."""
        assert self.last_step is not None
        return self.last_step.hermite(theta)

    def within(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        """Return a state in the last step by a step of the method to there; see `Stepper.within`."""
        step, begin = self.last_step, self._beginning
        assert step is not None
        assert begin is not None
        if theta in (0.0, 1.0):
            return (step.q1, step.v1) if theta else (step.q0, step.v0)
        memory = self.memory()
        state = self._again(begin, theta)
        self.recall(memory)
        return (state.q, state.v) if state is not None else self.inside(theta)

    def cut(self, theta: float) -> Stretch:
        """End the run within the last step; see `Stepper.cut`."""
        step, begin = self.last_step, self._beginning
        assert step is not None
        assert begin is not None
        if theta > 0.0:
            state = self._again(begin, theta)
        else:
            self.recall(begin.memory)
            state = begin.state
        if state is None:  # the step that led here could be taken, but none to this place
            state = begin.state
            state.energy += theta * (self.state.energy - state.energy)
            state.q, state.v = self.inside(theta)
        self.state = state
        self.done, self.recorded, self.time = begin.done + (theta > 0.0), begin.recorded, step.time(theta)
        self.counters.steps = self.counters.accepted = self.done
        self.finished, self.failure = True, None
        row = self.last_state()
        row.intervals[0, 2] = theta * begin.size
        return row

    def _again(self, begin: Beginning, theta: float) -> State | None:
        """Take the last step again, by a share of its size; None where that fails."""
        self.recall(begin.memory)
        state = begin.state.copied()
        status, _, _ = self.steps(theta * begin.size, begin.time, 0, 1, 2, state)
        return state if status == OK else None

    def _advance(self) -> Stretch:
        table = self.timetable
        total, every = table.steps, table.every
        allowed = min(total, table.max_steps)
        begin = time.perf_counter()
        first = self.done
        short = table.last_step != table.step and allowed == total
        last_full = total - 1 if short else allowed
        rows = 0
        if self.done < last_full:
            fit = (len(self.state.row_q) - 1) * every - self.done % every
            last = min(last_full, self.done + self.pace.steps, self.done + max(fit, 1))
            assert table.step is not None
            rows = self._run(table.step, table.start, last, every)
            self.time = table.start + self.done * table.step
        elif self.done < total:
            t0 = table.start + (total - 1) * (table.step or 0.0)
            # the step's number starts again at 0 there, so that its time is exact
            self._run_last(t0)
        if not table.single:
            self.pace.timed(self.done - first, begin)
        stretch = self._collect(rows)
        if self.failure is None and self.done >= allowed:
            if self.done < total:
                self.failure = Failure("max-steps", f"stopped after limits.max_steps = {table.max_steps} steps.")
            else:
                self.finished, self.time = True, table.end
                if self.recorded < self.done:
                    stretch = joined([stretch, self.last_state()])
                elif len(stretch.time):
                    stretch.time[-1] = table.end
                    stretch.intervals[-1, 0] = table.end
        return stretch

    def _run(self, h: float, t0: float, last: int, every: int) -> int:
        """Take full steps up to `last`, renewing pivots where asked for; return the rows written."""
        rows = 0
        while self.done < last and self.failure is None:
            view = self._rows_from(rows)
            status, self.done, written = self.steps(h, t0, self.done, last, every, view)
            rows += written
            self.counters.steps = self.counters.accepted = self.done
            if status != OK:
                self._handle(status)
        return rows

    def _run_last(self, t0: float) -> None:
        """Take the shorter last step; its row is the end, which is recorded apart."""
        total = self.timetable.steps
        while self.done < total and self.failure is None:
            status, reached, _ = self.steps(self.timetable.last_step, t0, 0, 1, 2, self.state)
            if status == OK:
                self.done += reached
                self.counters.steps = self.counters.accepted = self.done
            else:
                self._handle(status)

    def _rows_from(self, rows: int) -> State:
        """Return the state with its row buffers from `rows` on."""
        if rows == 0:
            return self.state
        view = copy.copy(self.state)
        view.row_q, view.row_v = self.state.row_q[rows:], self.state.row_v[rows:]
        view.row_energy, view.row_iterations = self.state.row_energy[rows:], self.state.row_iterations[rows:]
        return view

    def _handle(self, status: int) -> None:
        """Renew the pivots once a step, or note why the run stops."""
        self.time = self.timetable.start + self.done * (self.timetable.step or 0.0)
        where = f"in step {self.done + 1} from t = {self.time:.6g} s"
        if not self.problem.motions_are_finite():
            self.failure = Failure("not-finite", f"a driver or load is not a finite number {where}.")
            return
        if force := self.problem.unusable_law():
            self.failure = Failure("not-finite", f"the law of force '{force}' gives no finite number {where}.")
            return
        if status in (REPIVOT, REPIVOT_STAGES) and not self.problem.is_finite():
            status = self.overflow
        try:
            if status != NOT_FINITE and (self.done, status) not in self._renewed and self.renew(status):
                self._renewed = {pair for pair in self._renewed if pair[0] == self.done} | {(self.done, status)}
                return
        except SingularSystemError as error:
            name = self.problem.mechanism.unknown_name(error.index)
            self.failure = Failure("singular", f"no independent equations are left at {name} {where}; {self.hint}.")
            return
        if status == NOT_FINITE:
            self.failure = Failure("not-finite", f"numbers overflowed {where}; {self.hint}.")
        elif status == DIVERGED:
            self.failure = Failure("newton-failed", f"{where}{self.describe_divergence()}; {self.hint}.")
        else:
            index = int(self.problem.solver.failed[0])
            column = self.problem.solver.pattern.column_of
            name = self.problem.mechanism.unknown_name(int(column[index]) if 0 <= index < len(column) else -1)
            self.failure = Failure("singular", f"the equations lost their last pivot at {name} {where}; {self.hint}.")

    def _collect(self, rows: int) -> Stretch:
        every, step = self.timetable.every, self.timetable.step or 0.0
        numbers = self.recorded + every * np.arange(1, rows + 1)
        if rows:
            self.recorded = int(numbers[-1])
        intervals = np.zeros((rows, 6))
        intervals[:, 0] = times = self.timetable.start + numbers * step
        intervals[:, 1], intervals[:, 2] = every, step
        state = self.state
        intervals[:, 3:5] = state.row_iterations[:rows]
        return Stretch(
            times,
            state.row_q[:rows].copy(),
            state.row_v[:rows].copy(),
            state.row_energy[:rows, 0].copy(),
            state.row_energy[:rows, 1].copy(),
            intervals,
        )

    def last_state(self) -> Stretch:
        """Return the state reached as one row; see `Stepper.last_state`."""
        intervals = np.zeros((1, 6))
        size = self.timetable.last_step if self.finished else (self.timetable.step or 0.0)
        intervals[0, :3] = self.time, self.done - self.recorded, size
        self.recorded = self.done
        state = self.state
        intervals[0, 3:5] = state.iterations
        state.iterations[:] = 0
        return Stretch(
            np.array([self.time]),
            state.q[None].copy(),
            state.v[None].copy(),
            state.energy[:1].copy(),
            state.energy[1:].copy(),
            intervals,
        )
