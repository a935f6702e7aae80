"""Steps of compiled methods between events of rigid contacts, and the events.

Contacts are open, stick or slip. Between events, closed contacts are constraints of the accelerations, and those that
slip have the friction force -mu N against the slip (`mbdkit_contact.kernels.contact_modes.react`). Events are zeros of
functions of the state: a gap that closes, a normal force that vanishes, a friction force that reaches its limit, slip
that ends, and the end of an edge of a polygon. A step ends at its first event, which is located by steps of the method
itself. The next step begins with the event: a linear complementarity problem determines the new modes, and at an impact
also the impulses.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from mbdkit.engine.kernels.bundle_types import RealCube, RealMatrix, RealVector
from mbdkit.engine.kernels.engine_bundles import load_engine
from mbdkit.engine.kernels.interpolation import fade, hermite
from mbdkit.engine.kernels.system import NOT_FINITE, OK
from mbdkit.engine.kernels.vectors import copy, fill
from mbdkit.engine.native.calls import call_entry
from mbdkit.engine.native.functions import entry, kernel, separate, subkernel
from mbdkit.integrators.interface import SAME_INSTANT
from mbdkit.integrators.loop.step_loop import PAUSED, REFUSED
from mbdkit.integrators.run.run_state import AT_END_OF_LAST, AT_START_OF_LAST, MODIFIED, RHS, load_run_state
from mbdkit.integrators.run.step_guards import begin_energy
from mbdkit_contact.kernels.contact_events import book_energy, close, drift, happen, is_nearly_closed, limited
from mbdkit_contact.kernels.contact_modes import (
    add_forces,
    any_closed,
    decide_at_rest,
    find_accelerations,
    find_limits,
    find_rates,
    find_rows,
    find_values,
    friction_value,
    note_forces,
    rate_of_gap,
    share_forces,
    show_forces,
    switch,
    use_modes,
)
from mbdkit_contact.kernels.event_bundle import FRICTION, MORE_ROOM, NORMAL, PAINLEVE, PLACE, UNKNOWN, ZENO, load_events
from mbdkit_contact.kernels.event_search import (
    add_sample,
    add_samples,
    asks_for_decision,
    begin_search,
    is_above,
    needs_forces,
    next_place,
    note_value,
    release_sticking,
)
from mbdkit_contact.kernels.first_touch import find_near, find_rebounds, find_touches, set_piece
from mbdkit_contact.kernels.kinematics import find_margins, place
from mbdkit_contact.modes import OPEN, STICK

MOST_EVENTS = 1000  #: The run stops after this many consecutive events without a complete step.
SAMPLES = 8  #: Number of places in a step, the last one at its end, at which places on edges are evaluated.
#: Largest angle by which a body turns between two such places [rad], up to this number of places.
TURN, MOST_SAMPLES = 0.5, 1000.0
#: Least value of a force or slip, relative to its change between the stages of a step, that does not vanish within it.
#: From the last stage of gauss-2 to the end, a linear function changes by a third of its change between the stages.
FAR = 3.0
#: Error of the cubics that stand for the motion in a step, relative to the length of the mechanism, up to this number
#: of cubics.
SAME_PLACE, MOST_PIECES = 1e-8, 40.0
#: Forces of contacts at the stages of a step that the others predict up to this share of the largest one, or of the
#: limit of friction, do not exceed their limits unseen between the stages.
RESOLVED = 0.01
FAR_AWAY = 0.25  #: The same share of the distance from these limits.
JUMP = 1e-4  #: Share of the size of the last resolved step from which on steps are not resolved further.
WHOLE = 1.0 - 1e-12  #: Share of a step from which on an event counts as one at its end.
SAME_SHARE = 1e-9  #: Times that differ by less than this share of a step are equal.


@subkernel
def copy_rows(x, out):
    """Copy event functions (3, C)."""
    for kind in range(3):
        copy(x[kind], out[kind])


@subkernel
def _take_point(c, m, t):
    """Take the state of the run as the point, without the forces of contacts."""
    m.t[0] = t
    copy(c.q, m.q)
    copy(c.v, m.v)
    copy(c.z, m.z)
    for k in range(m.places[1]):
        m.z[m.places[0] + k] = 0.0


@subkernel
def _show(m, row):
    """Write forces and modes of contacts as the states that a row has to ``shown``."""
    known, count, out = m.known, len(m.known.modes), m.known.shown[row]
    for i in range(count):
        out[3 * i], out[3 * i + 1], out[3 * i + 2] = known.normal[i], known.tangent[i], abs(known.modes[i])
    for i in range(len(m.coordinates)):
        out[3 * count + i] = known.force[m.coordinates[i]]


@separate
def _show_inside(e, c, m, t):
    """Write forces and modes of contacts at the point of dense output, at the time `t`, to its states; return a status.

    Forces follow from the motion there. A polynomial through those at both ends of a long step would not have its
    accuracy.
    """
    known, shapes = m.known, m.closed.shapes
    m.t[0], m.ended[0] = t, 0
    copy(c.point_q, m.q)
    copy(c.point_v, m.v)
    copy(c.point_z, m.z)
    for k in range(m.places[1]):
        m.z[m.places[0] + k] = 0.0
    fill(m.normal, 0.0)
    fill(m.tangent, 0.0)
    find_rows(m)
    if any_closed(m):
        copy(known.basis, m.basis)  # the next step does not depend on whether states within this one are evaluated
        copy(known.shares, m.shares)
        c.counts[RHS] += 1
        status = find_accelerations(e, m)
        copy(m.basis, known.basis)
        copy(m.shares, known.shares)
        if status == OK:
            status = share_forces(e, m)
        if status != OK:
            return _status(m, status)
    add_forces(m, m.x)
    for i in range(len(known.modes)):
        k = m.places[0] + 3 * i
        c.point_z[k], c.point_z[k + 1], c.point_z[k + 2] = m.normal[i], m.tangent[i], abs(known.modes[i])
    for i in range(len(m.coordinates)):
        c.point_z[m.places[0] + 3 * len(shapes.contacts) + i] = m.x[m.coordinates[i]]
    return OK


@subkernel
def _store_shown(c, m):
    """Write forces and modes of contacts at the start of the step to the state of the run."""
    for k in range(m.places[1]):
        c.z[m.places[0] + k], c.z_low[m.places[0] + k] = m.known.shown[0, k], 0.0


@separate
def _change_state(e, c, m, t, kind, contact):
    """Apply an event to the state of the run at the start of a step; return a status, or `PAUSED` if that is asked for.

    If `kind` is negative, the modes are determined anew.
    """
    known = m.known
    _take_point(c, m, t)
    m.ended[0] = 0
    status = happen(e, m, kind, contact)
    c.counts[RHS] += 1
    if status == OK:
        status = show_forces(e, m)
    if status != OK:
        return _status(m, status)
    known.determined[0], known.determined[1], known.event[0] = 1, 1, 0
    _show(m, 0)
    for d in range(len(m.v)):
        if m.v[d] != c.v[d]:
            c.v[d], c.v_low[d] = m.v[d], 0.0
    _store_shown(c, m)
    copy(c.v, c.from_v)
    c.energy[0] += m.gained[0]
    c.energy[1] += m.gained[1]
    begin_energy(c, c.guards, t, c.q, c.v)
    c.base_state[0] = MODIFIED
    return PAUSED if m.pauses[0] != 0 else OK


@separate
def _begin(e, c, m, t, h):
    """Prepare a step, with the event at its start; return a status."""
    use_modes(m)
    known, is_due = m.known, False
    for d in range(len(m.q)):
        if m.q[d] != c.q[d] or m.v[d] != c.v[d]:
            m.ended[0] = 0
    _take_point(c, m, t)
    book_energy(e, m)
    if known.event[0] > 0:
        # not if the step that ended there was rejected
        is_due = abs(t - known.until[0]) <= SAME_SHARE * h + SAME_INSTANT * max(abs(t), 1.0)
        if not is_due:
            known.event[0] = 0
    if known.determined[0] == 0:
        return _change_state(e, c, m, t, -1, 0)
    if is_due:
        status = _change_state(e, c, m, t, known.event[0] - 1, known.event[1])
        known.streak[0] += known.event[0] == 0
        return status
    for k in range(m.places[1]):
        known.shown[0, k] = c.z[m.places[0] + k]
    return OK


@subkernel
def _begin_values(e, c, m, t):
    """Write the event functions at the start of the step; return a status."""
    if m.ended[0] == 0:
        _take_point(c, m, t)
        find_rows(m)
    status = find_values(e, m, False)
    for i in range(len(m.known.modes)):
        mode = m.known.modes[i]
        m.pace[i] = abs(rate_of_gap(m, i, 2, m.v)) if mode == OPEN else abs(m.rows[i, 1])
        for kind in range(3):
            m.begin[kind, i] = m.values[kind, i]
        if mode != OPEN:
            normal, tangent = m.known.shown[0, 3 * i], m.known.shown[0, 3 * i + 1]
            m.begin[NORMAL, i] = normal
            m.begin[FRICTION, i] = friction_value(m, i, m.rows[i, 1], normal, tangent)
    return status


@subkernel
def _status(m, status):
    """Return `REFUSED` for a failure that smaller steps do not avoid."""
    return REFUSED if status == NOT_FINITE and m.reason[0] == PAINLEVE else status


@separate
def _find_start(e, c, m, t):
    """Evaluate the forces at the start of the step, which the step before has left out; return a status."""
    _take_point(c, m, t)
    m.ended[0] = 0
    find_rows(m)
    c.counts[RHS] += any_closed(m)
    status = find_values(e, m, True)
    if status != OK:
        return status
    m.known.determined[1] = 1
    _show(m, 0)
    _store_shown(c, m)
    return _begin_values(e, c, m, t)


@separate
def _take(e, c, m, run, t, h, want_error):
    """Take a step of the method, whose end becomes the point, with closed joints and contacts, and evaluate the
    quantities of all contacts there; return a status.
    """
    known = m.known
    m.samples[0], m.samples[1], m.samples[2], m.reason[0], m.ended[0] = 0, 1, 0, 0, 0
    has_power = _has_power(m)
    c.has_power[0] = has_power
    switch(e, m, any_closed(m))
    status = call_entry(m.inner[1], run, m.inner[0], t, h, want_error)
    switch(e, m, 0)
    c.has_power[0] = 1
    if not has_power:
        fill(c.gain, 0.0)
    m.samples[1] = 0
    if status != OK:
        return _status(m, status)
    _sort_samples(m)
    c.base_state[0] = AT_START_OF_LAST
    m.t[0] = t + h
    for d in range(len(m.q)):  # as `mbdkit.integrators.run.run_state.add_increments` does
        m.q[d] = c.from_q[d] + (c.dq[d] + c.q_low[d])
        m.v[d] = c.from_v[d] + (c.dv[d] + c.v_low[d])
    for d in range(len(m.z)):
        m.z[d] = c.from_z[d] + c.dz[d]
    # a projection in every step would cost as much as a stage; drift of a few rounding errors is left to later steps
    m.ended[1] = not is_nearly_closed(e, m)
    if m.ended[1] == 0:
        fill(known.shift_q, 0.0)
        fill(known.shift_v, 0.0)
        return OK
    copy(m.q, known.shift_q)
    copy(m.v, known.shift_v)
    status = close(e, m)
    for d in range(len(m.q)):
        known.shift_q[d] = m.q[d] - known.shift_q[d]
        known.shift_v[d] = m.v[d] - known.shift_v[d]
    find_rows(m)
    return _status(m, status)


@separate
def _find_within(e, c, m, run, t, h, theta):
    """Write the state within the last step by dense output of the method; return a status.

    The correction of the end of the step is blended in by a cubic of theta.
    """
    m.ended[0] = 0
    switch(e, m, any_closed(m))
    status = call_entry(m.inner[2], run, m.inner[0], t, h, theta)
    switch(e, m, 0)
    share = fade(theta)
    for d in range(len(m.q)):
        c.point_q[d] += share * m.known.shift_q[d]
        c.point_v[d] += share * m.known.shift_v[d]
    return status


@subkernel
def _has_power(m):
    return m.power[0] != 0 or any_closed(m)


@subkernel
def _places(c, m, h):
    """Return the number of places within a step, and at its end, at which the motion is sampled."""
    fastest = 0.0
    for d in range(2, len(m.v), 3):
        fastest = max(fastest, abs(c.from_v[d]), abs(m.v[d]))
    return max(SAMPLES, int(min(h * fastest / TURN, MOST_SAMPLES)))


@subkernel
def _interpolate(c, m, h, theta, q, v):
    """Write positions and velocities of the cubic through both ends of a step."""
    for d in range(len(m.q)):
        q[d], v[d] = hermite(theta, h, c.from_q[d], m.q[d] - c.from_q[d], c.from_v[d], m.v[d])


@subkernel
def write_node(e, c, m, run, t, h, theta, q, v):
    """Write the state within a step by dense output, or at one of its ends; return a status."""
    if theta == 0.0 or theta == 1.0:
        copy(c.from_q if theta == 0.0 else m.q, q)
        copy(c.from_v if theta == 0.0 else m.v, v)
        return OK
    status = _find_within(e, c, m, run, t, h, theta)
    copy(c.point_q, q)
    copy(c.point_v, v)
    return status


@separate
def pieces(e, c, m, run, t, h):
    """Return into how many cubics the motion of a step is divided, with which their error is below `SAME_PLACE`; also a
    status.
    """
    # without dense output, the motion within a step is by definition the cubic through both ends
    if m.inner[2] == 0:
        return 1, OK
    status = _find_within(e, c, m, run, t, h, 0.5)
    _interpolate(c, m, h, 0.5, m.x, m.y)
    error = 0.0
    for d in range(len(m.q) - 3):
        error = max(error, abs(c.point_q[d] - m.x[d]) * (m.limits[1] if d % 3 == 2 else 1.0))
    return max(1, int(min(sqrt(sqrt(error / (SAME_PLACE * m.limits[1]))) + 1.0, MOST_PIECES))), status


@subkernel
def _may_touch(c, m, h):
    """Return whether open contacts may close within a step whose end is the point; see `find_near`."""
    set_piece(m, c.from_q, c.from_v, m.q, m.v, h)
    for i in range(len(m.gaps)):
        m.gaps[i] = m.rows[i, 0]
    return find_near(m, m.begin[NORMAL], m.gaps)


@separate
def _search_touches(e, c, m, run, t, h):
    """Search for the first touches of open contacts within a step whose end is the point; return whether there are any,
    or whether this is unknown of a part of the step, and a status.

    Requires `begin_search` and `_may_touch`.
    """
    for i in range(len(m.gaps)):
        m.search.level[i] = min(m.begin[NORMAL, i], 0.0)
    count, status = pieces(e, c, m, run, t, h)
    q0, v0, q1, v1 = m.touch.nodes[0], m.touch.nodes[1], m.touch.nodes[2], m.touch.nodes[3]
    any_touches = False
    for k in range(count):
        if status == OK:
            status = write_node(e, c, m, run, t, h, k / count, q0, v0)
        if status == OK:
            status = write_node(e, c, m, run, t, h, (k + 1) / count, q1, v1)
        if status != OK or any_touches:
            break
        set_piece(m, q0, v0, q1, v1, h / count)
        any_touches = find_touches(m, k / count, 1.0 / count)
    place(m.closed.shapes, m.q, m.v)
    return any_touches or m.search.first[0] < np.inf, status


@separate
def _is_apart(e, c, m, run, t, h):
    """Return whether no open contact closes within a step whose end is the point, and a status."""
    if not _may_touch(c, m, h):
        return True, OK
    begin_search(m, h)
    any_touches, status = _search_touches(e, c, m, run, t, h)
    for i in range(len(m.known.modes)):
        any_touches |= m.known.modes[i] == OPEN and m.rows[i, 0] < m.search.level[i]
    return not any_touches, status


@subkernel
def _stays_on_features(c, m, h):
    """Return whether no contact can leave its edge within a step whose end is the point."""
    for i in range(len(m.known.modes)):
        if m.known.modes[i] != OPEN and m.closed.shapes.held[i] >= 0:
            if _places(c, m, h) > SAMPLES:  # rates at both ends say little about bodies that turn so far
                return False
            if min(m.begin[PLACE, i], m.values[PLACE, i]) <= h * (m.pace[i] + abs(m.rows[i, 1])):
                return False
    return True


@subkernel
def _sampled(m, j, kind, i):
    """Return the event function of a force or a slip in sample `j`."""
    sample = m.sample_values[j]
    return sample[0, i] if kind == NORMAL else friction_value(m, i, sample[2, i], sample[0, i], sample[1, i])


@subkernel
def _keeps_mode(m, i):
    """Return whether forces and slip of a closed contact are so far from zero, at the stages of a step whose end is the
    point, that they do not vanish within the step.
    """
    if m.samples[0] < 2 or m.samples[2] == 2:
        return False
    for kind in range(2):
        low = high = _sampled(m, 0, kind, i)
        for j in range(1, m.samples[0]):
            value = _sampled(m, j, kind, i)
            low, high = min(low, value), max(high, value)
        if kind == FRICTION and m.known.modes[i] != STICK:
            value = friction_value(m, i, m.rows[i, 1], 0.0, 0.0)
            low, high = min(low, value), max(high, value)
        if not low > FAR * (high - low):
            return False
    return True


@separate
def _is_quiet(c, m, h):
    """Return whether no closed contact has an event within a step whose end is the point.

    If redundant contacts had to be closed, independent ones are chosen anew.
    """
    # after a correction, the forces at the stages belong to other independent contacts
    if m.ended[1] != 0 and m.samples[2] != 0:
        return False
    for i in range(len(m.known.modes)):
        if m.known.modes[i] != OPEN and not _keeps_mode(m, i):
            return False
    return _stays_on_features(c, m, h)


@separate
def _end_quietly(e, c, m, shows):
    """End a step without events, with the forces at its end, or those at its last stage where no row shows them; return
    a status.
    """
    known, has_closed = m.known, any_closed(m)
    known.determined[1] = shows or not has_closed
    m.ended[0] = m.ended[1] == 0
    if not has_closed:
        return OK
    if shows:
        c.counts[RHS] += 1
        return find_values(e, m, True)
    last = max(m.samples[0] - 1, 0)
    for i in range(len(known.modes)):
        is_closed = known.modes[i] != OPEN
        m.normal[i] = m.sample_values[last, 0, i] if is_closed else 0.0
        m.tangent[i] = m.sample_values[last, 1, i] if is_closed else 0.0
    note_forces(m)
    return OK


@separate
def _sample_features(c, m, h):
    """Add samples of places on edges within the step."""
    count = _places(c, m, h)
    for k in range(1, count):
        _interpolate(c, m, h, k / count, m.x, m.y)
        place(m.closed.shapes, m.x, m.y)
        find_margins(m.closed.shapes, m.values[PLACE])
        for i in range(len(m.known.modes)):
            add_sample(m, PLACE, i, k / count, m.values[PLACE, i])


@separate
def _sort_samples(m):
    """Sort the samples of contact forces by time: stages need not be in this order."""
    for k in range(1, m.samples[0]):
        j = k
        while j > 0 and m.sample_times[j - 1] > m.sample_times[j]:
            m.sample_times[j - 1], m.sample_times[j] = m.sample_times[j], m.sample_times[j - 1]
            for kind in range(3):
                for i in range(len(m.known.modes)):
                    before = m.sample_values[j - 1, kind, i]
                    m.sample_values[j - 1, kind, i] = m.sample_values[j, kind, i]
                    m.sample_values[j, kind, i] = before
            j -= 1


@separate
def _sample_forces(m, t, h):
    """Add samples of contact forces, slips and limits of friction, at the stages of the method."""
    for j in range(m.samples[0] if m.samples[2] != 2 else 0):
        share = (m.sample_times[j] - t) / h
        if 0.0 < share < 1.0:
            for i in range(len(m.known.modes)):
                if m.known.modes[i] != OPEN:
                    add_sample(m, NORMAL, i, share, _sampled(m, j, NORMAL, i))
                    add_sample(m, FRICTION, i, share, _sampled(m, j, FRICTION, i))


@separate
def _surprise(m, t, kind, i, scale):
    """Return the largest error with which samples of an event function predict those between them, relative to what is
    small compared with `scale`, or with the least sample.

    A sample is predicted by the polynomial through at most two samples on either side. The value at the start of the
    step, if it is known, is one of them.
    """
    worst, least, n = 0.0, np.inf, m.samples[0]
    is_known = m.known.determined[1] != 0 and m.samples[2] == 0  # redundant contacts share forces in another way there
    first = -1 if is_known and n > 0 and m.sample_times[0] > t else 0
    for j in range(n):
        value, predicted = _sampled(m, j, kind, i), 0.0
        least = min(least, value)
        if not first < j < n - 1:
            continue
        for k in range(max(first, j - 2), min(n, j + 3)):
            if k == j:
                continue
            at, weight = t if k < 0 else m.sample_times[k], 1.0
            for x in range(max(first, j - 2), min(n, j + 3)):
                if x not in (j, k):
                    other = t if x < 0 else m.sample_times[x]
                    weight *= (m.sample_times[j] - other) / (at - other)
            predicted += weight * (m.begin[kind, i] if k < 0 else _sampled(m, k, kind, i))
        worst = max(worst, abs(predicted - value))
    return worst / max(RESOLVED * scale, FAR_AWAY * least)


@separate
def _unresolved(m, t, h):
    """Return by how much the forces of closed contacts vary more than the samples in a step resolve; at most 1 if they
    are resolved, or if that needs much smaller steps than before, as where a load jumps.
    """
    worst = 0.0
    for i in range(len(m.known.modes)):
        mode, largest = m.known.modes[i], 0.0
        for j in range(m.samples[0] if mode != OPEN and m.samples[2] != 2 else 0):
            largest = max(largest, abs(m.sample_values[j, 0, i]))
        if largest > 0.0:
            worst = max(worst, _surprise(m, t, NORMAL, i, largest))
            if mode == STICK and m.coefficients[i, 1] > 0.0:
                worst = max(worst, _surprise(m, t, FRICTION, i, m.coefficients[i, 1] * largest))
    if worst <= 1.0:
        m.known.until[1] = h
    return 0.0 if h < JUMP * m.known.until[1] else worst


@subkernel
def _estimate_forces(c, m, t, h):
    """Let step-size control resolve the forces of contacts: the motion of a body at rest says nothing about them."""
    d, worst = m.places[0], 0.0
    if any_closed(m):
        scale = m.limits[4] + m.limits[3] * max(abs(c.z[d]), abs(c.z[d] + c.dz[d]))
        worst = _unresolved(m, t, h) * scale * sqrt(2.0 * (len(c.q) - 3) + len(c.z))
    c.est_z[d] = c.second_z[d] = worst


@separate
def _begin_search(e, c, m, run, t, h):
    """Begin the search for the first event in a step whose end is the point; return a status."""
    c.counts[RHS] += any_closed(m)
    status = find_values(e, m, True)
    if status != OK:
        return status
    copy_rows(m.values, m.end)
    find_limits(e, m, m.search.limits)
    begin_search(m, h)
    stays = _stays_on_features(c, m, h)
    copy_rows(m.begin, m.values)
    add_samples(m, 0.0, m.pace)
    if not stays:
        _sample_features(c, m, h)
    if _may_touch(c, m, h):
        find_rebounds(m)
        status = _search_touches(e, c, m, run, t, h)[1]
        if status != OK:
            return status
    _sample_forces(m, t, h)
    copy_rows(m.end, m.values)
    find_rates(m, m.pace)
    add_samples(m, 1.0, m.pace)
    return release_redundant(e, m)


@separate
def release_redundant(e, m):
    """Ignore events of sticking contacts if all modes persist at the point; return a status."""
    if not asks_for_decision(m):
        return OK
    for i in range(len(m.touching)):  # modes that persist at the end say nothing about the step before
        if m.known.modes[i] == STICK and min(m.search.high[NORMAL, i], m.search.high[FRICTION, i]) < 1.0:
            return OK
    fill(m.sliding, 0.0)
    for i in range(len(m.touching)):
        m.touching[i] = m.known.modes[i] != OPEN
    status = decide_at_rest(e, m)
    if status != OK:
        return status
    for i in range(len(m.modes)):
        if m.modes[i] != m.known.modes[i]:
            return OK
    release_sticking(m)
    return OK


@separate
def _advance(e, c, m, run, t, h, want_error):
    """Take a step, or its part up to the first event; return a status, the size of the part, and whether there is an
    event.
    """
    known, shows = m.known, e.w.reacting.shows[0] != 0
    status = _find_start(e, c, m, t) if shows and known.determined[1] == 0 else OK
    if status == OK:
        status = _take(e, c, m, run, t, h, want_error)
    if status != OK:
        return status, h, False
    find_margins(m.closed.shapes, m.values[PLACE])
    if _is_quiet(c, m, h):
        is_apart, status = _is_apart(e, c, m, run, t, h)
        if status != OK or m.search.event[0] == UNKNOWN:
            return _status(m, status), h, False
        if is_apart:
            return _end_quietly(e, c, m, shows), h, False
    if known.determined[1] == 0:
        status = _find_start(e, c, m, t)
        if status == OK:
            status = _take(e, c, m, run, t, h, want_error)
    known.determined[1] = 1
    if status == OK:
        status = _begin_search(e, c, m, run, t, h)
    if status != OK or m.search.event[0] == UNKNOWN:
        return status, h, False
    # every place of the search is the end of a shorter step, so that an event has the accuracy of the method, not
    # that of its dense output
    x, is_at_end = m.search, True
    while True:
        share = next_place(m)
        if share < 0.0:
            break
        is_at_end = share == 1.0
        status = _take(e, c, m, run, t, share * h, 0.0)
        if status == OK:
            has_forces = needs_forces(m)
            c.counts[RHS] += has_forces
            status = find_values(e, m, has_forces)
        if status == OK and is_above(m):
            c.counts[RHS] += 1
            status = find_accelerations(e, m)
        if status != OK:
            return status, h, False
        note_value(m)
    has_event = x.event[0] >= 0
    size = h
    if x.first[0] < WHOLE and (has_event or t + x.first[0] * h > t):
        size = x.first[0] * h
    # the last place that was examined need not be the event: the step to the event itself is taken again
    if size != h or not is_at_end:
        if t + size > t:
            status = _take(e, c, m, run, t, size, want_error)
            if status == OK:
                c.counts[RHS] += any_closed(m)
                status = find_values(e, m, True)
        else:
            size = 0.0
    return status, size, has_event


@entry
def attempt(run, method, t, h, want_error):
    """Compute a step from the base state, or the part of it before an event; see
    `mbdkit.integrators.loop.step_loop`.
    """
    c, m = load_run_state(run), load_events(method)
    e = load_engine(m.engine[0])
    e.w.reacting.run[0] = run
    known = m.known
    if c.base_state[0] == AT_END_OF_LAST:
        for d in range(len(m.q)):
            if known.shift_q[d] != 0.0 or known.shift_v[d] != 0.0:
                c.base_state[0] = MODIFIED
    status = _begin(e, c, m, t, h)
    longest, size, has_event = h, h, False
    while status == OK:
        for k in range(m.places[1]):
            c.from_z[m.places[0] + k] = 0.0
        status = _begin_values(e, c, m, t)
        if status == OK:
            size, status = limited(e, m, longest)
        if status != OK:
            break
        m.search.event[0] = -1
        status, size, has_event = _advance(e, c, m, run, t, size, want_error)
        if status == OK and m.search.event[0] == UNKNOWN:
            longest = size * m.search.first[0]
            continue
        if status != OK or size > 0.0 or not has_event:
            break
        known.streak[0] += 1  # the event is at the start of the step, which is then taken again
        if known.streak[0] > MOST_EVENTS:
            m.reason[0] = ZENO
            return REFUSED
        kind, contact = m.search.event[0], m.search.event[1]
        status = _change_state(e, c, m, t, kind, contact)
        if status == PAUSED and m.reason[0] == MORE_ROOM:  # the next attempt begins with the event
            known.event[0], known.event[1], known.until[0] = kind + 1, contact, t
    if status != OK:
        return _status(m, status)
    if not has_event:
        known.streak[0] = 0
    else:
        known.event[0], known.event[1], known.until[0] = m.search.event[0] + 1, m.search.event[1], t + size
    if known.streak[0] > MOST_EVENTS:
        m.reason[0] = ZENO
        return REFUSED
    if h - size > SAME_INSTANT * max(abs(t + h), 1.0):  # otherwise, nothing would remain of the step
        c.progress.part[0] = size
    _show(m, 1)
    for d in range(len(m.q)):
        c.dq[d] += known.shift_q[d]
        c.dv[d] += known.shift_v[d]
    for k in range(m.places[1]):
        d = m.places[0] + k
        c.dz[d], c.z_low[d] = known.shown[1, k] - c.z[d], 0.0
    if want_error != 0.0 and m.places[1] > 0:
        _estimate_forces(c, m, t, size)
    return OK


@entry
def dense(run, method, t, h, theta):
    """Write the state at ``t + theta h`` within the last attempt; see `mbdkit.integrators.loop.step_loop`.

    Forces of contacts follow from the motion there.
    """
    c, m = load_run_state(run), load_events(method)
    e = load_engine(m.engine[0])
    status = _find_within(e, c, m, run, t, h, theta)
    if not _has_power(m):
        fill(c.point_gain, 0.0)
    return _show_inside(e, c, m, t + theta * h) if status == OK else status


@entry
def keep(run, method, t, h, unused):
    """Store the stages of the last attempt as quadrature nodes; see `mbdkit.integrators.loop.step_loop`."""
    m = load_events(method)
    return call_entry(m.inner[3], run, m.inner[0], t, h, 0.0)


# ---- calls from Python, for methods whose steps are taken there ------------------------------------------------------


@kernel
def happen_at(engine: int, method: int, kind: int, contact: int) -> int:
    """Apply an event to the point, and evaluate the forces there; if `kind` is negative, determine the modes anew."""
    e, m = load_engine(engine), load_events(method)
    m.reason[0] = 0
    use_modes(m)
    status = happen(e, m, kind, contact)
    if status == OK:
        m.known.determined[0] = 1
        status = show_forces(e, m)
    return _status(m, status)


@kernel
def forces_at(engine: int, method: int) -> int:
    """Evaluate accelerations, multipliers and the forces of contacts at the point; return a status."""
    e, m = load_engine(engine), load_events(method)
    m.reason[0] = 0
    use_modes(m)
    return _status(m, show_forces(e, m))


@kernel
def close_at(engine: int, method: int) -> int:
    """Close joints and contacts at the point; return a status."""
    e, m = load_engine(engine), load_events(method)
    m.reason[0] = 0
    use_modes(m)
    return close(e, m)


@kernel
def drift_at(engine: int, method: int) -> float:
    """Return the largest gap of joints and closed contacts at the point [m, rad]."""
    e, m = load_engine(engine), load_events(method)
    use_modes(m)
    return drift(e, m)


@kernel
def limited_at(engine: int, method: int, h: float) -> tuple[float, int]:
    """Note the kinetic energy at the point; return a step size, and a status; see `limited`."""
    e, m = load_engine(engine), load_events(method)
    m.reason[0] = 0
    use_modes(m)
    book_energy(e, m)
    find_rows(m)
    return limited(e, m, h)


@kernel
def values_at(engine: int, method: int) -> int:
    """Evaluate the event functions, and the rates ``m.pace`` of the gaps, at the point; return a status."""
    e, m = load_engine(engine), load_events(method)
    m.reason[0] = 0
    use_modes(m)
    find_rows(m)
    status = find_values(e, m, True)
    find_rates(m, m.pace)
    return _status(m, status)


@kernel
def begin_search_at(
    engine: int,
    method: int,
    h: float,
    shares: RealVector,
    samples: RealCube,
    rates: RealMatrix,
    q: RealMatrix,
    v: RealMatrix,
) -> int:
    """Begin the search for the first event of a step of size `h` whose end is the point, with samples (L, 3, C) of the
    event functions, the rates (L, C) of the gaps, and positions and velocities (L, N), at shares (L,) of the step from
    0 to 1; return a status.
    """
    e, m = load_engine(engine), load_events(method)
    m.reason[0] = 0
    status = find_accelerations(e, m)
    if status != OK:
        return _status(m, status)
    find_limits(e, m, m.search.limits)
    begin_search(m, h)
    copy_rows(samples[0], m.values)
    add_samples(m, 0.0, rates[0])
    last = len(shares) - 1
    m.samples[0], m.samples[2] = min(len(shares), len(m.sample_times)), 0
    for j in range(m.samples[0]):
        m.sample_times[j] = shares[j] * h
        for i in range(len(m.known.modes)):
            normal = samples[j, NORMAL, i]
            m.sample_values[j, 0, i] = normal
            m.sample_values[j, 1, i] = m.coefficients[i, 1] * normal - samples[j, FRICTION, i]
    if any_closed(m) and _unresolved(m, 0.0, h) > 1.0:
        m.search.first[0], m.search.event[0] = 0.5, UNKNOWN
        return OK
    set_piece(m, q[0], v[0], q[last], v[last], h)
    copy(samples[last, NORMAL], m.gaps)
    if find_near(m, samples[0, NORMAL], m.gaps):
        find_rebounds(m)
    for j in range(1, len(shares)):
        part = shares[j] - shares[j - 1]
        set_piece(m, q[j - 1], v[j - 1], q[j], v[j], part * h)
        is_near = find_near(m, samples[j - 1, NORMAL], samples[j, NORMAL])
        if is_near and find_touches(m, shares[j - 1], part):
            break
    for j in range(1, len(shares)):
        copy_rows(samples[j], m.values)
        add_samples(m, shares[j], rates[j])
    return _status(m, release_redundant(e, m))


@kernel
def search_at(method: int, has_value: bool) -> float:
    """Use the event functions in ``m.values``, if there are any, and return the next place; see `next_place`."""
    m = load_events(method)
    if has_value:
        note_value(m)
    return next_place(m)
