"""Controlled steps of runs with compliant contacts: they end where shapes begin or cease to touch.

Error control sees only the motion, and a step whose stages all lie before and behind a wall shows no trace of it. The
first touch within a step is therefore found by the bounds of `mbdkit_contact.kernels.first_touch`, as for rigid
contacts, and the step is taken again up to there. The order of a method holds within contact and without, but not
across its begin or end, where the force is not smooth. A step that begins at a touch may have no stage in contact
either: it is taken again up to where its shapes cease to touch, until its stages see the contact.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_accelerations
from mbdkit.engine.kernels.applied_forces import take_states
from mbdkit.engine.kernels.bundle_types import RealVector
from mbdkit.engine.kernels.system import OK, prepare
from mbdkit.engine.native.functions import entry, kernel, separate, subkernel
from mbdkit.integrators.loop.step_loop import SHORTER
from mbdkit.integrators.run.run_state import load_run_state
from mbdkit_contact.kernels.contact_modes import EXACT_GAP
from mbdkit_contact.kernels.event_bundle import NORMAL, UNKNOWN, load_events
from mbdkit_contact.kernels.event_search import begin_search
from mbdkit_contact.kernels.first_touch import CLEAR, find_near, find_touches, set_piece, set_states
from mbdkit_contact.kernels.kinematics import ROUND, choose, find_gaps, gap_of, place
from mbdkit_contact.kernels.steps_to_events import pieces, write_node

#: Gaps up to this share of the way of the shapes in a step count as zero, and so do parts of the step up to this share
#: of it.
SAME_WAY = 1e-9
#: Parts of a step below this share of the time, or of the step, are too short to be steps. Steps end this much after a
#: contact has begun or ended: a law with a damper has a jump there, and a step must know on which side it begins.
SAME_PART = 1e-12
#: Share of a step after which shapes show whether they approach. The motion is that at the start of the step, although
#: dense output may be wild if some of its stages meet a contact of which error control knows nothing.
SOON = 1e-6
INTO = 0.25  #: Largest share of the way through a contact that a step from its begin may go.
SAMPLES = 8  #: Number of parts of a step at whose ends gaps of shapes in contact are evaluated.
LEAST_PART = 1e-9  #: Least part of a step, after a touch, that is searched for the contact.
#: A step from a touch is repeated with this share of its size if its velocities change by less than this share of what
#: the accelerations at its ends indicate.
SHORTER_FROM_TOUCH, LEAST_CHANGE = 0.25, 0.1
MOST_HALVES = 60  #: Largest number of evaluations of a gap in the search for its zero.


@subkernel
def _lowest(s, pair):
    """Return the least gap of a pair of shapes whose features are chosen."""
    lowest = np.inf
    for i in range(s.pairs[pair, 1], s.pairs[pair, 1] + s.pairs[pair, 2]):
        lowest = min(lowest, gap_of(s, i))
    return lowest


@subkernel
def _gap_at(m, i, share):
    """Return the gap of a contact at a share of the piece; for a circle on a polygon, that of all its edges."""
    s, pair = m.closed.shapes, m.closed.shapes.contacts[i, 3]
    set_states(m, i, share)
    choose(s, pair)
    return _lowest(s, pair) if s.pairs[pair, 0] == ROUND else gap_of(s, i)


@subkernel
def _find_gaps(m, q, v, gaps):
    """Write the gaps of all contacts; one of the rows of a circle on a polygon stands for the others."""
    s = m.closed.shapes
    place(s, q, v)
    find_gaps(s, 0.0, gaps)
    for pair in range(len(s.pairs)):
        if s.pairs[pair, 0] == ROUND:
            first = s.pairs[pair, 1]
            for i in range(first + 1, first + s.pairs[pair, 2]):
                gaps[first], gaps[i] = min(gaps[first], gaps[i]), np.inf


@subkernel
def _way(m, i):
    """Return a bound of the way of the shapes of a contact in a piece; infinite if a line turns."""
    way, c = 0.0, m.touch
    for side in range(2):
        bound = c.bounds[m.closed.shapes.contacts[i, side]]
        way += bound[0]
        if bound[3] > 0.0:
            way += bound[3] * c.arms[i, side]
    return way


@separate
def _zero_of_gap(m, i, a, b):
    """Return where the gap of a contact changes its sign between two shares of the piece, by bisection and secants."""
    fa, fb = _gap_at(m, i, a), _gap_at(m, i, b)
    for k in range(MOST_HALVES):
        if not (b - a > SAME_WAY * SAME_WAY and (fa > 0.0) != (fb > 0.0)):
            break
        share = 0.5
        if k % 3 != 2:
            share = min(max(fa / (fa - fb), 1e-12), 1.0 - 1e-12)
        middle = a + share * (b - a)
        f = _gap_at(m, i, middle)
        if f == 0.0:
            return middle
        if (f > 0.0) == (fa > 0.0):
            a, fa = middle, f
        else:
            b, fb = middle, f
    return b


@subkernel
def _release(m, i, same):
    """Return the share of the piece up to which a step may go that begins in contact; 1 if the contact does not end.

    A step from a touch goes only part of the way through the contact: error control may fail in a step from its begin
    to its end, of which most stages are outside. The same holds if it ends in contact, but beyond the deepest overlap:
    where shapes separate, a damper may take all force away.
    """
    before, begins = 0.0, not m.begin[NORMAL, i] < -same
    gap, lowest, deepest = 0.0, 0.0, 1.0
    for k in range(1, SAMPLES + 1):
        share = k / SAMPLES
        gap = _gap_at(m, i, share)
        if gap > same or (begins and k == SAMPLES and gap > -same):
            if k == 1 and begins:  # the whole contact may lie before the first sample
                while share > LEAST_PART and _gap_at(m, i, share / SAMPLES) > 0.0:
                    share /= SAMPLES
                before = share / SAMPLES
            end = _zero_of_gap(m, i, before, share)
            if not begins:
                return end
            return INTO * end if _gap_at(m, i, INTO * end) < -same else 1.0
        if gap < lowest:
            lowest, deepest = gap, share
        before = share
    return INTO * deepest if begins and gap > lowest + same else 1.0


@separate
def first_change(m, q0, v0, q1, v1, h):
    """Return the share of a piece of the motion of duration `h`, given by the states at its ends, at which a contact
    begins or ends; 1 if none does. Contacts that touch first at the start of the piece are marked in ``m.touching``.
    """
    touch, x, first = m.touch, m.search, 1.0
    set_piece(m, q0, v0, q1, v1, h)
    _find_gaps(m, q1, v1, m.gaps)
    _find_gaps(m, q0, v0, m.begin[NORMAL])
    any_near = find_near(m, m.begin[NORMAL], m.gaps)
    for i in range(len(m.gaps)):
        way, gap = _way(m, i), m.begin[NORMAL, i]
        same = SAME_WAY * min(way, m.limits[1])
        m.touching[i] = 0
        if gap < -same or (gap <= same and _gap_at(m, i, SOON) < gap):
            touch.near[i], m.touching[i] = 0, gap >= -same
            if not -gap - m.gaps[i] > CLEAR * way:
                first = min(first, _release(m, i, same))
    if not any_near:
        return first
    begin_search(m, h)
    for i in range(len(m.gaps)):
        x.level[i], x.limits[NORMAL, i] = min(m.begin[NORMAL, i], 0.0), EXACT_GAP * m.limits[1]
    any_touches = find_touches(m, 0.0, 1.0)
    if x.event[0] == UNKNOWN:
        return min(first, x.first[0])
    if any_touches:
        for i in range(len(m.gaps)):
            if x.high[NORMAL, i] < first:
                first = _zero_of_gap(m, i, max(x.best[NORMAL, i, 0], 0.0), x.high[NORMAL, i])
    return first


@separate
def _change_in_step(c, m, run, t, h):
    """Return the share of the last attempt at which a contact begins or ends, 1 if none does; and whether the step
    begins at a touch.
    """
    for d in range(len(m.q)):
        m.q[d], m.v[d] = c.from_q[d] + c.dq[d], c.from_v[d] + c.dv[d]
        if not (abs(m.q[d]) < np.inf and abs(m.v[d]) < np.inf):
            return 1.0, False
    first, touches, near = first_change(m, c.from_q, c.from_v, m.q, m.v, h), False, False
    for i in range(len(m.touching)):
        touches |= m.touching[i] != 0
        near |= m.touch.near[i] != 0
    if not (first < 1.0 or near):  # the cubic through both ends will do
        return 1.0, touches
    count, status = pieces(c, c, m, run, t, h)
    if count == 1 or status != OK:
        return first, touches
    q0, v0, q1, v1 = m.touch.nodes[0], m.touch.nodes[1], m.touch.nodes[2], m.touch.nodes[3]
    if not touches:  # else the step goes no further than this cubic allows
        first = 1.0
    for k in range(count):
        status = write_node(c, c, m, run, t, h, k / count, q0, v0)
        if status == OK:
            status = write_node(c, c, m, run, t, h, (k + 1) / count, q1, v1)
        if status != OK:
            break
        share = first_change(m, q0, v0, q1, v1, h / count)
        if share < 1.0:
            return min(first, (k + share) / count), touches
    return first, touches


@subkernel
def _accelerations(c, m, t, q, v, z, out):
    take_states(c.top, c.w, z)
    prepare(c.top, c.w, t, q)
    return solve_accelerations(c.top, c.w, c.solver, q, v, out, m.lam, True)


@separate
def _meets_contact(c, m, t, h):
    """Return whether the velocities after a step from a touch agree with the accelerations at its ends.

    They do not if the only stage that meets the contact is one without weight, such as the second one of DOPRI5, from
    which all others are thrown out of the contact. A force that grows with time to the power p changes velocities by
    ``h / (1 + p)`` times its last value.
    """
    for d in range(len(m.z)):
        m.z[d] = c.from_z[d] + c.dz[d]
    status = _accelerations(c, m, t, c.from_q, c.from_v, c.from_z, m.free)
    if status == OK:
        status = _accelerations(c, m, t + h, m.q, m.v, m.z, m.a)
    changed, expected = 0.0, 0.0
    for d in range(len(m.q) - 3):
        mass = c.top.mass[d // 3, d % 3]
        own, last = c.dv[d] - h * m.free[d], h * (m.a[d] - m.free[d])
        changed, expected = changed + mass * own * own, expected + mass * last * last
    return status != OK or changed >= LEAST_CHANGE * LEAST_CHANGE * expected


@entry
def look(run, method, t, h, unused):
    """Return `SHORTER` if a contact begins or ends within the last attempt, after writing the size of the part of the
    step before; see `mbdkit.integrators.loop.step_loop`.
    """
    c = load_run_state(run)
    m = load_events(c.w.reacting.elements[0])
    m.inner[0] = method
    share, touches = _change_in_step(c, m, run, t, h)
    if touches and not _meets_contact(c, m, t, h):
        share = min(share, SHORTER_FROM_TOUCH)
    size, same = share * h, SAME_PART * max(abs(t), h)
    if size >= h - max(SAME_WAY * h, 2.0 * same) or size <= same:
        return OK
    c.progress.tried_size[0] = size + same
    return SHORTER


@kernel
def change_at(method: int, q0: RealVector, v0: RealVector, q1: RealVector, v1: RealVector, h: float) -> float:
    """See `first_change`."""
    return first_change(load_events(method), q0, v0, q1, v1, h)
