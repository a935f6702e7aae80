"""Modes of closed contacts: accelerations and forces in given modes, and the modes that follow an event."""

from __future__ import annotations

from math import sqrt

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_accelerations
from mbdkit.engine.kernels.applied_forces import take_states
from mbdkit.engine.kernels.engine_bundles import load_engine
from mbdkit.engine.kernels.orthogonal import solve_triangle
from mbdkit.engine.kernels.system import NOT_FINITE, OK, prepare
from mbdkit.engine.kernels.vectors import copy, fill
from mbdkit.engine.native.functions import entry, separate, subkernel
from mbdkit.integrators.loop.step_loop import PAUSED, REFUSED
from mbdkit_contact.kernels.contact_forces import (
    SINGULAR,
    add_answers,
    along,
    find_answers,
    find_directions,
    find_few_forces,
    find_forces,
    gap_rate,
    spread,
    tangential,
    triangular,
)
from mbdkit_contact.kernels.event_bundle import FRICTION, MORE_ROOM, NO_MODES, NORMAL, PAINLEVE, PLACE, load_events
from mbdkit_contact.kernels.kinematics import choose, find_margins, hold, place, place_turned, row_of
from mbdkit_contact.kernels.pivoting import solve_cones
from mbdkit_contact.modes import OPEN, SLIP, STICK

#: Gaps below this, relative to the length of the mechanism, and velocities below this, relative to the largest of the
#: motion, count as zero.
SAME = 1e-10
SAME_ACCELERATION = 1e-9  #: Accelerations below this share of those without contact forces count as zero.
#: Friction forces that exceed their limit by more than this share of the normal force are assumed to result from
#: redundant contacts.
REDUNDANT = 1e-6
STAYING = 1e-9  #: Accelerations [m/s^2] below this, absolute and relative to the largest one, do not separate shapes.
FREE = 1e-6  #: Smallest component of a null vector, of length 1, that makes the force of a contact ambiguous.
FEW = 8  #: Largest number of touching contacts whose forces are examined for being unique.
EXACT_GAP = 1e-15  #: Gaps below this, relative to the length of the mechanism, do not trigger an event.


@subkernel
def speed(m):
    """Return the largest velocity of the motion so far, from its kinetic energy [m/s]."""
    return max(sqrt(2.0 * m.known.energy[0] / m.limits[2]), m.limits[5])


@subkernel
def is_slipping(mode):
    """Return whether a mode is slip."""
    return abs(mode) == SLIP


@subkernel
def use_modes(m):
    """Use the features of the modes that are known."""
    for i in range(len(m.known.modes)):
        m.closed.shapes.held[i] = int(m.known.features[i])


@subkernel
def set_modes(m, modes):
    """Set the modes, and fix the polygon features of closed contacts at the point."""
    m.known.basis[0], m.newton.key[0] = 0, -1
    for i in range(len(modes)):
        m.known.modes[i] = modes[i]
        m.touching[i] = modes[i] != OPEN
    hold(m.closed.shapes, m.q, m.touching)
    for i in range(len(modes)):
        m.known.features[i] = m.closed.shapes.held[i]


@separate
def find_rows(m):
    """Evaluate the quantities of all contacts at the point."""
    place(m.closed.shapes, m.q, m.v)
    rows_in_place(m)


@separate
def rows_in_place(m):
    """Evaluate the quantities of all contacts for the states of the bodies in ``m.closed.shapes``."""
    s, last = m.closed.shapes, -1
    for i in range(len(s.contacts)):
        if s.contacts[i, 3] != last:
            last = s.contacts[i, 3]
            choose(s, last)
        row_of(s, i, m.rows[i])


@subkernel
def rate_of_gap(m, i, at, x):
    """Return the rate of the gap (``at`` = 2) or the slip (8) of contact `i` from ``m.rows``; `x` is (N,)."""
    s = m.closed.shapes
    return gap_rate(m.rows[i], 3 * s.contacts[i, 0], 3 * s.contacts[i, 1], at, x)


@subkernel
def find_rates(m, out):
    """Write the rates (C,) of all gaps at the point; requires `find_rows`."""
    for i in range(len(out)):
        out[i] = rate_of_gap(m, i, 2, m.v)


@subkernel
def friction_value(m, i, slip, normal, tangent):
    """Return the event function of friction of a closed contact; see `find_values`."""
    mode = m.known.modes[i]
    if mode == STICK:
        return m.coefficients[i, 1] * normal - abs(tangent)
    if m.coefficients[i, 2] > 0.0:
        return slip if mode > 0.0 else -slip
    return 1.0


