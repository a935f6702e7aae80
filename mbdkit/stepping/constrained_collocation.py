"""Stiffly accurate collocation on the constraints themselves: index 3, index 2, and both (ggl), in compiled code.

Stage i, in second-order form, with A the tableau and its last row the weights of the step:

    M a_i + Phi_q(q_i)^T lambda_i = Q(t_i, q_i, v_i)                 v_i = v_n + h sum_j A_ij a_j
    q_i = q_n + h c_i v_n + h^2 sum_j (A A)_ij a_j - h sum_j A_ij w_j,    w_j = M^-1 Phi_q(q_j)^T mu_j

index-3 asks for Phi(t_i, q_i) = 0 and index-2 for Phi_q v_i + Phi_t = 0, both with mu = 0; ggl asks for both (Gear,
Leimkuhler and Gupta 1985), with multipliers mu that vanish for the exact motion. With M^-1, which their paper leaves
out, what mu moves is the smallest change in the mass metric, whatever the units of lengths and angles.

Simplified Newton with one tangent for all stages decouples along the eigenvectors of A, as on the index-1 equations
(`mbdkit.stepping.index1_collocation`). With r = h mu of an eigenvalue, the changes of accelerations and multipliers
solve

    [ M + r C + r^2 K          Phi_q^T ] [ da      ]     [ M a + Phi_q^T lambda - Q                     ]
    [ Phi_q - g gamma_v        0       ] [ dlambda ] = - [ Phi / r^2,  or  (Phi_q v + Phi_t) / r        ]

with g = 0 (index 3), or r / 2 because d(Phi_q v + Phi_t)/dq is -gamma_v / 2 (index 2, ggl). The rows are scaled by
powers of r, so that the matrix is as well conditioned as that of index 1 however small the step; the round-off of
index-3 multipliers, about eps / h^2 of a coordinate, is the workspace's own.

In ggl the change of w comes first. Both constraints together ask for ``Phi_q dw_i = sum_j (A^-1)_ij Phi_j / h - (Phi_q
v + Phi_t)_i`` but for terms of O(h): with dw_i in the range of M^-1 Phi_q^T that is an index-1 system a stage. The
positions that it moves enter the equations above with the exact K and gamma_v, so that stiff springs slow nothing down.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.engine.iteration_matrix import chosen_pivots, classes_of
from mbdkit.engine.jit.bundle import PinnedBundle, bundle_loader
from mbdkit.engine.jit.decorators import entry, subkernel
from mbdkit.engine.kernels.equations import DAMPING, GAMMA_V, JACOBIAN, MASS, RESIDUAL_Q, STIFFNESS
from mbdkit.engine.kernels.lu import factorize, substitute
from mbdkit.engine.kernels.projection import position_rows, rate_rows
from mbdkit.engine.kernels.system import (
    DIVERGED,
    NOT_FINITE,
    OK,
    REPIVOT_STAGES,
    applied_forces,
    evaluate_powers,
    evaluate_tangents,
    prepare,
    solve_system,
    solved_rows,
    unfold_multipliers,
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
from mbdkit.stepping.dense_output import dense_gains
from mbdkit.stepping.position_convergence import (
    IDLE,
    IDLE_RATIO,
    ROUND_OFF,
    RUNAWAY,
    SLOW,
    STAGNANT,
    is_settled,
    relative_sizes,
)
from mbdkit.stepping.run_state import FACTORIZATIONS, ITERATIONS, JACOBIANS, RHS, SAME, Common, load_common
from mbdkit.stepping.simplified_newton import one_of
from mbdkit.stepping.stages import extrapolate, extrapolation_weights, is_round_off, stage_mean, stage_states

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.methods.kinds import ImplicitRungeKutta

SMALL = 1e-9
"""A relative change of positions below which forces that cancel may keep it from shrinking further."""

INDEX_3, INDEX_2, GGL = range(3)
FORMULATIONS = {"index-3": INDEX_3, "index-2": INDEX_2, "ggl": GGL}


class Constrained(NamedTuple):
    """A stiffly accurate method of s stages on a formulation, and its room."""

    rk: Coefficients
    """Its last stage is the end of the step."""
    systems: Systems
    scatter: np.ndarray
    """(N, 3) each term of the matrices: its place in ``Scratch.source`` and among the values, and its class."""
    by_position: np.ndarray
    """(N', 4) the derivatives of the equations by positions: place in ``Scratch.source``, row, column, class."""
    inverse: np.ndarray
    """(s, s) A^-1."""
    choice: np.ndarray
    """(2,) INDEX_3, INDEX_2 or GGL, and the most iterations in one step."""
    tolerance: np.ndarray
    """(1,) expected change of the state, relative to its size, at which the iteration ends."""
    acc: np.ndarray
    """(s, 3 (B + 1)) accelerations of the stages; `begun` tells when the step began that they belong to, and its size:
    NaN where there are none."""
    lam: np.ndarray
    """(s, P, 2) multipliers of the stages, of the rows that are solved for."""
    mu: np.ndarray
    begun: np.ndarray
    weights: np.ndarray
    push: np.ndarray
    """(s, 3 (B + 1)) what mu moves, M^-1 Phi_q^T mu, and its last change."""
    push_change: np.ndarray
    jac: np.ndarray
    """(s, P, 12) Jacobians of the stages."""
    gap: np.ndarray
    """(s, P, 2) Phi of the stages."""
    lack: np.ndarray
    """(s, n + m) what the equations of motion and the constraints of each stage lack."""
    change: np.ndarray
    """(s, n + m) change of accelerations and multipliers."""
    q_stage: np.ndarray
    v_stage: np.ndarray
    first: np.ndarray
    """(3 (B + 1),) acceleration at the beginning of the step, and whether it is known."""
    first_known: np.ndarray
    mean: np.ndarray
    pairs: np.ndarray
    """(P, 2) scratch."""
    spread: np.ndarray
    """(s, 3 (B + 1)) scratch."""
    power: np.ndarray
    """(s, 2) powers of the stages."""
    point: np.ndarray
    """(s,) scratch: weights of dense output."""


def _example() -> Constrained:
    from mbdkit.engine.example_workspace import example_workspace
    from mbdkit.methods import radau_iia
    from mbdkit.methods.kinds import ImplicitRungeKutta

    workspace = replace(example_workspace(), formulation="index-3")
    return ConstrainedFamily(ImplicitRungeKutta(radau_iia.tableau(2)), workspace).own


load_constrained = bundle_loader(_example)


@subkernel
def _predict(m, t, h):
    """Begin with the stages of the step before, carried on by their polynomials, or with free flight."""
    size = m.begun[1]
    if not abs(size) > 0.0:
        m.acc[:, :] = 0.0
        m.lam[:, :, :] = 0.0
        m.mu[:, :, :] = 0.0
        m.push[:, :] = 0.0
        return True
    extrapolation_weights((t - m.begun[0]) / size, h / size, m.rk.c, m.weights)
    extrapolate(m.weights, m.acc, m.spread)
    for r in range(2):
        extrapolate(m.weights, m.lam[:, :, r], m.gap[:, :, r])
    return False


@subkernel
def _stages(c, m, h):
    """Evaluate positions and velocities of every stage."""
    stage_states(h, m.rk.a, m.rk.a2, m.rk.c, c.from_q, c.from_v, m.acc, m.q_stage, m.v_stage)
    if m.choice[0] == GGL:
        for i in range(len(m.rk.c)):
            for j in range(len(m.rk.c)):
                w = h * m.rk.a[i, j]
                for d in range(len(c.q) - 3):
                    m.q_stage[i, d] -= w * m.push[j, d]


@subkernel
def _gather(c, m, rate, values):
    """Fill the scaled values of the matrix for ``rate = h mu``."""
    lower = 0.0 * rate if m.choice[0] == INDEX_3 else -0.5 * rate
    values[:] = 0.0
    for e in range(len(m.scatter)):
        kind = m.scatter[e, 2]
        factor = 1.0 + 0.0 * rate
        if kind == DAMPING:
            factor = rate
        elif kind == STIFFNESS:
            factor = rate * rate
        elif kind == GAMMA_V:
            factor = lower
        values[m.scatter[e, 1]] += factor * c.w.source[m.scatter[e, 0]]
    for x in range(len(values)):
        values[x] *= m.systems.pattern.weight[x]


@subkernel
def _take_tangents(c, m, t, h):
    """Evaluate and factorize the matrices of all eigenvalues at the middle of the stages; return a status."""
    top, w, systems = c.top, c.w, m.systems
    stage_mean(m.q_stage, m.mean[0])
    stage_mean(m.v_stage, m.mean[1])
    stage_mean(m.acc, m.mean[2])
    for r in range(2):
        stage_mean(m.lam[:, :, r], m.pairs[:, r])
    middle = 0.0
    for i in range(len(m.rk.c)):
        middle += m.rk.c[i] / len(m.rk.c)
    prepare(top, w, t + middle * h, m.mean[0])
    unfold_multipliers(top, w.cs, m.pairs)
    evaluate_tangents(top, w, t + middle * h, m.mean[0], m.mean[1], m.mean[2], m.pairs)
    c.counts[JACOBIANS] += 1
    c.counts[FACTORIZATIONS] += len(m.rk.mu_real) + len(m.rk.mu_complex)
    failed = -1
    for e in range(len(m.rk.mu_real)):
        _gather(c, m, h * m.rk.mu_real[e], systems.real.a[e])
        failed = max(failed, factorize(systems.pattern, one_of(systems.real, e)))
    for e in range(len(m.rk.mu_complex)):
        _gather(c, m, h * m.rk.mu_complex[e], systems.cplx.a[e])
        failed = max(failed, factorize(systems.pattern, one_of(systems.cplx, e)))
    if failed >= 0:
        c.solver.failed[0] = failed
        return REPIVOT_STAGES
    return OK


@subkernel
def _evaluate(c, m, t, h):
    """Evaluate what the equations of every stage lack into ``m.lack``."""
    top, w = c.top, c.w
    n3 = len(c.q) - 3
    has_forces = len(top.springs) + len(top.loads) > 0
    for i in range(len(m.rk.c)):
        q, v, lack = m.q_stage[i], m.v_stage[i], m.lack[i]
        position_rows(top, w, t + m.rk.c[i] * h, q)
        solved_rows(top, w, q, v)
        for b in range(len(top.mass) - 1):
            lack[3 * b] = top.mass[b, 0] * (m.acc[i, 3 * b] - top.gravity[0])
            lack[3 * b + 1] = top.mass[b, 1] * (m.acc[i, 3 * b + 1] - top.gravity[1])
            lack[3 * b + 2] = top.mass[b, 2] * m.acc[i, 3 * b + 2]
        if has_forces:
            applied_forces(top, w, q, v)
            for d in range(n3):
                lack[d] -= w.force[d]
        rate_rows(top, w.jac, w.phi_t, v, m.pairs)
        for k in range(len(top.pairs)):
            for r in range(top.rows[k]):
                for side in range(2):
                    at = 3 * top.pairs[k, 1 + side]
                    if at < n3:
                        for d in range(3):
                            lack[at + d] += w.jac[k, 6 * r + 3 * side + d] * m.lam[i, k, r]
                m.gap[i, k, r] = w.phi[k, r]
                lack[c.solver.row_index[k, r]] = w.phi[k, r] if m.choice[0] == INDEX_3 else m.pairs[k, r]
            copy(w.jac[k], m.jac[i, k])
    c.counts[RHS] += len(m.rk.c)


@subkernel
def _push_on(c, m, h):
    """Change mu so that both constraints can be met, and what the equations lack by the positions it moves (ggl)."""
    top, w = c.top, c.w
    s = len(m.rk.c)
    n3 = len(c.q) - 3
    for i in range(s):
        for k in range(len(top.pairs)):
            copy(m.jac[i, k], w.jac[k])
            w.gamma[k, 0] = w.gamma[k, 1] = 0.0
            for r in range(top.rows[k]):
                total = -m.lack[i, c.solver.row_index[k, r]]
                for j in range(s):
                    total += m.inverse[i, j] / h * m.gap[j, k, r]
                w.gamma[k, r] = total
        status = solve_system(c.still, w, c.solver, False, m.mean[0], m.pairs, False)
        if status != OK:
            return status
        for d in range(n3):
            m.push_change[i, d] = -m.push[i, d]
            m.push[i, d] = 0.0
        for k in range(len(top.pairs)):
            for r in range(top.rows[k]):
                m.mu[i, k, r] -= m.pairs[k, r]
                for side in range(2):
                    b = top.pairs[k, 1 + side]
                    if 3 * b < n3:
                        for d in range(3):
                            g = top.weight[b, d] * w.jac[k, 6 * r + 3 * side + d]
                            m.push[i, 3 * b + d] += g * m.mu[i, k, r]
        for d in range(n3):
            m.push_change[i, d] += m.push[i, d]
    c.counts[FACTORIZATIONS] += s
    for i in range(s):
        for d in range(n3):
            total = 0.0
            for j in range(s):
                total -= h * m.rk.a[i, j] * m.push_change[j, d]
            m.spread[i, d] = total
        for e in range(len(m.by_position)):
            factor = 1.0 if m.by_position[e, 3] == STIFFNESS else -0.5
            m.lack[i, m.by_position[e, 1]] += factor * w.source[m.by_position[e, 0]] * m.spread[i, m.by_position[e, 2]]
    return OK


@subkernel
def _solve(c, m, h):
    """Solve the transformed systems for the change of every stage's accelerations and multipliers."""
    rk, systems = m.rk, m.systems
    b_real, x_real = systems.b_real, systems.x_real
    b_complex, x_complex = systems.b_complex, systems.x_complex
    s, size = m.lack.shape
    n3 = len(c.q) - 3
    m.change[:, :] = 0.0
    for e in range(len(rk.mu_real)):
        rate = h * rk.mu_real[e]
        scale = rate * rate if m.choice[0] == INDEX_3 else rate
        for d in range(size):
            total = 0.0
            for j in range(s):
                total += rk.t_real_inv[e, j] * m.lack[j, d]
            b_real[d] = total if d < n3 else total / scale
        substitute(systems.pattern, one_of(systems.real, e), b_real, x_real)
        for i in range(s):
            for d in range(size):
                m.change[i, d] -= rk.t_real[i, e] * x_real[d]
    for e in range(len(rk.mu_complex)):
        z = h * rk.mu_complex[e]
        lower = z * z if m.choice[0] == INDEX_3 else z
        for d in range(size):
            sum_z = 0.0 * z
            for j in range(s):
                sum_z += rk.t_complex_inv[e, j] * m.lack[j, d]
            b_complex[d] = sum_z if d < n3 else sum_z / lower
        substitute(systems.pattern, one_of(systems.cplx, e), b_complex, x_complex)
        for i in range(s):
            y = rk.t_complex[i, e]
            for d in range(size):
                m.change[i, d] -= 2.0 * (y.real * x_complex[d].real - y.imag * x_complex[d].imag)


@subkernel
def _change_of_positions(c, m, h):
    """Write the change of every stage's positions into ``m.spread``."""
    for i in range(len(m.rk.c)):
        for d in range(len(c.q) - 3):
            total = 0.0
            for j in range(len(m.rk.c)):
                total += h * h * m.rk.a2[i, j] * m.change[j, d]
                if m.choice[0] == GGL:
                    total -= h * m.rk.a[i, j] * m.push_change[j, d]
            m.spread[i, d] = total


@subkernel
def _change_of_velocities(c, m, h):
    """Write the change of every stage's velocities into ``m.spread``."""
    for i in range(len(m.rk.c)):
        for d in range(len(c.q) - 3):
            total = 0.0
            for j in range(len(m.rk.c)):
                total += h * m.rk.a[i, j] * m.change[j, d]
            m.spread[i, d] = total


@subkernel
def _is_noise(c, m, h, moved):
    """Return whether changes that shrink no more are the round-off of single forces, of stiff springs above all."""
    last = len(m.rk.c) - 1
    return moved <= SMALL and is_round_off(
        c.top, c.w, h, c.from_q, m.v_stage[last], m.lam[last], m.acc[last], len(c.top.mass) - 1, m.change, True
    )


@subkernel
def _iterate(c, m, t, h):
    """Solve the stage equations; return a status."""
    top = c.top
    s = len(m.rk.c)
    bodies = len(top.mass) - 1
    fresh = _predict(m, t, h)
    m.begun[0], m.begun[1] = t, np.nan
    _stages(c, m, h)
    stale = True
    taken_at = n = idle = 0
    before = np.inf
    while True:
        if stale:
            status = _take_tangents(c, m, t, h)
            if status != OK:
                return status
            stale = False
            taken_at = n
        _evaluate(c, m, t, h)
        if m.choice[0] == GGL:
            status = _push_on(c, m, h)
            if status != OK:
                return status
        _solve(c, m, h)
        c.counts[ITERATIONS] += 1
        n += 1
        for i in range(s):
            for d in range(3 * bodies):
                m.acc[i, d] += m.change[i, d]
            for k in range(len(top.pairs)):
                for r in range(top.rows[k]):
                    m.lam[i, k, r] += m.change[i, c.solver.row_index[k, r]]
        _stages(c, m, h)
        _change_of_positions(c, m, h)
        now = moved = relative_sizes(m.spread, c.from_q, bodies)
        if m.choice[0] != INDEX_3:
            _change_of_velocities(c, m, h)
            now = max(now, relative_sizes(m.spread, m.v_stage[s - 1], bodies))
            moved = max(moved, h * relative_sizes(m.spread, c.from_q, bodies))
        ratio = now / before
        if is_settled(n, now, ratio, moved, m.tolerance[0]):
            break
        if n > 1 and ratio > IDLE_RATIO and now < np.inf:
            idle += 1
            if idle >= IDLE and (now <= STAGNANT or _is_noise(c, m, h, moved)):
                break
        if n >= m.choice[1] or (n > 4 and ratio > 4.0 and now > RUNAWAY) or not now < np.inf:
            report_divergence(c, n, m.change, s)
            return DIVERGED
        stale = (fresh and n == 1) or (n - taken_at >= 3 and ratio > SLOW)
        before = now
    m.begun[1] = h
    return OK


@subkernel
def _own_multipliers(c, t, q, lam, out):
    """Write multipliers of the rows that are solved for as those of the pairs' own rows; prepares the position."""
    prepare(c.top, c.w, t, q)
    for k in range(len(out)):
        out[k, 0], out[k, 1] = lam[k, 0], lam[k, 1]
    unfold_multipliers(c.top, c.w.cs, out)


@entry
def attempt(common, own, t, h, want_error):
    """Try a step from the base state; see `mbdkit.stepping.driver`."""
    c, m = load_common(common), load_constrained(own)
    s = len(m.rk.c)
    if c.moved[0] != SAME:
        m.first_known[0] = 0
    status = _iterate(c, m, t, h)
    if status != OK:
        return status
    c.gain[0] = c.gain[1] = 0.0
    if c.has_power[0] != 0:
        for i in range(s):
            _own_multipliers(c, t + m.rk.c[i] * h, m.q_stage[i], m.lam[i], m.pairs)
            applied_forces(c.top, c.w, m.q_stage[i], m.v_stage[i])
            m.power[i, 0], m.power[i, 1] = evaluate_powers(c.top, c.w, m.q_stage[i], m.v_stage[i], m.pairs)
        c.counts[RHS] += s
        dense_gains(h, m.rk.b, m.power, c.gain)
    add_up(c, h, m.rk.a[s - 1], m.rk.a2[s - 1], m.acc)
    if m.choice[0] == GGL:
        for j in range(s):
            w = h * m.rk.a[s - 1, j]
            for d in range(len(c.q) - 3):
                c.dq[d] -= w * m.push[j, d]
    if not (stays_finite(c.from_q, c.dq) and stays_finite(c.from_v, c.dv)):
        return NOT_FINITE
    if want_error != 0.0:
        status = first_acceleration(c, t, m.first, m.first_known, m.pairs)
        if status != OK:
            return status
        _estimate(c, m, h)
    _own_multipliers(c, t + h, m.q_stage[s - 1], m.lam[s - 1], c.own_lam)
    return OK


@subkernel
def _estimate(c, m, h):
    """Write estimates of the local error, those of `mbdkit.stepping.index1_collocation` along the constraints.

    The lower right side is zero: what accelerations of the stages miss across the constraints does not add up.
    """
    systems = m.systems
    n3 = len(c.q) - 3
    gap_at_beginning(h, m.rk, m.first, m.acc, m.weights, c.est_v)
    for d in range(n3):
        c.est_v[d] *= c.top.mass[d // 3, d % 3]
    if len(m.rk.mu_real) > 0:
        for d in range(len(systems.b_real)):
            systems.b_real[d] = c.est_v[d] if d < n3 else 0.0
        substitute(systems.pattern, one_of(systems.real, 0), systems.b_real, systems.x_real)
        for d in range(n3):
            c.est_v[d] = systems.x_real[d]
    else:
        for d in range(len(systems.b_complex)):
            systems.b_complex[d] = c.est_v[d] if d < n3 else 0.0
        substitute(systems.pattern, one_of(systems.cplx, 0), systems.b_complex, systems.x_complex)
        for d in range(n3):
            c.est_v[d] = systems.x_complex[d].real
    rate = h * leading(m.rk)
    for d in range(n3):
        c.est_q[d] = rate * c.est_v[d]


@entry
def dense(common, own, t, h, theta):
    """Write the state at ``t + theta h`` within the last attempt, by its collocation polynomial."""
    c, m = load_common(common), load_constrained(own)
    state_inside(c, m.rk, h, theta, m.acc, m.point)
    if m.choice[0] == GGL:
        for i in range(len(m.rk.c)):
            w = h * m.point[i]
            for d in range(len(c.q) - 3):
                c.point_q[d] -= w * m.push[i, d]
    dense_gains(h, m.point, m.power, c.point_gain)
    extrapolation_weights(theta, 0.0, m.rk.c, m.weights)
    m.pairs[:, :] = 0.0
    for i in range(len(m.rk.c)):
        for k in range(len(m.pairs)):
            for r in range(2):
                m.pairs[k, r] += m.weights[0, i] * m.lam[i, k, r]
    _own_multipliers(c, t + theta * h, c.point_q, m.pairs, c.point_lam)
    return OK


def new_constrained(
    method: ImplicitRungeKutta, workspace: Workspace, rk: Coefficients, systems: Systems
) -> Constrained:
    """Return the bundle of a method for a mechanism on the workspace's formulation, without pivots."""
    s, size, n = method.tableau.stages, workspace.mechanism.size, workspace.unknowns
    pairs = len(workspace.mechanism.topology.pairs)
    tolerance = method.tolerance if method.tolerance is not None else ROUND_OFF
    terms, classes = workspace.terms, classes_of(workspace)
    wanted = (classes == STIFFNESS) | (classes == GAMMA_V)
    by_position = np.column_stack([x[wanted] for x in (terms.source, terms.row, terms.column, classes)])
    acc, push, push_change, q_stage, v_stage, spread = (np.zeros((s, size)) for _ in range(6))
    lam, mu, gap = (np.zeros((s, pairs, 2)) for _ in range(3))
    return Constrained(
        rk=rk, systems=systems,
        scatter=np.zeros((0, 3), dtype=np.int64), by_position=by_position.astype(np.int64),
        inverse=np.ascontiguousarray(np.linalg.inv(rk.a)),
        choice=np.array([FORMULATIONS[workspace.formulation], method.max_iterations]), tolerance=np.array([tolerance]),
        acc=acc, lam=lam, mu=mu, begun=np.array([0.0, np.nan]), weights=np.zeros((s, s)),
        push=push, push_change=push_change, jac=np.zeros((s, pairs, 12)), gap=gap,
        lack=np.zeros((s, n)), change=np.zeros((s, n)), q_stage=q_stage, v_stage=v_stage,
        first=np.zeros(size), first_known=np.array([0]), mean=np.zeros((3, size)), pairs=np.zeros((pairs, 2)),
        spread=spread, power=np.zeros((s, 2)), point=np.zeros(s),
    )  # fmt: skip


class ConstrainedFamily(StageFamily):
    """Stiffly accurate collocation on index 3, index 2 or ggl, as the workspace's formulation says."""

    attempt, dense = attempt, dense
    carries_multipliers = True

    def __init__(self, method: ImplicitRungeKutta, workspace: Workspace):
        super().__init__(method, workspace)
        self.own = new_constrained(method, workspace, self.rk, self._no_systems())
        self.hold = PinnedBundle(self.own)
        own, self.begun = self.own, self.own.begun
        self.memory = (own.acc, own.lam, own.mu, own.push, own.begun, own.first, own.first_known, own.power)

    def renew(self, common: Common, t: float, h: float) -> bool:
        """Choose new pivots for the stage matrix, and start without stage values from before."""
        own, workspace, rate = self.own, self.workspace, self._rate(h)
        self.forget()
        self._take_tangents(common, t, own.first, own.pairs)
        own.first_known[0] = 0
        coefficients = np.zeros(6, dtype=type(rate))
        coefficients[[MASS, JACOBIAN, DAMPING, STIFFNESS]] = 1.0, 1.0, rate, rate**2
        coefficients[GAMMA_V] = 0.0 if own.choice[0] == INDEX_3 else -0.5 * rate
        coefficients[RESIDUAL_Q] = 0.0
        pivots = chosen_pivots(workspace, classes_of(workspace), coefficients)
        self.own = own._replace(
            systems=new_systems(self.rk, pivots.pattern, workspace.unknowns), scatter=pivots.scatter
        )
        self.hold.replace(self.own)
        return True
