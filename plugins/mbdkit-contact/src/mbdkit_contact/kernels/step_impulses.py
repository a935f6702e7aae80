"""Impulses of contacts in a step of a time-stepping method."""

from __future__ import annotations

from mbdkit.engine.kernels.accelerations import substitute_by_pivots, substitute_by_schur
from mbdkit.engine.kernels.lu import solve_refined
from mbdkit.engine.kernels.system import DIVERGED, OK, REPIVOT_STAGES
from mbdkit.engine.kernels.vectors import copy, fill, fill_rows
from mbdkit.engine.native.functions import subkernel
from mbdkit_contact.kernels.active_set import solve_active_set
from mbdkit_contact.kernels.impacts import NEWTON, SMALL_RESTITUTION, find_ordered, stronge
from mbdkit_contact.kernels.kinematics import NOWHERE, SINGLE, choose, find_gaps, place, row_of
from mbdkit_contact.kernels.many_contacts import PRECISION, push_many
from mbdkit_contact.kernels.mode_path import solve_by_path
from mbdkit_contact.kernels.pivoting import solve_cones
from mbdkit_contact.kernels.stepping_bundle import (
    ACROSS,
    ALONG,
    CURVE,
    GAP,
    add_force,
    add_move,
    all_free,
    keep_held,
    rate_of,
)
from mbdkit_contact.modes import OPEN, SLIP, STICK

MOST_PIVOTED = 64  #: Up to this number of contacts, impulses are found by elimination; for more, see `many_contacts`.
#: Number of overlaps above which less accurate results are accepted: contacts at rest that others press together get no
#: impulse in this step, and positions are projected only once. The next steps reduce the remaining overlap.
MANY = 40
FEW = 8  #: Up to this number of contacts, it is found whether the order of simultaneous impacts matters.
#: A contact is at rest if its gap, rate and impulse are smaller than this many times those that accelerations cause in
#: one step; otherwise it has an impact.
AT_REST = 4.0
SMALL = 1e-12  #: Overlap, relative to the length of the mechanism, that counts as zero.
SAME_VELOCITY = 1e-9  #: Velocities below this share of the largest one count as zero.


@subkernel
def answer(c, m, impulse, out, lam):
    """Write the change of the velocities (N,) by a generalized impulse (N,), and the impulses (P, 2) of the joints;
    return a status.
    """
    n = len(out) - 3
    if m.by_matrix[0] != 0:
        fill(m.right, 0.0)
        for d in range(n):
            m.right[d] = impulse[d]
        if not solve_refined(m.pattern, m.factors, m.right, m.solution, m.correction) < 1e-9:
            return REPIVOT_STAGES
        for d in range(n):
            out[d] = m.solution[d]
        for k in range(len(lam)):
            for r in range(c.top.rows[k]):
                lam[k, r] = m.solution[c.solver.row_index[k, r]]
        return OK
    fill_rows(c.w.gamma, 0.0)
    copy(impulse, c.w.force)
    if c.solver.pivoted[0] != 0:
        return substitute_by_pivots(c.still, c.w, c.solver, True, out, lam)
    substitute_by_schur(c.still, c.w, c.solver.schur, True, out, lam, True)
    return OK


@subkernel
def write_end(m, v):
    """Write the positions at the end of the step for velocities `v` (N,) there into ``m.end``."""
    for d in range(len(v) - 3):
        m.end[d] = m.base[d] + m.factor[0] * v[d]


@subkernel
def find_rows(m, at, where, v, acts):
    """Write the rows of the contacts ``m.is_some``, at positions `where` and velocities `v` (N,).

    Their features are those at positions `at`. If `acts`, all features act; otherwise, the gap of one that does not is
    the distance of the shapes.
    """
    s, count, last = m.shapes, 0, -1
    place(s, at, v)
    for i in range(len(m.is_some)):
        if m.is_some[i] != 0:
            m.some[count] = i
            count += 1
            if s.contacts[i, 3] != last:
                last = s.contacts[i, 3]
                choose(s, last)
                if acts and s.pairs[last, 0] != SINGLE:
                    for k in range(s.pairs[last, 1], s.pairs[last, 1] + s.pairs[last, 2]):
                        s.least[k] = NOWHERE
    m.number[0] = count
    place(s, where, v)
    for j in range(count):
        row_of(s, m.some[j], m.rows[j])