@subkernel
def any_closed(m):
    """Return whether a contact is closed."""
    closed = 0
    for i in range(len(m.known.modes)):
        closed += m.known.modes[i] != OPEN
    return closed > 0


@subkernel
def take_contact(m, k, i, mode):
    """Write contact `i`, in a mode, as number `k` of the contacts in ``m.closed``; an open one has no friction."""
    s = m.closed
    s.chosen[k], s.sticks[k], s.share[k] = i, -1, 0.0
    if mode == STICK:
        s.sticks[k] = 0
    elif is_slipping(mode):  # the friction force is a fixed share of the normal force, against the slip
        s.share[k] = -m.coefficients[i, 2] if mode > 0 else m.coefficients[i, 2]


@subkernel
def find_effects(e, m, k):
    """Write the directions of the forces of the `k` contacts in ``m.closed`` and their effects at the point.

    Return a status, and the number of forces. Requires the factors of the system at the point.
    """
    place(m.closed.shapes, m.q, m.v)
    count = find_directions(m.closed, k)
    return find_answers(m.still, e.w, e.solver, m.closed, count, True), count


@subkernel
def collect_closed(m):
    """Write the closed contacts to ``m.closed``, with the constraints of their modes; return their number, or -1 if
    there are more than the arrays have room for.
    """
    k = 0
    for i in range(len(m.known.modes)):
        mode = m.known.modes[i]
        if mode == OPEN:
            continue
        if k == len(m.closed.chosen):
            m.reason[0] = MORE_ROOM
            return -1
        take_contact(m, k, i, mode)
        k += 1
    return k


@entry
def react(engine, method, t, unused, none):
    """Add the forces of closed contacts to a solution of the equations of motion; see `Reacting`.

    Only independent forces are computed, which cause the same accelerations, unless they are not known. Forces are
    stored as a sample of the step.
    """
    e, m = load_engine(engine), load_events(method)
    w, s, known = e.w, m.closed, m.known
    w.reacting.power[0] = 0.0
    k = collect_closed(m)
    if k < 0:
        return PAUSED
    if k == 0:
        return OK
    place_turned(s.shapes, w.cs, w.reacting.q, w.reacting.v)
    count = find_directions(s, k)
    # the motion needs independent forces only; how redundant contacts share them is decided where rows show it
    if find_few_forces(m.still, w, e.solver, s, k, count, known.basis, w.reacting.acc, w.reacting.lam):
        if known.basis[0] < count:
            m.samples[2] = 1 if spread(s, count, known.basis, known.shares) else 2
    else:
        status = find_answers(m.still, w, e.solver, s, count, False)
        if status != OK:
            return status
        failed = find_forces(s, k, count, w.reacting.acc, m.basis, m.shares)
        if failed >= 0:
            m.reason[0], m.reason[1] = PAINLEVE, s.chosen[failed]
            return NOT_FINITE
        add_answers(s, count, w.reacting.acc, w.reacting.lam)
    for d in range(len(w.reacting.acc) - 3):
        if not abs(w.reacting.acc[d]) < np.inf:
            return NOT_FINITE
    # the search for events uses the forces at the stages, which cost nothing more
    place_of_sample = _sample_at(m, t)
    for j in range(k):
        i, normal, tangent = s.chosen[j], s.forces[j], tangential(s, j)
        w.reacting.power[0] -= tangent * s.rows[j, 1]
        if place_of_sample >= 0:
            sample = m.sample_values[place_of_sample]
            sample[0, i], sample[1, i], sample[2, i] = normal, tangent, s.rows[j, 1]
    return OK


@subkernel
def _sample_at(m, t):
    """Return the index of the sample at a time, a new one if there is none; -1 if no samples are taken or stored."""
    if m.samples[1] == 0:
        return -1
    for j in range(m.samples[0]):
        if m.sample_times[j] == t:
            return j
    j = m.samples[0]
    if j == len(m.sample_times):
        return -1
    m.samples[0], m.sample_times[j] = j + 1, t
    return j


@subkernel
def switch(e, m, is_on):
    """Let contacts act in the equations of motion, or no longer."""
    e.w.reacting.acts[0] = is_on
    e.w.reacting.power[0] = 0.0


