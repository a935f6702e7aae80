"""Accelerations of a mechanism with rigid contacts in given modes."""

from __future__ import annotations

from math import sqrt
from typing import Annotated, NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_loaded, solve_system, substitute_by_pivots, substitute_by_schur
from mbdkit.engine.kernels.bundle_types import IntVector, RealCube, RealMatrix, RealVector
from mbdkit.engine.kernels.equations import load_equations
from mbdkit.engine.kernels.system import NOT_FINITE, OK, prepare, solved_rows
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.functions import kernel, subkernel
from mbdkit.mechanism.contacts import OPEN, SLIP, STICK
from mbdkit_contact.kernels.kinematics import Shapes, choose, place, row_of

SINGULAR = 1e-11
"""Singular values of the equations of contact forces below this share of the largest one indicate redundant rows."""


class ClosedContacts(NamedTuple):
    """Up to K closed contacts of C, with U <= 2 K unknown forces, and work arrays; N = 3 (B + 1)."""

    shapes: Shapes
    kinetic: RealVector
    """(C,) coefficients of kinetic friction."""
    closed: IntVector
    """(K,) result: indices of the closed contacts, and for each that sticks the index of its friction force, or -1."""
    sticks: IntVector
    rows: Annotated[RealMatrix, 16]
    """(K, 16) result: quantities of the closed contacts; see `mbdkit_contact.contact_rows.QUANTITIES`."""
    share: RealVector
    """(K,) ratios of friction force and normal force of contacts that slip; 0 for those that stick."""
    normal: RealVector
    """(K,) results: normal and friction forces."""
    tangent: RealVector
    failed: IntVector
    """(1,) result: place of a closed contact that its own friction presses together more than it is pressed, or -1."""
    held: RealMatrix
    """(U, N) derivatives of the constraints that closed contacts impose, and (U, N) directions of their forces."""
    pushed: RealMatrix
    moved: RealMatrix
    """(U, N) accelerations and (U, P, 2) multipliers that unit forces cause alone."""
    loaded: RealCube
    free: RealVector
    """(N,) accelerations and (P, 2) multipliers without contacts."""
    free_lam: RealMatrix
    matrix: RealMatrix
    """(U, U) equations of the forces, and work arrays of their solution."""
    columns: RealMatrix
    turns: RealMatrix
    right: RealVector
    forces: RealVector
    weights: RealVector
    sizes: RealVector
    order: IntVector


def new_closed_contacts(shapes: Shapes, kinetic: np.ndarray, most: int, n: int, pairs: int) -> ClosedContacts:
    """Return arrays for up to `most` closed contacts of a mechanism with n coordinates and P pairs of rows."""
    u, size = 2 * most, n + 3
    square = (u, u)
    return ClosedContacts(
        shapes, kinetic, np.zeros(most, dtype=np.int64), np.zeros(most, dtype=np.int64), np.zeros((most, 16)),
        np.zeros(most), np.zeros(most), np.zeros(most), np.zeros(1, dtype=np.int64),
        np.zeros((u, size)), np.zeros((u, size)), np.zeros((u, size)), np.zeros((u, pairs, 2)),
        np.zeros(size), np.zeros((pairs, 2)), np.zeros(square), np.zeros(square), np.zeros(square),
        np.zeros(u), np.zeros(u), np.zeros(u), np.zeros(u), np.zeros(u, dtype=np.int64),
    )  # fmt: skip


@subkernel
def _triangular(s, count):
    """Reduce the weighted matrix to triangular form by reflections with exchange of columns; return its rank.

    ``columns[j, i]`` is then row i of column j, and ``order[j]`` its column in the matrix; ``sizes`` is the transformed
    right-hand side.
    """
    a, b = s.columns, s.sizes
    for j in range(count):
        s.order[j], b[j] = j, s.right[j]
        for i in range(count):
            a[j, i] = s.matrix[i, j] * s.weights[j]
    first = 0.0
    for k in range(count):
        best, largest = k, -1.0
        for j in range(k, count):
            square = 0.0
            for i in range(k, count):
                square += a[j, i] * a[j, i]
            if square > largest:
                best, largest = j, square
        if k == 0:
            first = largest
        if not largest > SINGULAR * SINGULAR * first:
            return k
        s.order[k], s.order[best] = s.order[best], s.order[k]
        for i in range(count):
            a[k, i], a[best, i] = a[best, i], a[k, i]
        alpha = sqrt(largest) if a[k, k] <= 0.0 else -sqrt(largest)
        half = largest - alpha * a[k, k]
        a[k, k] -= alpha
        for j in range(k + 1, count):
            product = 0.0
            for i in range(k, count):
                product += a[k, i] * a[j, i]
            for i in range(k, count):
                a[j, i] -= product / half * a[k, i]
        product = 0.0
        for i in range(k, count):
            product += a[k, i] * b[i]
        for i in range(k, count):
            b[i] -= product / half * a[k, i]
        a[k, k] = alpha
    return count


