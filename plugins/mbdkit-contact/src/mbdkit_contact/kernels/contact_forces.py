"""Forces of closed rigid contacts: constraints of the accelerations, and friction of those that slip."""

from __future__ import annotations

from math import sqrt
from typing import Annotated, NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import (
    apply_multipliers,
    joint_right_side,
    refine_multipliers,
    substitute_by_pivots,
)
from mbdkit.engine.kernels.bundle_types import IntMatrix, IntVector, RealCube, RealMatrix, RealVector
from mbdkit.engine.kernels.orthogonal import reduce_columns, solve_least_norm
from mbdkit.engine.kernels.schur import solve as schur_solve
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.kernels.vectors import fill, fill_rows
from mbdkit.engine.native.functions import separate, subkernel
from mbdkit_contact.kernels.kinematics import NOWHERE, SINGLE, Shapes, choose, row_of

#: Singular values of the equations of contact forces below this share of the largest one indicate redundant rows.
SINGULAR = 1e-11


WEAK = 1e-7  #: Pivots below this share of the largest diagonal element show that equations are no longer independent.
#: Largest component of a null vector of the equations, relative to its redundant force, that counts as zero.
SHARED = 1e-9


class ClosedContacts(NamedTuple):
    """Up to K contacts of C that act, with U <= 2 K unknown forces, and work arrays; N = 3 (B + 1).

    The first k forces are those along the normals, each with a share of it along the tangent. The forces along the
    tangents of contacts in `sticks` follow.
    """

    shapes: Shapes
    chosen: IntVector  #: (K,) indices of the contacts, and for each the index of its force along the tangent, or -1.
    sticks: IntVector
    share: RealVector  #: (K,) ratios of friction force and normal force of contacts that slip; 0 for those that stick.
    #: (K, 16) quantities of the contacts; see `mbdkit_contact.contact_rows.QUANTITIES`.
    rows: Annotated[RealMatrix, 16]
    sites: Annotated[IntMatrix, 2]  #: (U, 2) first coordinates of the bodies on which each force acts.
    #: (U, 6) derivatives of the constraints that the contacts impose, and directions of their forces.
    held: Annotated[RealMatrix, 6]
    pushed: Annotated[RealMatrix, 6]
    moved: RealMatrix  #: (U, N) accelerations and (U, P, 2) multipliers that unit forces cause alone.
    loaded: RealCube
    #: (U, P, 2) work array: the constraints of contacts on joints, after forward substitution; see `find_few_forces`.
    bound: RealCube
    matrix: RealMatrix  #: (U, U) equations of the forces, and work arrays of their solution.
    columns: RealMatrix
    turns: RealMatrix
    right: RealVector
    forces: RealVector  #: (U,) result: the forces.
    weights: RealVector
    sizes: RealVector
    order: IntVector


def new_closed_contacts(shapes: Shapes, most: int, size: int, pairs: int) -> ClosedContacts:
    """Return arrays for up to `most` contacts that act; `size` is that of vectors, and `pairs` the number P."""
    u = 2 * most

    def integers(*shape: int) -> np.ndarray:
        return np.zeros(shape, dtype=np.int64)

    return ClosedContacts(
        shapes, integers(most), integers(most), np.zeros(most), np.zeros((most, 16)),
        integers(u, 2), np.zeros((u, 6)), np.zeros((u, 6)), np.zeros((u, size)), np.zeros((u, pairs, 2)),
        np.zeros((u, pairs, 2)), np.zeros((u, u)), np.zeros((u, u)), np.zeros((u, u)), np.zeros(u), np.zeros(u),
        np.zeros(u), np.zeros(u), integers(u),
    )  # fmt: skip


@subkernel
def triangular(s, count):
    """Reduce the weighted matrix and the right-hand side to triangular form; return the rank.

    The result is in ``s.columns``, ``s.order`` and ``s.sizes``; see `mbdkit.engine.kernels.orthogonal.reduce_columns`.
    """
    for j in range(count):
        s.sizes[j] = s.right[j]
        for i in range(count):
            s.columns[j, i] = s.matrix[i, j] * s.weights[j]
    return reduce_columns(s.columns, s.order, s.sizes, (count, count), SINGULAR)


@separate
def least_squares(s, count):
    """Write the solution of least norm of ``matrix diag(weights) x = right`` into ``s.forces``; return the rank."""
    rank = triangular(s, count)
    solve_least_norm(s.columns, s.order, s.sizes, s.forces, s.turns, count, rank)
    return rank