@separate
def find_free(e, m):
    """Write the accelerations at the point without contacts, and leave the factors of the system; return a status."""
    take_states(e.top, e.w, m.z)
    prepare(e.top, e.w, m.t[0], m.q)
    return solve_accelerations(e.top, e.w, e.solver, m.q, m.v, m.free, m.lam, True)


@separate
def find_accelerations(e, m):
    """Write accelerations and forces at the point, in the modes that are known; return a status."""
    status = find_free(e, m)
    fill(m.normal, 0.0)
    fill(m.tangent, 0.0)
    copy(m.free, m.a)
    k = collect_closed(m)
    if status != OK or k == 0:
        return status
    if k < 0:
        return PAUSED
    s = m.closed
    status, count = find_effects(e, m, k)
    if status != OK:
        return status
    failed = find_forces(s, k, count, m.free, m.known.basis, m.known.shares)
    if failed >= 0:
        m.reason[0], m.reason[1] = PAINLEVE, s.chosen[failed]
        return REFUSED
    add_answers(s, count, m.a, m.lam)
    for j in range(k):
        m.normal[s.chosen[j]], m.tangent[s.chosen[j]] = s.forces[j], tangential(s, j)
    for d in range(len(m.a) - 3):
        if not abs(m.a[d]) < np.inf:
            return NOT_FINITE
    return OK


@separate
def find_response(e, m):
    """Write the response of touching contacts to their normal and tangential forces, and their accelerations without
    these forces, to ``m.impacts.all.cones``; return a status, and the number of contacts.

    Requires the factors of the system at the point, and the accelerations ``m.free``. The directions of the forces and
    their effects are in ``m.closed``, those along the normals first.
    """
    s, cones, k = m.closed, m.impacts.all.cones, 0
    for i in range(len(m.touching)):
        if m.touching[i] != 0:
            if k == len(s.chosen):
                m.reason[0] = MORE_ROOM
                return PAUSED, 0
            take_contact(m, k, i, STICK)
            k += 1
    status, count = find_effects(e, m, k)
    for i in range(count):
        for j in range(count):
            cones.response[i, j] = along(s, i, s.moved[j])
    for j in range(k):
        cones.free[j] = along(s, j, m.free) - s.rows[j, 14]
        cones.free[k + j] = along(s, k + j, m.free) - s.rows[j, 15]
        cones.sliding[j] = cones.pressed[j] = 0.0
    return status, k


@separate
def decide(e, m):
    """Write the modes ``m.modes`` of contacts in the motion that follows; return a status.

    Contacts marked in ``m.touching`` are closed and do not separate. ``m.sliding`` are their directions of slip. A
    linear complementarity problem determines which contacts are closed, and which of them slip.
    """
    any_touches = False
    for i in range(len(m.touching)):
        m.modes[i] = OPEN
        any_touches |= m.touching[i] != 0
    if not any_touches:
        return OK
    status = find_free(e, m)
    if status != OK:
        return status
    status, k = find_response(e, m)
    if status != OK:
        return status
    s, cones = m.closed, m.impacts.all.cones
    largest = 0.0
    for j in range(2 * k):
        largest = max(largest, abs(cones.free[j]))
    for j in range(k):
        cones.sliding[j] = m.sliding[s.chosen[j]]
    for _ in range(2):  # contacts that begin to slip have kinetic friction in the second solution
        for j in range(k):
            cones.friction[j] = m.coefficients[s.chosen[j], 2 if cones.sliding[j] != 0.0 else 1]
        if not solve_cones(cones, k):
            m.reason[0], m.reason[1] = NO_MODES, s.chosen[0]
            return REFUSED
        is_final = True
        for j in range(k):
            i, slides, tangent = s.chosen[j], cones.sliding[j], cones.forces[k + j]
            after = cones.free[k + j]
            for x in range(2 * k):
                after += cones.response[k + j, x] * cones.forces[x]
            moves = abs(after) > SAME_ACCELERATION * largest or cones.friction[j] == 0.0
            begins = cones.slipping[j] != 0 and cones.closed[j] != 0 and slides == 0.0 and moves
            direction = slides
            if slides == 0.0:
                direction = -1.0 if tangent > 0.0 else 1.0
            m.modes[i] = OPEN
            if cones.closed[j] != 0:
                m.modes[i] = SLIP * direction if begins or slides != 0.0 else STICK
            s.weights[j] = direction if begins else 0.0
            is_final &= not (begins and m.coefficients[i, 1] != m.coefficients[i, 2])
        if is_final:
            break
        for j in range(k):
            if s.weights[j] != 0.0:
                cones.sliding[j] = s.weights[j]
    return OK


