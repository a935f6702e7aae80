"""Friction in joints: the parts of Newton's method, which is needed because friction depends on the reactions, and
changes them.

The iteration is `mbdkit.engine.kernels.accelerations.settle_by_newton`. The columns of ``w.friction`` are the F columns
of the matrix, the right side, which becomes the step, the frictions, and their scales. The columns of ``w.response``
are the F responses of the reactions to the frictions, and the reactions.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.applied_forces import evaluate_tension, path_rate, take_multipliers
from mbdkit.engine.kernels.table_rows import MULTIPLIER, SPRING, TENSION
from mbdkit.engine.native.functions import inlined, subkernel

#: Smallest pivot of the matrix of Newton's method for friction. It is 1 where friction does not change the reactions of
#: its own joint, and 0 where the joint locks itself.
LOCKED = 1e-3
NUDGE = 1e-6  #: Relative change of a friction by which the laws are differentiated.
#: Least scale of a friction relative to the largest multiplier; differences from the law of 1e-11 of the scale count as
#: round-off.
LEAST = 1e-4


@inlined
def friction_law(top, w, v, f):
    """Return the value of the law of friction `f` for the multipliers passed last to `take_multipliers`.

    Requires `applied_forces`.
    """
    k = top.frictions[f]
    evaluate_tension(top, w, k, path_rate(k, top.springs, v, w.grad))
    return w.tension[k, TENSION.force]


@subkernel
def add_friction(top, w, f, change):
    """Add a change of the friction `f` to ``w.force``."""
    k = top.frictions[f]
    a, b = 3 * top.springs[k, SPRING.first], 3 * top.springs[k, SPRING.second]
    for d in range(3):
        w.force[a + d] -= change * w.grad[k, d]
        w.force[b + d] -= change * w.grad[k, 3 + d]


@subkernel
def take_reactions(top, w, lam):
    """Use the multipliers `lam` in the friction that is evaluated next, and store them in ``w.response``."""
    take_multipliers(top, w, lam)
    for i in range(len(top.reactions)):
        w.response[i, len(top.frictions)] = lam[top.reactions[i, MULTIPLIER.pair], top.reactions[i, MULTIPLIER.row]]


@subkernel
def begin_frictions(top, w, v, lam):
    """Begin with the multipliers `lam` of the solution without friction; return whether friction changes it.

    The scale of each friction is the value of its law in that solution, at least `NUDGE` times the sum of all of them.
    A reaction that vanishes consists of rounding errors of other multipliers, so that the scale is also at least
    `LEAST` times the largest of these. The result is false if no joint both moves and bears a force, and if numbers
    have overflowed.
    """
    count, room = len(top.frictions), w.friction
    take_reactions(top, w, lam)
    total = largest = 0.0
    for k in range(len(lam)):
        largest = max(largest, max(abs(lam[k, 0]), abs(lam[k, 1])))
    for f in range(count):
        room[f, count + 1] = 0.0
        room[f, count + 2] = abs(friction_law(top, w, v, f))
        total += room[f, count + 2]
    # a joint at rest has no friction to begin with, but steps need a scale other than zero
    for f in range(count):
        room[f, count + 2] = max(room[f, count + 2], max(NUDGE * total, LEAST * largest))
    return total > 0.0 and total < np.inf


@subkernel
def add_unit(top, w, f, sign):
    """Add `sign` times the scale of the friction `f` to ``w.force``; return the scale."""
    scale = w.friction[f, len(top.frictions) + 2]
    add_friction(top, w, f, sign * scale)
    return scale


@subkernel
def note_response(top, w, f, lam, change):
    """Write the responses of the reactions to the friction `f`, given the multipliers `lam` after its `change`."""
    reactions, response, count = top.reactions, w.response, len(top.frictions)
    for i in range(len(reactions)):
        value = lam[reactions[i, MULTIPLIER.pair], reactions[i, MULTIPLIER.row]]
        response[i, f] = (value - response[i, count]) / change


@subkernel
def change_frictions(top, w):
    """Change all frictions by the step of Newton's method."""
    count, room = len(top.frictions), w.friction
    for f in range(count):
        room[f, count + 1] += room[f, count]
        add_friction(top, w, f, room[f, count])


@subkernel
def _law_slope(top, w, v, f, j):
    """Return the derivative of the law of friction `f` with respect to friction `j`, which changes the reactions."""
    reactions, response, count = top.reactions, w.response, len(top.frictions)
    k, nudge = top.frictions[f], NUDGE * w.friction[j, count + 2]
    # a difference, because laws have no derivatives with respect to their parameters
    now = w.tension[k, TENSION.force]
    for i in range(len(reactions)):
        if reactions[i, MULTIPLIER.friction] == f:
            w.law_values[reactions[i, MULTIPLIER.parameter]] = response[i, count] + nudge * response[i, j]
    slope = (friction_law(top, w, v, f) - now) / nudge
    for i in range(len(reactions)):
        if reactions[i, MULTIPLIER.friction] == f:
            w.law_values[reactions[i, MULTIPLIER.parameter]] = response[i, count]
    w.tension[k, TENSION.force] = now
    return slope


@subkernel
def newton_step(top, w, v):
    """Write a step of Newton's method for all frictions into column F of ``w.friction``.

    Returns the largest difference between a friction and the value of its law, relative to the friction, and the number
    of the friction with this difference. The difference is infinite if the joint locks itself.
    """
    count, room = len(top.frictions), w.friction
    rest, worst = 0.0, 0
    for f in range(count):
        now = friction_law(top, w, v, f)
        room[f, count] = now - room[f, count + 1]
        lack = abs(room[f, count]) / (abs(now) + room[f, count + 2])
        if lack > rest:
            rest, worst = lack, f
        for j in range(count):
            room[f, j] = (1.0 if f == j else 0.0) - _law_slope(top, w, v, f, j)
    for f in range(count):  # positive pivots without exchanges: the solution continues the one without friction
        if not room[f, f] > LOCKED:
            return np.inf, f
        for other in range(f + 1, count):
            share = room[other, f] / room[f, f]
            for j in range(f, count + 1):
                room[other, j] -= share * room[f, j]
    for f in range(count - 1, -1, -1):
        for j in range(f + 1, count):
            room[f, count] -= room[f, j] * room[j, count]
        room[f, count] /= room[f, f]
    return rest, worst