@subkernel
def _solve_triangle(a, rank, right, x):
    """Solve the triangular system of the first columns, whose right-hand side may be the solution `x` itself."""
    for i in range(rank - 1, -1, -1):
        value = right[i]
        for j in range(i + 1, rank):
            value -= a[j, i] * x[j]
        x[i] = value / a[i, i]


@subkernel
def least_squares(s, count):
    """Write the solution of least norm of ``matrix diag(weights) x = right`` into ``s.forces``; return the rank.

    Of all solutions, ``y - S z`` with ``S = R11^-1 R12`` and the other components z, that of least norm satisfies
    ``(I + S^T S) z = S^T y`` (G. H. Golub and C. F. Van Loan, Matrix Computations, 2013, section 5.5).
    """
    a, b, y, lean = s.columns, s.sizes, s.forces, s.turns
    rank = _triangular(s, count)
    _solve_triangle(a, rank, b, y)
    extra = count - rank
    for e in range(extra):
        _solve_triangle(a, rank, a[rank + e], lean[e])
        b[e] = 0.0
        for i in range(rank):
            b[e] += lean[e, i] * y[i]
    for e in range(extra):  # Cholesky factors, in the columns that are no longer needed
        for f in range(e + 1):
            value = 1.0 if e == f else 0.0
            for i in range(rank):
                value += lean[e, i] * lean[f, i]
            for g in range(f):
                value -= a[rank + e, g] * a[rank + f, g]
            a[rank + e, f] = sqrt(value) if e == f else value / a[rank + f, f]
        for f in range(e):
            b[e] -= a[rank + e, f] * b[f]
        b[e] /= a[rank + e, e]
    for e in range(extra - 1, -1, -1):
        for f in range(e + 1, extra):
            b[e] -= a[rank + f, e] * b[f]
        b[e] /= a[rank + e, e]
    for e in range(extra):
        y[rank + e] = b[e]
        for i in range(rank):
            y[i] -= lean[e, i] * b[e]
    for j in range(count):
        b[j] = y[j]
    for j in range(count):
        y[s.order[j]] = b[j]
    return rank


@subkernel
def _directions(s, modes, has_friction, has_slips):
    """Find the closed contacts, and write the constraints that they impose; return their number, and that of forces.

    First come the gaps of the k contacts, with friction that is a share of the normal force, and then, if `has_slips`,
    the slips of those that stick.
    """
    k = 0
    last = -1
    for i in range(len(modes)):
        if modes[i] != OPEN:
            if s.shapes.contacts[i, 3] != last:
                last = s.shapes.contacts[i, 3]
                choose(s.shapes, last)
            row_of(s.shapes, i, s.rows[k])
            s.closed[k], s.sticks[k] = i, -1
            s.share[k] = 0.0
            if has_friction and modes[i] != STICK:
                s.share[k] = -s.kinetic[i] if modes[i] == SLIP else s.kinetic[i]
            k += 1
    count = k
    for j in range(k):
        if has_slips and modes[s.closed[j]] == STICK:
            s.sticks[j] = count
            count += 1
    ground = len(s.free) - 3
    for j in range(count):
        for d in range(len(s.free)):
            s.held[j, d] = s.pushed[j, d] = 0.0
    for j in range(k):
        first, second = 3 * s.shapes.contacts[s.closed[j], 0], 3 * s.shapes.contacts[s.closed[j], 1]
        for d in range(6):
            at = first + d if d < 3 else second + d - 3
            if at >= ground:
                continue
            along, across = s.rows[j, 2 + d], s.rows[j, 8 + d]
            s.held[j, at] += along
            s.pushed[j, at] += along + s.share[j] * across
            if s.sticks[j] >= 0:
                s.held[s.sticks[j], at] += across
                s.pushed[s.sticks[j], at] += across
    return k, count


@subkernel
def _answers(eq, s, count):
    """Write the accelerations and multipliers that unit forces cause alone; return a status."""
    top, w = eq.top, eq.w
    for j in range(len(w.gamma)):
        w.gamma[j, 0] = w.gamma[j, 1] = 0.0
    top.gravity[0] = top.gravity[1] = 0.0
    for j in range(count):
        copy(s.pushed[j], w.force)
        if eq.solver.pivoted[0] != 0:
            status = substitute_by_pivots(top, w, eq.solver, True, eq.a, eq.lam)
            if status != OK:
                return status
        else:
            substitute_by_schur(top, w, eq.solver.schur, True, eq.a, eq.lam, True)
        copy(eq.a, s.moved[j])
        for p in range(len(eq.lam)):
            s.loaded[j, p, 0], s.loaded[j, p, 1] = eq.lam[p, 0], eq.lam[p, 1]
    return OK


@subkernel
def _assemble(s, count):
    """Write the equations of the forces with which the constraints have the values ``s.right``."""
    size = len(s.free) - 3
    for i in range(count):
        s.weights[i] = 1.0
        for d in range(size):
            s.right[i] -= s.held[i, d] * s.free[d]
        for j in range(count):
            s.matrix[i, j] = 0.0
            for d in range(size):
                s.matrix[i, j] += s.held[i, d] * s.moved[j, d]