@separate
def decide_at_rest(e, m):
    """Write the modes after an event from ``m.touching``, and from slip or its end; return a status.

    ``m.sliding`` is the direction of slips that begin, 2 where slip has just ended, and 0 elsewhere.
    """
    find_rows(m)
    slow = SAME * speed(m)
    for i in range(len(m.touching)):
        if m.touching[i] != 0 and rate_of_gap(m, i, 2, m.v) > slow:
            m.touching[i] = 0
        if abs(m.sliding[i]) == 2.0:
            m.sliding[i] = 0.0
        elif m.sliding[i] == 0.0 and abs(m.rows[i, 1]) > slow:
            m.sliding[i] = 1.0 if m.rows[i, 1] > 0.0 else -1.0
    return decide(e, m)


@separate
def share_forces(e, m):
    """If redundant contacts stick, choose forces within the limits of friction; return a status.

    ``m.normal`` and ``m.tangent`` are those of `find_accelerations`. They are replaced by forces that cause the same
    accelerations and satisfy Coulomb's law, if there are any.
    """
    # least squares may put more friction on a contact than its normal force carries, although other forces would do
    most, excess = 0.0, 0.0
    for i in range(len(m.normal)):
        most = max(most, abs(m.normal[i]))
        if m.known.modes[i] == STICK:
            excess = max(excess, abs(m.tangent[i]) - m.coefficients[i, 1] * m.normal[i])
    if not excess > REDUNDANT * most:  # a smaller excess means that the contact is about to slip
        return OK
    for i in range(len(m.touching)):
        m.touching[i] = m.known.modes[i] != OPEN
    status, k = find_response(e, m)
    if status != OK:
        return status
    s, cones = m.closed, m.impacts.all.cones
    for j in range(k):
        mode = m.known.modes[s.chosen[j]]
        cones.sliding[j] = 0.0
        if is_slipping(mode):
            cones.sliding[j] = 1.0 if mode > 0 else -1.0
        cones.friction[j] = m.coefficients[s.chosen[j], 2 if cones.sliding[j] != 0.0 else 1]
    # without such forces, those of least squares stay: the motion is the same, and the run records one possible set
    if not solve_cones(cones, k):
        return OK
    largest, moved = 1.0, 0.0
    for d in range(len(m.free) - 3):
        largest = max(largest, abs(m.free[d]))
        change = 0.0
        for j in range(k):
            i = s.chosen[j]
            change += s.moved[j, d] * (cones.forces[j] - m.normal[i])
            change += s.moved[k + j, d] * (cones.forces[k + j] - m.tangent[i])
        moved = max(moved, abs(change))
    if moved <= SAME_ACCELERATION * largest:
        for j in range(k):
            m.normal[s.chosen[j]], m.tangent[s.chosen[j]] = cones.forces[j], cones.forces[k + j]
    return OK


@separate
def find_values(e, m, with_forces):
    """Write the three event functions of each contact at the point to ``m.values``; return a status.

    They belong to the normal direction (gap or force), to friction (slip, or how far the friction force is from its
    limit), and to the place on the edge of a polygon. Those of forces are nan without `with_forces`; with it, the
    forces are written to ``m.known``. Requires `find_rows` at the point.
    """
    status = OK
    find_margins(m.closed.shapes, m.values[PLACE])
    if with_forces:
        if any_closed(m):
            status = find_accelerations(e, m)
        else:
            fill(m.normal, 0.0)
            fill(m.tangent, 0.0)
        if status == OK:
            status = share_forces(e, m)
        if status != OK:
            return status
        note_forces(m)
    for i in range(len(m.touching)):
        mode = m.known.modes[i]
        if mode == OPEN:
            m.values[NORMAL, i] = m.rows[i, 0]
            m.values[FRICTION, i] = 1.0
        elif with_forces or mode != STICK:
            m.values[NORMAL, i] = m.normal[i] if with_forces else np.nan
            m.values[FRICTION, i] = friction_value(m, i, m.rows[i, 1], m.normal[i], m.tangent[i])
        else:
            m.values[NORMAL, i] = m.values[FRICTION, i] = np.nan
    return OK


