"""Steps of time-stepping methods without impulses of contacts.

With positions q_m = q_0 + h/2 v_0, at which gaps, their gradients and joints are evaluated, a step of the method of
Moreau and Jean from (q_0, v_0) is

    M (v_1 - v_0) = h (theta Q(t_1, q_1, v_1) + (1 - theta) Q(t_0, q_0, v_0)) + joints + contacts
    q_1 = q_0 + h (theta v_1 + (1 - theta) v_0)

where "joints" are impulses that make the velocities consistent, and "contacts" are impulses, by the laws of Newton and
Coulomb, at the contacts that would overlap at the end. One iteration of Newton's method makes the forces implicit. Then
the positions are projected: joints are closed, and overlapping shapes are moved apart.

The nonsmooth generalized-alpha method first ignores contacts: the method of Chung and Hulbert gives positions q~ and
velocities v~ from accelerations that satisfy the equations of motion at the end,

    (1 - alpha_m) a_1 + alpha_m a_0 = (1 - alpha_f) w_1 + alpha_f w_0,    w_1 the accelerations at (t_1, q~_1, v~_1)
    v~_1 = v_0 + h ((1 - gamma) a_0 + gamma a_1)
    q~_1 = q_0 + h v_0 + h^2 ((1/2 - beta) a_0 + beta a_1)

Then the velocities are made consistent with the joints, and contacts that would overlap get impulses, which change the
velocities by dv and the positions by h dv / 2. Finally the positions are projected.

J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988; M. Jean, Computer Methods in Applied
Mechanics and Engineering 177:235-257, 1999; V. Acary and B. Brogliato, Numerical Methods for Nonsmooth Dynamical
Systems, 2008, chapter 10; Q.-z. Chen, V. Acary, G. Virlez and O. Bruls, International Journal for Numerical Methods in
Engineering 96:487-511, 2013, with the algorithmic parameters of J. Chung and G. M. Hulbert, Journal of Applied
Mechanics 60:371-375, 1993.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_accelerations, solve_system
from mbdkit.engine.kernels.applied_forces import any_forces, applied_forces, take_multipliers
from mbdkit.engine.kernels.equations import DAMPING, GAMMA_V, JACOBIAN, MASS, STIFFNESS
from mbdkit.engine.kernels.lu import factorize, solve_refined
from mbdkit.engine.kernels.projection import largest_size, position_rows, project_velocities, rate_rows
from mbdkit.engine.kernels.system import (
    DIVERGED,
    NOT_FINITE,
    OK,
    REPIVOT_STAGES,
    evaluate_tangents,
    fold_values,
    prepare,
    solved_rows,
    unfold_multipliers,
)
from mbdkit.engine.kernels.vectors import copy, fill, fill_rows
from mbdkit.engine.native.functions import subkernel
from mbdkit.integrators.run.run_state import FACTORIZATIONS, ITERATIONS, JACOBIANS, RHS

MOST_ITERATIONS = 20  #: Largest number of Newton iterations in a step of the generalized-alpha method.
#: Changes of the coordinates, relative to the largest coordinate, that count as zero, and below which the iteration may
#: stagnate.
CONVERGED, STALLED = 1e-14, 1e-9
#: Why an attempt failed: no impulses satisfy the laws of impact and friction, the equations of the step were not
#: solved, or no positions without overlap were found.
NO_IMPULSES, STAGES, OVERLAP = range(1, 4)


@subkernel
def total_force(c, t, q, v, lam, out):
    """Write the applied forces (N,), gravity included; `lam` (P, 2) determines the friction in joints."""
    prepare(c.top, c.w, t, q)
    fill(out, 0.0)
    if any_forces(c.top):
        take_multipliers(c.top, c.w, lam)
        applied_forces(c.top, c.w, q, v)
        for d in range(len(out) - 3):
            out[d] = c.w.force[d]
    for b in range(len(c.top.mass) - 1):
        for d in range(2):
            out[3 * b + d] += c.top.mass[b, d] * c.top.gravity[d]
    c.counts[RHS] += 1


@subkernel
def _factorize(c, m, damping, stiffness, gamma_v, residual_q):
    """Factorize the matrix of a step from the terms in ``c.w.source``; return a status.

    Bodies without terms other than their masses are coupled to others by contacts only.
    """
    source, values = c.w.source, m.factors.a
    c.counts[JACOBIANS] += 1
    c.counts[FACTORIZATIONS] += 1
    fill(m.free_body, 1)
    for e in range(len(m.sources)):
        if source[m.sources[e]] != 0.0:
            m.free_body[m.terms[e, 0]] = m.free_body[m.terms[e, 1]] = 0
    if len(m.pattern.row_of) != len(m.right):
        return REPIVOT_STAGES
    fill(values, 0.0)
    for e in range(len(m.scatter)):
        kind, factor = m.scatter[e, 2], residual_q
        if kind in (MASS, JACOBIAN):
            factor = 1.0
        elif kind == DAMPING:
            factor = damping
        elif kind == STIFFNESS:
            factor = stiffness
        elif kind == GAMMA_V:
            factor = gamma_v
        values[m.scatter[e, 1]] += factor * source[m.scatter[e, 0]]
    for x in range(len(values)):
        values[x] *= m.pattern.weight[x]
    return OK if factorize(m.pattern, m.factors) < 0 else REPIVOT_STAGES


@subkernel
def _solve_step(c, m, force, rows, x, lam):
    """Solve with the matrix of a step for right-hand sides (N,) and (P, 2); return a status."""
    n = len(x) - 3
    fill(m.right, 0.0)
    for d in range(n):
        m.right[d] = force[d]
    for k in range(len(lam)):
        for r in range(c.top.rows[k]):
            m.right[c.solver.row_index[k, r]] = rows[k, r]
    c.counts[ITERATIONS] += 1
    if not solve_refined(m.pattern, m.factors, m.right, m.solution, m.correction) < 1e-9:
        return REPIVOT_STAGES
    fill(x, 0.0)
    fill_rows(lam, 0.0)
    for d in range(n):
        x[d] = m.solution[d]
    for k in range(len(lam)):
        for r in range(c.top.rows[k]):
            lam[k, r] = m.solution[c.solver.row_index[k, r]]
    return OK


@subkernel
def constraint_rates(c, t, q, v, out):
    """Write ``Phi_q v + Phi_t`` (P, 2) of the rows that are solved for."""
    position_rows(c.still, c.w, t, q)
    solved_rows(c.still, c.w, q, v)
    rate_rows(c.still, c.w.jac, c.w.phi_t, v, out)


@subkernel
def _start(c, m, t):
    """Write the accelerations ``m.x`` and multipliers ``m.lam`` of all rows at the start of a step; return a status."""
    prepare(c.top, c.w, t, m.q)
    c.counts[RHS] += 1
    c.counts[FACTORIZATIONS] += 1
    return solve_accelerations(c.top, c.w, c.solver, m.q, m.v, m.x, m.lam, True)


@subkernel
def moreau_jean(c, m, t, h):
    """Take the step of Moreau and Jean without impulses of contacts; return a status."""
    theta, n = m.theta[0], len(m.q) - 3
    status = _start(c, m, t)
    if status != OK:
        return status
    for d in range(len(m.q)):
        m.middle[d] = m.q[d] + 0.5 * h * m.v[d]
        m.point[d] = m.q[d] + h * m.v[d]
    evaluate_tangents(c.top, c.w, t + 0.5 * h, m.middle, m.v, m.x, m.lam)
    status = _factorize(c, m, theta * h, (theta * h) ** 2, 0.0, 0.0)
    if status != OK:
        return status
    total_force(c, t + h, m.point, m.v, m.lam, m.force)
    total_force(c, t, m.q, m.v, m.lam, m.y)
    for d in range(n):
        m.force[d] = h * (theta * m.force[d] + (1.0 - theta) * m.y[d])
    constraint_rates(c, t + 0.5 * h, m.middle, m.v, m.lam_x)
    for k in range(len(m.lam_x)):
        for r in range(2):
            m.lam_x[k, r] = -m.lam_x[k, r]
    copy(m.force, m.y)
    status = _solve_step(c, m, m.y, m.lam_x, m.x, m.lam_x)
    if status != OK:
        return status
    for d in range(n):
        m.free[d] = m.v[d] + m.x[d]
        m.base[d] = m.q[d] + h * (1.0 - theta) * m.v[d]
    m.factor[0], m.by_matrix[0] = h * theta, 1
    return OK


@subkernel
def relative_change(c, q, dq, factor):
    """Return the largest change of a coordinate relative to the largest coordinate, at least 1 in its unit."""
    change, unit = 0.0, c.top.length[0]
    for b in range(len(q) // 3 - 1):
        for d in range(3):
            size = abs(factor * dq[3 * b + d])
            change = max(change, size / unit if d < 2 else size)
    return change / largest_size(c.top, q)


@subkernel
def generalized_alpha(c, m, t, h):
    """Take the step of the generalized-alpha method without impulses of contacts; return a status."""
    alpha_m, alpha_f, gamma, beta, ahead = m.alpha[0], m.alpha[1], m.alpha[2], m.alpha[3], m.alpha[4]
    n, is_known = len(m.q) - 3, m.now.known[0] != 0
    status = _start(c, m, t)
    if status != OK:
        return status
    w = m.new.accelerations[1]  # w_1, which begins with the accelerations at the start
    copy(m.x, w)
    a0, w0, a1 = m.now.accelerations[0], m.now.accelerations[1], m.new.accelerations[0]
    if not is_known:
        copy(m.x, a0)
        copy(m.x, w0)
    # derivatives with respect to w_1 of a_0 (begin) and a_1 (end), and of velocities and positions at the end
    begin, end = 0.0, (1.0 - alpha_f) / (1.0 - alpha_m)
    if not is_known:
        begin, end = ahead, 1.0 + ahead
    to_v = h * ((1.0 - gamma) * begin + gamma * end)
    to_q = h * h * ((0.5 - beta) * begin + beta * end)
    before = np.inf
    copy(m.q, m.end)
    copy(m.v, m.free)
    for _ in range(MOST_ITERATIONS):
        for d in range(n):
            if not is_known:
                a0[d] = w0[d] + ahead * (w[d] - w0[d])
            a1[d] = ((1.0 - alpha_f) * w[d] + alpha_f * w0[d] - alpha_m * a0[d]) / (1.0 - alpha_m)
            m.end[d] = m.q[d] + h * m.v[d] + h * h * ((0.5 - beta) * a0[d] + beta * a1[d])
            m.free[d] = m.v[d] + h * ((1.0 - gamma) * a0[d] + gamma * a1[d])
        evaluate_tangents(c.top, c.w, t + h, m.end, m.free, w, m.lam)
        status = _factorize(c, m, to_v, to_q, -to_v, to_q)
        if status != OK:
            return status
        _residual(c, m, t + h, w)
        status = _solve_step(c, m, m.force, m.lam_x, m.x, m.lam_x)
        if status != OK:
            return status
        unfold_multipliers(c.top, c.w.cs, m.lam_x)
        for d in range(n):
            w[d] += m.x[d]
        for k in range(len(m.lam)):
            for r in range(2):
                m.lam[k, r] += m.lam_x[k, r]
        change = relative_change(c, m.end, m.x, to_q)
        if change <= CONVERGED or (change >= 0.5 * before and change < STALLED):
            before = -1.0
            break
        if not change < np.inf:
            return NOT_FINITE
        before = change
    if before >= 0.0:
        m.reason[0] = STAGES
        return DIVERGED
    status = project_velocities(c.still, c.w, c.solver, t + h, m.end, m.free, m.x, m.lam_x)
    if status != OK:
        return status
    m.new.known[0] = 1
    copy(a1, m.now.accelerations[0])
    copy(w, m.now.accelerations[1])
    m.now.known[0] = 1
    for d in range(len(m.q)):
        m.middle[d] = m.q[d] + 0.5 * h * m.v[d]
        m.base[d] = m.end[d] - 0.5 * h * m.free[d]
    m.factor[0], m.by_matrix[0] = 0.5 * h, 0
    copy(m.end, m.smooth)
    return prepare_answers(c, m, t + h, m.end)


@subkernel
def _residual(c, m, t, w):
    """Write the negative residuals of the equations of motion and of the accelerations of the constraints for the
    accelerations `w` at the state ``m.end``, ``m.free`` into ``m.force`` and ``m.lam_x``.
    """
    total_force(c, t, m.end, m.free, m.lam, m.force)
    solved_rows(c.top, c.w, m.end, m.free)
    for b in range(len(c.top.mass) - 1):
        for d in range(3):
            m.force[3 * b + d] -= c.top.mass[b, d] * w[3 * b + d]
    pairs, jac = c.top.pairs, c.w.jac
    ground = len(w) - 3
    _fold_multipliers(c, m)
    for k in range(len(pairs)):
        for r in range(2):
            m.lam_x[k, r] = 0.0
            if r < c.top.rows[k]:
                m.lam_x[k, r] = c.w.gamma[k, r]
                for side in range(2):
                    b = 3 * pairs[k, 1 + side]
                    for d in range(3):
                        m.lam_x[k, r] -= jac[k, 6 * r + 3 * side + d] * w[b + d]
                        if b < ground:
                            m.force[b + d] -= jac[k, 6 * r + 3 * side + d] * m.miss[k, r]


@subkernel
def _fold_multipliers(c, m):
    """Write the multipliers of the rows that are solved for into ``m.miss`` (P, 2); see `unfold_multipliers`."""
    for k in range(len(m.lam)):
        m.miss[k, 0], m.miss[k, 1] = m.lam[k, 0], m.lam[k, 1]
    fold_values(c.top, c.w.cs, m.miss)


@subkernel
def prepare_answers(c, m, t, q):
    """Factorize the index-1 system at positions `q`, so that `answer` can use it; return a status."""
    prepare(c.still, c.w, t, q)
    solved_rows(c.still, c.w, q, c.rest)
    fill_rows(c.w.gamma, 0.0)
    fill(c.w.force, 0.0)
    c.counts[FACTORIZATIONS] += 1
    return solve_system(c.still, c.w, c.solver, True, m.x, m.lam_x, False)
