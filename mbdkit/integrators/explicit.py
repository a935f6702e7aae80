"""Explicit Runge-Kutta methods in fixed steps: one compiled loop for every tableau."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.cache import kernel, part
from mbdkit.engine.constraints import constraint_positions
from mbdkit.engine.system import NOT_FINITE, OK, evaluate_powers, prepare, solve_accelerations
from mbdkit.engine.vectors import add_compensated, copy, stays_finite
from mbdkit.integrators.fixed_step import FixedStepper, State, book_energies, note_misalignment

if TYPE_CHECKING:
    from mbdkit.engine.problem import Problem
    from mbdkit.integrators.methods import ExplicitRungeKutta
    from mbdkit.integrators.stepping import Timetable


@part
def _stage_state(base, h, weights, slopes, i, out):
    """Write ``base + h sum_{j < i} weights[i, j] slopes[j]`` into `out`."""
    out[:] = 0.0
    for j in range(i):
        w = weights[i, j]
        if w != 0.0:
            k = slopes[j]
            for d in range(len(out)):
                out[d] += w * k[d]
    for d in range(len(out)):
        out[d] = base[d] + h * out[d]


@part
def _increment(h, weights, slopes, out):
    """Write ``h sum_j weights[j] slopes[j]`` into `out`."""
    out[:] = 0.0
    for j in range(len(weights)):
        w = h * weights[j]
        k = slopes[j]
        for d in range(len(out)):
            out[d] += w * k[d]


@kernel
def run_explicit(
    top, w, solver, a, b, c, has_power, t0, h, first, last, every, q, q_low, v, v_low, energy, energy_low,
    rates, accelerations, q_stage, v_change, lam, worst, row_q, row_v, row_energy, counts,
):  # fmt: skip
    """Take steps `first` to `last - 1` of size `h`; return (status, next step, rows written).

    `counts` receives the evaluations of the right side; on a status other than OK the state stands before the step.
    """
    stages = len(b)
    rows = 0
    for k in range(first, last):
        t = t0 + k * h
        for i in range(stages):
            if i == 0:
                copy(v, rates[0])
                copy(q, q_stage)
            else:
                _stage_state(q, h, a, rates, i, q_stage)
                _stage_state(v, h, a, accelerations, i, rates[i])
            prepare(top, w, t + c[i] * h, q_stage)
            if i == 0:
                constraint_positions(top.pairs, top.pair_parameters, q, w.cs, w.u, w.phi, w.phi_t)
                note_misalignment(w.phi, worst)
            counts[0] += 1
            status = solve_accelerations(top, w, solver, q_stage, rates[i], accelerations[i], lam, False)
            if status != OK:
                return status, k, rows
            if has_power:
                work, lost = evaluate_powers(top, w, q_stage, rates[i], lam)
                energy[2 + 2 * i], energy[3 + 2 * i] = work, lost
        _increment(h, b, rates, q_stage)
        _increment(h, b, accelerations, v_change)
        if not (stays_finite(q, q_stage) and stays_finite(v, v_change)):
            return NOT_FINITE, k, rows
        add_compensated(q, q_low, q_stage)
        add_compensated(v, v_low, v_change)
        if has_power:
            book_energies(h, b, energy, energy_low)
        if (k + 1) % every == 0:
            copy(q, row_q[rows])
            copy(v, row_v[rows])
            row_energy[rows, 0], row_energy[rows, 1] = energy[0], energy[1]
            rows += 1
    return OK, last, rows


class ExplicitStepper(FixedStepper):
    """Runs an explicit tableau over a timetable."""

    def __init__(self, method: ExplicitRungeKutta, problem: Problem, timetable: Timetable):
        super().__init__(problem, timetable, hint="a smaller time.step or an implicit integrator may help")
        self.a, self.b, self.c = method.tableau.floats()
        stages, size = method.tableau.stages, problem.mechanism.size
        self.rates = np.zeros((stages, size))
        self.accelerations = np.zeros((stages, size))
        self.q_stage, self.v_change = np.zeros((2, size))
        self.lam = np.zeros((len(problem.mechanism.topology.pairs), 2))
        self.energy = np.zeros(2 + 2 * stages)
        self.counts = np.zeros(1, dtype=np.int64)
        self.load_kernel()

    def steps(self, h: float, t0: float, first: int, last: int, every: int, state: State) -> tuple[int, int, int]:
        """Take steps in compiled code; see `FixedStepper.steps`."""
        problem = self.problem
        self.energy[:2] = state.energy
        result = run_explicit(
            problem.stepping_topology, problem.scratch, problem.solver, self.a, self.b, self.c, self.has_power,
            t0, h, first, last, every, state.q, state.q_low, state.v, state.v_low, self.energy, state.energy_low,
            self.rates, self.accelerations, self.q_stage, self.v_change, self.lam, self.worst_pairs,
            state.row_q, state.row_v, state.row_energy, self.counts,
        )  # fmt: skip
        state.energy[:] = self.energy[:2]
        self.counters.rhs_evaluations = int(self.counts[0])
        self.counters.factorizations = int(self.counts[0])
        return result
