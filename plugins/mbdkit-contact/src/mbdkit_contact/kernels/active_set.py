"""Forces of contacts with Coulomb friction by an active-set method, which begins with the modes and forces of before.

For given modes, the forces of the closed contacts are the solution of linear equations. These may be singular, because
contacts can be redundant; the solution is then the one nearest to the forces of before, by the proximal-point iteration
``(A + eps D) (x' - x) = b - A x``. All modes that contradict the solution change, until none does: the forces then
satisfy all laws to rounding errors. `mbdkit_contact.kernels.mode_path` finds the forces where this does not succeed.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.bundle_types import IntVector, RealMatrix, RealVector
from mbdkit.engine.native.functions import subkernel
from mbdkit_contact.modes import OPEN, SLIP, STICK

PROXIMAL = 1e-9  #: Share of the diagonal of the equations that is added to it.
MOST_REFINEMENTS = 8  #: Largest number of iterations of the proximal-point method; two or three are usual.
#: Largest number of times that modes change, and number of times that they may change without progress.
MOST_CHANGES, PATIENCE = 24, 3
EXACT = 1e-12  #: Errors of velocities and forces below this share of the largest ones count as zero.


class ActiveSet(NamedTuple):
    """Work arrays for up to K contacts, U = 2 K."""

    #: (K,) modes: on input a guess, on output those of the solution; ``-SLIP`` is slip in the negative direction.
    modes: IntVector
    start: RealVector  #: (U,) forces to which the solution is the nearest one, normal ones first.
    unknown: IntVector  #: (U,) index of each unknown: that of a normal force, or k more for a friction force.
    share: RealVector  #: (K,) ratios of friction force and normal force of contacts that slip.
    scale: RealVector  #: (K,) scales of the contacts.
    matrix: RealMatrix  #: (U, U) equations of the forces, and (U, U) factors.
    factors: RealMatrix
    x: RealVector  #: (U,) work arrays: scaled forces, the right sides of equations and their solution.
    change: RealVector
    z: RealVector
    order: IntVector  #: (U,) order of the rows of the factors.
    path: RealMatrix  #: (8, U) vectors of `mbdkit_contact.kernels.mode_path`.


def new_active_set(most: int) -> ActiveSet:
    """Return arrays for up to `most` contacts."""
    u = 2 * most
    return ActiveSet(
        np.zeros(most, dtype=np.int64), np.zeros(u), np.zeros(u, dtype=np.int64), np.zeros(most), np.zeros(most),
        np.zeros((u, u)), np.zeros((u, u)), np.zeros(u), np.zeros(u), np.zeros(u), np.zeros(u, dtype=np.int64),
        np.zeros((8, u)),
    )  # fmt: skip


@subkernel
def assemble(s, w, k):
    """Write the scaled equations of the forces in the present modes; return their number."""
    count = 0
    for i in range(k):
        s.share[i] = 0.0
        if s.modes[i] != OPEN:
            s.unknown[count] = i
            count += 1
            if s.modes[i] != STICK:
                s.share[i] = -w.friction[i] if s.modes[i] == SLIP else w.friction[i]
    for i in range(k):
        if s.modes[i] == STICK and w.friction[i] > 0.0:
            s.unknown[count] = k + i
            count += 1
    for a in range(count):
        row = s.unknown[a]
        for b in range(count):
            column = s.unknown[b]
            value = w.response[row, column]
            if column < k and s.share[column] != 0.0:
                value += s.share[column] * w.response[row, k + column]
            s.matrix[a, b] = s.scale[row % k] * s.scale[column % k] * value
    return count


@subkernel
def factorize(s, count, share):
    """Factorize the equations by elimination with row exchange; return whether it succeeded.

    `share` is the share of the diagonal that is added to it.
    """
    f = s.factors
    for a in range(count):
        s.order[a] = a
        for b in range(count):
            f[a, b] = s.matrix[a, b]
        # redundant contacts make the equations singular; the share is taken out again by the refinement
        f[a, a] += share
    for j in range(count):
        best = j
        for a in range(j + 1, count):
            if abs(f[a, j]) > abs(f[best, j]):
                best = a
        if not abs(f[best, j]) > 0.0:
            return False
        if best != j:
            s.order[j], s.order[best] = s.order[best], s.order[j]
            for b in range(count):
                f[j, b], f[best, b] = f[best, b], f[j, b]
        inverse = 1.0 / f[j, j]
        for a in range(j + 1, count):
            if f[a, j] != 0.0:
                f[a, j] *= inverse
                factor = f[a, j]
                for b in range(j + 1, count):
                    f[a, b] -= factor * f[j, b]
    return True


@subkernel
def substitute(s, count):
    """Solve the factorized equations with the right side ``s.change`` for ``s.z``."""
    f = s.factors
    for a in range(count):  # the factors have the rows in the order of the exchanges
        value = s.change[s.order[a]]
        for b in range(a):
            value -= f[a, b] * s.z[b]
        s.z[a] = value
    for a in range(count - 1, -1, -1):
        value = s.z[a]
        for b in range(a + 1, count):
            value -= f[a, b] * s.z[b]
        s.z[a] = value / f[a, a]


@subkernel
def _solve(s, w, k, count, size):
    """Write the scaled forces of the closed contacts into ``s.x``; return whether they satisfy the equations."""
    for a in range(count):
        row = s.unknown[a]
        s.x[a] = s.start[row] / s.scale[row % k]
    worst = np.inf
    for _ in range(MOST_REFINEMENTS):
        worst = 0.0
        for a in range(count):
            row = s.unknown[a]
            rest = -s.scale[row % k] * w.free[row]
            for b in range(count):
                rest -= s.matrix[a, b] * s.x[b]
            if not abs(rest) < np.inf:
                return False
            worst = max(worst, abs(rest))
            s.change[a] = rest
        if worst <= 0.01 * EXACT * size:
            break
        substitute(s, count)
        for a in range(count):
            s.x[a] += s.z[a]
    return worst <= EXACT * size


@subkernel
def _better_mode(s, w, k, i, size, largest):
    """Return the mode of a contact that the forces do not contradict.

    A closed contact without pressing force opens, an open one that approaches closes, one that sticks with more
    friction than its limit slips, and one whose slip would change its direction sticks.
    """
    push, rub, mode = w.forces[i] / s.scale[i], w.forces[k + i] / s.scale[i], s.modes[i]
    if mode != OPEN and push < -EXACT * largest:
        return OPEN
    row = i if mode == OPEN else k + i
    rate = w.free[row]
    for j in range(2 * k):
        rate += w.response[row, j] * w.forces[j]
    if mode == OPEN:
        return STICK if s.scale[i] * rate < -EXACT * size else OPEN
    if w.friction[i] == 0.0:
        return STICK
    if mode == STICK:
        if abs(rub) > w.friction[i] * push + EXACT * largest:
            return SLIP if rub < 0.0 else -SLIP
        return STICK
    return STICK if s.scale[i] * rate * mode < -EXACT * size else mode


@subkernel
def find_scales(s, w, k):
    """Write the scale of each contact; return the largest scaled velocity without forces."""
    size = 0.0
    for i in range(k):
        diagonal = sqrt(max(w.response[i, i], w.response[k + i, k + i]))
        s.scale[i] = 1.0 / diagonal if diagonal > 0.0 else 1.0
        size = max(size, s.scale[i] * abs(w.free[i]), s.scale[i] * abs(w.free[k + i]))
    return size


@subkernel
def solve_modes(s, w, k, size):
    """Find the forces in the present modes; return whether they satisfy the equations of these modes."""
    count = assemble(s, w, k)
    if not factorize(s, count, PROXIMAL) or not _solve(s, w, k, count, size):
        return False
    for i in range(2 * k):
        w.forces[i] = 0.0
    for a in range(count):
        row = s.unknown[a]
        w.forces[row] = s.scale[row % k] * s.x[a]
    for i in range(k):
        if s.share[i] != 0.0:
            w.forces[k + i] = s.share[i] * w.forces[i]
    return True


@subkernel
def find_better_modes(s, w, k, size):
    """Write the modes that the forces do not contradict into ``s.order``; return the number of contradictions.

    If there are none, the results are written.
    """
    wrong, largest = 0, 0.0
    for i in range(k):
        largest = max(largest, w.forces[i] / s.scale[i])
    for i in range(k):
        s.order[i] = _better_mode(s, w, k, i, size, largest)
        wrong += s.order[i] != s.modes[i]
    if wrong == 0:
        for i in range(k):
            w.forces[i] = max(w.forces[i], 0.0)
            w.closed[i] = s.modes[i] != OPEN
            w.slipping[i] = abs(s.modes[i]) == SLIP or (s.modes[i] != OPEN and w.friction[i] == 0.0)
    return wrong


@subkernel
def solve_active_set(s, w, k):
    """Find the forces of the first k contacts of the `Cones` `w` from a guess; return whether this succeeds.

    No contact may slip already, or be pressed.
    """
    size = find_scales(s, w, k)
    for i in range(2 * k):
        w.forces[i] = s.start[i]
    # changing all contradicted modes at once is fast but may cycle; without progress, the path method takes over
    least, patience = k + 1, PATIENCE
    for _ in range(MOST_CHANGES):
        if not solve_modes(s, w, k, size):
            return False
        wrong = find_better_modes(s, w, k, size)
        if wrong == 0:
            return True
        if wrong < least:
            least, patience = wrong, PATIENCE
        elif patience == 0:
            return False
        else:
            patience -= 1
        for i in range(k):
            s.modes[i] = s.order[i]
    return False
