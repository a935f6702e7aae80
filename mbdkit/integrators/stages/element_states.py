"""First-order states of force elements in implicit steps: their stages, solved element by element.

Stage i of a state z, with A the tableau and g its derivative with respect to time:

    z_i = z_n + h sum_j A_ij k_j,        k_i = g(s_i, s'_i, t_i, z_i)

A state acts on bodies through its element only, and bodies act on it through the length s of the pathway only. For
given positions and velocities of the stages, the equations of each element are therefore a small separate system, which
Newton's method solves before every iteration of the bodies' equations. The unknowns are the derivatives k instead of
the states z: a stiff element would amplify the round-off of z in its derivatives.

If there are expressions of the state, a rate may depend on all states, also through the tension of an element with
states of its own. All states of the stages are then one system.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.applied_forces import applied_forces, law_value, path_rate, pathway_lengths
from mbdkit.engine.kernels.system import DIVERGED, OK, prepare
from mbdkit.engine.kernels.table_rows import STATE_ROW, STATE_USE
from mbdkit.engine.native.arithmetic import is_lanes
from mbdkit.engine.native.functions import inlined, overload, separate, subkernel

MOST_ITERATIONS = 50
#: Relative change of a state for difference quotients of its rate. Errors of the quotients slow the iteration, but do
#: not change its limit.
DIFFERENCE = 1e-7
#: A relative change of states counts as round-off if it is at most `ROUND_OFF`, or if it is at most `NEGLIGIBLE` and at
#: least `STALLED` times the previous change.
ROUND_OFF, NEGLIGIBLE, STALLED = 1e-16, 1e-9, 0.5


def solve_states(c, m, t, h):
    """Solve for the states of all stages at their present positions and velocities; return a status.

    Runs in lanes have no states if their method is implicit.
    """
    return _solve_states(c, m, t, h)


@separate
def _solve_states(c, m, t, h):
    if len(c.top.states) == 0:
        return OK
    take_lengths(c, m, t, h)
    first = 0
    while first < len(c.top.states):
        if is_held(c.top, first):
            first += 1
            continue
        last = end_of_element(c.top, first)
        if not _solve_element(c, m, t, h, first, last):
            c.report[0] = np.inf
            return DIVERGED
        first = last
    return OK


@subkernel
def take_lengths(c, m, t, h):
    """Evaluate the lengths of the pathways of elements with states, and their rates, at every stage."""
    top, room = c.top, m.states
    for i in range(len(m.rk.c)):
        prepare(top, c.w, t + m.rk.c[i] * h, m.q_stage[i])
        pathway_lengths(top, c.w, m.q_stage[i])
        for e in range(len(top.states)):
            k = top.states[e, STATE_ROW.segment]
            if k >= 0:
                room.length[i, e] = c.w.s[k, 0]
                room.speed[i, e] = path_rate(k, top.springs, m.v_stage[i], c.w.grad)


@inlined
def end_of_element(top, first):
    """Return the number of the first state after those that are solved together with state `first`."""
    last = first + 1
    while last < len(top.states) and (
        is_coupled(top) or top.states[last, STATE_ROW.segment] == top.states[first, STATE_ROW.segment]
    ):
        last += 1
    while is_held(top, last - 1):
        last -= 1
    return last


@inlined
def is_held(top, e):
    """Return whether a state is constant in each step: its rate is zero, and no equation has to be solved for it."""
    return top.states[e, STATE_ROW.rate] < 0


@overload(solve_states)
def _of_kind(c, m, t, h):
    if is_lanes(h):
        return lambda c, m, t, h: OK
    return lambda c, m, t, h: _solve_states(c, m, t, h)


@subkernel
def _solve_element(c, m, t, h, first, last):
    """Solve for the states `first` to `last - 1`, which are those of an element; return whether that succeeded."""
    room, stages, before = m.states, len(m.rk.c), np.inf
    add_up_states(c, m, h, first, last)
    for _ in range(MOST_ITERATIONS):
        linearize(c, m, t, h, first, last)
        if not solve_dense(room.matrix, room.right, stages * (last - first)):
            return False
        size = change = 0.0
        for i in range(stages):
            for e in range(first, last):
                more = room.right[i * (last - first) + e - first]
                room.rate[i, e] += more
                change = max(change, abs(h * more))
                size = max(size, abs(room.z[i, e]), abs(h * room.rate[i, e]))
        add_up_states(c, m, h, first, last)
        if change <= ROUND_OFF * size or (change >= STALLED * before and change <= NEGLIGIBLE * size):
            return True
        if not change < np.inf:
            return False
        before = change
    return False


@subkernel
def add_up_states(c, m, h, first, last):
    """Evaluate the states `first` to `last - 1` of every stage from their derivatives."""
    for i in range(len(m.rk.c)):
        for e in range(first, last):
            total = 0.0
            for j in range(len(m.rk.c)):
                total += m.rk.a[i, j] * m.states.rate[j, e]
            m.states.z[i, e] = c.from_z[e] + h * total


@inlined
def is_coupled(top):
    """Return whether the rate of a state may depend on the states of other elements."""
    return len(top.inputs) + len(top.load_values) > 0 or len(top.state_places) > len(top.states)


@inlined
def put_state(c, f, z):
    """Use the value `z` of state `f` in what is evaluated next."""
    top, w = c.top, c.w
    w.law_values[top.states[f, STATE_ROW.parameter]] = z
    if is_coupled(top):
        for k in range(len(top.state_places)):
            if top.state_places[k, STATE_USE.state] == f:
                w.law_values[top.state_places[k, STATE_USE.parameter]] = z


@subkernel
def state_rate(c, m, i, e, at):
    """Return the rate of state `e` at stage `i`, for the values last passed to `put_state`."""
    top, w, room = c.top, c.w, m.states
    if top.states[e, STATE_ROW.rate] < 0:
        return 0.0
    if top.states[e, STATE_ROW.segment] < 0:
        return law_value(top, w, top.states[e, STATE_ROW.rate], 0.0, 0.0, at)
    return law_value(top, w, top.states[e, STATE_ROW.rate], room.length[i, e], room.speed[i, e], at)


@subkernel
def linearize(c, m, t, h, first, last):
    """Write matrix and right side of the equations of an element, ordered by stages."""
    top, w, room, n = c.top, c.w, m.states, last - first
    for i in range(len(m.rk.c)):
        at = t + m.rk.c[i] * h
        for e in range(first, last):
            put_state(c, e, room.z[i, e])
        if is_coupled(top):
            prepare(top, w, at, m.q_stage[i])
            applied_forces(top, w, m.q_stage[i], m.v_stage[i])
        for e in range(first, last):
            room.right[i * n + e - first] = state_rate(c, m, i, e, at) - room.rate[i, e]
        for f in range(first, last):
            z, is_held = room.z[i, f], top.states[f, STATE_ROW.rate] < 0
            step = DIFFERENCE * max(abs(z), abs(h * room.rate[i, f]))
            if step == 0.0:
                step = DIFFERENCE
            put_state(c, f, z + step)
            if is_coupled(top) and not is_held:
                applied_forces(top, w, m.q_stage[i], m.v_stage[i])
            for e in range(first, last):
                row, slope = i * n + e - first, 0.0
                if not is_held:
                    slope = (state_rate(c, m, i, e, at) - room.right[row] - room.rate[i, e]) / step
                for j in range(len(m.rk.c)):
                    is_own = i == j and e == f
                    room.matrix[row, j * n + f - first] = (1.0 if is_own else 0.0) - h * m.rk.a[i, j] * slope
                if e == f:
                    room.slope[e] = slope
            put_state(c, f, z)


@subkernel
def solve_dense(matrix, right, n):
    """Replace `right` by the solution of the leading `n` equations; return False if they are singular."""
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if not abs(matrix[pivot, k]) > 0.0:
            return False
        if pivot != k:
            for j in range(k, n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            right[k], right[pivot] = right[pivot], right[k]
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, n):
                matrix[i, j] -= factor * matrix[k, j]
            right[i] -= factor * right[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            right[k] -= matrix[k, j] * right[j]
        right[k] /= matrix[k, k]
    return True