@subkernel
def find_responses(c, m):
    """Write the velocities that unit impulses of the contacts cause, and their effects on the contact itself; return
    a status.
    """
    k, is_small = m.number[0], m.number[0] <= MOST_PIVOTED
    # an impulse on bodies without joints moves only these two, which needs no solution of equations
    free = True
    for j in range(k):
        free &= all_free(m, j)
    if is_small or not free:
        for j in range(k):
            for way in range(2):
                at, row = (ALONG, 2 * j) if way == 0 else (ACROSS, 2 * j + 1)
                fill(m.moved[row], 0.0)
                if free:
                    add_move(c, m, j, at, 1.0, m.moved[row])
                else:
                    fill(m.x, 0.0)
                    add_force(m, j, at, 1.0, m.x)
                    status = answer(c, m, m.x, m.moved[row], m.lam_x)
                    if status != OK:
                        return status
    if is_small:
        for i in range(k):
            for j in range(k):
                m.cones.response[i, j] = rate_of(m, i, ALONG, m.moved[2 * j])
                m.cones.response[i, k + j] = rate_of(m, i, ALONG, m.moved[2 * j + 1])
                m.cones.response[k + i, j] = rate_of(m, i, ACROSS, m.moved[2 * j])
                m.cones.response[k + i, k + j] = rate_of(m, i, ACROSS, m.moved[2 * j + 1])
        return OK
    for j in range(k):
        for way in range(2):
            at, row = (ALONG, 2 * j) if way == 0 else (ACROSS, 2 * j + 1)
            if free:
                fill(m.x, 0.0)
                add_move(c, m, j, at, 1.0, m.x)
                m.block[j, way], m.block[j, 2 + way] = rate_of(m, j, ALONG, m.x), rate_of(m, j, ACROSS, m.x)
            else:
                m.block[j, way] = rate_of(m, j, ALONG, m.moved[row])
                m.block[j, 2 + way] = rate_of(m, j, ACROSS, m.moved[row])
    m.is_sparse[0] = free
    return OK


@subkernel
def push_apart(c, m, velocities, precision):
    """Find the impulses of the contacts in ``m.some``, and the velocities ``m.after`` after them; return whether there
    are such impulses.

    ``m.more`` is added to the normal velocities. A few contacts are solved by an active set that begins with the modes
    and forces of the last step, and if this fails along a path of solutions or by pivoting; for many, see `push_many`.
    """
    k, w, s = m.number[0], m.cones, m.active
    m.error[0] = 0.0
    if k > MOST_PIVOTED:
        return push_many(c, m, velocities, precision)
    for j in range(k):
        w.free[j] = rate_of(m, j, ALONG, velocities) + m.more[j]
        w.free[k + j] = rate_of(m, j, ACROSS, velocities)
        w.friction[j], w.sliding[j], w.pressed[j] = m.friction[j], 0.0, 0.0
        s.start[j], s.start[k + j] = m.normal[j], m.tangent[j]
        mode = m.now.modes[m.some[j]]
        s.modes[j] = STICK if mode == OPEN or m.friction[j] == 0.0 else int(mode)
    # in the order of cost: contacts mostly keep the modes of the last step
    if not (solve_active_set(s, w, k) or solve_by_path(s, w, k) or solve_cones(w, k)):
        return False
    copy(velocities, m.after)
    for j in range(k):
        m.normal[j], m.tangent[j] = w.forces[j], w.forces[k + j]
        m.closed[j], m.slipping[j] = w.closed[j], w.slipping[j]
        for d in range(len(m.after) - 3):
            m.after[d] += m.normal[j] * m.moved[2 * j, d] + m.tangent[j] * m.moved[2 * j + 1, d]
    return True