@subkernel
def _find_forces(s, k, count):
    """Write the forces of the closed contacts.

    Redundant contacts that stick share the friction force in proportion to their normal forces.
    """
    _assemble(s, count)
    s.failed[0] = -1
    for j in range(k):
        if s.matrix[j, j] <= 0.0 and s.share[j] != 0.0 and s.failed[0] < 0:
            s.failed[0] = j
    if s.failed[0] >= 0:
        return
    rank = least_squares(s, count)
    if rank < count and count > k:
        largest = 0.0
        for j in range(k):
            largest = max(largest, abs(s.forces[j]))
        for j in range(k):
            if s.sticks[j] >= 0:
                s.weights[s.sticks[j]] = sqrt(max(s.forces[j], 1e-9 * largest))
        least_squares(s, count)
        for j in range(count):
            s.forces[j] *= s.weights[j]
    for j in range(k):
        s.normal[j], s.tangent[j] = s.forces[j], s.share[j] * s.forces[j]
        if s.sticks[j] >= 0:
            s.tangent[j] = s.forces[s.sticks[j]]


@subkernel
def _sum_up(eq, s, count, a, lam):
    """Write accelerations (n,) and multipliers (m,), those of contacts included; return a status."""
    n = len(a)
    for d in range(n):
        a[d] = s.free[d]
        for j in range(count):
            a[d] += s.forces[j] * s.moved[j, d]
        if not abs(a[d]) < np.inf:
            return NOT_FINITE
    for p in range(len(eq.lam)):
        for r in range(eq.top.rows[p]):
            row = eq.solver.row_index[p, r] - n
            lam[row] = s.free_lam[p, r]
            for j in range(count):
                lam[row] += s.forces[j] * s.loaded[j, p, r]
    return OK


@kernel
def closed_accelerations(
    address: int, t: float, s: ClosedContacts, q: RealVector, v: RealVector, modes: IntVector, a: RealVector,
    lam: RealVector,
) -> int:  # fmt: skip
    """Write the accelerations (n,) and multipliers (m,) with contacts in given modes (C,); return a status.

    `address` is that of an `Equations` bundle.
    """
    eq = load_equations(address)
    top, w = eq.top, eq.w
    n = len(q)
    for d in range(n):
        eq.q[d], eq.v[d] = q[d], v[d]
    prepare(top, w, t, eq.q)
    solved_rows(top, w, eq.q, eq.v)
    top.gravity[0], top.gravity[1] = eq.gravity[0], eq.gravity[1]
    status = solve_loaded(top, w, eq.solver, eq.q, eq.v, eq.a, eq.lam, True)
    if status != OK:
        return status
    copy(eq.a, s.free)
    for p in range(len(eq.lam)):
        s.free_lam[p, 0], s.free_lam[p, 1] = eq.lam[p, 0], eq.lam[p, 1]
    place(s.shapes, q, v)
    k, count = _directions(s, modes, True, True)
    status = _answers(eq, s, count)
    if status != OK:
        return status
    for j in range(k):  # gaps and slips do not accelerate
        s.right[j] = s.rows[j, 14]
        if s.sticks[j] >= 0:
            s.right[s.sticks[j]] = s.rows[j, 15]
    _find_forces(s, k, count)
    return OK if s.failed[0] >= 0 else _sum_up(eq, s, count, a, lam)


@kernel
def closed_solution(
    address: int, t: float, s: ClosedContacts, q: RealVector, force: RealVector, rows: RealVector, modes: IntVector,
    x: RealVector, mu: RealVector,
) -> int:  # fmt: skip
    """Solve ``M x + Phi_q^T mu = force``, ``Phi_q x = rows`` with the gaps of closed contacts among the constraints.

    The rows of the joints come first, then those of the gaps, and then, if there are so many, those of the slips of
    contacts that stick. Forces of contacts have least norm; those of joints are `mu`. Returns a status.
    """
    eq = load_equations(address)
    top, w = eq.top, eq.w
    n, m = len(q), len(mu)
    for d in range(n):
        eq.q[d], eq.v[d] = q[d], 0.0
    prepare(top, w, t, eq.q)
    solved_rows(top, w, eq.q, eq.v)
    for d in range(n):
        w.force[d] = force[d]
    for p in range(len(top.pairs)):
        w.gamma[p, 0] = w.gamma[p, 1] = 0.0
        for r in range(top.rows[p]):
            w.gamma[p, r] = rows[eq.solver.row_index[p, r] - n]
    top.gravity[0] = top.gravity[1] = 0.0
    status = solve_system(top, w, eq.solver, True, eq.a, eq.lam, True)
    if status != OK:
        return status
    copy(eq.a, s.free)
    for p in range(len(eq.lam)):
        s.free_lam[p, 0], s.free_lam[p, 1] = eq.lam[p, 0], eq.lam[p, 1]
    place(s.shapes, q, q)
    closed = 0
    for i in range(len(modes)):
        closed += modes[i] != OPEN
    _, count = _directions(s, modes, False, len(rows) > m + closed)
    status = _answers(eq, s, count)
    if status != OK:
        return status
    for j in range(count):
        s.right[j] = rows[m + j]
    _assemble(s, count)
    least_squares(s, count)
    return _sum_up(eq, s, count, x, mu)
