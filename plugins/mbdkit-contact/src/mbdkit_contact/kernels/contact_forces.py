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
from mbdkit_contact.kernels.kinematics import NOWHERE, Shapes, choose, row_of

SINGULAR = 1e-11
"""Singular values of the equations of contact forces below this share of the largest one indicate redundant rows."""


WEAK = 1e-7
"""Pivots below this share of the largest diagonal element show that equations are no longer independent."""
SHARED = 1e-9
"""Largest component of a null vector of the equations, relative to its redundant force, that counts as zero."""


class ClosedContacts(NamedTuple):
    """Up to K contacts of C that act, with U <= 2 K unknown forces, and work arrays; N = 3 (B + 1).

    The first k forces are those along the normals, each with a share of it along the tangent. The forces along the
    tangents of contacts in `sticks` follow.
    """

    shapes: Shapes
    chosen: IntVector
    """(K,) indices of the contacts, and for each the index of its force along the tangent, or -1."""
    sticks: IntVector
    share: RealVector
    """(K,) ratios of friction force and normal force of contacts that slip; 0 for those that stick."""
    rows: Annotated[RealMatrix, 16]
    """(K, 16) quantities of the contacts; see `mbdkit_contact.contact_rows.QUANTITIES`."""
    sites: Annotated[IntMatrix, 2]
    """(U, 2) first coordinates of the bodies on which each force acts."""
    held: Annotated[RealMatrix, 6]
    """(U, 6) derivatives of the constraints that the contacts impose, and directions of their forces."""
    pushed: Annotated[RealMatrix, 6]
    moved: RealMatrix
    """(U, N) accelerations and (U, P, 2) multipliers that unit forces cause alone."""
    loaded: RealCube
    matrix: RealMatrix
    """(U, U) equations of the forces, and work arrays of their solution."""
    columns: RealMatrix
    turns: RealMatrix
    right: RealVector
    forces: RealVector
    """(U,) result: the forces."""
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
        np.zeros((u, u)), np.zeros((u, u)), np.zeros((u, u)), np.zeros(u), np.zeros(u), np.zeros(u), np.zeros(u),
        integers(u),
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
        if s.shapes.held[i] >= 0:
            s.shapes.features[i], s.shapes.least[i] = s.shapes.held[i], NOWHERE
        elif s.shapes.contacts[i, 3] != last:
            last = s.shapes.contacts[i, 3]
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


@separate
def find_few_forces(s, k, count, free, basis):
    """Write forces as `find_forces` does, but with those of redundant equations zero; return whether there are any.

    The accelerations that they cause are the same. `basis` holds the number of independent equations, 0 if it is
    unknown, and these equations.
    """
    a, b, rank, largest = s.matrix, s.sizes, basis[0], 0.0
    if rank == 0 or rank > count:
        return False
    _balance(s, k, free)
    for i in range(rank):
        at = basis[1 + i]
        if at >= count:
            return False
        b[i] = s.right[at]
        for j in range(rank):
            a[i, j] = along(s, at, s.moved[basis[1 + j]])
        if not a[i, i] > 0.0:
            return False
        largest = max(largest, a[i, i])
    for i in range(rank):
        if not a[i, i] > WEAK * largest:
            return False
        for j in range(i + 1, rank):
            factor = a[j, i] / a[i, i]
            b[j] -= factor * b[i]
            for x in range(i + 1, rank):
                a[j, x] -= factor * a[i, x]
    for j in range(count):
        s.forces[j] = 0.0
    for i in range(rank - 1, -1, -1):
        for j in range(i + 1, rank):
            b[i] -= a[i, j] * b[j]
        b[i] /= a[i, i]
        s.forces[basis[1 + i]] = b[i]
    return True


@subkernel
def _note_basis(s, k, count, rank, basis):
    """Write the independent equations of the last solution by `least_squares`; their number is 0 if the redundant
    forces change the accelerations, through the friction of contacts that slip.
    """
    basis[0] = rank
    for i in range(rank):
        basis[1 + i] = s.order[i]
    for e in range(rank, count):
        if s.order[e] < k and s.share[s.order[e]] != 0.0:
            basis[0] = 0
        for i in range(rank):
            if s.order[i] < k and s.share[s.order[i]] != 0.0 and abs(s.turns[e - rank, i]) > SHARED:
                basis[0] = 0


@separate
def find_forces(s, k, count, free, basis):
    """Write the forces with which gaps and slips do not accelerate, for accelerations `free` (N,) without them.

    Redundant contacts that stick share the friction force in proportion to their normal forces. Returns the place of a
    contact that its own friction presses together more than it is pressed, or -1. `basis` is for `find_few_forces`.
    """
    _balance(s, k, free)
    assemble(s, count)
    for j in range(k):
        if s.matrix[j, j] <= 0.0 and s.share[j] != 0.0:
            return j
    rank = least_squares(s, count)
    _note_basis(s, k, count, rank, basis)
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
