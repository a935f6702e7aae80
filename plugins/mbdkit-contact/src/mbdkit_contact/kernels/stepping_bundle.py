"""Arrays of a time-stepping method on one mechanism, and operations on velocities and impulses of its contacts."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from mbdkit.engine.kernels.bundle_types import STATE, IntMatrix, IntVector, RealMatrix, RealVector
from mbdkit.engine.kernels.lu import Factors, Pattern
from mbdkit.engine.native.functions import subkernel
from mbdkit_contact.kernels.active_set import ActiveSet
from mbdkit_contact.kernels.impacts import ImpactBundle
from mbdkit_contact.kernels.kinematics import Shapes
from mbdkit_contact.kernels.pivoting import Cones

#: Columns of a row of a contact: gap, derivatives of gap rate and slip, right-hand side of the gap.
GAP, ALONG, ACROSS, CURVE = 0, 2, 8, 14


class HeldContacts(NamedTuple):
    """What a step passes to the next one; C contacts, N = 3 (B + 1)."""

    modes: RealVector  #: (C,) modes at the end of the step; all open if they are unknown, after a discontinuity.
    normal: RealVector  #: (C,) mean forces over the step [N].
    tangent: RealVector
    force: RealVector  #: (N,) generalized forces of all contacts, as means over the step.
    accelerations: RealMatrix  #: (2, N) accelerations a and w of the generalized-alpha method.
    known: IntVector  #: (1,) whether `accelerations` are known.
    owed: RealVector  #: (1,) energy added by moving overlapping shapes apart that contacts have not dissipated yet [J].
    #: (1,) largest error of the velocities of contacts so far, relative to the largest velocity in the same step.
    residual: RealVector
    changed: IntVector  #: (C,) whether another law of impact than the chosen one was used at a contact.
    ordered: IntVector  #: (C,) whether a contact had simultaneous impacts whose order matters.


class Stepping(NamedTuple):
    """A time-stepping method on one mechanism, K = min(C, most pivoted) contacts solved exactly, U = 2 K."""

    #: (1,) weight of the forces at the end of a step of Moreau and Jean, and (5,) alpha_m, alpha_f, gamma, beta and the
    #: share `ahead` of the generalized-alpha method; one of them is empty.
    theta: RealVector
    alpha: RealVector
    shapes: Shapes
    coefficients: Annotated[RealMatrix, 3]  #: (C, 3) coefficients of restitution, and of static and kinetic friction.
    #: (2,) index of the first of the states that hold forces and modes, and their number; (D,) coordinates whose sums
    #: of forces follow them.
    places: IntVector
    coordinates: IntVector
    reach: RealVector  #: (1,) largest gap that is always computed exactly [m].
    now: Annotated[HeldContacts, STATE]
    before: HeldContacts  #: Copies at the start of an attempt and of a part of a step, and the result of the part.
    saved: HeldContacts
    new: HeldContacts
    saved_q: RealVector  #: (N,) state at the start of the part of a step.
    saved_v: RealVector
    #: (T, 2) bodies of the row and the column of each term in ``Scratch.source`` that is not a mass.
    terms: Annotated[IntMatrix, 2]
    sources: IntVector  #: (T,) their indices there.
    pattern: Pattern  #: The matrix of the step, with (X, 3) index of the term, index of the value, class of the term.
    factors: Factors
    scatter: Annotated[IntMatrix, 3]
    right: RealVector
    solution: RealVector
    correction: RealVector
    by_matrix: IntVector  #: (1,) whether impulses are answered by this matrix, or by the index-1 system evaluated last.
    #: (B + 1,) whether a body is coupled to others by contacts only, and (1,) whether all that have impulses are.
    free_body: IntVector
    is_sparse: IntVector
    #: (N,) state at the start of the (part of a) step, velocities at its end without and with impulses, and after the
    #: last solution of impulses.
    q: RealVector
    v: RealVector
    free: RealVector
    after: RealVector
    middle: RealVector  #: (N,) positions at which gradients of gaps are evaluated.
    base: RealVector  #: (N,) positions at the end are ``base + factor[0] v``.
    factor: RealVector
    #: (N,) positions at the end of a part of a step, and those without impulses; velocities at the end; positions at
    #: the end of the step of the generalized-alpha method.
    end: RealVector
    unchanged: RealVector
    ended: RealVector
    smooth: RealVector
    z: RealVector  #: (Z,) first-order states at the end of the step.
    point: RealVector  #: (N,) work arrays.
    x: RealVector
    y: RealVector
    force: RealVector
    lam: RealMatrix  #: (P, 2) multipliers at the start of the step, and work arrays.
    lam_x: RealMatrix
    miss: RealMatrix
    number: IntVector  #: (1,) number of contacts with impulses.
    some: IntVector  #: (C,) their indices, in increasing order, and whether each contact is one of them.
    is_some: IntVector
    gaps: RealVector
    rows: Annotated[RealMatrix, 16]  #: (C, 16) their quantities; see `mbdkit_contact.contact_rows.QUANTITIES`.
    #: (2 K, N), or (2 C, N) if bodies are coupled by more than contacts: velocities caused by unit impulses, those of
    #: normal impulses at even rows.
    moved: RealMatrix
    block: Annotated[RealMatrix, 4]  #: (C, 4) changes of the velocities of a contact by its own unit impulses.
    more: RealVector  #: (C,) velocities that are added to the normal velocities of contacts.
    closing: RealVector  #: (C,) rates with which gaps may close, by index of the contact [m/s].
    friction: RealVector
    restitution: RealVector
    normal: RealVector  #: (C,) impulses of the contacts in the order of `some`.
    tangent: RealVector
    closed: IntVector
    slipping: IntVector
    slides: IntVector  #: (C,) by index: contacts that have kinetic friction, and contacts whose slip would turn.
    stops: IntVector
    error: RealVector  #: (1,) relative error of the velocities after the impulses.
    lost: RealVector  #: (1,) energy lost in impulses of the step [J].
    other_law: IntVector  #: (1,) whether another law of impact was used.
    states: IntVector  #: (C,) modes of many contacts in the order of `some`, and (9, 2 C) vectors of their equations.
    krylov: RealMatrix
    cones: Cones
    active: ActiveSet
    impacts: ImpactBundle
    reason: IntVector  #: (1,) why the last attempt failed; see `mbdkit_contact.kernels.smooth_steps`.


@subkernel
def rate_of(m, j, at, x):
    """Return the rate of the gap (`at` = ALONG) or the slip (ACROSS) of the contact at place `j` for velocities `x`."""
    a, b = 3 * m.shapes.contacts[m.some[j], 0], 3 * m.shapes.contacts[m.some[j], 1]
    total = 0.0
    for d in range(3):
        total += m.rows[j, at + d] * x[a + d] + m.rows[j, at + 3 + d] * x[b + d]
    return total


@subkernel
def add_force(m, j, at, size, out):
    """Add the generalized force of a force of this size along the normal (ALONG) or tangent (ACROSS) to `out` (N,)."""
    a, b = 3 * m.shapes.contacts[m.some[j], 0], 3 * m.shapes.contacts[m.some[j], 1]
    ground = len(out) - 3
    for d in range(3):
        if a < ground:
            out[a + d] += size * m.rows[j, at + d]
        if b < ground:
            out[b + d] += size * m.rows[j, at + 3 + d]


@subkernel
def all_free(m, j):
    """Return whether both bodies of the contact at place `j` are coupled to others by contacts only."""
    i = m.some[j]
    return m.free_body[m.shapes.contacts[i, 0]] != 0 and m.free_body[m.shapes.contacts[i, 1]] != 0


@subkernel
def add_move(c, m, j, at, size, out):
    """Add the velocities caused by an impulse of this size of a contact, whose bodies are free, to `out` (N,)."""
    ground = len(out) // 3 - 1
    for side in range(2):
        b = m.shapes.contacts[m.some[j], side]
        if b < ground:
            for d in range(3):
                out[3 * b + d] += size * c.top.weight[b, d] * m.rows[j, at + 3 * side + d]


@subkernel
def keep_held(source, target):
    """Copy what a step passes to the next one."""
    for i in range(len(source.modes)):
        target.modes[i], target.normal[i], target.tangent[i] = source.modes[i], source.normal[i], source.tangent[i]
        target.changed[i], target.ordered[i] = source.changed[i], source.ordered[i]
    for d in range(len(source.force)):
        target.force[d] = source.force[d]
        for i in range(2):
            target.accelerations[i, d] = source.accelerations[i, d]
    target.known[0], target.owed[0], target.residual[0] = source.known[0], source.owed[0], source.residual[0]