@separate
def find_directions(s, k):
    """Evaluate the rows of the first k contacts in ``s.chosen``, and the directions of their forces; return the number
    of forces. Requires `place`.

    A contact has a force along the tangent if ``s.sticks`` is not -1; its index is written there.
    """
    last, count = -1, k
    for j in range(k):
        i = s.chosen[j]
        # a closed contact stays at its feature, although another one may be nearer by rounding errors
        if s.shapes.held[i] >= 0:
            s.shapes.features[i], s.shapes.least[i] = s.shapes.held[i], NOWHERE
        elif s.shapes.contacts[i, 3] != last:
            last = s.shapes.contacts[i, 3]
            if s.shapes.pairs[last, 0] != SINGLE:
                choose(s.shapes, last)
        row_of(s.shapes, i, s.rows[j])
        a, b = 3 * s.shapes.contacts[i, 0], 3 * s.shapes.contacts[i, 1]
        s.sites[j, 0], s.sites[j, 1] = a, b
        for d in range(6):
            s.held[j, d] = s.rows[j, 2 + d]
            s.pushed[j, d] = s.rows[j, 2 + d] + s.share[j] * s.rows[j, 8 + d]
        if s.sticks[j] >= 0:
            s.sticks[j] = count
            s.sites[count, 0], s.sites[count, 1] = a, b
            for d in range(6):
                s.held[count, d] = s.pushed[count, d] = s.rows[j, 8 + d]
            count += 1
    return count


@subkernel
def along(s, j, x):
    """Return the product of the derivatives of constraint `j` and a vector (N,)."""
    a, b, total = s.sites[j, 0], s.sites[j, 1], 0.0
    for d in range(3):
        total += s.held[j, d] * x[a + d] + s.held[j, 3 + d] * x[b + d]
    return total


@subkernel
def gap_rate(row, a, b, at, v):
    """Return the rate of a gap (``at`` = 2) or a slip (8) from the quantities (16,) of a row; `v` is (N,)."""
    total = 0.0
    for d in range(3):
        total += row[at + d] * v[a + d] + row[at + 3 + d] * v[b + d]
    return total


