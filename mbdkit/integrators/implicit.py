"""Fully implicit Runge-Kutta methods in fixed steps: stages solved for accelerations, in compiled code.

Stage i, in second-order form, with A the tableau, the unknowns a_i and f the index-1 accelerations:

    v_i = v_n + h sum_j A_ij a_j,        q_i = q_n + h c_i v_n + h^2 sum_j (A A)_ij a_j,        a_i = f(t_i, q_i, v_i)

Simplified Newton with one tangent for all stages decouples along the eigenvectors of A (Butcher 1976, Bickart 1977).
The defect r = a - f of each eigenvalue mu takes one sparse system, complex for a pair of conjugate eigenvalues, with
all terms of the tangents of M a + Phi_q^T lambda - Q and of Phi_q a - gamma,

    [ M + h mu C + h^2 mu^2 K                               Phi_q^T ] [ x  ]   [ M r     ]
    [ Phi_q - h mu gamma_v + h^2 mu^2 (Phi_q a - gamma)_q   0       ] [ nu ] = [ Phi_q r ]

which is (1 - h mu f_v - h^2 mu^2 f_q) x = r without forming f_v and f_q. Because f is evaluated exactly at every
stage, only its derivatives are frozen, and the contraction of the iteration is O(h^2).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.analysis import new_factors
from mbdkit.engine.cache import kernel
from mbdkit.engine.constraints import constraint_positions
from mbdkit.engine.lu import Factors
from mbdkit.engine.observe import tangents_at
from mbdkit.engine.singularity import describe_nearness
from mbdkit.engine.system import (
    DIVERGED,
    NOT_FINITE,
    OK,
    REPIVOT,
    REPIVOT_STAGES,
    evaluate_powers,
    evaluate_tangents,
    prepare,
    solve_accelerations,
)
from mbdkit.engine.vectors import add_compensated, copy, stays_finite
from mbdkit.integrators.coupled_newton import CoupledNewton
from mbdkit.integrators.fixed_step import FixedStepper, State, book_energies, note_misalignment
from mbdkit.integrators.newton import factorize_all, newton_changes
from mbdkit.integrators.stages import STAGNANT, extrapolate, is_round_off, relative_change, stage_mean, stage_states

if TYPE_CHECKING:
    from mbdkit.engine.problem import Problem
    from mbdkit.integrators.methods import ImplicitRungeKutta
    from mbdkit.integrators.stepping import Timetable
    from mbdkit.integrators.tableau import ButcherTableau

NEWTON, FIXED_POINT = range(2)

ROUND_OFF = 1e-18
"""A change of the accelerations that is expected to stay below this, relative to their size, ends the iteration."""

IDLE = 4
"""After so many iterations without progress a change is compared with single forces as well."""

RUNAWAY = 1e-6
"""Relative change above which growth from one iteration to the next counts as divergence."""

ROUGH = 1e-5
"""Relative change below which the accelerations of the next iteration are refined to round-off."""

SLOW = 0.25
"""Contraction above which the tangent is taken anew within the step."""


@kernel
def run_implicit(
    top, w, solver, a, a2, b, b2, c, weights, kind, tolerance, max_iterations, has_power, fresh,
    t_real, t_real_inv, mu_real, t_complex, t_complex_inv, mu_complex, pattern, scatter, real, cplx,
    t0, h, first, last, every, q, q_low, v, v_low, energy, energy_low, given,
    acc, lam, f, q_stage, v_stage, change, mean, mean_lam, mean_jac,
    z_real, z_complex, b_real, x_real, b_complex, x_complex,
    worst, iterations, row_q, row_v, row_energy, row_iterations, counts, report,
):  # fmt: skip
    """Take steps `first` to `last - 1` of size `h`; return (status, next step, rows written).

    `counts`: evaluations of the right side, of tangents, factorizations, iterations. `report`: on divergence the
    largest change of an acceleration, its coordinate, and the iterations. `fresh`: no stage values of a step before
    stand in `acc`. `given`: those of the first step stand there.
    """
    s = len(c)
    bodies = len(top.mass) - 1
    n3 = 3 * bodies
    rows = 0
    for k in range(first, last):
        t = t0 + k * h
        prepare(top, w, t, q)
        constraint_positions(top.pairs, top.pair_parameters, q, w.cs, w.u, w.phi, w.phi_t)
        note_misalignment(w.phi, worst)
        begun = fresh
        solved = given and k == first
        if solved:
            fresh = False
        elif fresh:  # a stiff force may be far from constant over the step: begin with free flight
            acc[:, :] = 0.0
            lam[:, :, :] = 0.0
            fresh = False
        else:
            extrapolate(weights, acc, f)
        stage_states(h, a, a2, c, q, v, acc, q_stage, v_stage)
        stale = True
        taken_at = 0
        before = np.inf
        m = 0
        idle = 0
        settled = solved
        while not settled or has_power or m > 0:
            if kind == NEWTON and stale and not settled:
                stage_mean(q_stage, mean[0])
                stage_mean(v_stage, mean[1])
                stage_mean(acc, mean[2])
                for r in range(2):
                    stage_mean(lam[:, :, r], mean_lam[:, r])
                evaluate_tangents(top, w, t + 0.5 * h, mean[0], mean[1], mean[2], mean_lam)
                for p in range(len(top.pairs)):
                    copy(w.jac[p], mean_jac[p])
                counts[1] += 1
                counts[2] += len(mu_real) + len(mu_complex)
                solver.failed[0] = factorize_all(w.source, scatter, pattern, real, cplx, mu_real, mu_complex, h)
                if solver.failed[0] >= 0:
                    return REPIVOT_STAGES, k, rows
                stale = False
                taken_at = m
            for i in range(s):
                prepare(top, w, t + c[i] * h, q_stage[i])
                status = solve_accelerations(top, w, solver, q_stage[i], v_stage[i], f[i], lam[i], before < ROUGH)
                if status != OK:
                    return status, k, rows
                if settled:
                    work, lost = evaluate_powers(top, w, q_stage[i], v_stage[i], lam[i])
                    energy[2 + 2 * i], energy[3 + 2 * i] = work, lost
            counts[0] += s
            counts[2] += s
            if settled:
                book_energies(h, b, energy, energy_low)
                break
            counts[3] += 1
            iterations[0] += 1
            m += 1
            if kind == NEWTON:
                for i in range(s):
                    for d in range(n3):
                        f[i, d] = acc[i, d] - f[i, d]
                newton_changes(
                    top, solver.row_index, mean_jac, pattern, real, cplx, t_real, t_real_inv, t_complex, t_complex_inv,
                    f, z_real, z_complex, b_real, x_real, b_complex, x_complex, change,
                )  # fmt: skip
            else:
                for i in range(s):
                    for d in range(n3):
                        change[i, d] = f[i, d] - acc[i, d]
            for i in range(s):
                for d in range(n3):
                    acc[i, d] += change[i, d]
            stage_states(h, a, a2, c, q, v, acc, q_stage, v_stage)
            now = relative_change(acc, change, bodies)
            ratio = now / before
            settled = now == 0.0 or (m > 1 and ratio < 0.9 and ratio / (1.0 - ratio) * now <= tolerance)
            if not settled and m > 1 and ratio > 0.5 and now < np.inf:  # shrinks no more: round-off, or divergence
                idle += 1
                settled = now <= STAGNANT or is_round_off(
                    top, w, h, q, v_stage[s - 1], lam[s - 1], acc[s - 1], bodies, change, idle >= IDLE
                )
            if settled:
                if has_power:
                    continue  # once more through the stages, for their powers
                break
            if m >= max_iterations or (m > 4 and ratio > 4.0 and now > RUNAWAY) or not now < np.inf:
                report[0], report[2] = 0.0, m
                for i in range(s):
                    for d in range(n3):
                        if not abs(change[i, d]) <= report[0]:
                            report[0], report[1] = abs(change[i, d]), d
                return DIVERGED, k, rows
            stale = (begun and m == 1) or (m - taken_at >= 3 and ratio > SLOW)
            before = now
        dq, dv = mean[0], mean[1]
        dq[:] = 0.0
        dv[:] = 0.0
        for i in range(s):
            w1, w2 = h * b[i], h * h * b2[i]
            for d in range(n3):
                dv[d] += w1 * acc[i, d]
                dq[d] += w2 * acc[i, d]
        for d in range(n3):
            dq[d] += h * v[d] + h * v_low[d]
        if not (stays_finite(q, dq) and stays_finite(v, dv)):
            return NOT_FINITE, k, rows
        add_compensated(q, q_low, dq)
        add_compensated(v, v_low, dv)
        iterations[1] = max(iterations[1], m)
        if (k + 1) % every == 0:
            copy(q, row_q[rows])
            copy(v, row_v[rows])
            row_energy[rows, 0], row_energy[rows, 1] = energy[0], energy[1]
            row_iterations[rows, 0], row_iterations[rows, 1] = iterations[0], iterations[1]
            iterations[:] = 0
            rows += 1
    return OK, last, rows


def extrapolation_weights(c: np.ndarray, ratio: float) -> np.ndarray:
    """Return the (s, s) weights that carry stage values of one step to the stages of the next.

    Parameters
    ----------
    c
        (s,) nodes.
    ratio
        Size of the next step over that of the last.
    """
    at = 1.0 + ratio * c
    weights = np.ones((len(c), len(c)))
    for j in range(len(c)):
        for m in range(len(c)):
            if m != j:
                weights[:, j] *= (at - c[m]) / (c[j] - c[m])
    return weights


class Eigenvalues:
    """The eigenvalues of a tableau's matrix, real ones and one of each conjugate pair, with their transformations."""

    def __init__(self, tableau: ButcherTableau):
        a, _, _ = tableau.floats()
        values, vectors = np.linalg.eig(a)
        inverse = np.linalg.inv(vectors)
        real = np.abs(values.imag) < 1e-12
        upper = ~real & (values.imag > 0)
        self.mu_real = np.ascontiguousarray(values[real].real)
        self.t_real = np.ascontiguousarray(vectors[:, real].real)
        self.t_real_inv = np.ascontiguousarray(inverse[real].real)
        self.mu_complex = np.ascontiguousarray(values[upper].astype(complex))
        self.t_complex = np.ascontiguousarray(vectors[:, upper].astype(complex))
        self.t_complex_inv = np.ascontiguousarray(inverse[upper].astype(complex))


