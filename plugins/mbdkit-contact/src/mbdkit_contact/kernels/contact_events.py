"""Events of rigid contacts: impacts, and changes between sticking, slipping and separation."""

from __future__ import annotations

from math import sqrt

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_system
from mbdkit.engine.kernels.projection import (
    EPS,
    FEW_ROUNDINGS,
    MOST_ITERATIONS,
    STAGNANT,
    largest_size,
    position_rows,
    rate_rows,
    scaled_residual,
)
from mbdkit.engine.kernels.system import DIVERGED, OK, solved_rows
from mbdkit.engine.kernels.vectors import copy, fill, fill_rows
from mbdkit.engine.native.functions import separate, subkernel
from mbdkit.integrators.loop.step_loop import PAUSED, REFUSED
from mbdkit_contact.kernels.contact_forces import (
    add_answers,
    along,
    assemble,
    find_answers,
    find_directions,
    least_squares,
)
from mbdkit_contact.kernels.contact_modes import (
    SAME,
    SAME_ACCELERATION,
    collect_closed,
    decide_at_rest,
    find_accelerations,
    find_effects,
    find_free,
    find_limits,
    find_response,
    find_rows,
    find_touching,
    find_values,
    rate_of_gap,
    rows_in_place,
    set_modes,
    speed,
    take_contact,
)
from mbdkit_contact.kernels.event_bundle import (
    CHANGED,
    CUT,
    FRICTION,
    MORE_ROOM,
    NO_IMPULSES,
    NORMAL,
    OPEN_JOINTS,
    ORDERED,
    PLACE,
)
from mbdkit_contact.kernels.impacts import OTHER_LAW, UNSOLVED, find_ordered, strike
from mbdkit_contact.kernels.kinematics import place, place_turned
from mbdkit_contact.modes import OPEN, SLIP, STICK

#: Gaps and rates of joints and closed contacts up to this size, relative to the largest coordinate or velocity (at
#: least 1), are left as they are at the end of a step. It exceeds the rounding errors of many steps and is much smaller
#: than `SAME`.
NEARLY = 1e-13
QUADRATIC = 1e-9  #: Relative residual from which one iteration of Newton's method leaves nothing but rounding errors.


@separate
def is_nearly_closed(e, m):
    """Evaluate the quantities of all contacts at the point; return whether joints and contacts are closed up to
    `NEARLY`.
    """
    w, still, has_joints = e.w, m.still, len(e.w.phi) > 0
    if has_joints:
        position_rows(still, w, m.t[0], m.q)
        place_turned(m.closed.shapes, w.cs, m.q, m.v)
    else:
        place(m.closed.shapes, m.q, m.v)
    rows_in_place(m)
    gap = scaled_residual(still, w.phi)
    for i in range(len(m.rows)):
        if m.known.modes[i] != OPEN:
            gap = max(gap, abs(m.rows[i, 0]) / still.length[0])
    if not gap <= NEARLY * largest_size(still, m.q):
        return False
    rate = 0.0
    if has_joints:
        solved_rows(still, w, m.q, m.v)
        rate_rows(still, w.jac, w.phi_t, m.v, w.refinement)
        rate = scaled_residual(still, w.refinement)
    for i in range(len(m.rows)):
        if m.known.modes[i] != OPEN:
            rate = max(rate, abs(rate_of_gap(m, i, 2, m.v)) / still.length[0])
        if m.known.modes[i] == STICK:
            rate = max(rate, abs(m.rows[i, 1]) / still.length[0])
    return rate <= NEARLY * largest_size(still, m.v)


@subkernel
def _closing(m, with_slips):
    """Write the closed contacts to ``m.closed``, as constraints without friction; return the number of constraints.

    With `with_slips`, the slips of contacts that stick are constraints too.
    """
    s = m.closed
    k = collect_closed(m)
    if k <= 0:
        return k
    for j in range(k):
        s.share[j] = 0.0
        if not with_slips:
            s.sticks[j] = -1
    place(s.shapes, m.q, m.v)
    return find_directions(s, k)


@subkernel
def _add_changes(s, count, out):
    """Add the changes (N,) that the forces of contacts cause."""
    for j in range(count):
        for d in range(len(out) - 3):
            out[d] += s.forces[j] * s.moved[j, d]


