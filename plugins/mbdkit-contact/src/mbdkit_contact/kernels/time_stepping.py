"""Time-stepping methods: velocities may jump in any step, and impacts are not located.

A step is first taken without impulses of contacts; see `mbdkit_contact.kernels.smooth_steps`. Then contacts that would
overlap at its end get impulses. Finally the positions are projected: joints are closed, and overlapping shapes are
moved apart.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_system
from mbdkit.engine.kernels.applied_forces import applied_forces, take_multipliers, take_states
from mbdkit.engine.kernels.bundle_types import example_of
from mbdkit.engine.kernels.interpolation import hermite
from mbdkit.engine.kernels.projection import EPS, FEW_ROUNDINGS, STAGNANT, position_rows
from mbdkit.engine.kernels.projection import MOST_ITERATIONS as MOST_CORRECTIONS
from mbdkit.engine.kernels.system import DIVERGED, NOT_FINITE, OK, evaluate_powers, prepare, solved_rows
from mbdkit.engine.kernels.vectors import copy, fill, fill_rows, stays_finite
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import entry, subkernel
from mbdkit.integrators.run.run_state import FACTORIZATIONS, keep_node, load_run_state
from mbdkit_contact.kernels.kinematics import find_gaps, place
from mbdkit_contact.kernels.many_contacts import PRECISION
from mbdkit_contact.kernels.smooth_steps import (
    NO_IMPULSES,
    OVERLAP,
    constraint_rates,
    generalized_alpha,
    moreau_jean,
    prepare_answers,
    relative_change,
    total_force,
)
from mbdkit_contact.kernels.step_impulses import (
    MANY,
    SMALL,
    answer,
    apply_impulses,
    find_responses,
    find_rows,
    push_apart,
    write_end,
)
from mbdkit_contact.kernels.stepping_bundle import GAP, Stepping, keep_held

MOST_HALVINGS = 4  #: Largest number of times that a step is halved.
PARTS = 2**MOST_HALVINGS
#: Precision of the projection in a step if more than `MANY` contacts overlap; the next steps reduce the remaining
#: overlap.
ROUGH = 1e-4

load_stepping = bundle_loader(lambda: example_of(Stepping))


@subkernel
def _close(c, m, t):
    """Move ``m.end`` to the nearest positions in which the joints are closed and no shapes overlap; return a status.

    If more than `MANY` contacts overlap, some overlap may remain.
    """
    length, n, before, is_last = c.top.length[0], len(m.q) - 3, np.inf, False
    has_joints = False
    for k in range(len(c.top.rows)):
        has_joints |= c.top.rows[k] > 0
    is_closed = not has_joints
    for i in range(len(m.is_some)):
        m.is_some[i] = 0
    copy(m.end, m.base)
    fill(m.v, 0.0)  # velocities at the start are no longer needed
    for _ in range(MOST_CORRECTIONS):
        if is_closed and is_last:
            return OK
        place(m.shapes, m.end, m.v)
        find_gaps(m.shapes, m.reach[0], m.gaps)
        deepest = 0.0
        for i in range(len(m.gaps)):
            deepest = max(deepest, -m.gaps[i])
        is_apart = deepest <= SMALL * length
        if is_closed and is_apart:
            return OK
        if 2.0 * deepest > m.reach[0]:
            find_gaps(m.shapes, 2.0 * deepest, m.gaps)
        count = 0
        for i in range(len(m.gaps)):  # near contacts are included: shapes moved apart may be pushed into others
            if m.gaps[i] < (0.0 if is_apart else 2.0 * deepest):
                m.is_some[i] = 1
            count += m.is_some[i]
        is_last = count > MANY
        position_rows(c.still, c.w, t, m.end)
        solved_rows(c.still, c.w, m.end, c.rest)
        for k in range(len(c.w.phi)):
            for r in range(2):
                c.w.gamma[k, r] = -c.w.phi[k, r]
        for b in range(len(c.still.mass) - 1):
            for d in range(3):
                c.w.force[3 * b + d] = c.still.mass[b, d] * (m.base[3 * b + d] - m.end[3 * b + d])
        c.counts[FACTORIZATIONS] += 1
        status = solve_system(c.still, c.w, c.solver, True, m.y, m.lam_x, True)
        if status != OK:
            return status
        copy(m.y, m.after)
        if count > 0:
            m.by_matrix[0] = 0
            find_rows(m, m.end, m.end, m.v, False)
            status = find_responses(c, m)
            if status != OK:
                return status
            for j in range(m.number[0]):
                m.more[j], m.friction[j] = m.rows[j, GAP], 0.0
                m.normal[j] = m.tangent[j] = 0.0
            if not push_apart(c, m, m.y, ROUGH if is_last else PRECISION):
                m.reason[0] = NO_IMPULSES
                return DIVERGED
        for d in range(n):
            m.end[d] += m.after[d]
        now = relative_change(c, m.end, m.after, 1.0)
        roundings = FEW_ROUNDINGS * EPS
        is_closed = not has_joints or now <= roundings or (now >= 0.5 * before and now < STAGNANT)
        before = now
    m.reason[0] = OVERLAP
    return DIVERGED


@subkernel
def _powers(c, t, q, v, lam):
    """Return the power of loads and drivers and the dissipated power [W]; `lam` (P, 2) are those of all rows."""
    prepare(c.top, c.w, t, q)
    take_multipliers(c.top, c.w, lam)
    applied_forces(c.top, c.w, q, v)
    return evaluate_powers(c.top, c.w, q, v, lam)


@subkernel
def _take_part(c, m, t, h):
    if len(m.theta) > 0:
        status = moreau_jean(c, m, t, h)
    else:
        status = generalized_alpha(c, m, t, h)
    if status != OK:
        return status
    length, owed, n = c.top.length[0], m.now.owed[0], len(m.q) - 3
    status = apply_impulses(c, m, h, length)
    if status == DIVERGED:
        m.reason[0] = NO_IMPULSES
    if status != OK:
        return status
    fill(m.force, 0.0)
    any_force = False
    for d in range(n):
        m.force[d] = m.now.force[d]
        any_force |= m.force[d] != 0.0
        m.point[d] = 0.5 * (m.v[d] + m.after[d])
    work, dissipated = 0.0, 0.0
    if c.has_power[0] != 0:
        work, dissipated = _powers(c, t + 0.5 * h, m.middle, m.point, m.lam)
    # the impulses of the joints are needed for the work of drivers that contacts cause
    fill_rows(m.miss, 0.0)
    if any_force and c.has_power[0] != 0:
        for d in range(n):
            m.y[d] = h * m.force[d]
        if m.by_matrix[0] == 0:
            status = prepare_answers(c, m, t + h, m.smooth)
            if status != OK:
                return status
        status = answer(c, m, m.y, m.x, m.miss)
        if status != OK:
            return status
    write_end(m, m.free)
    copy(m.end, m.unchanged)
    write_end(m, m.after)
    copy(m.after, m.ended)
    status = _close(c, m, t + h)
    if status != OK:
        return status
    lost, lifted, more = m.lost[0] - owed, 0.0, 0.0
    if any_force:
        fill(m.x, 0.0)
        for d in range(n):
            m.x[d] = m.end[d] - m.unchanged[d] - 0.5 * h * (m.ended[d] - m.free[d])
            m.point[d] = m.end[d] - 0.5 * m.x[d]
        if c.has_power[0] != 0:
            fill_rows(m.lam_x, 0.0)
            more = _powers(c, t + h, m.point, m.x, m.lam_x)[0]
            constraint_rates(c, t + 0.5 * h, m.middle, c.rest, m.lam_x)
            for k in range(len(m.lam_x)):
                for r in range(2):
                    more += m.miss[k, r] * m.lam_x[k, r]
        fill_rows(m.lam_x, 0.0)
        total_force(c, t + h, m.point, c.rest, m.lam_x, m.y)
        for d in range(n):
            lifted -= m.y[d] * m.x[d]
    lost -= lifted
    m.now.owed[0] = max(-lost, 0.0)
    c.gain[0] += h * work + more
    c.gain[1] += h * dissipated + max(lost, 0.0)
    return OK


@subkernel
def _hold_nothing(c, m):
    """Evaluate forces without those of contacts, which the method computes itself."""
    first = m.places[0]
    for d in range(len(c.from_z)):
        m.z[d] = c.from_z[d]
    for d in range(m.places[1]):
        m.z[first + d] = 0.0
    take_states(c.top, c.w, m.z)


@entry
def attempt(run, method, t, h, want_error):
    """Compute a step from the base state; see `mbdkit.integrators.loop.step_loop`.

    If an iteration in the step does not converge, it is taken as two half steps, which may be halved again.
    """
    c, m = load_run_state(run), load_stepping(method)
    n = len(c.q) - 3
    _hold_nothing(c, m)
    keep_held(m.now, m.before)
    copy(c.from_q, m.q)
    copy(c.from_v, m.v)
    c.gain[0] = c.gain[1] = 0.0
    done, size = 0, PARTS
    while done < PARTS:
        keep_held(m.now, m.saved)
        copy(m.q, m.saved_q)
        copy(m.v, m.saved_v)
        work, lost = c.gain[0], c.gain[1]
        m.reason[0] = 0
        status = _take_part(c, m, t + h * done / PARTS, h * size / PARTS)
        if status == OK:
            done += size
            copy(m.end, m.q)
            copy(m.ended, m.v)
            size = done & -done
            continue
        keep_held(m.saved, m.now)
        copy(m.saved_q, m.q)
        copy(m.saved_v, m.v)
        c.gain[0], c.gain[1] = work, lost
        if status != DIVERGED or m.reason[0] == NO_IMPULSES or size == 1:
            keep_held(m.before, m.now)
            return status
        size //= 2
    for d in range(n):
        c.dq[d], c.dv[d] = m.q[d] - c.from_q[d], m.v[d] - c.from_v[d]
    if not (stays_finite(c.from_q, c.dq) and stays_finite(c.from_v, c.dv)):
        keep_held(m.before, m.now)
        return NOT_FINITE
    _hold_forces(c, m)
    return OK


@subkernel
def _hold_forces(c, m):
    """Write the increments of the first-order states, which hold forces and modes of contacts."""
    fill(c.dz, 0.0)
    first, count = m.places[0], len(m.now.modes)
    for i in range(count):
        m.z[first + 3 * i], m.z[first + 3 * i + 1] = m.now.normal[i], m.now.tangent[i]
        m.z[first + 3 * i + 2] = abs(m.now.modes[i])
    for i in range(len(m.coordinates)):
        m.z[first + 3 * count + i] = m.now.force[m.coordinates[i]]
    for d in range(first, first + m.places[1]):
        c.dz[d], c.z_low[d] = m.z[d] - c.from_z[d], 0.0


@entry
def dense(run, method, t, h, theta):
    """Write the state at ``t + theta h`` within the last attempt; see `mbdkit.integrators.loop.step_loop`.

    Positions and velocities are on the cubic through both ends; forces of contacts are means over the step.
    """
    c = load_run_state(run)
    for d in range(len(c.q)):
        c.point_q[d], c.point_v[d] = hermite(theta, h, c.from_q[d], c.dq[d], c.from_v[d], c.from_v[d] + c.dv[d])
    for d in range(len(c.from_z)):
        c.point_z[d] = c.from_z[d] + c.dz[d]
    c.point_gain[0], c.point_gain[1] = theta * c.gain[0], theta * c.gain[1]
    return OK


@entry
def keep(run, method, t, h, unused):
    """Store the middle of the last attempt as a quadrature node; see `mbdkit.integrators.loop.step_loop`."""
    c, m = load_run_state(run), load_stepping(method)
    for d in range(len(c.q)):
        m.point[d], m.x[d] = c.from_q[d] + 0.5 * c.dq[d], c.from_v[d] + 0.5 * c.dv[d]
    keep_node(c, t + 0.5 * h, h, m.point, m.x)
    return OK
