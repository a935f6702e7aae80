"""Fully implicit Runge-Kutta methods on the index-1 equations: stages solved for accelerations, in compiled code.

Stage i, in second-order form, with A the tableau, the unknowns a_i and f the index-1 accelerations:

    v_i = v_n + h sum_j A_ij a_j,        q_i = q_n + h c_i v_n + h^2 sum_j (A A)_ij a_j,        a_i = f(t_i, q_i, v_i)

Simplified Newton with one tangent for all stages decouples along the eigenvectors of A (Butcher 1976, Bickart 1977).
The defect r = a - f of each eigenvalue mu takes one sparse system, complex for a pair of conjugate eigenvalues, with
all terms of the tangents of M a + Phi_q^T lambda - Q and of Phi_q a - gamma,

    [ M + h mu C + h^2 mu^2 K                               Phi_q^T ] [ x  ]   [ M r     ]
    [ Phi_q - h mu gamma_v + h^2 mu^2 (Phi_q a - gamma)_q   0       ] [ nu ] = [ Phi_q r ]

which is (1 - h mu f_v - h^2 mu^2 f_q) x = r without forming f_v and f_q. Because f is evaluated exactly at every
stage, only its derivatives are frozen, and the contraction of the iteration is O(h^2).

The local error is estimated by an embedded formula with one more node, at the beginning of the step: gamma0 h times the
difference between the acceleration there and that of the collocation polynomial, filtered by one of the systems above
with gamma0 its mu (Hairer and Wanner 1996, IV.8); it is of order s + 1 in h.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.engine.analysis import new_factors
from mbdkit.engine.cache import entry, part
from mbdkit.engine.hold import Hold, loader
from mbdkit.engine.lu import Factors, Pattern
from mbdkit.engine.observe import tangents_at
from mbdkit.engine.system import (
    DIVERGED,
    NOT_FINITE,
    OK,
    REPIVOT_STAGES,
    Scatter,
    evaluate_powers,
    evaluate_tangents,
    prepare,
    solve_accelerations,
)
from mbdkit.engine.vectors import copy, stays_finite
from mbdkit.integrators.common import (
    ADVANCED,
    ALTERED,
    FACTORIZATIONS,
    ITERATIONS,
    JACOBIANS,
    RHS,
    Common,
    load_common,
)
from mbdkit.integrators.coupled_newton import CoupledNewton
from mbdkit.integrators.dense import collocation_polynomials, dense_gains, weights_at
from mbdkit.integrators.family import Family
from mbdkit.integrators.newton import factorize_all, filtered, newton_changes
from mbdkit.integrators.stages import (
    STAGNANT,
    extrapolate,
    extrapolation_weights,
    is_round_off,
    relative_change,
    stage_mean,
    stage_states,
)

if TYPE_CHECKING:
    from mbdkit.engine.problem import Problem
    from mbdkit.integrators.control import Control
    from mbdkit.integrators.methods import ImplicitRungeKutta
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


class Collocation(NamedTuple):
    """An implicit method of s stages and its room."""

    a: np.ndarray
    a2: np.ndarray
    """(s, s) A and A A: weights of accelerations in velocities and positions of the stages."""
    b: np.ndarray
    b2: np.ndarray
    """(s,) the same of the step."""
    c: np.ndarray
    dense_v: np.ndarray
    """(s, s) and (s, s + 1) polynomials of dense output (`collocation_polynomials`)."""
    dense_q: np.ndarray
    choice: np.ndarray
    """(2,) NEWTON or FIXED_POINT, and the most iterations in one step."""
    tolerance: np.ndarray
    """(1,) relative change of accelerations at which the iteration ends."""
    t_real: np.ndarray
    t_real_inv: np.ndarray
    mu_real: np.ndarray
    t_complex: np.ndarray
    t_complex_inv: np.ndarray
    mu_complex: np.ndarray
    pattern: Pattern
    scatter: Scatter
    real: Factors
    cplx: Factors
    """Factors of the matrices of all eigenvalues, stacked."""
    acc: np.ndarray
    """(s, 3 (B + 1)) accelerations of the stages; `begun` tells when the step began that they belong to, and its size:
    NaN where there are none."""
    begun: np.ndarray
    given: np.ndarray
    """(1,) iterations that found the stages of the next attempt, which stand in `acc` and `lam`; 0: none did."""
    weights: np.ndarray
    lam: np.ndarray
    f: np.ndarray
    change: np.ndarray
    q_stage: np.ndarray
    v_stage: np.ndarray
    first: np.ndarray
    """(3 (B + 1),) acceleration at the beginning of the step, and whether it is known."""
    first_known: np.ndarray
    first_lam: np.ndarray
    mean: np.ndarray
    mean_lam: np.ndarray
    mean_jac: np.ndarray
    z_real: np.ndarray
    z_complex: np.ndarray
    b_real: np.ndarray
    x_real: np.ndarray
    b_complex: np.ndarray
    x_complex: np.ndarray
    power: np.ndarray
    """(s, 2) powers of the stages."""
    point: np.ndarray
    """(s,) scratch: weights of dense output."""


def _example() -> Collocation:
    from mbdkit.engine.view import example_problem
    from mbdkit.integrators import gauss
    from mbdkit.integrators.methods import ImplicitRungeKutta

    return new_collocation(ImplicitRungeKutta(gauss.tableau(1)), example_problem(), None)


load_collocation = loader(_example)


@part
def _predict(m, t, h):
    """Begin with the accelerations of the step before, carried on by their polynomial, or with free flight."""
    size = m.begun[1]
    if not abs(size) > 0.0:  # a stiff force may be far from constant over the step
        m.acc[:, :] = 0.0
        m.lam[:, :, :] = 0.0
        return True
    extrapolation_weights((t - m.begun[0]) / size, h / size, m.c, m.weights)
    extrapolate(m.weights, m.acc, m.f)
    return False


@part
def _take_tangents(c, m, t, h):
    """Evaluate and factorize the matrices of all eigenvalues at the middle of the stages; return a status."""
    top, w = c.top, c.w
    stage_mean(m.q_stage, m.mean[0])
    stage_mean(m.v_stage, m.mean[1])
    stage_mean(m.acc, m.mean[2])
    for r in range(2):
        stage_mean(m.lam[:, :, r], m.mean_lam[:, r])
    evaluate_tangents(top, w, t + 0.5 * h, m.mean[0], m.mean[1], m.mean[2], m.mean_lam)
    for p in range(len(top.pairs)):
        copy(w.jac[p], m.mean_jac[p])
    c.counts[JACOBIANS] += 1
    c.counts[FACTORIZATIONS] += len(m.mu_real) + len(m.mu_complex)
    failed = factorize_all(w.source, m.scatter, m.pattern, m.real, m.cplx, m.mu_real, m.mu_complex, h)
    if failed >= 0:
        c.solver.failed[0] = failed
        return REPIVOT_STAGES
    return OK


@part
def _evaluate_stages(c, m, t, h, refine, with_powers):
    """Evaluate the index-1 accelerations of every stage into ``m.f``; return a status."""
    top, w = c.top, c.w
    for i in range(len(m.c)):
        prepare(top, w, t + m.c[i] * h, m.q_stage[i])
        status = solve_accelerations(top, w, c.solver, m.q_stage[i], m.v_stage[i], m.f[i], m.lam[i], refine)
        if status != OK:
            return status
        if with_powers:
            m.power[i, 0], m.power[i, 1] = evaluate_powers(top, w, m.q_stage[i], m.v_stage[i], m.lam[i])
    c.counts[RHS] += len(m.c)
    c.counts[FACTORIZATIONS] += len(m.c)
    return OK


@part
def _iterate(c, m, t, h):
    """Solve the stage equations from the accelerations that stand in ``m.acc``; return a status."""
    top, w = c.top, c.w
    s = len(m.c)
    bodies = len(top.mass) - 1
    n3 = 3 * bodies
    kind, most, tolerance = m.choice[0], m.choice[1], m.tolerance[0]
    if m.given[0] > 0:
        c.counts[ITERATIONS] += m.given[0]
        m.given[0] = 0
        m.begun[0], m.begun[1] = t, h
        stage_states(h, m.a, m.a2, m.c, c.from_q, c.from_v, m.acc, m.q_stage, m.v_stage)
        return OK
    fresh = _predict(m, t, h)
    m.begun[0], m.begun[1] = t, np.nan
    stage_states(h, m.a, m.a2, m.c, c.from_q, c.from_v, m.acc, m.q_stage, m.v_stage)
    stale = True
    taken_at = 0
    before = np.inf
    n = 0
    idle = 0
    while True:
        if kind == NEWTON and stale:
            status = _take_tangents(c, m, t, h)
            if status != OK:
                return status
            stale = False
            taken_at = n
        status = _evaluate_stages(c, m, t, h, before < ROUGH, False)
        if status != OK:
            return status
        c.counts[ITERATIONS] += 1
        n += 1
        if kind == NEWTON:
            for i in range(s):
                for d in range(n3):
                    m.f[i, d] = m.acc[i, d] - m.f[i, d]
            newton_changes(
                top, c.solver.row_index, m.mean_jac, m.pattern, m.real, m.cplx,
                m.t_real, m.t_real_inv, m.t_complex, m.t_complex_inv,
                m.f, m.z_real, m.z_complex, m.b_real, m.x_real, m.b_complex, m.x_complex, m.change,
            )  # fmt: skip
        else:
            for i in range(s):
                for d in range(n3):
                    m.change[i, d] = m.f[i, d] - m.acc[i, d]
        for i in range(s):
            for d in range(n3):
                m.acc[i, d] += m.change[i, d]
        stage_states(h, m.a, m.a2, m.c, c.from_q, c.from_v, m.acc, m.q_stage, m.v_stage)
        now = relative_change(m.acc, m.change, bodies)
        ratio = now / before
        settled = now == 0.0 or (n > 1 and ratio < 0.9 and ratio / (1.0 - ratio) * now <= tolerance)
        if not settled and n > 1 and ratio > 0.5 and now < np.inf:  # shrinks no more: round-off, or divergence
            idle += 1
            settled = now <= STAGNANT or is_round_off(
                top, w, h, c.from_q, m.v_stage[s - 1], m.lam[s - 1], m.acc[s - 1], bodies, m.change, idle >= IDLE
            )
        if settled:
            break
        if n >= most or (n > 4 and ratio > 4.0 and now > RUNAWAY) or not now < np.inf:
            c.report[0], c.report[2] = 0.0, n
            for i in range(s):
                for d in range(n3):
                    if not abs(m.change[i, d]) <= c.report[0]:
                        c.report[0], c.report[1] = abs(m.change[i, d]), d
            return DIVERGED
        stale = (fresh and n == 1) or (n - taken_at >= 3 and ratio > SLOW)
        before = now
    m.begun[1] = h
    return OK


@entry
def attempt(common, own, t, h, want_error):
    """Try a step from the base state; see `mbdkit.integrators.driver`."""
    c, m = load_common(common), load_collocation(own)
    s = len(m.c)
    if c.moved[0] == ADVANCED and m.first_known[0] != 0 and m.c[s - 1] == 1.0:
        copy(m.acc[s - 1], m.first)  # the last stage of the step before is the beginning of this one
    elif c.moved[0] == ALTERED or c.moved[0] == ADVANCED:
        m.first_known[0] = 0
    status = _iterate(c, m, t, h)
    if status != OK:
        return status
    if c.has_power[0] != 0:
        status = _evaluate_stages(c, m, t, h, True, True)
        if status != OK:
            return status
        for k in range(2):
            c.gain[k] = 0.0
            for i in range(s):
                c.gain[k] += h * m.b[i] * m.power[i, k]
    c.dq[:] = 0.0
    c.dv[:] = 0.0
    n3 = len(c.q) - 3
    for i in range(s):
        w1, w2 = h * m.b[i], h * h * m.b2[i]
        for d in range(n3):
            c.dv[d] += w1 * m.acc[i, d]
            c.dq[d] += w2 * m.acc[i, d]
    for d in range(n3):
        c.dq[d] += h * c.from_v[d] + h * c.v_low[d]
    if not (stays_finite(c.from_q, c.dq) and stays_finite(c.from_v, c.dv)):
        return NOT_FINITE
    if want_error != 0.0:
        if m.first_known[0] == 0:
            prepare(c.top, c.w, t, c.from_q)
            status = solve_accelerations(c.top, c.w, c.solver, c.from_q, c.from_v, m.first, m.first_lam, False)
            if status != OK:
                return status
            c.counts[RHS] += 1
            c.counts[FACTORIZATIONS] += 1
            m.first_known[0] = 1
        _estimate(c, m, h)
    return OK


@part
def _estimate(c, m, h):
    """Write estimates of the local error of positions and velocities."""
    s = len(m.c)
    extrapolation_weights(0.0, 0.0, m.c, m.weights)  # every row: the polynomial at the beginning
    if len(m.mu_real) > 0:
        mu = m.mu_real[0]
    else:
        mu = abs(m.mu_complex[0])
    for d in range(len(c.q) - 3):
        gap = m.first[d]
        for i in range(s):
            gap -= m.weights[0, i] * m.acc[i, d]
        c.est_v[d] = h * mu * gap
    if m.choice[0] == NEWTON:
        filtered(
            c.top, c.solver.row_index, m.mean_jac, m.pattern, m.real, m.cplx,
            m.z_real, m.z_complex, m.b_real, m.x_real, m.b_complex, m.x_complex, c.est_v,
        )  # fmt: skip
    for d in range(len(c.q) - 3):
        c.est_q[d] = h * mu * c.est_v[d]


@entry
def dense(common, own, t, h, theta):
    """Write the state at ``t + theta h`` within the last attempt, by its collocation polynomial."""
    c, m = load_common(common), load_collocation(own)
    weights_at(m.dense_q, theta, m.point)
    for d in range(len(c.q)):
        c.point_q[d] = 0.0
        c.point_v[d] = 0.0
    for i in range(len(m.c)):
        w = h * h * m.point[i]
        for d in range(len(c.q) - 3):
            c.point_q[d] += w * m.acc[i, d]
    weights_at(m.dense_v, theta, m.point)
    for i in range(len(m.c)):
        w = h * m.point[i]
        for d in range(len(c.q) - 3):
            c.point_v[d] += w * m.acc[i, d]
    for d in range(len(c.q)):
        c.point_q[d] += c.from_q[d] + theta * h * c.from_v[d]
        c.point_v[d] += c.from_v[d]
    dense_gains(h, m.point, m.power, c.point_gain)
    return OK


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


def new_collocation(method: ImplicitRungeKutta, problem: Problem, control: Control | None) -> Collocation:
    """Return the bundle of a method for a mechanism, without pivots."""
    from mbdkit.engine.analysis import empty_pattern

    a, b, c = method.tableau.floats()
    a2, b2 = method.tableau.second_order_floats()
    e = Eigenvalues(method.tableau)
    s, size, n = method.tableau.stages, problem.mechanism.size, problem.unknowns
    pairs = len(problem.mechanism.topology.pairs)
    distinct = len(set(c.tolist())) == s
    dense_v, dense_q = collocation_polynomials(c) if distinct else (np.zeros((s, s)), np.zeros((s, s + 1)))
    tolerance = control.iteration_tolerance if control is not None else ROUND_OFF
    if method.tolerance is not None:
        tolerance = method.tolerance
    pattern = empty_pattern()
    stages = (np.zeros((s, size)) for _ in range(5))
    acc, f, change, q_stage, v_stage = stages
    return Collocation(
        a=a, a2=a2, b=b, b2=b2, c=c, dense_v=dense_v, dense_q=dense_q,
        choice=np.array([NEWTON if method.stage_solver == "newton" else FIXED_POINT, method.max_iterations]),
        tolerance=np.array([tolerance]),
        t_real=e.t_real, t_real_inv=e.t_real_inv, mu_real=e.mu_real,
        t_complex=e.t_complex, t_complex_inv=e.t_complex_inv, mu_complex=e.mu_complex,
        pattern=pattern, scatter=problem.solver.scatter,
        real=stacked(pattern, len(e.mu_real), np.float64), cplx=stacked(pattern, len(e.mu_complex), np.complex128),
        acc=acc, begun=np.array([0.0, np.nan]), given=np.array([0]),
        weights=np.zeros((s, s)), lam=np.zeros((s, pairs, 2)),
        f=f, change=change, q_stage=q_stage, v_stage=v_stage,
        first=np.zeros(size), first_known=np.array([0]), first_lam=np.zeros((pairs, 2)),
        mean=np.zeros((3, size)), mean_lam=np.zeros((pairs, 2)), mean_jac=np.zeros((pairs, 12)),
        z_real=np.zeros(size), z_complex=np.zeros(size, dtype=complex),
        b_real=np.zeros(n), x_real=np.zeros(n), b_complex=np.zeros(n, dtype=complex),
        x_complex=np.zeros(n, dtype=complex), power=np.zeros((s, 2)), point=np.zeros(s),
    )  # fmt: skip


class CollocationFamily(Family):
    """Fully implicit tableaus on the index-1 equations."""

    attempt, dense = attempt, dense
    carries_stages = True

    def __init__(self, method: ImplicitRungeKutta, problem: Problem, control: Control | None):
        super().__init__(problem)
        self.own = new_collocation(method, problem, control)
        self.hold = Hold(self.own)
        self.coupled: CoupledNewton | None = None
        self.has_dense_output = method.tableau.is_collocation
        own = self.own
        self.memory = (own.acc, own.lam, own.begun, own.first, own.first_known, own.power)

    def start(self, common: Common, h: float) -> None:
        """Choose pivots for the stage matrix by its numbers at the state in `common`; make room for all eigenvalues."""
        self.renew(common, self.problem.t0, h)

    def renew(self, common: Common, t: float, h: float) -> bool:
        """Choose new pivots for the stage matrix, and start without stage values from before."""
        own, problem = self.own, self.problem
        own.begun[1] = np.nan
        if own.choice[0] == FIXED_POINT:
            rate: complex | None = None
        elif len(own.mu_complex):
            rate = complex(h * own.mu_complex[0])
        else:
            rate = float(h * max(own.mu_real, key=abs))
        for _ in range(2):
            status = tangents_at(problem.stepping_engine, t, common.q, common.v, own.f[0], own.lam[0])
            if status == OK:
                break
            problem.use_pivots()
        own.lam[:] = 0.0
        pattern, _, scatter = problem.choose_pivots(rate)
        self.own = own._replace(
            pattern=pattern,
            scatter=scatter,
            real=stacked(pattern, len(own.mu_real), np.float64),
            cplx=stacked(pattern, len(own.mu_complex), np.complex128),
        )
        self.hold.replace(self.own)
        return True

    def forget(self) -> None:
        """Begin the next step without stage values from before."""
        self.own.begun[1] = np.nan

    def solve_apart(self, common: Common, t: float, h: float) -> bool:
        """Solve the stages of the next attempt with a tangent each; return whether that succeeded."""
        own = self.own
        if own.choice[0] == FIXED_POINT:
            return False
        if self.coupled is None:
            self.coupled = CoupledNewton(self.problem, own.a, own.a2, own.c)
        iterations = self.coupled.solve(t, h, common.q, common.v, own.acc, own.lam)
        spent, counts = self.coupled.counters, common.counts
        counts[RHS] += spent.rhs_evaluations
        counts[JACOBIANS] += spent.jacobian_evaluations
        counts[FACTORIZATIONS] += spent.factorizations
        spent.rhs_evaluations = spent.jacobian_evaluations = spent.factorizations = 0
        own.given[0] = iterations if iterations <= own.choice[1] else 0
        return bool(own.given[0] > 0)

    def describe_divergence(self, report: np.ndarray) -> str:
        """Return the largest residual and where it is."""
        return stage_divergence(self.problem, report)


def stacked(pattern: Pattern, count: int, dtype: type) -> Factors:
    """Return storage for the factors of `count` matrices of one pattern."""
    one = new_factors(pattern, dtype)
    return Factors(*(np.zeros((count, len(x)), x.dtype) for x in one))


def stage_divergence(problem: Problem, report: np.ndarray) -> str:
    """Return where stage equations failed to converge, from a report (3,)."""
    if not np.isfinite(report[0]):
        return ": the stage iteration ran away"
    name = problem.mechanism.unknown_name(int(report[1]))
    unit = "rad/s^2" if int(report[1]) % 3 == 2 else "m/s^2"
    return (
        f": the stage equations did not converge in {int(report[2])} iterations, "
        f"the last one still changed an acceleration of {name} by {report[0]:.3g} {unit}"
    )