@subkernel
def _solve_closing(e, m, count, has_forces):
    """Write to ``m.y`` the smallest change for ``w.gamma``, ``w.force`` and the values ``s.right``; return a status."""
    s = m.closed
    status = solve_system(m.still, e.w, e.solver, has_forces, m.y, m.lam, True)
    if status != OK or count == 0:
        return status
    status = find_answers(m.still, e.w, e.solver, s, count, True)
    if status != OK:
        return status
    for j in range(count):
        s.right[j] -= along(s, j, m.y)
    assemble(s, count)
    least_squares(s, count)
    _add_changes(s, count, m.y)
    return OK


@separate
def close_positions(e, m):
    """Move the point to the nearest positions, in the mass metric, with closed joints and contacts; return a status.

    See `mbdkit.engine.kernels.projection.project_positions`.
    """
    s, w, still, before = m.closed, e.w, m.still, np.inf
    copy(m.q, m.x)
    # Newton's method for the nearest positions: each turn corrects the rows at the present positions and returns
    # towards the positions before, so that only the normals of the rows remain in the change
    for turn in range(MOST_ITERATIONS):
        position_rows(still, w, m.t[0], m.q)
        count = _closing(m, False)
        if count < 0:
            return PAUSED
        now, size = scaled_residual(still, w.phi), largest_size(still, m.q)
        for j in range(count):
            s.right[j] = -s.rows[j, 0]
            now = max(now, abs(s.right[j]) / still.length[0])
        if now <= FEW_ROUNDINGS * EPS * size or (turn > 1 and now > 0.5 * before and now < STAGNANT * size):
            return OK
        if not now < np.inf:
            return DIVERGED
        before = now
        solved_rows(still, w, m.q, m.rest)
        for p in range(len(w.phi)):
            for r in range(2):
                w.gamma[p, r] = -w.phi[p, r]
        for d in range(len(m.q) - 3):
            w.force[d] = still.mass[d // 3, d % 3] * (m.x[d] - m.q[d])
        status = _solve_closing(e, m, count, True)
        if status != OK:
            return status
        for d in range(len(m.q) - 3):
            m.q[d] += m.y[d]
        if now <= QUADRATIC * size:
            return OK
    m.reason[0] = OPEN_JOINTS
    return DIVERGED


@separate
def close_velocities(e, m):
    """Change the velocities of the point to the nearest ones of closed joints and contacts; return a status."""
    s, w, still, before = m.closed, e.w, m.still, np.inf
    position_rows(still, w, m.t[0], m.q)
    size = largest_size(still, m.v)
    # the equations are linear in the velocities; further turns remove the rounding errors of the first solution
    for turn in range(3):
        solved_rows(still, w, m.q, m.v)
        rate_rows(still, w.jac, w.phi_t, m.v, w.refinement)
        count = _closing(m, True)
        if count < 0:
            return PAUSED
        now = scaled_residual(still, w.refinement)
        for j in range(count):
            s.right[j] = -along(s, j, m.v)
            now = max(now, abs(s.right[j]) / still.length[0])
        if now <= FEW_ROUNDINGS * EPS * size or (turn > 1 and now > 0.5 * before):
            return OK
        before = now
        for p in range(len(w.gamma)):
            for r in range(2):
                w.gamma[p, r] = -w.refinement[p, r]
        status = _solve_closing(e, m, count, False)
        if status != OK:
            return status
        for d in range(len(m.v) - 3):
            m.v[d] += m.y[d]
        if now <= QUADRATIC * size:
            return OK
    return OK


@subkernel
def close(e, m):
    """Move the point to the nearest state in which joints and contacts are closed; return a status."""
    status = close_positions(e, m)
    return close_velocities(e, m) if status == OK else status


@separate
def drift(e, m):
    """Return the largest gap of joints and closed contacts at the point [m, rad]."""
    position_rows(m.still, e.w, m.t[0], m.q)
    worst = 0.0
    for p in range(len(e.w.phi)):
        for r in range(m.still.rows[p]):
            worst = max(worst, abs(e.w.phi[p, r]))
    find_rows(m)
    for i in range(len(m.known.modes)):
        if m.known.modes[i] != OPEN:
            worst = max(worst, abs(m.rows[i, 0]))
    return worst


@subkernel
def book_energy(e, m):
    """Note the kinetic energy at the point if it is the largest so far."""
    energy = 0.0
    for d in range(len(m.v) - 3):
        energy += 0.5 * e.top.mass[d // 3, d % 3] * m.v[d] * m.v[d]
    m.known.energy[0] = max(m.known.energy[0], energy)


@separate
def limited(e, m, h):
    """Return a step size, at most `h`, that ends soon after a contact that has just opened closes again; also a status.

    Such a rebound may be too small to be noticed within a longer step.

    Requires `find_rows` at the point.
    """
    near, slow, any_leaves = SAME * m.limits[1], SAME * speed(m), False
    for i in range(len(m.known.modes)):
        leaves = m.rows[i, 0] <= near and rate_of_gap(m, i, 2, m.v) > slow
        any_leaves |= m.known.modes[i] == OPEN and leaves
    if not any_leaves:
        return h, OK
    status = find_accelerations(e, m)
    for i in range(len(m.known.modes)):
        rate = rate_of_gap(m, i, 2, m.v)
        if m.known.modes[i] == OPEN and m.rows[i, 0] <= near and rate > slow:
            curve = rate_of_gap(m, i, 2, m.a) - m.rows[i, 14]
            if curve < 0.0:
                h = min(h, -3.0 * rate / curve)
    return h, status


@subkernel
def _decide_and_set(e, m):
    status = decide_at_rest(e, m)
    if status == OK:
        set_modes(m, m.modes)
    return status


@subkernel
def _note_impact(m, k, outcome):
    """Note the impact of the contacts in ``m.closed``, whose impulses are ``s.forces``; return its number of rows.

    Impulses that change the velocity of their contact by rounding errors only are left out.
    """
    s, known, new, slow = m.closed, m.known, 0, SAME * speed(m)
    row = known.number[1]
    for d in range(len(m.q)):
        known.strikes[row, d] = m.q[d]
    for p in range(len(m.lam_x)):
        for r in range(2):
            known.strikes[row, len(m.q) + 2 * p + r] = m.lam_x[p, r]
    known.number[1] = row + 1
    for j in range(k):
        if not s.forces[j] * m.impacts.all.cones.response[j, j] > slow:
            continue
        at = known.number[0]
        known.rows[at, 0], known.rows[at, 1] = m.t[0], s.chosen[j]
        known.rows[at, 2], known.rows[at, 3], known.rows[at, 5] = s.forces[j], s.forces[k + j], row
        known.number[0] = at + 1
        new += 1
        if outcome == OTHER_LAW:
            known.flags[CHANGED, s.chosen[j]] = 1
    return new


@subkernel
def _note_coupling(m, k):
    """Note the time if several contacts that approach affect each other, so that the order of impacts is unknown."""
    x, slow = m.impacts.all, SAME * speed(m)
    for i in range(k):
        for j in range(i):
            if x.before[i] < -slow and x.before[j] < -slow:
                size = sqrt(abs(x.cones.response[i, i] * x.cones.response[j, j]))
                if abs(x.cones.response[i, j]) > SAME_ACCELERATION * size:
                    m.known.times[1] = min(m.known.times[1], m.t[0])


@subkernel
def _energy_lost(e, m):
    """Return the kinetic energy that is lost from the velocities ``m.x`` to those of the point [J]."""
    lost = 0.0
    for d in range(len(m.v) - 3):
        lost += 0.5 * (m.x[d] - m.v[d]) * e.top.mass[d // 3, d % 3] * (m.x[d] + m.v[d])
    return lost


@separate
def strike_contacts(e, m):
    """Apply an impact of the contacts in ``m.touching`` to the velocities of the point; return a status.

    Energies are added to ``m.gained``.
    """
    s, x = m.closed, m.impacts
    status = find_free(e, m)
    if status != OK:
        return status
    status, k = find_response(e, m)
    if status != OK:
        return status
    fill(m.approach, 0.0)
    for i in range(len(m.touching)):
        m.struck[i] = m.touching[i]
    for j in range(k):
        i = s.chosen[j]
        x.all.before[j], x.all.before[k + j] = along(s, j, m.v), along(s, k + j, m.v)
        x.all.cones.friction[j] = m.coefficients[i, 2]
        x.all.restitution[j] = x.restitution[j] = m.coefficients[i, 0]
        m.approach[i] = x.all.before[j]
    # which contact of a chain strikes first decides the velocities after it, so that error bars end here
    _note_coupling(m, k)
    outcome = strike(x.all, k, m.law[0])
    if outcome == UNSOLVED:
        m.reason[0], m.reason[1] = NO_IMPULSES, s.chosen[0]
        return REFUSED
    for j in range(2 * k):
        s.forces[j] = x.all.impulses[j]
    copy(m.v, m.x)
    fill_rows(m.lam_x, 0.0)
    add_answers(s, 2 * k, m.v, m.lam_x)
    lost = _energy_lost(e, m)
    new = _note_impact(m, k, outcome)
    find_ordered(x, k, m.law[0])
    for j in range(k):
        if x.ordered[j] != 0:
            m.known.flags[ORDERED, s.chosen[j]] = 1
    fill(m.sliding, 0.0)
    first = m.known.number[0] - new
    status = _decide_and_set(e, m)
    if status == OK:
        status = _cut(e, m)
    if status != OK:
        return status
    position_rows(m.still, e.w, m.t[0], m.q)
    work = 0.0
    for p in range(len(m.lam_x)):
        for r in range(m.still.rows[p]):
            work += m.lam_x[p, r] * e.w.phi_t[p, r]  # of drivers that move
    m.gained[0] += work
    m.gained[1] += work + _energy_lost(e, m)
    for row in range(first, first + new):
        m.known.rows[row, 4] = work + lost
    return OK


@separate
def _cut(e, m):
    """Close contacts that would otherwise have an infinite sequence of impacts; return a status.

    These are the contacts that an impact opens with less energy than ``rest_energy`` and that would close again. The
    sequence may belong to one contact or to several in turn, as for a rocking block. Its end is noted as an impact
    without impulses.
    """
    # only a contact that an impact opens can fall back onto its partner without end
    any_open = False
    for i in range(len(m.struck)):
        any_open |= m.struck[i] != 0 and m.known.modes[i] == OPEN
    if not any_open:
        return OK
    status = find_accelerations(e, m)
    if status != OK:
        return status
    find_rows(m)
    known, shapes, any_rests = m.known, m.closed.shapes, False
    for i in range(len(m.struck)):
        m.touching[i] = 0
        if m.struck[i] == 0 or known.modes[i] != OPEN:
            continue
        after, curve, inverse_mass = rate_of_gap(m, i, 2, m.v), rate_of_gap(m, i, 2, m.a) - m.rows[i, 14], 1e-300
        for side in range(2):
            for d in range(3):
                slope = m.rows[i, 2 + 3 * side + d]
                inverse_mass += slope * slope * m.still.weight[shapes.contacts[i, side], d]
        is_small = 0.5 * after * after / inverse_mass <= m.limits[0] * known.energy[0]
        if not (after > 0.0 and curve < 0.0 and is_small):
            continue
        m.touching[i], any_rests = 1, True
        known.flags[CUT, i] = 1
        known.times[0] = min(known.times[0], m.t[0])
        restitution = m.coefficients[i, 0]
        if m.approach[i] < -SAME * speed(m) and 0.0 < restitution < 1.0:
            at = known.number[0]
            fill(known.rows[at], 0.0)
            known.rows[at, 0] = m.t[0] - 2.0 * after / curve / (1.0 - restitution)
            known.rows[at, 1], known.rows[at, 5] = i, -1.0
            known.number[0] = at + 1
    if not any_rests:
        return OK
    status = _change_by_tail(e, m)
    if status != OK:
        return status
    for i in range(len(m.struck)):
        m.touching[i], m.sliding[i] = m.struck[i], 0.0
    return _decide_and_set(e, m)


@separate
def _change_by_tail(e, m):
    """Change the velocities by what replaces a sequence of impacts of the contacts in ``m.touching``; return a status.

    Until the sequence ends, a contact at rest exerts the normal impulse of the sequence and, in addition, the impulse
    that stops the separation. The change removes the additional impulse, with its friction: otherwise the slip after
    the sequence would have an error of the first order in the velocity of separation. The energy that a slip gains
    here is dissipated again until the sequence ends; it is no part of the energy that the impact loses.
    """
    s, k, slow = m.closed, 0, SAME * speed(m)
    for i in range(len(m.touching)):
        mode = m.known.modes[i]
        if m.touching[i] == 0 and mode == OPEN:
            continue
        if k == len(s.chosen):
            m.reason[0] = MORE_ROOM
            return PAUSED
        slip = m.rows[i, 1]
        if mode != STICK and abs(slip) > slow:  # until the sequence ends, friction acts against the slip
            direction = slip if m.touching[i] != 0 else mode
            take_contact(m, k, i, SLIP if direction > 0.0 else -SLIP)
        else:
            take_contact(m, k, i, STICK if mode == STICK else OPEN)
        k += 1
    status, count = find_effects(e, m, k)
    if status != OK:
        return status
    for j in range(count):
        s.right[j] = -along(s, j, m.v)
    assemble(s, count)
    least_squares(s, count)
    _add_changes(s, count, m.v)
    return OK


@subkernel
def _meet(e, m):
    """Set the modes of contacts in ``m.touching``; those that approach each other collide first. Returns a status."""
    # contacts at rest on each other need no impact: with rounding errors as velocities, it would never end
    approaches, slow = False, SAME * speed(m)
    for i in range(len(m.touching)):
        approaches |= m.touching[i] != 0 and rate_of_gap(m, i, 2, m.v) < -slow
    if approaches:
        return strike_contacts(e, m)
    fill(m.sliding, 0.0)
    return _decide_and_set(e, m)


@separate
def begin_modes(e, m):
    """Determine the modes at the point anew, at the start or after a discontinuity; return a status."""
    fill(m.modes, 0.0)
    set_modes(m, m.modes)
    find_rows(m)
    for i in range(len(m.touching)):
        m.touching[i] = m.rows[i, 0] <= SAME * m.limits[1]
    return _meet(e, m)


@separate
def _change_modes(e, m, kind, contact):
    modes, limits = m.known.modes, m.search.limits
    fill(m.sliding, 0.0)
    if kind == FRICTION and modes[contact] == STICK:
        find_rows(m)
        status = find_values(e, m, True)
        if status != OK:
            return status
        find_limits(e, m, limits)
        for i in range(len(modes)):
            is_there = i == contact or m.values[FRICTION, i] <= limits[FRICTION, i]
            if modes[i] == STICK and is_there and m.tangent[i] != 0.0:
                m.sliding[i] = -1.0 if m.tangent[i] > 0.0 else 1.0
    elif kind == FRICTION:
        copy(modes, m.modes)
        m.modes[contact] = STICK
        set_modes(m, m.modes)
        status = close_velocities(e, m)
        if status != OK:
            return status
        m.sliding[contact] = 2.0  # the slip has ended
    status = find_accelerations(e, m)
    if status != OK:
        return status
    find_limits(e, m, limits)
    least = limits[NORMAL, contact]
    for i in range(len(modes)):
        m.touching[i] = modes[i] != OPEN
        m.struck[i] = m.touching[i]
    status = _decide_and_set(e, m)
    if status != OK or kind != NORMAL or modes[contact] == OPEN:
        return status
    status = find_accelerations(e, m)
    has_changed = False
    for i in range(len(modes)):
        has_changed |= modes[i] != m.kept_modes[i]
    # in the same modes, the force is that whose zero was located, even if all forces vanish at this instant
    if status != OK or (has_changed and m.normal[contact] > least):
        return status
    for i in range(len(modes)):  # the force vanishes now, and would pull later
        m.touching[i], m.sliding[i] = m.struck[i], 0.0
    m.touching[contact] = 0
    return _decide_and_set(e, m)


@separate
def happen(e, m, kind, contact):
    """Apply an event to the point and to the modes; return a status. Nothing is changed if it is not OK.

    The energies gained are in ``m.gained``.
    """
    known = m.known
    m.gained[0] = m.gained[1] = 0.0
    m.reason[0] = 0
    if len(known.rows) - known.number[0] < 2 * len(known.modes) or known.number[1] == len(known.strikes):
        m.reason[0] = MORE_ROOM
        return PAUSED
    copy(known.modes, m.kept_modes)
    copy(known.features, m.kept_features)
    rows, strikes = known.number[0], known.number[1]
    if kind < 0:
        status = begin_modes(e, m)
    elif kind == NORMAL and known.modes[contact] == OPEN:
        find_rows(m)
        find_touching(m)
        m.touching[contact] = 1
        status = strike_contacts(e, m)
    elif kind == PLACE:  # the contact reaches the end of its edge or corner
        copy(known.modes, m.modes)
        m.modes[contact] = OPEN
        set_modes(m, m.modes)
        find_rows(m)
        find_touching(m)
        status = _meet(e, m)
    else:
        status = _change_modes(e, m, kind, contact)
    if status != OK:
        copy(m.kept_modes, known.modes)
        copy(m.kept_features, known.features)
        known.number[0], known.number[1] = rows, strikes
    return status
