"""Linear complementarity problems, solved by Lemke's method, and forces of contacts with planar Coulomb friction.

R. W. Cottle, J.-S. Pang and R. E. Stone, The Linear Complementarity Problem, 1992, section 4.4; D. E. Stewart and
J. C. Trinkle, International Journal for Numerical Methods in Engineering 39:2673-2691, 1996.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.bundle_types import IntVector, RealMatrix, RealVector
from mbdkit.engine.native.functions import subkernel

#: Entries of a scaled tableau whose magnitude is below the first of these are treated as zero; the next one is tried if
#: the solution is inaccurate. Rows of contacts on one surface are equal up to gaps in the order of 1e-10 m, and a pivot
#: that is the difference of two such rows has lost most of its digits.
TINY = (1e-11, 1e-8, 1e-5)
ACCURATE = 1e-9  #: Largest error of an accurate solution of a scaled problem.


class Cones(NamedTuple):
    """Data of up to K contacts with friction, of which the first k are used, and work arrays.

    Each normal force N is positive only if the contact does not open: ``0 <= N, 0 <= u_n, N u_n = 0``, where u are the
    accelerations of the contacts, or their velocities after an impact. Each friction force T satisfies
    ``|T| <= mu N``; if u_t is not 0, then T has the magnitude mu N and opposes u_t.
    """

    #: (2 K, 2 K) matrix that maps forces to accelerations; in both, the k normal components come first.
    response: RealMatrix
    free: RealVector  #: (2 K,) accelerations without these forces, in the same order.
    friction: RealVector  #: (K,) coefficients mu.
    #: (K,) directions of slip, 1 or -1, of contacts that slip already; their friction force is -mu N times the
    #: direction. 0 for other contacts.
    sliding: RealVector
    #: (K,) normal forces whose effects `free` includes already. The forces found are added to them, and the limits of
    #: friction follow from the sums.
    pressed: RealVector
    forces: RealVector  #: (2 K,) result: the forces, normal ones first.
    closed: IntVector  #: (K,) result: whether the normal force is a basic variable of the solution.
    slipping: IntVector  #: (K,) result: whether friction is at its limit.
    #: (K,) work arrays: scale of each contact, and index of its row among those that may stick, or -1.
    scale: RealVector
    sticks: IntVector
    #: (N, N) and (N,) work arrays, N = 4 K: the complementarity problem ``w = matrix z + right``, and its solution.
    matrix: RealMatrix
    right: RealVector
    z: RealVector
    best: RealVector
    basic: IntVector
    best_basic: IntVector
    tableau: RealMatrix  #: (N, 2 N + 2) work array, and (N,) basic variables and possible pivots.
    basis: IntVector
    able: IntVector


def new_cones(most: int, most_pivoted: int | None = None) -> Cones:
    """Return arrays for up to `most` contacts, of which up to `most_pivoted` (None: all) are solved by pivoting."""
    n = 4 * (most if most_pivoted is None else most_pivoted)

    def integers(size: int) -> np.ndarray:
        return np.zeros(size, dtype=np.int64)

    return Cones(
        np.zeros((2 * most, 2 * most)), np.zeros(2 * most), np.zeros(most), np.zeros(most), np.zeros(most),
        np.zeros(2 * most), integers(most), integers(most), np.zeros(most), integers(most),
        np.zeros((n, n)), np.zeros(n), np.zeros(n), np.zeros(n), integers(n), integers(n),
        np.zeros((n, 2 * n + 2)), integers(n), integers(n),
    )  # fmt: skip


@subkernel
def _leaving_row(w, n, entering, tiny):
    """Return the row that leaves the basis, or -1 if the method ends on a ray.

    On a tie, it is the artificial variable if possible, else the lexicographic least row.
    """
    largest = 1.0
    for i in range(n):
        largest = max(largest, abs(w.tableau[i, entering]))
    least = np.inf
    for i in range(n):
        if w.tableau[i, entering] > tiny * largest:
            least = min(least, w.tableau[i, 2 * n + 1] / w.tableau[i, entering])
    if least == np.inf:
        return -1
    count = 0
    limit = least + tiny * max(1.0, abs(least))
    for i in range(n):
        if w.tableau[i, entering] > tiny * largest and w.tableau[i, 2 * n + 1] / w.tableau[i, entering] <= limit:
            if w.basis[i] == 2 * n:
                return i
            w.able[count] = i
            count += 1
    # the lexicographic rule: without it, ties of contacts on one surface make the method cycle
    place = 0
    while count > 1 and place < n:
        least = np.inf
        for k in range(count):
            least = min(least, w.tableau[w.able[k], place] / w.tableau[w.able[k], entering])
        kept = 0
        for k in range(count):
            if w.tableau[w.able[k], place] / w.tableau[w.able[k], entering] <= least + tiny:
                w.able[kept] = w.able[k]
                kept += 1
        count = kept
        place += 1
    return w.able[0]


@subkernel
def _pivoted(w, n, tiny):
    """Solve the complementarity problem by Lemke's method with a lexicographic rule; return whether it succeeded.

    Entries below `tiny`, relative to the largest in the column if this is above 1, are treated as zero. The columns of
    the tableau are w, z, the artificial variable and the right side. Those of w record the inverse of the basis, which
    the lexicographic rule needs to break ties.
    """
    row = 0
    for i in range(n):
        w.z[i] = 0.0
        w.basic[i] = 0
        if w.right[i] < w.right[row]:
            row = i
    if n == 0 or w.right[row] >= 0.0:
        return True
    t, last, artificial = w.tableau, 2 * n + 1, 2 * n
    for i in range(n):
        for j in range(n):
            t[i, j] = 0.0
            t[i, n + j] = -w.matrix[i, j]
        t[i, i], t[i, artificial], t[i, last] = 1.0, -1.0, w.right[i]
        w.basis[i] = i
    entering = artificial
    for _ in range(50 * (n + 1)):
        pivot = t[row, entering]
        for j in range(last + 1):
            t[row, j] /= pivot
        for i in range(n):
            factor = t[i, entering]
            if i != row and factor != 0.0:
                for j in range(last + 1):
                    t[i, j] -= factor * t[row, j]
        leaving, w.basis[row] = w.basis[row], entering
        # without the artificial variable, the basis is a solution of the problem itself
        if leaving == artificial:
            for i in range(n):
                if w.basis[i] >= n:
                    w.z[w.basis[i] - n] = max(t[i, last], 0.0)
                    w.basic[w.basis[i] - n] = 1
            return True
        entering = leaving + n if leaving < n else leaving - n
        row = _leaving_row(w, n, entering, tiny)
        if row < 0:
            return False
    return False


@subkernel
def _error(w, n):
    """Return the error of the solution of the complementarity problem, relative to its largest entry."""
    worst, size = 0.0, 1.0
    for i in range(n):
        rate = w.right[i]
        for j in range(n):
            rate += w.matrix[i, j] * w.z[j]
        worst = max(worst, -rate, min(w.z[i], rate))
        size = max(size, w.z[i])
    return worst / size


@subkernel
def complementary(w, n):
    """Solve the complementarity problem with the thresholds `TINY` in turn; return whether there is a solution.

    If no solution is accurate, the most accurate one is kept.
    """
    least = np.inf
    for tiny in TINY:
        if not _pivoted(w, n, tiny):
            continue
        error = _error(w, n)
        if error < least:
            least = error
            for i in range(n):
                w.best[i], w.best_basic[i] = w.z[i], w.basic[i]
        if error <= ACCURATE:
            break
    if least == np.inf:
        return False
    for i in range(n):
        w.z[i], w.basic[i] = w.best[i], w.best_basic[i]
    return True


@subkernel
def _assemble(w, k):
    """Write the scaled complementarity problem of k contacts; return its size, and the size of its right side.

    Its unknowns are the normal forces, then, for contacts that may stick, the friction forces in both directions and
    the slips.
    """
    m = 0
    for i in range(k):
        # masses of the bodies may differ by many orders; with unit diagonals, one threshold serves all rows
        size = sqrt(max(w.response[i, i], w.response[k + i, k + i]))
        w.scale[i] = 1.0 / size if size > 0.0 else 1.0
        w.sticks[i] = -1
        if w.sliding[i] == 0.0 and w.friction[i] > 0.0:
            w.sticks[i] = m
            m += 1
    n = k + 3 * m
    for i in range(n):
        for j in range(n):
            w.matrix[i, j] = 0.0
    for i in range(k):
        p = w.sticks[i]
        w.right[i] = w.scale[i] * w.free[i]
        if p >= 0:
            w.right[k + p] = w.scale[i] * w.free[k + i]
            w.right[k + m + p] = -w.right[k + p]
            w.right[k + 2 * m + p] = w.friction[i] * w.pressed[i] / w.scale[i]
            w.matrix[k + p, k + 2 * m + p] = w.matrix[k + m + p, k + 2 * m + p] = 1.0
            w.matrix[k + 2 * m + p, i] = w.friction[i]
            w.matrix[k + 2 * m + p, k + p] = w.matrix[k + 2 * m + p, k + m + p] = -1.0
        for j in range(k):
            both, r = w.scale[i] * w.scale[j], w.sticks[j]
            nn, nt = both * w.response[i, j], both * w.response[i, k + j]
            tn, tt = both * w.response[k + i, j], both * w.response[k + i, k + j]
            share = w.friction[j] * w.sliding[j]
            w.matrix[i, j] = nn - nt * share
            if p >= 0:
                w.matrix[k + p, j] = tn - tt * share
                w.matrix[k + m + p, j] = -w.matrix[k + p, j]
            if r >= 0:
                w.matrix[i, k + r], w.matrix[i, k + m + r] = nt, -nt
                if p >= 0:
                    w.matrix[k + p, k + r] = w.matrix[k + m + p, k + m + r] = tt
                    w.matrix[k + p, k + m + r] = w.matrix[k + m + p, k + r] = -tt
    largest = 0.0
    for i in range(n):
        largest = max(largest, abs(w.right[i]))
    return m, largest


@subkernel
def solve_cones(w, k):
    """Find the forces of the first k contacts; return whether there is a solution."""
    m, largest = _assemble(w, k)
    n = k + 3 * m
    # solutions are proportional to the right side, whose size has no meaning for the thresholds
    if largest == 0.0:
        largest = 1.0
    for i in range(n):
        w.right[i] /= largest
    if not complementary(w, n):
        return False
    for i in range(k):
        p, normal = w.sticks[i], largest * w.z[i]
        tangent = -w.friction[i] * w.sliding[i] * normal
        w.slipping[i] = 1
        if p >= 0:
            tangent = largest * (w.z[k + p] - w.z[k + m + p])
            w.slipping[i] = w.basic[k + 2 * m + p]
        w.closed[i] = w.basic[i]
        w.forces[i], w.forces[k + i] = w.scale[i] * normal, w.scale[i] * tangent
    return True