@subkernel
def _gains(m):
    """Return whether the impulses increase the kinetic energy by more than their errors explain."""
    gain = size = 0.0
    for j in range(m.number[0]):
        for at in (ALONG, ACROSS):
            impulse = m.normal[j] if at == ALONG else m.tangent[j]
            before, then = rate_of(m, j, at, m.v), rate_of(m, j, at, m.after)
            gain += impulse * (before + then)
            size += abs(impulse) * (abs(before) + abs(then))
    return gain > max(1e-12, m.error[0]) * size


@subkernel
def _by_newton(c, m):
    for j in range(m.number[0]):
        approach = min(rate_of(m, j, ALONG, m.v), 0.0)
        m.more[j] = m.restitution[j] * approach + m.closing[m.some[j]]
    return push_apart(c, m, m.free, PRECISION)


@subkernel
def _strike(c, m):
    """Find the impulses of the contacts; return whether there are such impulses.

    If they would gain energy, the law of Stronge is used for a single contact, and else smaller coefficients of
    restitution.
    """
    k = m.number[0]
    bounces = False
    for j in range(k):
        m.restitution[j] = m.coefficients[m.some[j], 0]
        bounces |= m.restitution[j] > 0.0 and rate_of(m, j, ALONG, m.v) < 0.0
    m.other_law[0] = 0
    if not _by_newton(c, m):
        return False
    if not bounces or not _gains(m):
        return True
    m.other_law[0] = 1
    # a single contact that still approaches without impulses has an impact by the law of Stronge
    if k == 1 and rate_of(m, 0, ALONG, m.free) < 0.0:
        s = m.impacts.alone
        for a in range(2):
            for b in range(2):
                s.cones.response[a, b] = m.cones.response[a, b]
        s.before[0], s.before[1] = rate_of(m, 0, ALONG, m.free), rate_of(m, 0, ACROSS, m.free)
        s.cones.friction[0], s.restitution[0] = m.friction[0], m.restitution[0]
        stronge(s)
        m.normal[0], m.tangent[0] = s.impulses[0], s.impulses[1]
        for d in range(len(m.after) - 3):
            m.after[d] = m.free[d] + m.normal[0] * m.moved[0, d] + m.tangent[0] * m.moved[1, d]
    while _gains(m):
        any_left = False
        for j in range(k):
            any_left |= m.restitution[j] != 0.0
            m.restitution[j] = 0.9 * m.restitution[j] if m.restitution[j] > SMALL_RESTITUTION else 0.0
        if not any_left:
            break
        if not _by_newton(c, m):
            return False
    return True


@subkernel
def _gained(m, j, h):
    """Return the absolute change of a gap rate in the step without impulses [m/s]."""
    change = rate_of(m, j, ALONG, m.free) - rate_of(m, j, ALONG, m.v)
    return abs(change) + h * abs(m.rows[j, CURVE])


@subkernel
def _negligible(m, error):
    """Return the slip velocity [m/s] that counts as zero if velocities have this relative error."""
    size = 0.0
    for j in range(m.number[0]):
        for at in (ALONG, ACROSS):
            size = max(size, abs(rate_of(m, j, at, m.v)), abs(rate_of(m, j, at, m.free)))
    return max(SAME_VELOCITY, error) * size


@subkernel
def _slip(m, j, negligible, is_smooth):
    """Return the direction in which a contact slips at the end of the step, 1 or -1; 0 if it sticks.

    Friction at its limit does not imply slip: contacts that stick on one surface share the friction in many ways, and
    the solution may load some of them up to their limits. A contact without friction, `is_smooth`, slips.
    """
    slip = rate_of(m, j, ACROSS, m.after)
    if (m.slipping[j] != 0 and abs(slip) > negligible) or is_smooth:
        return -1 if slip < 0.0 else 1
    return 0


