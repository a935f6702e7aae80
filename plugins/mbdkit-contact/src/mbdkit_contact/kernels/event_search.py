"""Search for the first event in a step: the first zero of the event functions of all contacts.

Samples of the event functions within the step show which of them become negative, or may be negative between two
samples. For the gaps of open contacts, `mbdkit_contact.kernels.first_touch` shows this instead, so that none is missed.
Each of these functions is then evaluated at more places, until the place of its zero is known. The search does not take
steps itself: it asks for one place after another, so that methods in machine code and in Python use the same search.

A gap that is negative at the start of the step, by rounding errors, has an event if it becomes smaller than there. As
long as no gap was positive, only shapes that approach each other are about to touch; later, all that overlap.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.vectors import fill
from mbdkit.engine.native.functions import separate, subkernel
from mbdkit_contact.kernels.contact_modes import rate_of_gap
from mbdkit_contact.kernels.event_bundle import NORMAL, PLACE
from mbdkit_contact.modes import OPEN, STICK

#: Phases: choose the next function; look for a positive value of a function that starts at zero; evaluate the function
#: where it is negative, and before; narrow the bracket of a zero.
NEXT, RISE, HIGH, LOW, ROOT = range(5)
#: Largest number of places, each a tenth of the one before, at which a function that starts at zero is evaluated. It
#: may be slip that begins just before the contact opens, for example.
MOST_RISES = 5
MOST_DIPS = 5  #: Largest number of places at which a gap is evaluated to find its minimum.
MOST_EVALUATIONS = 60  #: Largest number of evaluations in a bracket; about ten are usual.
NARROW = 8.9e-16  #: Width of a bracket, relative to its place in the step, that ends the search for a zero.


@separate
def begin_search(m, h):
    """Begin the search in a new step of size `h`."""
    x = m.search
    x.step[0], x.event[0] = h, -1
    fill(x.level, 0.0)
    for kind in range(3):
        for i in range(len(m.touching)):
            x.best[kind, i, 0], x.best[kind, i, 1] = 0.0, -np.inf
            x.high[kind, i] = np.inf
            fill(x.last[kind, i], np.nan)
    x.state[0] = NEXT
    x.first[0] = np.inf


@subkernel
def is_open_gap(m, kind, i):
    """Return whether an event function is the gap of an open contact."""
    return kind == NORMAL and m.known.modes[i] == OPEN


@subkernel
def add_sample(m, kind, i, share, value):
    """Add a sample of an event function; shares must not decrease. Samples that are nan are ignored.

    After the first negative one, ``last`` has the place and the value of the least one.
    """
    x = m.search
    last = x.last[kind, i]
    if np.isnan(value):
        return
    if x.high[kind, i] < np.inf:
        if value < last[1]:
            last[0], last[1] = share, value
        return
    if value < -x.limits[kind, i] and share > 0.0:
        x.high[kind, i] = last[0] = share
        last[1] = value
        return
    if value > x.best[kind, i, 1]:
        x.best[kind, i, 0], x.best[kind, i, 1] = share, value
    s0, f0, s1, f1 = last[0], last[1], last[2], last[3]
    if f1 < f0 and f1 < value and f1 > 0.0 and s0 < s1 < share:  # nan compares as false
        # the parabola through three samples may have a negative minimum between them
        left, right = (f1 - f0) / (s1 - s0), (value - f1) / (share - s1)
        curve = (right - left) / (share - s0)
        slope = left + curve * (s1 - s0)
        lowest = s1 - 0.5 * slope / curve
        if f1 - 0.25 * slope * slope / curve < -x.limits[kind, i] and s0 < lowest < share:
            x.high[kind, i] = last[0] = lowest
            last[1] = 0.0
            if lowest <= s1:
                x.best[kind, i, 0], x.best[kind, i, 1] = s0, f0
            return
    if s1 != share:
        last[0], last[1] = s1, f1
    last[2], last[3] = share, value


@subkernel
def _leaves(m, i, gap, rate):
    """Return whether a gap is only negative because the contact has just opened."""
    return gap < 0.0 and rate >= 0.0 and not m.search.best[NORMAL, i, 1] > 0.0


@subkernel
def add_samples(m, share, rates):
    """Add the samples in ``m.values`` of all event functions; those of gaps, whose rates are `rates` (C,), only at both
    ends of the step.
    """
    level = m.search.level
    for kind in range(3):
        for i in range(len(m.touching)):
            value = m.values[kind, i]
            if is_open_gap(m, kind, i):
                if share == 0.0:
                    level[i] = min(value, 0.0)
                value -= level[i]
                if 0.0 < share < 1.0 or _leaves(m, i, value, rates[i]):
                    continue
            add_sample(m, kind, i, share, value)


@separate
def release_sticking(m):
    """Ignore the functions of forces of contacts that stick: redundant contacts can share the forces differently."""
    for i in range(len(m.touching)):
        if m.known.modes[i] == STICK:
            m.search.high[0, i] = m.search.high[1, i] = np.inf


@subkernel
def asks_for_decision(m):
    """Return whether forces of contacts that stick indicate an event."""
    for i in range(len(m.touching)):
        if m.known.modes[i] == STICK and min(m.search.high[0, i], m.search.high[1, i]) < np.inf:
            return True
    return False


@subkernel
def _accept(x, share):
    """Take the zero of the function that is searched, and go on with the next function."""
    kind, i = x.state[1], x.state[2]
    x.high[kind, i] = np.inf
    x.state[0] = NEXT
    if share < x.first[0]:
        x.first[0], x.event[0], x.event[1] = share, kind, i


@subkernel
def _next_function(m):
    """Choose the function with the first negative sample that can have a zero before the first event found; return
    whether there is one.
    """
    x, least = m.search, np.inf
    for kind in range(3):
        for i in range(len(m.touching)):
            begins = x.best[kind, i, 0] if x.best[kind, i, 1] > 0.0 else 0.0
            if x.high[kind, i] < least and begins < x.first[0]:
                least = x.high[kind, i]
                x.state[1], x.state[2] = kind, i
    x.state[0], x.state[3] = HIGH, 0
    x.bracket[6] = least
    return least < np.inf


@subkernel
def _interpolated(b):
    """Return where to evaluate next, as a share of the bracket from its last point.

    T. R. Chandrupatla, Advances in Engineering Software 28:145-149, 1997: inverse quadratic interpolation where the
    function is so nearly linear that it is monotone, else bisection.
    """
    a, fa, other, fb, c, fc = b[0], b[1], b[2], b[3], b[4], b[5]
    if c == other or fc in (fb, fa):
        return 0.5
    xi, phi = (a - other) / (c - other), (fa - fb) / (fc - fb)
    if not (phi * phi < xi and (1.0 - phi) * (1.0 - phi) < 1.0 - xi):
        return 0.5
    t = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (other - a) * fa / (fc - fa) * fb / (fc - fb)
    return min(max(t, 1e-3), 1.0 - 1e-3)


@subkernel
def next_place(m):
    """Return the share of the step at which the event functions are to be evaluated; -1 if the search has ended.

    The first event is then in ``m.search``: its share is infinite if there is none.
    """
    x = m.search
    if x.state[0] == NEXT and not _next_function(m):
        return -1.0
    return x.bracket[6]


@subkernel
def needs_forces(m):
    """Return whether the function that is searched depends on the forces of contacts."""
    kind, i = m.search.state[1], m.search.state[2]
    mode = m.known.modes[i]
    return kind != PLACE and mode != 0 and (kind == 0 or mode == STICK)


@subkernel
def _value(m):
    kind, i = m.search.state[1], m.search.state[2]
    value = m.values[kind, i]
    if is_open_gap(m, kind, i):
        value -= m.search.level[i]
        if _leaves(m, i, value, rate_of_gap(m, i, 2, m.v)):
            value = -value
    return value


@subkernel
def is_above(m):
    """Return whether the gap of an open contact in ``m.values`` is positive where an approximate sample was negative.

    `note_value` requires the accelerations at this place.
    """
    return m.search.state[0] == HIGH and is_open_gap(m, m.search.state[1], m.search.state[2]) and _value(m) >= 0.0


@subkernel
def _follow_dip(m, i, value):
    """Go on to the minimum of a positive gap, or end the step here: what follows is examined from here on."""
    x = m.search
    share, rate, curve = x.bracket[6], rate_of_gap(m, i, 2, m.v), rate_of_gap(m, i, 2, m.a) - m.rows[i, 14]
    if x.state[3] < MOST_DIPS and curve > 0.0 and value - 0.5 * rate * rate / curve < -x.limits[NORMAL, i]:
        lowest = share - rate / (curve * x.step[0])
        if 0.0 < lowest <= 1.0:
            x.bracket[6] = lowest
            return
    x.state[0], x.high[NORMAL, i] = NEXT, np.inf
    if share < min(x.first[0], 1.0):
        x.first[0], x.event[0] = share, -1


@separate
def note_value(m):
    """Use the event function in ``m.values`` at the place that `next_place` has returned."""
    x = m.search
    b, kind, i = x.bracket, x.state[1], x.state[2]
    share, value, limit = b[6], _value(m), x.limits[kind, i]
    x.state[3] += 1
    if is_above(m):
        _follow_dip(m, i, value)
        return
    if x.state[0] == HIGH:
        if value >= 0.0:  # an approximate sample showed an event, but a step of the method does not
            x.best[kind, i, 0], x.best[kind, i, 1] = share, value
            x.state[0], x.high[kind, i] = NEXT, np.inf
            if share < 1.0 and x.state[3] < 3:  # redundant contacts may share the forces there, and not later
                x.state[0], least = HIGH, x.last[kind, i, 0]
                x.high[kind, i] = b[6] = least if share < least else 1.0
            return
        b[0], b[1] = share, value
        if x.best[kind, i, 1] > 0.0:
            x.state[0], b[6] = LOW, x.best[kind, i, 0]
            if b[6] == 0.0:
                x.state[0], x.state[3] = ROOT, 0
                b[2], b[3] = 0.0, x.best[kind, i, 1]
                _bracket(m)
            return
        x.state[0], x.state[3], b[6] = RISE, 0, 0.1 * share
        return
    if x.state[0] == RISE:
        if value > limit:
            x.state[0], x.state[3] = ROOT, 0
            b[2], b[3] = share, value
            _bracket(m)
        elif x.state[3] == MOST_RISES:
            _accept(x, 0.0)
        else:
            b[6] = 0.1 * share
        return
    if x.state[0] == LOW:
        if value <= 0.0:  # the approximate sample was wrong
            b[0], b[1], b[6] = share, value, 0.1 * share
            x.state[0], x.state[3] = RISE, 0
            return
        x.state[0], x.state[3] = ROOT, 0
        b[2], b[3] = share, value
        _bracket(m)
        return
    if (value > 0.0) == (b[1] > 0.0):
        b[4], b[5] = b[0], b[1]
    else:
        b[4], b[5] = b[2], b[3]
        b[2], b[3] = b[0], b[1]
    b[0], b[1] = share, value
    _narrow(m)


@subkernel
def _bracket(m):
    b = m.search.bracket
    b[4], b[5] = b[2], b[3]
    if b[1] == 0.0 or b[3] == 0.0:
        _accept(m.search, b[0] if b[1] == 0.0 else b[2])
        return
    b[6] = b[0] + 0.5 * (b[2] - b[0])


@subkernel
def _narrow(m):
    x = m.search
    b = x.bracket
    root, value = (b[0], b[1]) if abs(b[1]) < abs(b[3]) else (b[2], b[3])
    width, least = abs(b[2] - b[0]), NARROW * root + 1e-15
    if value == 0.0 or width <= 2.0 * least or x.state[3] >= MOST_EVALUATIONS:
        _accept(x, root)
        return
    t = _interpolated(b)
    t = min(max(t, least / width), 1.0 - least / width)
    b[6] = b[0] + t * (b[2] - b[0])
