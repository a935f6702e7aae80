"""Controlled steps that end where a force switches: at the zeros of the switching functions of laws and expressions.

The order of a method holds on either side of such a zero, but not across it, and error control sees only the stages:
those of a step that passes over the begin of a contact may all lie before it. The motion within each step is therefore
searched for the first zero (`mbdkit.engine.law_compiler.switches_of`), and the step is taken again up to there, also
where error control would reject it and approach the zero by ever smaller steps. If some of its stages lie behind the
zero, its dense output is wrong; that of the shorter step is then searched again.

The search asks for switching functions at one place of the step after another, so that it is the same for methods in
machine code (`look`) and in Python (`mbdkit.integrators.host.steps_to_changes`).
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from mbdkit.engine.kernels.applied_forces import applied_forces, path_rate, take_states
from mbdkit.engine.kernels.bundle_types import STATE, IntMatrix, IntVector, RealMatrix, RealVector, example_of
from mbdkit.engine.kernels.engine_bundles import load_engine
from mbdkit.engine.kernels.interpolation import hermite
from mbdkit.engine.kernels.system import OK, prepare
from mbdkit.engine.kernels.table_rows import LAW_ROW
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.calls import call_entry, call_law
from mbdkit.engine.native.functions import entry, kernel, separate, subkernel
from mbdkit.integrators.loop.step_loop import SHORTER
from mbdkit.integrators.run.run_state import load_run_state

PARTS = 4  #: Number of equal parts of a step at whose ends switching functions are always evaluated.
MOST_SAMPLES = 128  #: Largest number of places in a step.
#: A zero up to this share of a step belongs to its start: the step began there.
SOON = 1e-12
#: Zeros are located up to this share of the step. A step ends behind a zero, so that the next one knows its side.
CLOSE = 2e-13
#: Zeros up to this share before the end of a step belong to its end.
AT_END = 1e-12
#: Differences of times below this number of rounding errors cannot be steps.
ROUNDINGS = 64.0 * float(np.finfo(float).eps)
#: An extremum between three samples of equal signs is searched unless it is this close to the middle one, in shares of
#: the way between the outer ones, or its predicted value more than this share of the middle one.
NEAR_SAMPLE, LOWER = 1e-3, 0.5
#: A step that begins at a zero goes no further than this share of the way to the extremum, or to the next zero, of the
#: same function: error control may fail in a step of which most stages are behind a short contact.
INTO = 0.25
FAR = 0.5  #: Functions that stay this share of their change in a step away from zero have no zero in it.
#: A function whose value at the start is below this share of the largest one in the step begins at a zero.
AT_ZERO = 1e-6
#: After so many zeros within this share of the span of a run, its steps pass over zeros for the other share.
MOST_ZEROS, SPELL, PAUSE = 100, 1e-6, 1e-3


class Spell(NamedTuple):
    """Zeros in quick succession, as where a force jumps against the motion on both sides of a zero."""

    begin: RealVector  #: (1,) time of the first zero that is counted [s].
    last: RealVector  #: (1,) start of the last step that ended at a zero [s].
    count: IntVector  #: (1,) number of zeros since the first one.
    until: RealVector  #: (1,) time up to which steps pass over zeros [s].
    first: RealVector  #: (1,) time from which on steps have first done so [s]; nan if they have not.


class SwitchBundle(NamedTuple):
    """The switching functions of a mechanism and their samples; L laws, G functions, N = 3 (B + 1)."""

    #: (L, 5) row of each law in ``Topology.laws``, first segment of its pathway or -1, index of its first function, and
    #: the addresses of the code and of the program.
    laws: Annotated[IntMatrix, 5]
    other_look: IntVector  #: (1,) address of a look into steps that comes first; 0 for none.
    dense: IntVector  #: (1,) address of the dense output of the method; 0 for the cubic through both ends.
    span: RealVector  #: (1,) duration of the run [s].
    spell: Annotated[Spell, STATE]
    value: Annotated[RealMatrix, 1]  #: (G, 1) functions at the last place.
    places: RealVector  #: (MOST_SAMPLES,) places, sorted, as shares of the step.
    samples: RealMatrix  #: (MOST_SAMPLES, G) functions there.
    count: IntVector  #: (1,) number of samples.
    limits: RealVector  #: (3,) share of the step up to which it goes, `SOON` and `CLOSE` in this step.
    q: RealVector  #: (N,) a state within the step.
    v: RealVector
    z: RealVector


load_switches = bundle_loader(lambda: example_of(SwitchBundle))


@separate
def _evaluate(top, w, m, t, q, v, z):
    """Write the switching functions at a state into ``m.value``."""
    take_states(top, w, z)
    prepare(top, w, t, q)
    applied_forces(top, w, q, v)
    for k in range(len(m.laws)):
        law, segment, length, rate = m.laws[k, 0], m.laws[k, 1], 0.0, 0.0
        if segment >= 0:
            length, rate = w.s[segment, 0], path_rate(segment, top.springs, v, w.grad)
        parameters = top.laws[law, LAW_ROW.parameters]
        call_law(
            m.laws[k, 3], m.laws[k, 4], length, rate, w.time[0], w.law_values, parameters, m.value, m.laws[k, 2], 1
        )


@subkernel
def _begin(m, t, h):
    """Begin the search in a step; return the first place, or -1 in a step that is too short to be divided."""
    smallest = ROUNDINGS * max(abs(t), abs(t + h)) / h
    m.count[0] = 0
    m.limits[0], m.limits[1], m.limits[2] = 1.0, max(SOON, smallest), max(CLOSE, 0.125 * smallest)
    return 0.0 if PARTS * m.limits[1] < 1.0 else -1.0


@subkernel
def _note(m, place):
    """Add the functions in ``m.value`` at a place to the samples, which stay sorted."""
    j = m.count[0]
    m.count[0] = j + 1
    while j > 0 and m.places[j - 1] > place:
        m.places[j] = m.places[j - 1]
        for i in range(len(m.value)):
            m.samples[j, i] = m.samples[j - 1, i]
        j -= 1
    m.places[j] = place
    for i in range(len(m.value)):
        m.samples[j, i] = m.value[i, 0]


@subkernel
def _inner_extremum(m, j, i):
    """Return where function `i` may have an extremum towards zero near sample `j`, by a parabola; 0 for none."""
    a, b, c = m.samples[j - 1, i], m.samples[j, i], m.samples[j + 1, i]
    if (a > 0.0) != (b > 0.0) or (b > 0.0) != (c > 0.0) or not (abs(b) <= abs(a) and abs(b) <= abs(c)):
        return 0.0
    x, y = m.places[j] - m.places[j - 1], m.places[j + 1] - m.places[j]
    left, right = (b - a) / x, (c - b) / y
    curvature = (right - left) / (x + y)
    slope = (left * y + right * x) / (x + y)
    if curvature == 0.0:
        return 0.0
    way = -0.5 * slope / curvature
    lowest = (b + 0.5 * slope * way) / b if b != 0.0 else 0.0
    if not (-x < way < y and abs(way) > NEAR_SAMPLE * min(x, y)) or lowest > LOWER:
        return 0.0
    return m.places[j] + way


@subkernel
def _inner_zero(m, j, i):
    """Return a place between samples `j` and `j + 1`, of different signs, that approaches the zero of function `i`."""
    a, b, f, g = m.places[j], m.places[j + 1], m.samples[j, i], m.samples[j + 1, i]
    if m.count[0] % 2 == 1:  # functions may have corners at their zeros
        return 0.5 * (a + b)
    # beside the secant's zero, alternately, so that the samples enclose the zero
    beside = 0.5 * m.limits[2] * (1.0 if m.count[0] % 4 == 0 else -1.0)
    place = a + (b - a) * f / (f - g) + beside
    return min(max(place, a + 0.25 * m.limits[2]), b - 0.25 * m.limits[2])


@subkernel
def _is_clear(m):
    """Return whether no function comes close to zero in the samples of a cubic, so that dense output need not be asked.

    Dense output may cost further evaluations of the equations of motion.
    """
    for i in range(len(m.value)):
        lowest = highest = m.samples[0, i]
        for j in range(1, m.count[0]):
            lowest, highest = min(lowest, m.samples[j, i]), max(highest, m.samples[j, i])
        if not max(lowest, -highest) > FAR * (highest - lowest):
            return False
    return True


@separate
def _next_place(m):
    """Return the place at which the functions are needed next; -1 if ``m.limits[0]`` is known."""
    n = m.count[0]
    if n < 2:
        return 0.0 if n == 0 else m.limits[1]
    if n < 2 + PARTS:
        return (n - 1) / PARTS
    end, last = 1.0, n - 1
    for i in range(len(m.value)):
        m.value[i, 0] = m.samples[1, i]  # the last value that is not zero
    for j in range(1, n - 1):
        for i in range(len(m.value)):
            if not abs(m.samples[j, i] + m.samples[j + 1, i]) < np.inf:
                return -1.0
            place = _inner_extremum(m, j, i)
            if n < MOST_SAMPLES and place > 0.0:
                return place
        for i in range(len(m.value)):
            before, here = m.value[i, 0], m.samples[j + 1, i]
            if here == 0.0:  # a step ends behind a zero, where a jump has a side
                continue
            if before != 0.0 and (before > 0.0) != (here > 0.0):
                if n < MOST_SAMPLES and m.places[j + 1] - m.places[j] > m.limits[2]:
                    return _inner_zero(m, j, i)
                end, last = m.places[j + 1], j + 1
            m.value[i, 0] = here
        if end < 1.0:
            break
    m.limits[0] = end
    for i in range(len(m.value)):
        extremum, largest = 0, 0.0
        for j in range(last + 1):
            if abs(m.samples[j, i]) > largest:
                extremum, largest = j, abs(m.samples[j, i])
        if abs(m.samples[0, i]) <= AT_ZERO * largest and extremum < last:
            m.limits[0] = min(m.limits[0], INTO * m.places[extremum])
    return -1.0


@separate
def _size(m, t, h):
    """Return the size up to which a step goes; note that it ends at a zero."""
    size, spell = m.limits[0] * h, m.spell
    if m.limits[0] > 1.0 - max(AT_END, 4.0 * m.limits[2]) or m.limits[0] <= m.limits[1] or t < spell.until[0]:
        return h
    if t - spell.begin[0] > SPELL * m.span[0] or not t >= spell.begin[0]:
        spell.begin[0], spell.count[0] = t, 0
    spell.count[0] += t != spell.last[0]  # not where the same step is shortened again
    spell.last[0] = t
    if spell.count[0] > MOST_ZEROS:
        spell.until[0], spell.count[0] = t + PAUSE * m.span[0], 0
        if np.isnan(spell.first[0]):
            spell.first[0] = t
        return h
    return size


@separate
def _place_state(c, m, h, share):
    """Write the state at a share of the last attempt, on the cubic through its ends."""
    for d in range(len(m.q)):
        rates = c.from_v[d], c.from_v[d] + c.dv[d]
        m.q[d], m.v[d] = hermite(share, h, c.from_q[d], c.dq[d], rates[0], rates[1])
    for d in range(len(m.z)):
        m.z[d] = c.from_z[d] + share * c.dz[d]


@entry
def look(run, method, t, h, error):
    """Return `SHORTER` if a force switches within the last attempt, after writing the size of the part of the step
    before; see `mbdkit.integrators.loop.step_loop`. The error is relative to its tolerance.
    """
    c = load_run_state(run)
    m = load_switches(c.w.reacting.add_forces[2])
    if m.other_look[0] != 0 and error <= 1.0:
        status = call_entry(m.other_look[0], run, method, t, h, 0.0)
        if status != OK:
            return status
    place, by_cubic = _begin(m, t, h), m.dense[0] != 0
    while place >= 0.0:
        if by_cubic or m.dense[0] == 0 or place == 0.0 or place == 1.0:
            _place_state(c, m, h, place)
            _evaluate(c.top, c.w, m, t + place * h, m.q, m.v, m.z)
        else:
            status = call_entry(m.dense[0], run, method, t, h, place)
            if status != OK:
                return OK
            _evaluate(c.top, c.w, m, t + place * h, c.point_q, c.point_v, c.point_z)
        _note(m, place)
        if by_cubic and m.count[0] == 2 + PARTS:
            if _is_clear(m):
                return OK
            place, by_cubic = _begin(m, t, h), False
        else:
            place = _next_place(m)
    size = _size(m, t, h)
    if size == h:
        return OK
    c.progress.tried_size[0] = size
    return SHORTER


# ---- calls from Python, for methods whose steps are taken there ------------------------------------------------------


@kernel
def first_place(switches: int, t: float, h: float) -> float:
    """Begin the search in a step; return the first place at which the functions are needed, or -1."""
    return _begin(load_switches(switches), t, h)


@kernel
def is_clear(switches: int) -> bool:
    """See `_is_clear`."""
    return _is_clear(load_switches(switches))


@kernel
def next_place(engine: int, switches: int, t: float, h: float, place: float) -> float:
    """Evaluate the functions at the state in ``q, v, z`` of the bundle, a place of the step; return the next place, or
    -1 less the share of the step at which it is to end.
    """
    e, m = load_engine(engine), load_switches(switches)
    _evaluate(e.top, e.w, m, t + place * h, m.q, m.v, m.z)
    _note(m, place)
    place = _next_place(m)
    return place if place >= 0.0 else -1.0 - _size(m, t, h) / h