class ImplicitStepper(FixedStepper):
    """Runs a fully implicit tableau over a timetable."""

    def __init__(self, method: ImplicitRungeKutta, problem: Problem, timetable: Timetable):
        super().__init__(problem, timetable, hint="a smaller time.step may help")
        self.overflow = DIVERGED
        self.method = method
        self.a, self.b, self.c = method.tableau.floats()
        self.a2, self.b2 = method.tableau.second_order_floats()
        self.eigen = Eigenvalues(method.tableau)
        self.kind = NEWTON if method.stage_solver == "newton" else FIXED_POINT
        self.tolerance = method.tolerance if method.tolerance is not None else ROUND_OFF
        s, size, pairs, n = method.tableau.stages, problem.mechanism.size, len(self.worst_pairs), problem.unknowns
        self.acc, self.f, self.change = np.zeros((3, s, size))
        self.q_stage, self.v_stage = np.zeros((2, s, size))
        self.lam = np.zeros((s, pairs, 2))
        self.mean, self.mean_lam, self.mean_jac = np.zeros((3, size)), np.zeros((pairs, 2)), np.zeros((pairs, 12))
        self.z_real, self.z_complex = np.zeros(size), np.zeros(size, dtype=complex)
        self.b_real, self.x_real = np.zeros((2, n))
        self.b_complex, self.x_complex = np.zeros((2, n), dtype=complex)
        self.energy = np.zeros(2 + 2 * s)
        self.counts, self.report = np.zeros(4, dtype=np.int64), np.zeros(3)
        self.fresh, self.last_h = True, 0.0
        self.coupled: CoupledNewton | None = None
        self.given = 0
        """Iterations that solved the stages of the step that comes next, whose accelerations stand in `acc`."""
        self.step_now = (0.0, 0.0)
        """Start and size of the step that comes next [s]."""
        self.weights = np.zeros((s, s))
        self._pivot(timetable.step or 0.0)
        self.load_kernel()

    def _pivot(self, h: float) -> None:
        """Choose pivots for the stage matrix by its numbers where the step begins; make room for all eigenvalues."""
        eigen, problem, state = self.eigen, self.problem, self.state
        if self.kind == FIXED_POINT:
            rate: complex | None = None
        elif len(eigen.mu_complex):
            rate = complex(h * eigen.mu_complex[0])
        else:
            rate = float(h * max(eigen.mu_real, key=abs))
        top, scratch = problem.mechanism.topology, problem.scratch
        for _ in range(2):
            status = tangents_at(top, scratch, problem.solver, self.time, state.q, state.v, self.f[0], self.lam[0])
            if status == OK:
                break
            problem.use_pivots()
        self.pattern, _, self.scatter = problem.choose_pivots(rate)
        self.real = _stack(self.pattern, len(eigen.mu_real), np.float64)
        self.cplx = _stack(self.pattern, len(eigen.mu_complex), np.complex128)

    def renew(self, status: int) -> bool:
        """Choose new pivots for the system that failed, and start the step without stage values from before."""
        self.fresh = True
        if status == REPIVOT:
            return super().renew(status)
        if self.kind == NEWTON:
            self._pivot(self.last_h)
        return True

    def describe_divergence(self) -> str:
        """Return the largest residual and where it is."""
        if not np.isfinite(self.report[0]):
            return ": the stage iteration ran away"
        name = self.problem.mechanism.unknown_name(int(self.report[1]))
        unit = "rad/s^2" if int(self.report[1]) % 3 == 2 else "m/s^2"
        return (
            f": the stage equations did not converge in {int(self.report[2])} iterations, "
            f"the last one still changed an acceleration of {name} by {self.report[0]:.3g} {unit}"
        )

    def steps(self, h: float, t0: float, first: int, last: int, every: int, state: State) -> tuple[int, int, int]:
        """Take steps in compiled code; see `FixedStepper.steps`."""
        if h != self.last_h:
            self.weights = extrapolation_weights(self.c, h / self.last_h if self.last_h else 1.0)
        problem, e = self.problem, self.eigen
        self.energy[:2] = state.energy
        result = run_implicit(
            problem.mechanism.topology, problem.scratch, problem.solver, self.a, self.a2, self.b, self.b2, self.c,
            self.weights, self.kind, self.tolerance, self.method.max_iterations, self.has_power, self.fresh,
            e.t_real, e.t_real_inv, e.mu_real, e.t_complex, e.t_complex_inv, e.mu_complex,
            self.pattern, self.scatter, self.real, self.cplx,
            t0, h, first, last, every, state.q, state.q_low, state.v, state.v_low, self.energy, state.energy_low,
            self.given > 0, self.acc, self.lam, self.f, self.q_stage, self.v_stage, self.change,
            self.mean, self.mean_lam, self.mean_jac, self.z_real, self.z_complex,
            self.b_real, self.x_real, self.b_complex, self.x_complex,
            self.worst_pairs, state.iterations, state.row_q, state.row_v, state.row_energy, state.row_iterations,
            self.counts, self.report,
        )  # fmt: skip
        state.energy[:] = self.energy[:2]
        self.step_now = (t0 + result[1] * h, h)
        if result[1] > first:
            self.given = 0
        if last > first:
            self.fresh = result[0] != OK
        if h != self.last_h:
            self.last_h = h
            self.weights = extrapolation_weights(self.c, 1.0)
        counters = self.counters
        counters.rhs_evaluations, counters.jacobian_evaluations = int(self.counts[0]), int(self.counts[1])
        counters.factorizations, counters.newton_iterations = int(self.counts[2]), int(self.counts[3])
        if self.coupled is not None:
            for name in ("rhs_evaluations", "jacobian_evaluations", "factorizations", "newton_iterations"):
                setattr(counters, name, getattr(counters, name) + getattr(self.coupled.counters, name))
        return result

    def _handle(self, status: int) -> None:
        """Solve the stages with a tangent each before the run stops because one for all does not serve."""
        super()._handle(status)
        if self.kind == FIXED_POINT or self.failure is None or self.failure.code not in ("newton-failed", "singular"):
            return
        if self.given == 0:
            if self.coupled is None:
                self.coupled = CoupledNewton(self.problem, self.a, self.a2, self.c)
            t, h = self.step_now
            self.given = self.coupled.solve(t, h, self.state.q, self.state.v, self.acc, self.lam)
            if 0 < self.given <= self.method.max_iterations:
                self.state.iterations += (self.given, 0)
                self.state.iterations[1] = max(self.state.iterations[1], self.given)
                self.failure = None
                return
        near = describe_nearness(self.problem, self.step_now[0], self.state.q)
        if near:
            self.failure = replace(self.failure, sentence=f"{self.failure.sentence.rstrip('.')}; {near}.")


def _stack(pattern, count: int, dtype: type) -> Factors:
    """Return storage for the factors of `count` matrices of one pattern."""
    one = new_factors(pattern, dtype)
    return Factors(*(np.zeros((count, len(x)), x.dtype) for x in one))