@separate
def find_limits(e, m, out):
    """Write the smallest absolute values of event functions (3, C) that do not count as zero.

    Requires `find_accelerations` at the point if a contact is closed.
    """
    # forces are compared with the weights and inertia forces of the bodies: a force alone has no scale
    weight = 1e-300
    if any_closed(m):
        for i in range(len(m.normal)):
            weight = max(weight, abs(m.normal[i]))
        for b in range(len(e.top.mass) - 1):
            for d in range(2):
                weight = max(weight, abs(e.top.mass[b, d] * m.a[3 * b + d]))
    for i in range(len(m.normal)):
        mode = m.known.modes[i]
        out[NORMAL, i] = EXACT_GAP * m.limits[1] if mode == OPEN else SAME * weight
        out[FRICTION, i] = SAME * (speed(m) if is_slipping(mode) else weight)
        out[PLACE, i] = EXACT_GAP * m.limits[1]


@separate
def show_forces(e, m):
    """Evaluate forces at the point, and write them to ``m.known``; note the contacts whose normal forces are not
    unique. Returns a status.
    """
    status = find_accelerations(e, m)
    if status != OK:
        return status
    find_rows(m)
    status = share_forces(e, m)
    if status == OK:
        note_forces(m)
        status = note_undetermined(e, m)
    return status


@separate
def add_forces(m, out):
    """Write the generalized forces (N,) of all contacts into `out`, from ``m.normal`` and ``m.tangent``; needs
    `find_rows`.
    """
    shapes = m.closed.shapes
    fill(out, 0.0)
    for i in range(len(m.normal)):
        if m.known.modes[i] == OPEN:
            continue
        a, b = 3 * shapes.contacts[i, 0], 3 * shapes.contacts[i, 1]
        for d in range(3):
            out[a + d] += m.normal[i] * m.rows[i, 2 + d] + m.tangent[i] * m.rows[i, 8 + d]
            out[b + d] += m.normal[i] * m.rows[i, 5 + d] + m.tangent[i] * m.rows[i, 11 + d]
    for d in range(len(out) - 3, len(out)):
        out[d] = 0.0


@subkernel
def note_forces(m):
    """Write the forces at the point, and their sums, to ``m.known``; requires `find_rows`."""
    add_forces(m, m.known.force)
    copy(m.normal, m.known.normal)
    copy(m.tangent, m.known.tangent)


@subkernel
def find_touching(m):
    """Mark the contacts that are closed, or touch and do not separate; requires `find_rows`."""
    slow = SAME * speed(m)
    for i in range(len(m.touching)):
        is_near = m.rows[i, 0] <= SAME * m.limits[1] and rate_of_gap(m, i, 2, m.v) <= slow
        m.touching[i] = m.known.modes[i] != OPEN or is_near


@separate
def note_undetermined(e, m):
    """Flag contacts whose normal forces are not unique, because other forces of joints and contacts cause the same
    accelerations; return a status. Requires `find_accelerations` and `find_rows` at the point.
    """
    s, largest, k = m.closed, 1.0, 0
    for d in range(len(m.a)):
        largest = max(largest, abs(m.a[d]))
    find_touching(m)
    for i in range(len(m.touching)):
        mode = m.known.modes[i]
        stays = mode != OPEN or rate_of_gap(m, i, 2, m.a) - m.rows[i, 14] <= STAYING * largest
        if m.touching[i] == 0 or not stays:
            continue
        if k == min(FEW, len(s.chosen)):
            return OK
        take_contact(m, k, i, mode)
        k += 1
    if k == 0:
        return OK
    status, count = find_effects(e, m, k)
    if status != OK:
        return status
    widest = 0.0
    for i in range(count):
        s.weights[i], s.right[i] = 1.0, 0.0
        s.forces[i] = sqrt(abs(along(s, i, s.moved[i])))
        widest = max(widest, s.forces[i])
    for i in range(count):  # forces of joints that hold the bodies have no effect, and are not scaled
        s.forces[i] = 1.0 / s.forces[i] if s.forces[i] > sqrt(SINGULAR) * widest else 0.0
    for i in range(count):
        for j in range(count):
            s.matrix[i, j] = s.forces[i] * s.forces[j] * along(s, i, s.moved[j])
    rank = triangular(s, count)
    for extra in range(rank, count):
        solve_triangle(s.columns, rank, s.columns[extra], s.turns[0])
        size = 1.0
        for i in range(rank):
            size += s.turns[0, i] * s.turns[0, i]
        for i in range(rank):
            if s.order[i] < k and abs(s.turns[0, i]) > FREE * sqrt(size):
                m.known.flags[2, s.chosen[s.order[i]]] = 1
        if s.order[extra] < k:
            m.known.flags[2, s.chosen[s.order[extra]]] = 1
    return OK