@subkernel
def _find_still_pressed(m, h):
    """Add contacts that were pressed in the last step and are at rest, among many; their gaps may close.

    Bodies that lie on each other fall together in a step, so that tiny gaps between them stay open. Without impulses at
    these gaps, the upper bodies would fall onto the lower ones, which the floor stops, and a pile would never come to
    rest.
    """
    fallen = 0.0
    for j in range(m.number[0]):
        fallen = max(fallen, h * _gained(m, j, h))
    for i in range(len(m.gaps)):
        if m.now.normal[i] > 0.0 and m.gaps[i] <= AT_REST * fallen:
            m.is_some[i] = 1
            m.closing[i] = max(m.gaps[i], 0.0) / h


@subkernel
def _find_pressed(m, h, length):
    """Add other contacts at rest that the impulses press together; return their number.

    The gap of a contact at rest may be as large as the distance that a body falls in a step, so the contact may be
    predicted to stay open. Without an impulse at such a contact, the impact of others would have a wrong result,
    however small the step. Contacts with larger gaps are left to the next step, whose impulses include restitution.
    """
    write_end(m, m.after)
    place(m.shapes, m.end, m.v)
    find_gaps(m.shapes, m.reach[0], m.gaps)
    kept, count = m.number[0], 0
    for i in range(len(m.gaps)):
        if m.is_some[i] == 0 and m.gaps[i] < -SMALL * length:
            count += 1
    if count == 0:
        return 0
    added, last, s = 0, -1, m.shapes
    place(s, m.middle, m.v)
    for i in range(len(m.gaps)):
        if m.is_some[i] != 0 or not m.gaps[i] < -SMALL * length:
            continue
        if s.contacts[i, 3] != last:
            last = s.contacts[i, 3]
            choose(s, last)
        m.some[kept] = i
        row_of(s, i, m.rows[kept])
        if m.rows[kept, GAP] <= AT_REST * h * _gained(m, kept, h):
            m.is_some[i] = 2
            added += 1
    for i in range(len(m.gaps)):
        m.is_some[i] = m.is_some[i] != 0
    return added


@subkernel
def _note_order(m, h):
    """Note contacts of at most `FEW` that strike in this step or are closed, and whose velocities depend on the order
    of the impacts.
    """
    k, x = m.number[0], m.impacts
    all_known, strikes = True, False
    for j in range(k):
        all_known &= m.now.ordered[m.some[j]] != 0
        strikes |= m.normal[j] > 0.0 and rate_of(m, j, ALONG, m.v) < -AT_REST * _gained(m, j, h)
    if not 1 < k <= FEW or all_known or not strikes:
        return
    for i in range(2 * k):
        for j in range(2 * k):
            x.all.cones.response[i, j] = m.cones.response[i, j]
    for j in range(k):
        x.all.cones.friction[j], x.restitution[j] = m.coefficients[m.some[j], 2], m.coefficients[m.some[j], 0]
        x.all.before[j], x.all.before[k + j] = rate_of(m, j, ALONG, m.v), rate_of(m, j, ACROSS, m.v)
    find_ordered(x, k, NEWTON)
    for j in range(k):
        if x.ordered[j] != 0:
            m.new.ordered[m.some[j]] = 1


