"""Impulses of many contacts: sweeps over them find the modes, and an iteration for the modes found the impulses.

In a sweep, each contact in turn gets the impulses that satisfy the laws of contact and friction for the present
impulses of all others (M. Jean, Computer Methods in Applied Mechanics and Engineering 177:235-257, 1999; V. Acary and
B. Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008, section 13.7.4). Sweeps soon find which contacts
are open, stick and slip, but their impulses converge slowly. For given modes, the impulses solve linear equations,
which the method of H. A. van der Vorst solves without their matrix (Bi-CGSTAB, SIAM Journal on Scientific and
Statistical Computing 13:631-644, 1992): its products are velocities of bodies. Modes that contradict the solution
change, as in `mbdkit_contact.kernels.active_set`. If this does not end, the modes change one at a time, as in
`mbdkit_contact.kernels.mode_path`, which factorizes the matrix of up to `MOST_FACTORIZED` contacts.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from mbdkit.engine.kernels.vectors import copy, fill
from mbdkit.engine.native.functions import subkernel
from mbdkit_contact.kernels.active_set import EXACT
from mbdkit_contact.kernels.mode_path import solve_by_path
from mbdkit_contact.kernels.stepping_bundle import ACROSS, ALONG, add_move, rate_of
from mbdkit_contact.modes import OPEN, SLIP, STICK

#: Number of sweeps before modes are taken from them, and before this is repeated if modes and impulses do not agree.
FIRST_SWEEPS, SWEEPS = 100, 500
#: Limits of the relative change of velocities in a sweep. If modes and impulses do not agree, the result is accepted if
#: the last change is at most `ACCEPTED`.
#:
#: Changes are relative to the largest velocity without impulses. If more contacts are closed than are needed, sweeps
#: move forces between them ever more slowly.
PRECISION, ACCEPTED = 1e-8, 1e-2
#: Largest number of times that modes change, and number of times that they may change without progress.
MOST_CHANGES, PATIENCE = 60, 3
MOST_FACTORIZED = 256  #: Largest number of contacts of which the matrix of all responses is stored; 2 MB.
#: Largest number of times that the iteration for given modes starts again, with the residual computed anew.
MOST_RESTARTS = 4


@subkernel
def _move(c, m, j, at, size, out):
    """Add the velocities caused by an impulse of this size to `out` (N,)."""
    if m.is_sparse[0] != 0:
        add_move(c, m, j, at, size, out)
    else:
        row = m.moved[2 * j if at == ALONG else 2 * j + 1]
        for d in range(len(row) - 3):
            out[d] += size * row[d]


@subkernel
def _find_after(c, m, velocities):
    """Write the velocities after the present impulses into ``m.after``."""
    copy(velocities, m.after)
    for j in range(m.number[0]):
        if m.normal[j] != 0.0:
            _move(c, m, j, ALONG, m.normal[j], m.after)
        if m.tangent[j] != 0.0:
            _move(c, m, j, ACROSS, m.tangent[j], m.after)


@subkernel
def _sweep(c, m, most, tolerance):
    """Sweep over the contacts; return the largest change of a velocity in the last sweep."""
    worst = 0.0
    for _ in range(most):
        worst = 0.0
        for j in range(m.number[0]):
            nn, nt, tn, tt, mu = m.block[j, 0], m.block[j, 1], m.block[j, 2], m.block[j, 3], m.friction[j]
            p, r = m.normal[j], m.tangent[j]
            normal = rate_of(m, j, ALONG, m.after) + m.more[j] - nn * p - nt * r
            push = rub = 0.0
            # the laws of one contact with two unknowns have a closed form: it opens, sticks, or slips one way or the
            # other
            if normal < 0.0 and mu == 0.0:
                push = -normal / nn
            elif normal < 0.0:
                tangent = rate_of(m, j, ACROSS, m.after) - tn * p - tt * r
                determinant = nn * tt - nt * tn
                push = (nt * tangent - tt * normal) / determinant
                rub = (tn * normal - nn * tangent) / determinant
                if push <= 0.0 or abs(rub) > mu * push:  # it slips, against the impulse of friction
                    ratio = mu if rub > 0.0 else -mu
                    slope = nn + ratio * nt
                    push = -normal / slope if slope > 0.0 else 0.0
                    rub = ratio * push
            if push != p:
                _move(c, m, j, ALONG, push - p, m.after)
            if rub != r:
                _move(c, m, j, ACROSS, rub - r, m.after)
            worst = max(worst, abs(push - p) * nn, abs(rub - r) * tt)
            m.normal[j], m.tangent[j] = push, rub
        if worst <= tolerance:
            break
    return worst


@subkernel
def _share(m, j):
    """Return the ratio of friction and normal impulse of a contact that slips."""
    return -m.friction[j] if m.states[j] == SLIP else m.friction[j]


@subkernel
def _times(c, m, x, out):
    """Multiply the scaled equations of the impulses in the present modes by `x` (2 C,)."""
    k = m.number[0]
    fill(m.x, 0.0)
    for j in range(k):
        if m.states[j] == OPEN:
            continue
        push = x[j] / sqrt(m.block[j, 0])
        _move(c, m, j, ALONG, push, m.x)
        if m.states[j] != STICK:
            _move(c, m, j, ACROSS, _share(m, j) * push, m.x)
        elif m.friction[j] > 0.0:
            _move(c, m, j, ACROSS, x[k + j] / sqrt(m.block[j, 3]), m.x)
    for j in range(k):
        out[j] = out[k + j] = 0.0
        if m.states[j] != OPEN:
            out[j] = rate_of(m, j, ALONG, m.x) / sqrt(m.block[j, 0])
            if m.states[j] == STICK and m.friction[j] > 0.0:
                out[k + j] = rate_of(m, j, ACROSS, m.x) / sqrt(m.block[j, 3])


@subkernel
def _product(x, y, count):
    total = 0.0
    for i in range(count):
        total += x[i] * y[i]
    return total


@subkernel
def _residual(c, m, velocities, out):
    """Write the residual of the equations of the impulses into `out` (2 C,); return its largest entry.

    This is infinite if an entry is not finite.
    """
    k, worst = m.number[0], 0.0
    _find_after(c, m, velocities)
    for j in range(k):
        out[j] = out[k + j] = 0.0
        if m.states[j] != OPEN:
            out[j] = -(rate_of(m, j, ALONG, m.after) + m.more[j]) / sqrt(m.block[j, 0])
            if m.states[j] == STICK and m.friction[j] > 0.0:
                out[k + j] = -rate_of(m, j, ACROSS, m.after) / sqrt(m.block[j, 3])
        if not abs(out[j]) + abs(out[k + j]) < np.inf:
            return np.inf
        worst = max(worst, abs(out[j]), abs(out[k + j]))
    return worst


@subkernel
def _add_impulses(m, x):
    k = m.number[0]
    for j in range(k):
        if m.states[j] == OPEN:
            continue
        m.normal[j] += x[j] / sqrt(m.block[j, 0])
        if m.states[j] != STICK:
            m.tangent[j] = _share(m, j) * m.normal[j]
        elif m.friction[j] > 0.0:
            m.tangent[j] += x[k + j] / sqrt(m.block[j, 3])


@subkernel
def _solve(c, m, velocities, size):
    """Solve the equations of the impulses in the present modes, beginning with the present impulses; return whether
    they are satisfied.
    """
    k = m.number[0]
    for j in range(k):
        if m.states[j] == OPEN:
            m.normal[j] = m.tangent[j] = 0.0
        elif m.states[j] != STICK:
            m.tangent[j] = _share(m, j) * m.normal[j]
        elif m.friction[j] == 0.0:
            m.tangent[j] = 0.0
    r, first, p, v, s, t, x = (
        m.krylov[0], m.krylov[1], m.krylov[2], m.krylov[3], m.krylov[4], m.krylov[5], m.krylov[6],
    )  # fmt: skip
    for _ in range(MOST_RESTARTS):
        if _residual(c, m, velocities, r) <= 0.1 * EXACT * size:
            return True
        # the recursion loses the true residual to rounding errors, so that each restart computes it anew
        for i in range(2 * k):
            first[i] = p[i] = r[i]
            x[i] = 0.0
        rho, limit = _product(r, r, 2 * k), 0.0
        limit = 1e-8 * EXACT * EXACT * size * size
        for _ in range(4 * k):
            _times(c, m, p, v)
            below = _product(first, v, 2 * k)
            if below == 0.0:
                break
            alpha = rho / below
            for i in range(2 * k):
                s[i] = r[i] - alpha * v[i]
            _times(c, m, s, t)
            square = _product(t, t, 2 * k)
            omega = _product(t, s, 2 * k) / square if square > 0.0 else 0.0
            for i in range(2 * k):
                x[i] += alpha * p[i] + omega * s[i]
                r[i] = s[i] - omega * t[i]
            if _product(r, r, 2 * k) <= limit or omega == 0.0:
                break
            before, rho = rho, _product(first, r, 2 * k)
            beta = rho / before * alpha / omega
            for i in range(2 * k):
                p[i] = r[i] + beta * (p[i] - omega * v[i])
        _add_impulses(m, x)
    return _residual(c, m, velocities, r) <= EXACT * size


@subkernel
def _better_mode(m, j, size, largest):
    """Return the mode of a contact that the impulses do not contradict; see `active_set`."""
    scale, mu, state = sqrt(m.block[j, 0]), m.friction[j], m.states[j]
    push, rub = m.normal[j] * scale, m.tangent[j] * scale
    if state == OPEN:
        approaches = (rate_of(m, j, ALONG, m.after) + m.more[j]) / scale < -EXACT * size
        return STICK if approaches else OPEN
    if push < -EXACT * largest:
        return OPEN
    if state == STICK:
        if mu > 0.0 and abs(rub) > mu * push + EXACT * largest:
            return SLIP if rub < 0.0 else -SLIP
        return STICK
    turns = rate_of(m, j, ACROSS, m.after) / sqrt(m.block[j, 3]) * state < -EXACT * size
    return STICK if turns else state


@subkernel
def _correct_modes(m, size):
    k, count, largest = m.number[0], 0, 0.0
    for j in range(k):
        largest = max(largest, m.normal[j] * sqrt(m.block[j, 0]))
    for j in range(k):
        better = _better_mode(m, j, size, largest)
        count += better != m.states[j]
        m.states[j] = better
    return count


@subkernel
def _take_modes(m):
    for j in range(m.number[0]):
        limit = m.friction[j] * m.normal[j]
        m.states[j] = OPEN
        if m.normal[j] > 0.0:
            m.states[j] = STICK
            if limit > 0.0 and abs(m.tangent[j]) >= limit * (1.0 - 1e-9):
                m.states[j] = SLIP if m.tangent[j] < 0.0 else -SLIP


@subkernel
def _agree(c, m, velocities, size):
    """Find modes and impulses that agree, beginning with those of sweeps; return whether this succeeds."""
    _take_modes(m)
    for j in range(m.number[0]):  # redundant contacts share their impulses as before, not as sweeps have left them
        m.normal[j], m.tangent[j] = m.krylov[8, j], m.krylov[8, m.number[0] + j]
    # changing all contradicted modes at once may cycle; patience ends that
    least, patience = len(m.states) + 1, PATIENCE
    for _ in range(MOST_CHANGES):
        if not _solve(c, m, velocities, size):
            return False
        count = _correct_modes(m, size)
        if count == 0:
            return True
        if count < least:
            least, patience = count, PATIENCE
        elif patience == 0:
            return False
        else:
            patience -= 1
    return False


@subkernel
def _agree_by_path(c, m, velocities):
    """Find modes and impulses that agree, beginning with those of sweeps, by a path; return whether this succeeds."""
    k, w, s = m.number[0], m.cones, m.active
    if k > MOST_FACTORIZED:
        return False
    for column in range(2 * k):
        j, at = column % k, ALONG if column < k else ACROSS
        fill(m.x, 0.0)
        _move(c, m, j, at, 1.0, m.x)
        for i in range(k):
            w.response[i, column], w.response[k + i, column] = rate_of(m, i, ALONG, m.x), rate_of(m, i, ACROSS, m.x)
    # from the impulses of the sweeps, which the attempt before has changed
    for j in range(k):
        m.normal[j], m.tangent[j] = m.krylov[7, j], m.krylov[7, k + j]
    _take_modes(m)
    for j in range(k):
        w.free[j], w.free[k + j] = rate_of(m, j, ALONG, velocities) + m.more[j], rate_of(m, j, ACROSS, velocities)
        w.friction[j], s.modes[j] = m.friction[j], m.states[j]
        w.forces[j], w.forces[k + j] = m.normal[j], m.tangent[j]
        s.start[j], s.start[k + j] = m.krylov[8, j], m.krylov[8, k + j]
    if not solve_by_path(s, w, k):
        return False
    for j in range(k):
        m.states[j], m.normal[j], m.tangent[j] = s.modes[j], w.forces[j], w.forces[k + j]
    _find_after(c, m, velocities)
    return True


@subkernel
def push_many(c, m, velocities, precision):
    """Find the impulses of many contacts; see `mbdkit_contact.kernels.step_impulses.push_apart`.

    If `precision` is above `PRECISION`, sweeps suffice.
    """
    k, size, scaled = m.number[0], 0.0, 0.0
    for j in range(k):
        normal, slip = rate_of(m, j, ALONG, velocities) + m.more[j], rate_of(m, j, ACROSS, velocities)
        size = max(size, abs(normal), abs(slip))
        scaled = max(scaled, abs(normal) / sqrt(m.block[j, 0]), abs(slip) / sqrt(m.block[j, 3]))
    given, before = m.krylov[7], m.krylov[8]
    for j in range(k):
        before[j], before[k + j] = m.normal[j], m.tangent[j]
    _find_after(c, m, velocities)
    # rough results suffice for the projection of positions, which the next step repeats
    is_rough, is_exact = precision > PRECISION, False
    worst = _sweep(c, m, SWEEPS if is_rough else FIRST_SWEEPS, precision * size)
    for turn in range(0 if is_rough else 2):
        if turn > 0:
            worst = _sweep(c, m, SWEEPS - FIRST_SWEEPS, 0.0)
        for j in range(k):
            given[j], given[k + j] = m.normal[j], m.tangent[j]
        is_exact = _agree(c, m, velocities, scaled) or _agree_by_path(c, m, velocities)
        if is_exact:
            worst = EXACT * size
            for j in range(k):
                m.normal[j] = max(m.normal[j], 0.0)
            break
        for j in range(k):
            m.normal[j], m.tangent[j] = given[j], given[k + j]
        _find_after(c, m, velocities)
    for j in range(k):
        m.closed[j] = m.normal[j] > 0.0 or (is_exact and m.states[j] != OPEN)
        m.slipping[j] = abs(m.tangent[j]) >= m.friction[j] * m.normal[j]
        if is_exact:
            m.slipping[j] = m.states[j] != STICK or m.friction[j] == 0.0
    m.error[0] = worst / size if size > 0.0 else 0.0
    return worst <= ACCEPTED * size or is_rough
