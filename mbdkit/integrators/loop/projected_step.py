"""Steps of compiled methods, optionally with projection onto the constraints, after the step or symmetric."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_system
from mbdkit.engine.kernels.projection import (
    EPS,
    FEW_ROUNDINGS,
    STAGNANT,
    largest_residual,
    largest_size,
    position_rows,
    project_positions,
    project_velocities,
    rate_rows,
    scaled_residual,
)
from mbdkit.engine.kernels.system import DIVERGED, NOT_FINITE, OK, solved_rows
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.calls import call_entry
from mbdkit.engine.native.functions import subkernel
from mbdkit.integrators.run.run_plan import NO_PROJECTION, SYMMETRIC
from mbdkit.integrators.run.run_state import MODIFIED, PROJECTIONS, load_run_state

MAX_TRIALS = 100  #: Largest number of iterations of a symmetric projection, each with a step of the method; chosen.

#: Smallest divisor of a change by Broyden's method; with a smaller one, the approximation begins anew.
LEAST_DIVISOR = 0.1

#: Number of iterations without progress after which the iteration ends; chosen. An iteration makes no progress if its
#: residual is below `STAGNANT`, the level of rounding errors, but above `IDLE_RATIO` times the smallest residual so
#: far.
IDLE, IDLE_RATIO = 2, 0.9


@subkernel
def _push(c, t, q, push_q, push_v):
    """Write ``M^-1 Phi_q(q)^T mu`` into `push_q`, and ``M^-1 Phi_q(q)^T nu`` into `push_v`."""
    position_rows(c.still, c.w, t, q)
    solved_rows(c.still, c.w, q, c.rest)
    pairs, jac, weight = c.still.pairs, c.w.jac, c.still.weight
    push_q[:] = 0.0
    push_v[:] = 0.0
    for k in range(len(pairs)):
        for r in range(c.still.rows[k]):
            for side in range(2):
                b = pairs[k, PAIR.first + side]
                for i in range(3):
                    g = weight[b, i] * jac[k, 6 * r + 3 * side + i]
                    push_q[3 * b + i] += g * c.mu[k, r]
                    push_v[3 * b + i] += g * c.nu[k, r]


@subkernel
def _newton_on(c, residual, change):
    """Write ``-(Phi_q M^-1 Phi_q^T)^-1 residual / 2`` into `change` (P, 2), with the rows evaluated last."""
    for k in range(len(residual)):
        for r in range(2):
            c.w.gamma[k, r] = 0.5 * residual[k, r]
    status = solve_system(c.still, c.w, c.solver, False, c.x, c.lam, True)
    for k in range(len(change)):
        for r in range(2):
            change[k, r] = c.lam[k, r] if r < c.still.rows[k] else 0.0
    return status


@subkernel
def _product(x, y, h):
    """Return the inner product of two changes (2, P, 2) of multipliers; those of velocities act for the time `h`."""
    total = 0.0
    for k in range(len(x[0])):
        for r in range(len(x[0, 0])):
            total += x[0, k, r] * y[0, k, r] + h * h * x[1, k, r] * y[1, k, r]
    return total


@subkernel
def improve(changes, count, h):
    """Turn a change of multipliers by simplified Newton iteration into one by Broyden's method; return the number of
    changes that are used later.

    The simplified matrix neglects that the step of the method turns the bodies, and with it the iteration diverges if
    they turn by more than about 0.2 rad. Broyden's method, started with the simplified matrix, learns that from the
    changes so far (C. T. Kelley, Solving Nonlinear Equations with Newton's Method, SIAM 2003, section 4.3). Damping of
    the simplified iteration does not help, and Anderson's acceleration takes as many iterations.

    Parameters
    ----------
    changes
        (K, 2, P, 2) changes so far, followed by the one that is replaced.
    count
        Number of the changes so far.
    h
        Size of the step [s].
    """
    new = changes[count]
    for j in range(count):
        last = changes[j]
        square = _product(last, last, h)
        share = _product(last, new, h) / square if square > 0.0 else 0.0
        if j < count - 1:
            for i in range(2):
                for k in range(len(new[0])):
                    for r in range(len(new[0, 0])):
                        new[i, k, r] += share * changes[j + 1, i, k, r]
        elif 1.0 - share > LEAST_DIVISOR:
            for i in range(2):
                for k in range(len(new[0])):
                    for r in range(len(new[0, 0])):
                        new[i, k, r] /= 1.0 - share
        else:
            return 0
    return count + 1 if count + 1 < len(changes) else 0


@subkernel
def _symmetric_step(run, method, attempt, t, h, changes):
    """Take a step with symmetric projection: the same multipliers correct the state before and after the step.

    Writes the end of the step into ``new_q, new_v``, and the sum of both corrections into ``shift_q, shift_v``.
    Iteration on the multipliers (Hairer 2000, BIT 40, 726-734) by Broyden's method, which starts with a simplified
    derivative of the residual: twice the matrix ``Phi_q M^-1 Phi_q^T``, since a multiplier acts both before and after
    the step.
    """
    c = load_run_state(run)
    before = np.inf
    idle = count = 0
    for m in range(MAX_TRIALS):
        _push(c, t, c.q, c.shift_q, c.shift_v)
        for d in range(len(c.q)):
            c.from_q[d] = c.q[d] + c.shift_q[d]
            c.from_v[d] = c.v[d] + c.shift_v[d]
        copy(c.z, c.from_z)
        c.base_state[0] = MODIFIED
        status = call_entry(attempt, run, method, t, h, 0.0)
        if status != OK:
            return status
        for d in range(len(c.q)):
            c.new_q[d] = c.from_q[d] + c.dq[d]
        for _ in range(2):  # twice, since Phi_q is evaluated at the projected end, which depends on it
            _push(c, t + h, c.new_q, c.est_q, c.est_v)
            for d in range(len(c.q)):
                c.new_q[d] = c.from_q[d] + c.dq[d] + c.est_q[d]
                c.new_v[d] = c.from_v[d] + c.dv[d] + c.est_v[d]
        for d in range(len(c.q)):
            c.shift_q[d] += c.est_q[d]
            c.shift_v[d] += c.est_v[d]
        position_rows(c.still, c.w, t + h, c.new_q)
        solved_rows(c.still, c.w, c.new_q, c.rest)
        rate_rows(c.still, c.w.jac, c.w.phi_t, c.new_v, c.miss)
        now = max(
            scaled_residual(c.still, c.w.phi) / largest_size(c.still, c.new_q),
            scaled_residual(c.still, c.miss) / largest_size(c.still, c.new_v),
        )
        if not now < np.inf:
            return NOT_FINITE
        if m > 1 and now > IDLE_RATIO * before and now < STAGNANT:
            idle += 1
        if now <= FEW_ROUNDINGS * EPS or idle >= IDLE:
            return OK
        before = min(before, now)
        change = changes[count]
        status = _newton_on(c, c.w.phi, change[0])
        if status == OK:  # velocities are corrected with the rows at the new positions
            for d in range(len(c.q)):
                c.est_q[d] = c.new_q[d] - 2.0 * c.x[d]
            position_rows(c.still, c.w, t + h, c.est_q)
            solved_rows(c.still, c.w, c.est_q, c.rest)
            rate_rows(c.still, c.w.jac, c.w.phi_t, c.new_v, c.miss)
            status = _newton_on(c, c.miss, change[1])
        if status != OK:
            return status
        for k in range(len(c.mu)):  # nu changes the velocity before the step, and so the positions at its end by h nu
            for r in range(2):
                change[0, k, r] -= 0.5 * h * change[1, k, r]
        count = improve(changes, count, h)
        for k in range(len(c.mu)):
            for r in range(2):
                c.mu[k, r] += change[0, k, r]
                c.nu[k, r] += change[1, k, r]
    c.report[0], c.report[2] = now, 0.0  # no stage iteration has failed
    return DIVERGED


@subkernel
def _passes_bound(c, t, q, v, bound):
    """Return whether positions or velocities at `t` violate a constraint by more than `bound`."""
    position_rows(c.still, c.w, t, q)
    if not largest_residual(c.still, c.w.phi) <= bound:
        return True
    solved_rows(c.still, c.w, q, c.rest)
    rate_rows(c.still, c.w.jac, c.w.phi_t, v, c.miss)
    return not largest_residual(c.still, c.miss) <= bound


@subkernel
def take(run, method, attempt, t, h, want_error, plan):
    """Compute one step, including a symmetric projection; write its end into ``new_q, new_v``; return a status.

    The state is not changed. ``shift_q, shift_v`` are the corrections that the projection adds to ``dq, dv``. `plan` is
    the `mbdkit.integrators.run.run_plan.ProjectionPlan` of the run.
    """
    c, mode = load_run_state(run), plan.mode[0]
    if mode == SYMMETRIC:
        status = _symmetric_step(run, method, attempt, t, h, plan.changes)
        c.counts[PROJECTIONS] += 1
        return status
    status = call_entry(attempt, run, method, t, h, 1.0 if want_error else 0.0)
    if status != OK:
        return status
    for d in range(len(c.q)):
        c.new_q[d] = c.from_q[d] + c.dq[d]
        c.new_v[d] = c.from_v[d] + c.dv[d]
    if mode != NO_PROJECTION:
        c.shift_q[:] = 0.0
        c.shift_v[:] = 0.0
    return OK


@subkernel
def project(run, t, mode, due, bound):
    """Project the end of a step if a projection is due; return a status and whether the step is projected."""
    c = load_run_state(run)
    if mode in (NO_PROJECTION, SYMMETRIC) or not due:
        return OK, mode == SYMMETRIC
    if bound > 0.0 and not _passes_bound(c, t, c.new_q, c.new_v, bound):
        return OK, False
    status = project_positions(c.still, c.w, c.solver, t, c.new_q, c.shift_q, c.rest, c.x, c.lam)
    if status != OK:
        return status, False
    copy(c.new_v, c.shift_v)
    status = project_velocities(c.still, c.w, c.solver, t, c.shift_q, c.shift_v, c.x, c.lam)
    if status != OK:
        return status, False
    for d in range(len(c.q)):
        projected_q, projected_v = c.shift_q[d], c.shift_v[d]
        c.shift_q[d] = projected_q - c.new_q[d]
        c.shift_v[d] = projected_v - c.new_v[d]
        c.new_q[d] = projected_q
        c.new_v[d] = projected_v
    c.counts[PROJECTIONS] += 1
    return OK, True