@subkernel
def _find_impulses(c, m, h, length):
    """Find the contacts that have impulses in the step, beginning with ``m.is_some``, and the impulses; return
    a status, DIVERGED if there are none.

    Contacts that stick, or whose slip would change its direction, have static friction, unless they slip with it. If
    there are impacts, contacts that are struck by them have kinetic friction.
    """
    for i in range(len(m.slides)):
        m.slides[i] = m.stops[i] = 0
    is_new = True
    while True:
        if is_new:
            write_end(m, m.free)
            find_rows(m, m.end, m.middle, m.v, True)
            status = find_responses(c, m)
            if status != OK:
                return status
        is_new = False
        k = m.number[0]
        rest = _negligible(m, m.now.residual[0])
        for j in range(k):
            i = m.some[j]
            m.normal[j], m.tangent[j] = h * m.now.normal[i], h * m.now.tangent[i]
            rests = m.now.modes[i] == OPEN and abs(rate_of(m, j, ACROSS, m.v)) <= rest
            sticks = (m.now.modes[i] == STICK or rests or m.stops[i] != 0) and m.slides[i] == 0
            m.friction[j] = m.coefficients[i, 1] if sticks else m.coefficients[i, 2]
        if not _strike(c, m):
            return DIVERGED
        negligible = _negligible(m, m.error[0])
        # static friction holds up to its limit only: what slips beyond it has kinetic friction, and is solved again
        again = False
        for j in range(k):
            i, slip = m.some[j], _slip(m, j, negligible, False)
            if m.coefficients[i, 1] > m.coefficients[i, 2] and slip != 0 and m.slides[i] == 0:
                if m.friction[j] == m.coefficients[i, 1]:
                    m.slides[i] = 1
                    again = True
                elif slip * m.now.modes[i] < 0:
                    m.stops[i] = 1
                    again = True
        if again:
            continue
        # With many contacts, the following search takes long, and the order of impacts has larger effects anyway.
        if k > MANY:
            return OK
        if _find_pressed(m, h, length) > 0:
            is_new = True
            continue
        # an impact breaks static friction of the contacts that it presses: their friction impulse is a kinetic one
        strikes = begins = False
        for j in range(k):
            strikes |= m.normal[j] > 0.0 and rate_of(m, j, ALONG, m.v) < -AT_REST * _gained(m, j, h)
        for j in range(k):
            i = m.some[j]
            is_static = m.coefficients[i, 1] > m.coefficients[i, 2] and m.friction[j] == m.coefficients[i, 1]
            if strikes and is_static and m.normal[j] > AT_REST * h * m.now.normal[i]:
                m.slides[i] = 1
                begins = True
        if not begins:
            return OK


@subkernel
def apply_impulses(c, m, h, length):
    """Find the impulses of all contacts in a step, and the velocities ``m.after`` after them; return whether there are
    such impulses.

    The state of the contacts after the step is written to ``m.now``.
    """
    held, new = m.now, m.new
    keep_held(held, new)
    for i in range(len(m.gaps)):
        new.modes[i], new.normal[i], new.tangent[i] = OPEN, 0.0, 0.0
        m.closing[i] = 0.0
    fill(new.force, 0.0)
    m.lost[0] = 0.0
    write_end(m, m.free)
    place(m.shapes, m.end, m.v)
    find_gaps(m.shapes, m.reach[0], m.gaps)
    count = 0
    for i in range(len(m.gaps)):
        m.is_some[i] = m.gaps[i] <= SMALL * length
        count += m.is_some[i]
    if count == 0:
        copy(m.free, m.after)
    else:
        # the search for further pressed contacts is left out for so many, so that those of the last step are taken
        if count > MANY:
            find_rows(m, m.end, m.middle, m.v, True)
            _find_still_pressed(m, h)
        status = _find_impulses(c, m, h, length)
        if status != OK:
            return status
        _note_order(m, h)
        negligible = _negligible(m, m.error[0])
        new.residual[0] = max(new.residual[0], m.error[0])
        for j in range(m.number[0]):
            i = m.some[j]
            new.normal[i], new.tangent[i] = m.normal[j] / h, m.tangent[j] / h
            slip = _slip(m, j, negligible, m.coefficients[i, 1] == 0.0)
            if m.closed[j] != 0:
                new.modes[i] = SLIP * slip if slip != 0 else STICK
            if m.other_law[0] != 0 and m.normal[j] > 0.0:
                new.changed[i] = 1
            add_force(m, j, ALONG, new.normal[i], new.force)
            add_force(m, j, ACROSS, new.tangent[i], new.force)
            for at in (ALONG, ACROSS):
                rates = rate_of(m, j, at, m.v) + rate_of(m, j, at, m.after)
                m.lost[0] -= 0.5 * (m.normal[j] if at == ALONG else m.tangent[j]) * rates
    keep_held(new, held)
    return OK