@separate
def find_answers(still, w, solver, s, count, refine):
    """Write the accelerations and multipliers that unit forces cause alone; return a status.

    `still` is the mechanism without gravity. With `refine`, they satisfy the constraints of joints to rounding. Uses
    the factors of the last solution of the index-1 system.
    """
    if len(w.gamma) > 0:
        fill_rows(w.gamma, 0.0)
    for j in range(count):
        a, b, acc = s.sites[j, 0], s.sites[j, 1], s.moved[j]
        # the pivoted solver has no factors of the Schur complement, so that each force is a load of its own
        if solver.pivoted[0] != 0:
            fill(w.force, 0.0)
            for d in range(3):
                w.force[a + d] += s.pushed[j, d]
                w.force[b + d] += s.pushed[j, 3 + d]
            fill(acc, 0.0)
            status = substitute_by_pivots(still, w, solver, True, acc, s.loaded[j])
            if status != OK:
                return status
            continue
        fill(acc, 0.0)
        for d in range(3):
            acc[a + d] += still.weight[a // 3, d] * s.pushed[j, d]
            acc[b + d] += still.weight[b // 3, d] * s.pushed[j, 3 + d]
        if len(w.gamma) > 0:
            joint_right_side(still, w, acc, s.loaded[j])
            schur_solve(solver.schur, s.loaded[j])
            apply_multipliers(still, w, s.loaded[j], acc, True)
            if refine:
                refine_multipliers(still, w, solver.schur, acc, s.loaded[j], True)
    return OK


@subkernel
def assemble(s, count):
    """Write the equations of the forces, whose right side is ``s.right``, for solutions of least norm."""
    for i in range(count):
        s.weights[i] = 1.0
        for j in range(count):
            s.matrix[i, j] = along(s, i, s.moved[j])


@subkernel
def _balance(s, k, free):
    """Write the right sides of the equations with which gaps and slips do not accelerate; `free` is (N,)."""
    for j in range(k):
        s.right[j] = s.rows[j, 14] - along(s, j, free)
        if s.sticks[j] >= 0:
            s.right[s.sticks[j]] = s.rows[j, 15] - along(s, s.sticks[j], free)


@subkernel
def _reduce(still, w, schur, sites, row, out):
    """Write ``L^-1 Phi_q M^-1 d`` for the Schur complement ``L D L^T`` of the joints and a row d (6,) of a contact."""
    pairs, jac, weight = still.pairs, w.jac, still.weight
    for p in range(len(pairs)):
        r0 = r1 = 0.0
        for side in range(2):
            body = pairs[p, 1 + side]
            for end in range(2):
                if 3 * body == sites[end]:
                    for i in range(3):
                        x = weight[body, i] * row[3 * end + i]
                        r0 += jac[p, 3 * side + i] * x
                        r1 += jac[p, 6 + 3 * side + i] * x
        out[p, 0] = r0
        out[p, 1] = r1 if still.rows[p] == 2 else 0.0
    for p in range(len(pairs)):
        x0, x1 = out[p, 0], out[p, 1]
        if x0 != 0.0 or x1 != 0.0:
            for e in range(schur.start[p], schur.start[p + 1]):
                i = schur.row[e]
                out[i, 0] -= schur.below[e, 0] * x0 + schur.below[e, 1] * x1
                out[i, 1] -= schur.below[e, 2] * x0 + schur.below[e, 3] * x1


@subkernel
def _assemble_few(still, w, schur, s, k, basis):
    """Write the equations of independent forces ``G (M^-1 - M^-1 Phi_q^T S^-1 Phi_q M^-1) D``, S being the Schur
    complement of the joints.
    """
    rank, pairs, diagonal = basis[0], len(w.gamma), schur.diagonal
    # the equations need products with the factors only; accelerations would cost a second substitution per force
    if pairs > 0:
        for i in range(rank):
            at = basis[1 + i]
            x = s.loaded[i]
            _reduce(still, w, schur, s.sites[at], s.held[at], s.bound[i])
            if at < k and s.share[at] != 0.0:
                _reduce(still, w, schur, s.sites[at], s.pushed[at], x)
            else:
                for p in range(pairs):
                    x[p, 0], x[p, 1] = s.bound[i, p, 0], s.bound[i, p, 1]
            for p in range(pairs):
                x0, x1 = x[p, 0], x[p, 1]
                x[p, 0] = diagonal[p, 0] * x0 + diagonal[p, 1] * x1
                x[p, 1] = diagonal[p, 1] * x0 + diagonal[p, 2] * x1
    for j in range(rank):
        at = basis[1 + j]
        d, a, b = s.pushed[at], s.sites[at, 0], s.sites[at, 1]
        wa, wb = still.weight[a // 3], still.weight[b // 3]
        a0, a1, a2, b0, b1, b2 = wa[0] * d[0], wa[1] * d[1], wa[2] * d[2], wb[0] * d[3], wb[1] * d[4], wb[2] * d[5]
        for i in range(rank):
            row, value = basis[1 + i], 0.0
            g = s.held[row]
            if s.sites[row, 0] == a:
                value += g[0] * a0 + g[1] * a1 + g[2] * a2
            elif s.sites[row, 0] == b:
                value += g[0] * b0 + g[1] * b1 + g[2] * b2
            if s.sites[row, 1] == b:
                value += g[3] * b0 + g[4] * b1 + g[5] * b2
            elif s.sites[row, 1] == a:
                value += g[3] * a0 + g[4] * a1 + g[5] * a2
            for p in range(pairs):
                value -= s.bound[i, p, 0] * s.loaded[j, p, 0] + s.bound[i, p, 1] * s.loaded[j, p, 1]
            s.matrix[i, j] = value


@subkernel
def _add_few(still, w, schur, s, basis, acc, lam):
    """Add what independent forces cause to accelerations (N,) and multipliers (P, 2)."""
    b, pairs, x = s.sizes, len(w.gamma), s.bound[0]
    for j in range(basis[0]):
        at = basis[1 + j]
        for end in range(2):
            first = s.sites[at, end]
            for d in range(3):
                acc[first + d] += b[j] * still.weight[first // 3, d] * s.pushed[at, 3 * end + d]
    if pairs == 0:
        return
    for p in range(pairs):
        x[p, 0] = x[p, 1] = 0.0
        for j in range(basis[0]):
            x[p, 0] += b[j] * s.loaded[j, p, 0]
            x[p, 1] += b[j] * s.loaded[j, p, 1]
    for p in range(pairs - 1, -1, -1):
        for e in range(schur.start[p], schur.start[p + 1]):
            i = schur.row[e]
            x[p, 0] -= schur.below[e, 0] * x[i, 0] + schur.below[e, 2] * x[i, 1]
            x[p, 1] -= schur.below[e, 1] * x[i, 0] + schur.below[e, 3] * x[i, 1]
        lam[p, 0] += x[p, 0]
        lam[p, 1] += x[p, 1]
    apply_multipliers(still, w, x, acc, True)


@separate
def find_few_forces(still, w, solver, s, k, count, basis, acc, lam):
    """Write forces as `find_forces` does, but with those of redundant equations zero, and add what they cause to the
    accelerations (N,) and multipliers (P, 2) without them; return whether this was possible.

    The accelerations are the same as with `find_forces`. `basis` holds the number of independent equations, 0 if it is
    unknown, and these equations. They are eliminated after the joints, whose factors are those of the last solution.
    """
    a, b, rank, largest = s.matrix, s.sizes, basis[0], 0.0
    # equations that were independent before may no longer be so: the caller then finds all forces anew
    if rank == 0 or rank > count or solver.pivoted[0] != 0:
        return False
    for i in range(rank):
        if basis[1 + i] >= count:
            return False
    _balance(s, k, acc)
    _assemble_few(still, w, solver.schur, s, k, basis)
    for i in range(rank):
        b[i] = s.right[basis[1 + i]]
        if not a[i, i] > 0.0:
            return False
        largest = max(largest, a[i, i])
    for i in range(rank):
        # without exchange of rows, a small pivot would lose the digits of the forces
        if not a[i, i] > WEAK * largest:
            return False
        s.weights[i] = 1.0 / a[i, i]
        for j in range(i + 1, rank):
            if a[j, i] != 0.0:  # contacts of different bodies
                factor = a[j, i] * s.weights[i]
                b[j] -= factor * b[i]
                for x in range(i + 1, rank):
                    a[j, x] -= factor * a[i, x]
    for j in range(count):
        s.forces[j] = 0.0
    for i in range(rank - 1, -1, -1):
        for j in range(i + 1, rank):
            b[i] -= a[i, j] * b[j]
        b[i] *= s.weights[i]
        s.forces[basis[1 + i]] = b[i]
    _add_few(still, w, solver.schur, s, basis, acc, lam)
    return True


@subkernel
def spread(s, count, basis, shares):
    """Replace the forces of independent equations by those of nearly least norm; return whether this was possible.

    `shares` are those of `_note_shares` at the last call of `find_forces`.
    """
    rank, b = basis[0], s.sizes
    extra = count - rank
    if 2 * extra * rank > len(shares):
        return False
    for e in range(extra):
        z = 0.0
        for i in range(rank):
            z += shares[(extra + e) * rank + i] * b[i]
        s.forces[basis[1 + rank + e]] = z
        for i in range(rank):
            s.forces[basis[1 + i]] -= shares[e * rank + i] * z
    return True


@subkernel
def _note_shares(s, rank, extra, shares):
    """Write the combinations S of forces without effect (see `mbdkit.engine.kernels.orthogonal.solve_least_norm`), and
    then ``(I + S^T S)^-1 S^T``, to `shares` if it has room for them.
    """
    lean = s.turns
    if 2 * extra * rank > len(shares):
        return
    for i in range(rank):
        for e in range(extra):
            shares[e * rank + i] = value = lean[e, i]
            for f in range(e):
                value -= lean[e, rank + f] * shares[(extra + f) * rank + i]
            shares[(extra + e) * rank + i] = value / lean[e, rank + e]
        for e in range(extra - 1, -1, -1):
            value = shares[(extra + e) * rank + i]
            for f in range(e + 1, extra):
                value -= lean[f, rank + e] * shares[(extra + f) * rank + i]
            shares[(extra + e) * rank + i] = value / lean[e, rank + e]


@subkernel
def _note_basis(s, k, count, rank, basis, shares):
    """Write the independent equations of the last solution by `least_squares`, and then the others; the number of
    independent ones is 0 if redundant forces change the accelerations, through the friction of contacts that slip.
    """
    basis[0] = rank
    for i in range(count):
        basis[1 + i] = s.order[i]
    _note_shares(s, rank, count - rank, shares)
    for e in range(rank, count):
        if s.order[e] < k and s.share[s.order[e]] != 0.0:
            basis[0] = 0
        for i in range(rank):
            if s.order[i] < k and s.share[s.order[i]] != 0.0 and abs(s.turns[e - rank, i]) > SHARED:
                basis[0] = 0


@separate
def find_forces(s, k, count, free, basis, shares):
    """Write the forces with which gaps and slips do not accelerate, for accelerations `free` (N,) without them.

    Redundant contacts that stick share the friction force in proportion to their normal forces. Returns the place of a
    contact that its own friction presses together more than it is pressed, or -1. `basis` and `shares` are for
    `find_few_forces` and `spread`.
    """
    _balance(s, k, free)
    assemble(s, count)
    for j in range(k):
        # Painleve: pressing such a contact makes it approach faster, so that no normal force keeps it closed
        if s.matrix[j, j] <= 0.0 and s.share[j] != 0.0:
            return j
    rank = least_squares(s, count)
    _note_basis(s, k, count, rank, basis, shares)
    # the solution of least norm may load contacts with friction that are hardly pressed; weights by the normal forces
    # prefer those that are
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
    return -1


@subkernel
def tangential(s, j):
    """Return the friction force of the contact at place `j`."""
    return s.forces[s.sticks[j]] if s.sticks[j] >= 0 else s.share[j] * s.forces[j]


@subkernel
def add_answers(s, count, acc, lam):
    """Add what the forces cause to accelerations (N,) and multipliers (P, 2)."""
    for j in range(count):
        for d in range(len(acc) - 3):
            acc[d] += s.forces[j] * s.moved[j, d]
        for p in range(len(lam)):
            for r in range(2):
                lam[p, r] += s.forces[j] * s.loaded[j, p, r]
