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

from mbdkit.engine.jit.bundle import PinnedBundle, bundle_loader
from mbdkit.engine.jit.decorators import entry, subkernel
from mbdkit.engine.kernels.system import (
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
from mbdkit.engine.kernels.vectors import copy, stays_finite
from mbdkit.stepping.collocation import (
    Coefficients,
    StageFamily,
    Systems,
    add_up,
    first_acceleration,
    gap_at_beginning,
    leading,
    new_systems,
    report_divergence,
    state_inside,
)
from mbdkit.stepping.coupled_newton import CoupledNewton
from mbdkit.stepping.dense_output import dense_gains
from mbdkit.stepping.run_state import (
    ADVANCED,
    ALTERED,
    FACTORIZATIONS,
    ITERATIONS,
    JACOBIANS,
    RHS,
    Common,
    load_common,
)
from mbdkit.stepping.simplified_newton import factorize_all, filtered, newton_changes
from mbdkit.stepping.stages import (
    STAGNANT,
    extrapolate,
    extrapolation_weights,
    is_round_off,
    relative_change,
    stage_mean,
    stage_states,
)

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.methods.kinds import ImplicitRungeKutta
    from mbdkit.stepping.step_control import Control

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

    rk: Coefficients
    systems: Systems
    scatter: Scatter
    choice: np.ndarray
    """(2,) NEWTON or FIXED_POINT, and the most iterations in one step."""
    tolerance: np.ndarray
    """(1,) relative change of accelerations at which the iteration ends."""
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
    power: np.ndarray
    """(s, 2) powers of the stages."""
    point: np.ndarray
    """(s,) scratch: weights of dense output."""


def _example() -> Collocation:
    from mbdkit.engine.example_workspace import example_workspace
    from mbdkit.methods import gauss
    from mbdkit.methods.kinds import ImplicitRungeKutta

    return CollocationFamily(ImplicitRungeKutta(gauss.tableau(1)), example_workspace(), None).own


load_collocation = bundle_loader(_example)


@subkernel
def _predict(m, t, h):
    """Begin with the accelerations of the step before, carried on by their polynomial, or with free flight."""
    size = m.begun[1]
    if not abs(size) > 0.0:  # a stiff force may be far from constant over the step
        m.acc[:, :] = 0.0
        m.lam[:, :, :] = 0.0
        return True
    extrapolation_weights((t - m.begun[0]) / size, h / size, m.rk.c, m.weights)
    extrapolate(m.weights, m.acc, m.f)
    return False


@subkernel
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
    c.counts[FACTORIZATIONS] += len(m.rk.mu_real) + len(m.rk.mu_complex)
    failed = factorize_all(w.source, m.scatter, m.rk, m.systems, h)
    if failed >= 0:
        c.solver.failed[0] = failed
        return REPIVOT_STAGES
    return OK


@subkernel
def _evaluate_stages(c, m, t, h, refine, with_powers):
    """Evaluate the index-1 accelerations of every stage into ``m.f``; return a status."""
    top, w = c.top, c.w
    for i in range(len(m.rk.c)):
        prepare(top, w, t + m.rk.c[i] * h, m.q_stage[i])
        status = solve_accelerations(top, w, c.solver, m.q_stage[i], m.v_stage[i], m.f[i], m.lam[i], refine)
        if status != OK:
            return status
        if with_powers:
            m.power[i, 0], m.power[i, 1] = evaluate_powers(top, w, m.q_stage[i], m.v_stage[i], m.lam[i])
    c.counts[RHS] += len(m.rk.c)
    c.counts[FACTORIZATIONS] += len(m.rk.c)
    return OK


@subkernel
def _iterate(c, m, t, h):
    """Solve the stage equations from the accelerations that stand in ``m.acc``; return a status."""
    top, w = c.top, c.w
    s = len(m.rk.c)
    bodies = len(top.mass) - 1
    n3 = 3 * bodies
    kind, most, tolerance = m.choice[0], m.choice[1], m.tolerance[0]
    if m.given[0] > 0:
        c.counts[ITERATIONS] += m.given[0]
        m.given[0] = 0
        m.begun[0], m.begun[1] = t, h
        stage_states(h, m.rk.a, m.rk.a2, m.rk.c, c.from_q, c.from_v, m.acc, m.q_stage, m.v_stage)
        return OK
    fresh = _predict(m, t, h)
    m.begun[0], m.begun[1] = t, np.nan
    stage_states(h, m.rk.a, m.rk.a2, m.rk.c, c.from_q, c.from_v, m.acc, m.q_stage, m.v_stage)
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
            newton_changes(top, c.solver.row_index, m.mean_jac, m.rk, m.systems, m.f, m.z_real, m.z_complex, m.change)
        else:
            for i in range(s):
                for d in range(n3):
                    m.change[i, d] = m.f[i, d] - m.acc[i, d]
        for i in range(s):
            for d in range(n3):
                m.acc[i, d] += m.change[i, d]
        stage_states(h, m.rk.a, m.rk.a2, m.rk.c, c.from_q, c.from_v, m.acc, m.q_stage, m.v_stage)
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
            report_divergence(c, n, m.change, s)
            return DIVERGED
        stale = (fresh and n == 1) or (n - taken_at >= 3 and ratio > SLOW)
        before = now
    m.begun[1] = h
    return OK


@entry
def attempt(common, own, t, h, want_error):
    """Try a step from the base state; see `mbdkit.stepping.driver`."""
    c, m = load_common(common), load_collocation(own)
    s = len(m.rk.c)
    if c.moved[0] == ADVANCED and m.first_known[0] != 0 and m.rk.c[s - 1] == 1.0:
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
                c.gain[k] += h * m.rk.b[i] * m.power[i, k]
    add_up(c, h, m.rk.b, m.rk.b2, m.acc)
    if not (stays_finite(c.from_q, c.dq) and stays_finite(c.from_v, c.dv)):
        return NOT_FINITE
    if want_error != 0.0:
        status = first_acceleration(c, t, m.first, m.first_known, m.first_lam)
        if status != OK:
            return status
        _estimate(c, m, h)
    return OK


@subkernel
def _estimate(c, m, h):
    """Write estimates of the local error of positions and velocities."""
    gap_at_beginning(h, m.rk, m.first, m.acc, m.weights, c.est_v)
    if m.choice[0] == NEWTON:
        filtered(c.top, c.solver.row_index, m.mean_jac, m.systems, m.z_real, m.z_complex, c.est_v)
    rate = h * leading(m.rk)
    for d in range(len(c.q) - 3):
        c.est_q[d] = rate * c.est_v[d]


@entry
def dense(common, own, t, h, theta):
    """Write the state at ``t + theta h`` within the last attempt, by its collocation polynomial."""
    c, m = load_common(common), load_collocation(own)
    state_inside(c, m.rk, h, theta, m.acc, m.point)
    dense_gains(h, m.point, m.power, c.point_gain)
    return OK


def new_collocation(
    method: ImplicitRungeKutta, workspace: Workspace, control: Control | None, rk: Coefficients, systems: Systems
) -> Collocation:
    """Return the bundle of a method for a mechanism, without pivots."""
    s, size = method.tableau.stages, workspace.mechanism.size
    pairs = len(workspace.mechanism.topology.pairs)
    tolerance = control.iteration_tolerance if control is not None else ROUND_OFF
    if method.tolerance is not None:
        tolerance = method.tolerance
    acc, f, change, q_stage, v_stage = (np.zeros((s, size)) for _ in range(5))
    return Collocation(
        rk=rk, systems=systems, scatter=workspace.solver.scatter,
        choice=np.array([NEWTON if method.stage_solver == "newton" else FIXED_POINT, method.max_iterations]),
        tolerance=np.array([tolerance]),
        acc=acc, begun=np.array([0.0, np.nan]), given=np.array([0]),
        weights=np.zeros((s, s)), lam=np.zeros((s, pairs, 2)),
        f=f, change=change, q_stage=q_stage, v_stage=v_stage,
        first=np.zeros(size), first_known=np.array([0]), first_lam=np.zeros((pairs, 2)),
        mean=np.zeros((3, size)), mean_lam=np.zeros((pairs, 2)), mean_jac=np.zeros((pairs, 12)),
        z_real=np.zeros(size), z_complex=np.zeros(size, dtype=complex),
        power=np.zeros((s, 2)), point=np.zeros(s),
    )  # fmt: skip


class CollocationFamily(StageFamily):
    """Fully implicit tableaus on the index-1 equations."""

    attempt, dense = attempt, dense

    def __init__(self, method: ImplicitRungeKutta, workspace: Workspace, control: Control | None):
        super().__init__(method, workspace)
        self.own = new_collocation(method, workspace, control, self.rk, self._no_systems())
        self.hold = PinnedBundle(self.own)
        self.coupled: CoupledNewton | None = None
        own, self.begun = self.own, self.own.begun
        self.memory = (own.acc, own.lam, own.begun, own.first, own.first_known, own.power)

    def renew(self, common: Common, t: float, h: float) -> bool:
        """Choose new pivots for the stage matrix, and start without stage values from before."""
        own, workspace = self.own, self.workspace
        self.forget()
        self._take_tangents(common, t, own.f[0], own.lam[0])
        own.lam[:] = 0.0
        pattern, _, scatter = workspace.choose_pivots(None if own.choice[0] == FIXED_POINT else self._rate(h))
        self.own = own._replace(systems=new_systems(self.rk, pattern, workspace.unknowns), scatter=scatter)
        self.hold.replace(self.own)
        return True

    def solve_apart(self, common: Common, t: float, h: float) -> bool:
        """Solve the stages of the next attempt with a tangent each; return whether that succeeded."""
        own = self.own
        if own.choice[0] == FIXED_POINT:
            return False
        if self.coupled is None:
            self.coupled = CoupledNewton(self.workspace, self.rk.a, self.rk.a2, self.rk.c)
        iterations = self.coupled.solve(t, h, common.q, common.v, own.acc, own.lam)
        spent, counts = self.coupled.counters, common.counts
        counts[RHS] += spent.rhs_evaluations
        counts[JACOBIANS] += spent.jacobian_evaluations
        counts[FACTORIZATIONS] += spent.factorizations
        spent.rhs_evaluations = spent.jacobian_evaluations = spent.factorizations = 0
        own.given[0] = iterations if iterations <= own.choice[1] else 0
        return bool(own.given[0] > 0)
