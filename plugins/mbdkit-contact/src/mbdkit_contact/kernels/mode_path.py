"""Forces of contacts with Coulomb friction along a path of solutions, on which one mode changes at a time.

Where the method of `mbdkit_contact.kernels.active_set` does not end, its last modes and forces are the solution of a
neighboring problem, in which the velocities without forces are shifted. While the shift decreases to zero, the forces
change along a line until a contact reaches a limit of its mode: it opens, closes, sticks or slips, and the line has a
corner. Where no line with a smaller shift follows, the shift increases again, as in the method of Lemke (R. W. Cottle,
J.-S. Pang and R. E. Stone, The Linear Complementarity Problem, 1992, sections 4.4 and 4.5). Small additional shifts,
different for each contact, keep several contacts from reaching their limits together.

If contacts are redundant, the equations of given modes have no unique solution. The path is therefore that of forces f
for velocities ``u + eps D (f - f0)``, and its end is the start f0 of the next path (R. T. Rockafellar, SIAM Journal on
Control and Optimization 14:877-898, 1976), until the forces for ``eps = 0`` in the modes at its end satisfy all laws.
A large eps makes paths simpler. If one with a small eps has no end, eps decreases from path to path.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.native.functions import subkernel
from mbdkit_contact.kernels.active_set import (
    PROXIMAL,
    assemble,
    factorize,
    find_better_modes,
    find_scales,
    solve_modes,
    substitute,
)
from mbdkit_contact.modes import OPEN, SLIP, STICK

#: Largest numbers of corners of a path, of a first attempt with small eps, and of further attempts with decreasing eps;
#: less than ten corners are usual.
MOST_CORNERS = 30, 40, 40
#: First eps of further attempts, and factors by which it decreases. With about 150 contacts of discs in a pit, each of
#: the last two factors solved problems that the other did not.
LARGEST, FACTORS = 1e-2, (1.0, 0.1, 0.3)
MOST_ENDS = 10  #: Largest number of paths with the smallest eps; one to three are usual.
SHIFT = 1e-6  #: Size of the additional shifts, relative to the largest force or velocity.
GOLDEN = 0.6180339887498949  #: Fractional parts of multiples of this number are spread evenly, and all differ.

#: Rows of ``path``: scaled forces and rates on the path, their slopes, and the shifts; modes, forces and start of the
#: first path.
_FORCE, _FORCE_SLOPE, _RATE, _RATE_SLOPE, _SHIFT, _MODES, _FORCES, _START = range(8)


@subkernel
def _sign(mode):
    return 1.0 if mode > 0 else -1.0


@subkernel
def _find_rates(s, w, k, eps, t):
    """Write the scaled rates of all contacts at the parameter `t` of the path, and their slopes."""
    p = s.path
    for row in range(2 * k):
        free = s.scale[row % k] * w.free[row] - (1.0 - t) * p[_SHIFT, row]
        rate = free + eps * (p[_FORCE, row] - s.start[row] / s.scale[row % k])
        slope = p[_SHIFT, row] + eps * p[_FORCE_SLOPE, row]
        for column in range(2 * k):
            response = s.scale[row % k] * s.scale[column % k] * w.response[row, column]
            rate += response * p[_FORCE, column]
            slope += response * p[_FORCE_SLOPE, column]
        p[_RATE, row], p[_RATE_SLOPE, row] = rate, slope


@subkernel
def _begin(s, w, k, eps, size):
    """Change the forces slightly, so that they are no limit of the present modes, and write the shifts with which they
    are a solution.
    """
    p, largest = s.path, 0.0
    for i in range(k):
        largest = max(largest, w.forces[i] / s.scale[i])
    for i in range(k):
        more = SHIFT * (0.5 + (i * GOLDEN) % 1.0)
        normal, tangent, limit = 0.0, 0.0, 0.0
        if s.modes[i] != OPEN:
            normal = max(w.forces[i] / s.scale[i], 0.0) + more * largest
            limit = w.friction[i] * normal
        if s.modes[i] == STICK:
            limit *= 1.0 - more
            tangent = min(max(w.forces[k + i] / s.scale[i], -limit), limit)
        elif s.modes[i] != OPEN:
            tangent = -limit if s.modes[i] == SLIP else limit
        p[_FORCE, i], p[_FORCE, k + i] = normal, tangent
        for row in (i, k + i):
            p[_FORCE_SLOPE, row] = p[_SHIFT, row] = 0.0
    _find_rates(s, w, k, eps, 1.0)
    for i in range(k):
        more = SHIFT * (0.5 + (i * GOLDEN) % 1.0) * size
        normal, tangent = p[_RATE, i], p[_RATE, k + i]
        p[_SHIFT, i], p[_SHIFT, k + i] = normal, tangent
        if s.modes[i] == OPEN:
            p[_SHIFT, i], p[_SHIFT, k + i] = min(normal, 0.0) - more, 0.0
        elif s.modes[i] != STICK:
            p[_SHIFT, k + i] = _sign(s.modes[i]) * (min(_sign(s.modes[i]) * tangent, 0.0) - more)


@subkernel
def _find_line(s, w, k, eps, t):
    """Write the forces at the parameter `t`, the rates, and the slopes of both in the present modes; return whether the
    equations have a solution.
    """
    p, count = s.path, assemble(s, w, k)
    if not factorize(s, count, eps):
        return False
    for i in range(2 * k):
        p[_FORCE, i] = p[_FORCE_SLOPE, i] = 0.0
    for at in (_FORCE, _FORCE_SLOPE):
        for a in range(count):
            row = s.unknown[a]
            s.change[a] = -p[_SHIFT, row]
            if at == _FORCE:
                free = s.scale[row % k] * w.free[row] - eps * s.start[row] / s.scale[row % k]
                s.change[a] = (1.0 - t) * p[_SHIFT, row] - free
        substitute(s, count)
        for a in range(count):
            p[at, s.unknown[a]] = s.z[a]
        for i in range(k):
            if s.share[i] != 0.0:
                p[at, k + i] = s.share[i] * p[at, i]
    _find_rates(s, w, k, eps, t)
    return True


@subkernel
def _margin(s, w, k, i, way, at):
    """Return the distance of a contact from the limit of its mode in direction `way`; only if it sticks, it has two.

    `at` is 0 for the distance on the path, and 1 for its slope.
    """
    p, mode = s.path, s.modes[i]
    if mode == OPEN:
        return p[_RATE + at, i]
    if mode == STICK and w.friction[i] > 0.0:
        return w.friction[i] * p[_FORCE + at, i] - way * p[_FORCE + at, k + i]
    if mode == STICK or way > 0:
        return p[_FORCE + at, i]
    return _sign(mode) * p[_RATE + at, k + i]


@subkernel
def _beyond(mode, way, friction, slip):
    """Return the mode beyond a limit; `slip` is the slip velocity there."""
    if mode == OPEN:
        if friction == 0.0:
            return STICK
        return SLIP if slip > 0.0 else -SLIP
    if mode == STICK:
        return OPEN if friction == 0.0 else -way * SLIP
    return OPEN if way > 0 else STICK


@subkernel
def _way_back(mode, before):
    """Return the direction of the limit of a mode beyond which the mode before is."""
    if mode == STICK:
        return -1 if before == SLIP else 1
    return 1 if before == OPEN else -1


@subkernel
def _follow(s, w, k, eps, size, most):
    """Follow the path from the present modes and forces; return whether it has an end.

    The modes there are written, and the forces as the start of the next path.
    """
    _begin(s, w, k, eps, size)
    t, forward, last, before = 0.0, 1.0, -1, OPEN
    for _ in range(most):
        if not _find_line(s, w, k, eps, t):
            return False
        if last >= 0:  # the new mode of the contact holds in the direction in which the value grows
            slope = _margin(s, w, k, last, _way_back(s.modes[last], before), 1)
            forward = 1.0 if slope > 0.0 else -1.0
        # the line ends where the first contact reaches a limit of its mode, or where the shift vanishes
        length = 1.0 - t if forward > 0.0 else np.inf
        last, way = -1, 1
        for i in range(k):
            for side in (1, -1):
                slope, margin = forward * _margin(s, w, k, i, side, 1), max(_margin(s, w, k, i, side, 0), 0.0)
                if slope < 0.0 and margin < -slope * length:
                    length, last, way = margin / -slope, i, side
        if last < 0:
            for row in range(2 * k):
                force = s.path[_FORCE, row] + (1.0 - t) * s.path[_FORCE_SLOPE, row]
                w.forces[row] = s.start[row] = s.scale[row % k] * force
            return forward > 0.0
        t += forward * length
        slip = s.path[_RATE, k + last] + forward * length * s.path[_RATE_SLOPE, k + last]
        before = s.modes[last]
        s.modes[last] = _beyond(before, way, w.friction[last], slip)
    return False


@subkernel
def solve_by_path(s, w, k):
    """Find the forces of the first k contacts from the modes ``s.modes`` and forces ``w.forces``; return whether this
    succeeds.

    The arguments are those of `mbdkit_contact.kernels.active_set.solve_active_set`.
    """
    size, p = find_scales(s, w, k), s.path
    for row in range(2 * k):
        p[_FORCES, row], p[_START, row] = w.forces[row], s.start[row]
        p[_MODES, row] = s.modes[row % k]
    # a small eps first, because it changes the forces least; larger ones have simpler paths
    for attempt in range(len(FACTORS)):
        for row in range(2 * k):
            w.forces[row], s.start[row] = p[_FORCES, row], p[_START, row]
            s.modes[row % k] = int(p[_MODES, row])
        eps, ends = PROXIMAL if attempt == 0 else LARGEST, 0
        while ends < MOST_ENDS and _follow(s, w, k, eps, size, MOST_CORNERS[attempt]):
            if eps <= PROXIMAL:
                ends += 1
                if solve_modes(s, w, k, size) and find_better_modes(s, w, k, size) == 0:
                    return True
                for row in range(2 * k):
                    w.forces[row] = s.start[row]
            eps = max(FACTORS[attempt] * eps, PROXIMAL)
    return False
