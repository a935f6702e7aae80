"""The index-1 system of a whole mechanism: accelerations and multipliers, and the tangents of its terms.

    [ M      Phi_q^T ] [ a      ]   [ Q     ]
    [ Phi_q  0       ] [ lambda ] = [ gamma ]

State vectors are flat, (3 (B + 1),), with ground last and at rest, so that elements on ground need no special case.
Multipliers are (P, 2), one row for each pair of constraint rows.

Two solvers exist. The Schur complement (`mbdkit.engine.kernels.schur`) eliminates the accelerations and is used by
default. Sparse LU with numerical pivoting (`mbdkit.engine.kernels.lu`) solves the whole system if the Schur complement
is too dense, badly scaled or has lost accuracy.

Redundant directions are not solved for. `fold` removes them from the constraint rows, and `unfold_multipliers` restores
the multipliers of all rows afterwards.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from mbdkit.engine.kernels.applied_forces import (
    any_forces,
    applied_forces,
    force_tangents,
    powers,
    take_multipliers,
)
from mbdkit.engine.kernels.bundle_types import IntMatrix, IntVector, RealMatrix, RealVector, example_of
from mbdkit.engine.kernels.constraints import (
    constraint_accelerations,
    constraint_positions,
    constraint_tangents,
    turn_bodies,
)
from mbdkit.engine.kernels.friction_kernels import (
    add_unit,
    begin_frictions,
    change_frictions,
    newton_step,
    note_response,
    take_reactions,
)
from mbdkit.engine.kernels.lu import Factors, Pattern, factorize, solve_refined
from mbdkit.engine.kernels.motions import OF_CENTER, centers, motions
from mbdkit.engine.kernels.schur import Schur
from mbdkit.engine.kernels.schur import factor as schur_factor
from mbdkit.engine.kernels.schur import solve as schur_solve
from mbdkit.engine.kernels.vectors import fill, fill_rows
from mbdkit.engine.native.arithmetic import any_of, renewed
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import inlined, overload, subkernel

OK, REPIVOT, REPIVOT_STAGES, NOT_FINITE, DIVERGED = range(5)
"""Status of a kernel: success; the index-1 system or the stage matrix needs new pivots; overflow; no convergence."""

SETTLED = 4.0 * np.finfo(float).eps
"""Differences between the friction in a joint and the value of its law, relative to the friction, up to this size count
as zero."""
NEARLY_SETTLED = 1e-11
"""Relative differences up to this size count as round-off if they no longer decrease."""
MOST_PASSES = 30
"""Largest number of Newton steps for the friction in joints; three are usual."""
KKT_TOLERANCE = 1e-9
"""Largest accepted residual of the pivoted system, relative to the largest row sum; above it, new pivots are chosen."""


class Topology(NamedTuple):
    """A compiled mechanism: all data that do not change during a run.

    B is the number of bodies without ground, P of pairs of constraint rows, S of segments of springs, X of pairs of
    segments of the same spring, L of loads, G of cross-sections of beams, E of their elements, J of joints, K of
    markers. All force elements on a pathway are called springs, whatever their law. Most have one segment; the length
    of one with several is the sum over its segments.
    """

    mass: Annotated[RealMatrix, 3]
    """(B + 1, 3) diagonal of the mass matrix; ground has ones."""
    weight: Annotated[RealMatrix, 3]
    """(B + 1, 3) inverse of `mass`; ground has zeros, so that no force accelerates it."""
    gravity: RealVector
    """(2,) gravity [m/s^2]."""
    pairs: Annotated[IntMatrix, 4]
    """(P, 4) kind, first body, second body, motion or first function of a moving center (-1: none)."""
    rows: IntVector
    """(P,) number of rows that are solved for, 0, 1 or 2."""
    length: RealVector
    """(1,) length [m] that is compared with an angle of 1 rad: the characteristic length of the mechanism, at most
    1 m."""
    row_units: Annotated[RealMatrix, 2]
    """(P, 2) `length` for rows whose Phi is a length, 1 for angles."""
    pair_parameters: Annotated[RealMatrix, 6]
    """(P, 6) parameters of each pair, the two points first; see `mbdkit.engine.kernels.element_kernels`."""
    spare: Annotated[IntMatrix, 2]
    """(D, 2) redundant directions, which are not solved for: pair, and body in whose frame the direction is fixed."""
    spare_axes: Annotated[RealMatrix, 2]
    """(D, 2) unit vectors of the redundant directions in that frame, as coefficients of the pair's two rows; (1, 0) for
    a pair with a single row."""
    springs: Annotated[IntMatrix, 6]
    """(S, 6) pathway, first body, second body, row of `laws` (-1: linear), first segment of the same spring, number of
    its segments (0 for all but the first segment)."""
    spring_points: Annotated[RealMatrix, 6]
    """(S, 6) parameters of the segments: the points in the frames of both bodies, and further ones."""
    couplings: Annotated[IntMatrix, 2]
    """(X, 2) ordered pairs of different segments of the same spring."""
    linear: Annotated[RealMatrix, 3]
    """(S, 3) stiffness, damping and free length of the linear springs."""
    laws: Annotated[IntMatrix, 4]
    """(W, 4) laws of all other springs: address of the compiled law, index of its first parameter in `law_parameters`,
    claims, and address of its program (`mbdkit.engine.native.calls`)."""
    law_parameters: RealVector
    """(N,) for each law its number of parameters, followed by their values; a parameter that is a state has its initial
    value."""
    states: Annotated[IntMatrix, 3]
    """(Z, 3) first-order states: first segment of the force element (-1: none), index in `law_parameters`, row of
    `laws` of its rate (-1: it is held between samples); the states of an element follow one another."""
    state_places: Annotated[IntMatrix, 2]
    """(Y, 2) all elements of `law_parameters` that hold the value of a state: state, index."""
    inputs: Annotated[IntMatrix, 3]
    """(N, 3) inputs of expressions of the state: kind (`mbdkit.engine.kernels.applied_forces`), coordinate or first
    segment, index in `law_parameters`."""
    load_values: Annotated[IntMatrix, 2]
    """(V, 2) components of loads that are expressions of the state: row of `laws`, and number of the motion in
    ``Scratch.u`` whose value is replaced."""
    slopes: Annotated[IntMatrix, 5]
    """(D, 5) derivatives of these components with respect to their inputs: load, component, row of `laws`, input,
    segment."""
    frictions: IntVector
    """(F,) segment of the force element of each joint with friction."""
    reactions: Annotated[IntMatrix, 4]
    """(N, 4) multipliers on which these frictions depend: pair, row, index in `law_parameters`, friction."""
    loads: Annotated[IntMatrix, 5]
    """(L, 5) kind, body, reaction body, motion x (or of the torque), motion y."""
    load_points: Annotated[RealMatrix, 2]
    """(L, 2) point of application of each load in the frame of its body [m]."""
    sections: Annotated[IntMatrix, 5]
    """(G, 5) cross-sections at which the elements of beams are integrated: element, number of its nodes, the nodes."""
    section_parameters: Annotated[RealMatrix, 16]
    """(G, 16) values and derivatives with respect to the arc length of the shape functions of three nodes, then the
    parameters of the cross-section; see `mbdkit.symbolic.definitions.derive_section`."""
    force_place: IntVector
    """(S + L,) index of the force element of each segment and of each load."""
    pair_joint: IntVector
    """(P,) number of the joint of each pair."""
    joints: Annotated[IntMatrix, 3]
    """(J, 3) kind of the coordinate (`mbdkit.engine.kernels.acting`), first body, second body."""
    joint_lines: Annotated[RealMatrix, 6]
    """(J, 6) line of a travel: the points in the frames of both bodies and the unit vector in the first; else zeros."""
    markers: IntVector
    """(K,) body of each marker."""
    marker_points: Annotated[RealMatrix, 2]
    """(K, 2) marker in the frame of its body [m]."""
    centers: Annotated[IntMatrix, 2]
    """(C, 2) first and second body of each center that moves with their relative angle; see
    `mbdkit.engine.kernels.motions`."""
    motion_start: IntVector
    """Start of the program of each motion; see `mbdkit.engine.kernels.motions.evaluate_motions`."""
    motion_ops: IntVector
    motion_values: RealVector
    baumgarte: RealVector
    """(2,) alpha, beta [1/s] of Baumgarte stabilization, which modifies gamma; zeros without stabilization."""


class Scratch(NamedTuple):
    """Working arrays of one run.

    `source` holds all terms of the stage matrix; `jac`, `stiff` and the other arrays of terms are views of it.
    """

    time: RealVector
    """(1,) time of the last `prepare` [s]."""
    sides: RealVector
    """(2,) earliest and latest time at which motions are evaluated [s]; see `Workspace.clamp_motions`."""
    cs: Annotated[RealMatrix, 2]
    """(B + 1, 2) cosine and sine of every angle."""
    u: Annotated[RealMatrix, 3]
    """(motions, 3) value, first and second derivative of each motion with respect to time, then of the functions of
    each moving center with respect to the angle."""
    stack: RealMatrix
    """Stack of `evaluate_motions`."""
    force: RealVector
    """(3 (B + 1),) generalized applied forces without gravity."""
    phi: Annotated[RealMatrix, 2]
    """(P, 2) constraint residuals Phi."""
    phi_t: Annotated[RealMatrix, 2]
    """(P, 2) partial derivatives of Phi with respect to time."""
    gamma: Annotated[RealMatrix, 2]
    """(P, 2) right-hand side of ``Phi_q a = gamma``."""
    refinement: Annotated[RealMatrix, 2]
    """(P, 2) residual and correction of the iterative refinement."""
    s: Annotated[RealMatrix, 1]
    """(S, 1) length of the pathway of each segment, the sum over its segments."""
    grad: Annotated[RealMatrix, 6]
    """(S, 6) gradients s_q of the segments."""
    hess: Annotated[RealMatrix, 36]
    """(S, 36) second derivatives s_qq of the segments."""
    tension: Annotated[RealMatrix, 4]
    """(S + 1, 4) force, derivatives with respect to length and rate, and potential of the spring of each segment; the
    last row is a work array."""
    section: Annotated[RealMatrix, 10]
    """(G, 10) state of each cross-section of a beam, its rates, cosine and sine of its angle."""
    section_force: Annotated[RealMatrix, 4]
    """(G, 4) forces conjugate to these states."""
    section_stress: Annotated[RealMatrix, 3]
    """(G, 3) axial force, shear force and bending moment."""
    section_energy: Annotated[RealMatrix, 2]
    """(G, 2) strain energy and dissipated power of the part of the beam that the cross-section represents."""
    section_stiff: Annotated[RealMatrix, 16]
    """(G, 16) derivatives of the forces with respect to the states."""
    section_damp: Annotated[RealMatrix, 16]
    """(G, 16) derivatives of the forces with respect to the rates."""
    law_values: RealVector
    """(N,) parameters of laws as in `Topology.law_parameters`, but with the present values of states and inputs.
    Without states and inputs, it is that array itself."""
    friction: RealMatrix
    """(F, F + 3) matrix and right side of Newton's method for the friction in joints, the frictions, and their
    scales."""
    response: RealMatrix
    """(N, F + 1) change of each multiplier in ``Topology.reactions`` by a unit of each friction; the value of the
    multiplier in the last column."""
    faulty: IntVector
    """(1,) row of the last law whose force or required derivatives were not finite; -1 for none."""
    source: RealVector
    """All terms of the stage matrix, one after another; the constant masses are stored there once."""
    jac: Annotated[RealMatrix, 12]
    """(P, 12) Jacobian Phi_q, two rows of six columns for each pair."""
    stiff: Annotated[RealMatrix, 36]
    """(P, 36) d(Phi_q^T lam)/dq."""
    gamma_v: Annotated[RealMatrix, 12]
    """(P, 12) d gamma/dv."""
    res_q: Annotated[RealMatrix, 12]
    """(P, 12) d(Phi_q a - gamma)/dq."""
    spring_stiff: Annotated[RealMatrix, 36]
    """(S, 36) -dQ/dq of the springs."""
    spring_damp: Annotated[RealMatrix, 36]
    """(S, 36) -dQ/dv of the springs."""
    coupled_stiff: Annotated[RealMatrix, 36]
    """(X, 36) -dQ/dq of springs with several segments: Q on the first segment of a coupling, q of the second."""
    coupled_damp: Annotated[RealMatrix, 36]
    """(X, 36) -dQ/dv of the same springs."""
    slope_stiff: Annotated[RealMatrix, 36]
    """(D, 36) -dQ/dq of loads whose value is an expression of the state, due to one of its inputs."""
    slope_damp: Annotated[RealMatrix, 36]
    """(D, 36) -dQ/dv of the same loads."""
    load_stiff: Annotated[RealMatrix, 3]
    """(L, 3) -dQ/dq of the loads; see `mbdkit.engine.kernels.applied_forces.force_tangents`."""
    beam_stiff: Annotated[RealMatrix, 81]
    """(G, 81) -dQ/dq of the cross-sections of beams, for three nodes."""
    beam_damp: Annotated[RealMatrix, 81]
    """(G, 81) -dQ/dv of the cross-sections of beams, for three nodes."""
    loose: Annotated[RealMatrix, 6]
    """(D, 6) Jacobian of the redundant directions."""
    push: RealVector
    """(3 (B + 1),) accelerations caused by a single multiplier."""
    right: RealVector
    """(n,) right-hand side of the pivoted system."""
    solution: RealVector
    """(n,) solution of the pivoted system."""
    correction: RealVector
    """(n,) correction of that solution by iterative refinement, later the residual."""


class Scatter(NamedTuple):
    """Index pairs that add the entries of `Scratch.source` to the values of a sparse matrix, grouped by factor.

    The factors contain the step h and the eigenvalue mu of the stage matrix.
    """

    one: Annotated[IntMatrix, 2]
    """(n1, 2) source, target; factor 1 (masses, Jacobian)."""
    rate: Annotated[IntMatrix, 2]
    """(n2, 2) source, target; factor h mu (damping)."""
    minus_rate: Annotated[IntMatrix, 2]
    """(n3, 2) source, target; factor -h mu (gamma_v)."""
    level: Annotated[IntMatrix, 2]
    """(n4, 2) source, target; factor h^2 mu^2 (stiffness, residual_q)."""


class Solver(NamedTuple):
    """Solver for accelerations: the Schur complement, or pivoted LU of the whole system."""

    pivoted: IntVector
    """(1,) whether the pivoted solver is in use."""
    schur: Schur
    pattern: Pattern
    factors: Factors
    scatter: Scatter
    row_index: Annotated[IntMatrix, 2]
    """(P, 2) number of the unknown of each multiplier in the pivoted system; -1 for an empty row."""
    failed: IntVector
    """(1,) pair or pivot position at which the last factorization failed."""


class LaneSolver(NamedTuple):
    """Solver for accelerations in lanes, where every run uses the Schur complement; see `Solver`."""

    schur: Schur
    row_index: Annotated[IntMatrix, 2]
    failed: IntVector


class Engine(NamedTuple):
    """Mechanism, working arrays and solver; kernels called from Python take the address of a pinned engine."""

    top: Topology
    w: Scratch
    solver: Solver


load_engine = bundle_loader(lambda: example_of(Engine))


@inlined
def prepare(top, w, t, q):
    """Evaluate the quantities that all elements share at a time and position: motions, centers, cosines and sines."""
    prepare_motions(top, w, t)
    prepare_angles(top, w, q)


@inlined
def prepare_motions(top, w, t):
    """Evaluate the part of `prepare` that depends on the time only."""
    w.time[0] = t
    at = min(max(t, w.sides[0]), w.sides[1])
    count = len(top.motion_start) - 1 - OF_CENTER * len(top.centers)
    motions(at, count, top.motion_start, top.motion_ops, top.motion_values, w.stack, w.u)


@inlined
def prepare_angles(top, w, q):
    """Evaluate the part of `prepare` that depends on the angles of the bodies only."""
    if len(top.centers) > 0:
        centers(q, top.centers, top.motion_start, top.motion_ops, top.motion_values, w.stack, w.u)
    turn_bodies(q, w.cs)


@inlined
def evaluate_positions(top, w, q):
    """Evaluate Phi and Phi_t of every row into ``w.phi`` and ``w.phi_t``; requires `prepare`."""
    constraint_positions(top.pairs, top.pair_parameters, q, w.cs, w.u, w.phi, w.phi_t)


@inlined
def evaluate_powers(top, w, q, v, lam):
    """Return two powers [W]: that of loads, drivers and active laws, and the dissipated power.

    Requires `prepare` and `applied_forces`.
    """
    evaluate_positions(top, w, q)
    return powers(top, w, v, lam)


@inlined
def constraint_rate(pairs, jac, phi_t, v, k, r):
    """Return row `r` of pair `k` of ``Phi_q v + Phi_t``, the time derivative of the constraints."""
    a, b = 3 * pairs[k, 1], 3 * pairs[k, 2]
    rate = phi_t[k, r]
    for i in range(3):
        rate += jac[k, 6 * r + i] * v[a + i] + jac[k, 6 * r + 3 + i] * v[b + i]
    return rate


@subkernel
def subtract_baumgarte(top, w, v):
    """Subtract ``2 alpha (Phi_q v + Phi_t) + beta^2 Phi`` from ``w.gamma``; return the largest of these terms.

    This is Baumgarte stabilization: the constraints then obey ``Phi'' + 2 alpha Phi' + beta^2 Phi = 0``.
    """
    rate_factor, factor = 2.0 * top.baumgarte[0], top.baumgarte[1] * top.baumgarte[1]
    largest = 0.0
    for k in range(len(top.pairs)):
        for r in range(2):
            rate = constraint_rate(top.pairs, w.jac, w.phi_t, v, k, r)
            term = rate_factor * rate + factor * w.phi[k, r]
            w.gamma[k, r] -= term
            largest = max(largest, abs(term))
    return largest


@inlined
def constraint_rows(top, w, q, v):
    """Evaluate the Jacobian and gamma of every row, including redundant ones; requires `prepare`.

    With Baumgarte stabilization, ``w.phi`` and ``w.phi_t`` are evaluated too, gamma is the stabilized right-hand side,
    and the largest Baumgarte term is returned (otherwise 0).
    """
    for i in range(len(top.spare)):
        for c in range(12):  # entries that element kernels never write must be zero, but `fold` has filled them
            w.jac[top.spare[i, 0], c] = 0.0
    constraint_accelerations(top.pairs, top.pair_parameters, q, v, w.cs, w.u, w.jac, w.gamma)
    largest = 0.0
    if top.baumgarte[0] != 0.0 or top.baumgarte[1] != 0.0:
        evaluate_positions(top, w, q)
        largest = subtract_baumgarte(top, w, v)
    return largest


@inlined
def solved_rows(top, w, q, v):
    """Evaluate the Jacobian and gamma of the rows that are solved for; requires `prepare`.

    The Jacobian of the redundant directions is stored in ``w.loose``. For Baumgarte stabilization see
    `constraint_rows`.
    """
    constraint_rows(top, w, q, v)
    _remove_redundant_rows(top, w)


@inlined
def spare_direction(top, cs, i):
    """Return redundant direction `i` as the coefficients (x, y) of the two rows of its pair."""
    c, s = cs[top.spare[i, 1], 0], cs[top.spare[i, 1], 1]
    x, y = top.spare_axes[i, 0], top.spare_axes[i, 1]
    return c * x - s * y, s * x + c * y


@subkernel
def fold(top, cs, x):
    """Reduce the two rows of six columns of every pair, `x` (P, 12), to the rows that are solved for, in place.

    Of a pair with one redundant direction, the combination of rows perpendicular to this direction becomes the first
    row. Of a pair with two redundant directions, nothing is left. All other rows become zero.
    """
    for i in range(len(top.spare)):
        k = top.spare[i, 0]
        dx, dy = spare_direction(top, cs, i)
        for c in range(6):
            x[k, c] = dx * x[k, 6 + c] - dy * x[k, c] if top.rows[k] == 1 else 0.0
            x[k, 6 + c] = 0.0


@subkernel
def fold_values(top, cs, x):
    """Reduce the two values of every pair, `x` (P, 2), to those of the rows that are solved for; see `fold`."""
    for i in range(len(top.spare)):
        k = top.spare[i, 0]
        dx, dy = spare_direction(top, cs, i)
        x[k, 0] = dx * x[k, 1] - dy * x[k, 0] if top.rows[k] == 1 else 0.0
        x[k, 1] = 0.0


@subkernel
def _remove_redundant_rows(top, w):
    """Reduce the Jacobian and gamma to the rows that are solved for; store the removed rows in ``w.loose``."""
    jac, loose = w.jac, w.loose
    for i in range(len(top.spare)):
        k = top.spare[i, 0]
        dx, dy = spare_direction(top, w.cs, i)
        for c in range(6):
            loose[i, c] = dx * jac[k, c] + dy * jac[k, 6 + c]
    fold(top, w.cs, jac)
    fold_values(top, w.cs, w.gamma)


@subkernel
def unfold_multipliers(top, cs, lam):
    """Convert the multipliers of the rows that are solved for to those of the original rows, in place.

    This is the transpose of `fold`; the redundant directions carry no force.
    """
    for i in range(len(top.spare)):
        k = top.spare[i, 0]
        dx, dy = spare_direction(top, cs, i)
        across = lam[k, 0] if top.rows[k] == 1 else 0.0
        lam[k, 0] = -dy * across
        lam[k, 1] = dx * across


@subkernel
def free_accelerations(top, has_forces, force, acc):
    """Write the accelerations ``M^-1 Q`` of the unconstrained bodies, gravity included, into `acc` (3 (B + 1),)."""
    gravity, weight = top.gravity, top.weight
    for b in range(len(top.mass) - 1):
        acc[3 * b] = gravity[0]
        acc[3 * b + 1] = gravity[1]
        acc[3 * b + 2] = 0.0
        if has_forces:
            for i in range(3):
                acc[3 * b + i] += weight[b, i] * force[3 * b + i]


@subkernel
def joint_right_side(top, w, acc, lam):
    """Write ``Phi_q a - gamma``, the right-hand side of the Schur complement, into `lam` (P, 2)."""
    pairs, rows, jac, gamma = top.pairs, top.rows, w.jac, w.gamma
    for k in range(len(pairs)):
        a, b = 3 * pairs[k, 1], 3 * pairs[k, 2]
        r0, r1 = -gamma[k, 0], -gamma[k, 1]
        for i in range(3):
            r0 += jac[k, i] * acc[a + i] + jac[k, 3 + i] * acc[b + i]
            r1 += jac[k, 6 + i] * acc[a + i] + jac[k, 9 + i] * acc[b + i]
        lam[k, 0] = r0
        lam[k, 1] = r1 if rows[k] == 2 else 0.0


@subkernel
def apply_multipliers(top, w, lam, acc, wanted):
    """Subtract ``M^-1 Phi_q^T lambda`` from the accelerations `acc` (3 (B + 1),); in lanes, only where `wanted`."""
    pairs, jac, weight = top.pairs, w.jac, top.weight
    for k in range(len(pairs)):
        a, b = pairs[k, 1], pairs[k, 2]
        l0, l1 = lam[k, 0], lam[k, 1]
        for i in range(3):
            x, y = acc[3 * a + i], weight[a, i] * (jac[k, i] * l0 + jac[k, 6 + i] * l1)
            acc[3 * a + i] = renewed(x - y, x, wanted)
            x, y = acc[3 * b + i], weight[b, i] * (jac[k, 3 + i] * l0 + jac[k, 9 + i] * l1)
            acc[3 * b + i] = renewed(x - y, x, wanted)


@inlined
def refine_multipliers(top, w, schur, acc, lam, wanted):
    """Do one step of iterative refinement of ``Phi_q a = gamma`` with the factors of the Schur complement.

    The residual ``Phi_q a - gamma`` is the right-hand side of a correction of the multipliers; `acc` and `lam` are
    corrected in place, in lanes only where `wanted`.
    """
    joint_right_side(top, w, acc, w.refinement)
    schur_solve(schur, w.refinement)
    apply_multipliers(top, w, w.refinement, acc, wanted)
    for k in range(len(lam)):
        for r in range(2):
            lam[k, r] = renewed(lam[k, r] + w.refinement[k, r], lam[k, r], wanted)


@inlined
def gather_values(source, scatter, rate, row_rate, weight, values):
    """Fill the scaled values of a sparse matrix from the terms in `source`.

    `rate` is ``h mu``, the factor of damping, and its square that of stiffness; it is 0 for the KKT matrix. `row_rate`
    is the factor of -gamma_v.
    """
    fill(values, 0.0)
    for e in range(len(scatter.one)):
        values[scatter.one[e, 1]] += source[scatter.one[e, 0]]
    if any_of(rate != 0.0):
        level = rate * rate
        for e in range(len(scatter.rate)):
            values[scatter.rate[e, 1]] += rate * source[scatter.rate[e, 0]]
        for e in range(len(scatter.minus_rate)):
            values[scatter.minus_rate[e, 1]] -= row_rate * source[scatter.minus_rate[e, 0]]
        for e in range(len(scatter.level)):
            values[scatter.level[e, 1]] += level * source[scatter.level[e, 0]]
    for x in range(len(values)):
        values[x] *= weight[x]


@subkernel
def pivoted_accelerations(top, w, solver, has_forces, acc, lam):
    """Solve the whole index-1 system by pivoted sparse LU with one step of refinement; return a status.

    Returns REPIVOT if no pivots have been chosen yet, a pivot has become too small, or the residual is above
    `KKT_TOLERANCE`; `acc` and `lam` are then unchanged.
    """
    pattern, factors = solver.pattern, solver.factors
    if len(pattern.row_of) != len(w.right):  # the pattern is still empty: no pivots have been chosen yet
        return REPIVOT
    gather_values(w.source, solver.scatter, 0.0, 0.0, pattern.weight, factors.a)
    solver.failed[0] = factorize(pattern, factors)
    if solver.failed[0] >= 0:
        return REPIVOT
    return substitute_by_pivots(top, w, solver, has_forces, acc, lam)


@subkernel
def substitute_by_pivots(top, w, solver, has_forces, acc, lam):
    """Solve the index-1 system with the existing pivoted factors; return a status as `pivoted_accelerations` does."""
    n3 = 3 * (len(top.mass) - 1)
    row_index, right, solution = solver.row_index, w.right, w.solution
    for b in range(len(top.mass) - 1):
        right[3 * b] = top.mass[b, 0] * top.gravity[0]
        right[3 * b + 1] = top.mass[b, 1] * top.gravity[1]
        right[3 * b + 2] = 0.0
    if has_forces:
        for i in range(n3):
            right[i] += w.force[i]
    for k in range(len(top.pairs)):
        for r in range(top.rows[k]):
            right[row_index[k, r]] = w.gamma[k, r]
    if not solve_refined(solver.pattern, solver.factors, right, solution, w.correction) < KKT_TOLERANCE:
        return REPIVOT
    for i in range(n3):
        acc[i] = solution[i]
    for k in range(len(top.pairs)):
        for r in range(top.rows[k]):
            lam[k, r] = solution[row_index[k, r]]
    return OK


@inlined
def solve_accelerations(top, w, solver, q, v, acc, lam, refine):
    """Solve for accelerations and multipliers at a position for which `prepare` was called; return a status.

    With `refine`, one step of iterative refinement reduces the residual of ``Phi_q a = gamma`` to rounding errors; in
    lanes, `refine` may be a mask.
    """
    solved_rows(top, w, q, v)
    status = solve_loaded(top, w, solver, q, v, acc, lam, refine)
    unfold_multipliers(top, w.cs, lam)
    return status


@inlined
def solve_loaded(top, w, solver, q, v, acc, lam, refine):
    """Solve the index-1 system with the applied forces, for ``w.jac`` and ``w.gamma`` of the independent rows.

    The multipliers `lam` are those of the rows that are solved for; they are not unfolded. Returns a status.
    """
    if len(top.frictions) > 0:  # the first pass is without friction, so that the result depends on the state only
        fill_rows(lam, 0.0)
        take_multipliers(top, w, lam)
    has_forces = any_forces(top)
    if has_forces:
        applied_forces(top, w, q, v)
    status = solve_system(top, w, solver, has_forces, acc, lam, refine)
    if len(top.frictions) > 0 and status == OK:
        status = settle_friction(top, w, solver, v, acc, lam, refine)
    return status


@inlined
def _substitute(top, w, solver, acc, lam, refine):
    """Solve the index-1 system for the present forces with the factors of the last solution; return a status."""
    if solver.pivoted[0] != 0:
        return substitute_by_pivots(top, w, solver, True, acc, lam)
    substitute_by_schur(top, w, solver.schur, True, acc, lam, refine)
    return OK


@inlined
def settle_by_newton(top, w, solver, v, acc, lam, refine):
    """Change accelerations and multipliers until they agree with the friction in joints that they cause.

    With frictions T in the joints, the multipliers are an affine function of T, and the law of each joint requires
    ``T = F(lam(T))``. Newton's method begins without friction and uses the same factors in all solutions. If there is
    no solution that continues the one without friction, the law is stored in ``w.faulty``, and NOT_FINITE is returned:
    the joint locks itself.
    """
    count = len(top.frictions)
    if not begin_frictions(top, w, v, lam):
        return OK
    for f in range(count):
        scale = add_unit(top, w, f, 1.0)
        status = _substitute(top, w, solver, acc, lam, refine)
        if status != OK:
            return status
        note_response(top, w, f, lam, scale)
        add_unit(top, w, f, -1.0)
    before, worst = np.inf, 0
    for _ in range(MOST_PASSES):
        rest, worst = newton_step(top, w, v)
        if rest <= SETTLED or (rest >= before and rest <= NEARLY_SETTLED):
            return OK
        if not rest < np.inf:
            break
        before = rest
        change_frictions(top, w)
        status = _substitute(top, w, solver, acc, lam, refine)
        if status != OK:
            return status
        take_reactions(top, w, lam)
    w.faulty[0] = top.springs[top.frictions[worst], 3]
    return NOT_FINITE


@inlined
def _not_settled(top, w, solver, v, acc, lam, refine):
    """Return OK: runs with friction in joints are neither vectorized nor differentiated with respect to parameters."""
    return OK


def settle_friction(top, w, solver, v, acc, lam, refine):
    """Solve for accelerations and multipliers together with the friction in joints; see `settle_by_newton`."""
    return settle_by_newton(top, w, solver, v, acc, lam, refine)


@overload(settle_friction)
def _settle_friction(top, w, solver, v, acc, lam, refine):
    settle = settle_by_newton if "pivoted" in solver.bundle.fields else _not_settled
    return lambda top, w, solver, v, acc, lam, refine: settle(top, w, solver, v, acc, lam, refine)


@inlined
def schur_accelerations(top, w, schur, has_forces, acc, lam, refine):
    """Solve the index-1 system by the Schur complement; return the result of `mbdkit.engine.kernels.schur.factor`.

    ``a = a_free - M^-1 Phi_q^T lambda``, and so ``S lambda = Phi_q a_free - gamma``.
    """
    failed = schur_factor(top, w.jac, schur)
    if failed < 0:
        substitute_by_schur(top, w, schur, has_forces, acc, lam, refine)
    return failed


@inlined
def substitute_by_schur(top, w, schur, has_forces, acc, lam, refine):
    """Solve the index-1 system with the factors of the Schur complement."""
    free_accelerations(top, has_forces, w.force, acc)
    joint_right_side(top, w, acc, lam)
    schur_solve(schur, lam)
    apply_multipliers(top, w, lam, acc, True)
    if any_of(refine):
        refine_multipliers(top, w, schur, acc, lam, refine)


@inlined
def by_pivots_or_schur(top, w, solver, has_forces, acc, lam, refine):
    """Solve the index-1 system with ``w.force``, ``w.jac`` and ``w.gamma`` of the independent rows; return a status.

    The pivoted solver refines in any case; `refine` applies to the Schur complement only.
    """
    for i in range(3):  # ground stays at rest, even if an earlier solution was not finite
        acc[len(acc) - 3 + i] = 0.0
    if solver.pivoted[0] != 0:
        status = pivoted_accelerations(top, w, solver, has_forces, acc, lam)
    else:
        solver.failed[0] = schur_accelerations(top, w, solver.schur, has_forces, acc, lam, refine)
        status = OK if solver.failed[0] < 0 else REPIVOT
    return status


@inlined
def _by_schur(top, w, solver, has_forces, acc, lam, refine):
    """Solve the index-1 system by the Schur complement, and return OK; lanes in which it loses accuracy become NaN."""
    for i in range(3):
        acc[len(acc) - 3 + i] = 0.0
    schur_accelerations(top, w, solver.schur, has_forces, acc, lam, refine)
    return OK


def solve_system(top, w, solver, has_forces, acc, lam, refine):
    """Solve the index-1 system with ``w.force``, ``w.jac`` and ``w.gamma`` of the independent rows; return a status.

    The pivoted solver refines in any case; `refine` applies to the Schur complement only. In lanes, there is no pivoted
    solver: accelerations become NaN in a lane that would need it.
    """
    return by_pivots_or_schur(top, w, solver, has_forces, acc, lam, refine)


@overload(solve_system)
def _solve_system(top, w, solver, has_forces, acc, lam, refine):
    if "numbers" in solver.bundle.fields:  # a solver of dual numbers; see `mbdkit.engine.kernels.dual_system`
        return None
    solve = by_pivots_or_schur if "pivoted" in solver.bundle.fields else _by_schur
    return lambda top, w, solver, has_forces, acc, lam, refine: solve(top, w, solver, has_forces, acc, lam, refine)


@inlined
def transferred(top, w, solver, i, lam):
    """Write the multipliers that cause the same accelerations as a unit multiplier of redundant direction `i`.

    Must be called right after `solve_accelerations`, whose factors and ``w.loose`` it uses. `lam` (P, 2) receives the
    multipliers. Overwrites ``w.gamma`` or the vectors of the pivoted system.
    """
    n3 = 3 * (len(top.mass) - 1)
    a, b = top.pairs[top.spare[i, 0], 1], top.pairs[top.spare[i, 0], 2]
    lam[:, :] = 0.0
    if solver.pivoted[0] != 0:
        right, solution, correction = w.right, w.solution, w.correction
        right[:] = 0.0
        for d in range(3):
            if 3 * a < n3:  # ground has no rows in the pivoted system
                right[3 * a + d] = w.loose[i, d]
            if 3 * b < n3:
                right[3 * b + d] = w.loose[i, 3 + d]
        solve_refined(solver.pattern, solver.factors, right, solution, correction)
        for k in range(len(top.pairs)):
            for r in range(top.rows[k]):
                lam[k, r] = solution[solver.row_index[k, r]]
    else:
        w.push[:] = 0.0
        w.gamma[:, :] = 0.0
        for d in range(3):
            w.push[3 * a + d] = top.weight[a, d] * w.loose[i, d]
            w.push[3 * b + d] = top.weight[b, d] * w.loose[i, 3 + d]
        for _ in range(2):  # the second pass removes the rounding errors of the first
            refine_multipliers(top, w, solver.schur, w.push, lam, True)
    unfold_multipliers(top, w.cs, lam)


@subkernel
def stabilize_tangents(top, w):
    """Add the Baumgarte terms to the derivatives of gamma.

    Their derivatives need no further element kernels: d(Phi_q v + Phi_t)/dv is Phi_q, and d(Phi_q v + Phi_t)/dq is
    -gamma_v / 2, because gamma is quadratic in v.
    """
    alpha, factor = top.baumgarte[0], top.baumgarte[1] * top.baumgarte[1]
    jac, gamma_v, res_q = w.jac, w.gamma_v, w.res_q
    for k in range(len(jac)):
        for c in range(12):
            res_q[k, c] += factor * jac[k, c] - alpha * gamma_v[k, c]
            gamma_v[k, c] -= 2.0 * alpha * jac[k, c]


@inlined
def evaluate_tangents(top, w, t, q, v, acc, lam):
    """Evaluate all terms of the stage matrix into ``w.source``, except for the masses, which are constant.

    The multipliers `lam` (P, 2) are those of the original rows, because d(Phi_q^T lam)/dq is computed for all rows;
    redundant directions carry no force and contribute nothing.
    """
    prepare(top, w, t, q)
    take_multipliers(top, w, lam)
    solved_rows(top, w, q, v)
    stabilized = top.baumgarte[0] != 0.0 or top.baumgarte[1] != 0.0
    if stabilized:  # `stabilize_tangents` fills entries that element kernels never write
        fill_rows(w.gamma_v, 0.0)
        fill_rows(w.res_q, 0.0)
    constraint_tangents(top.pairs, top.pair_parameters, q, v, acc, w.cs, w.u, lam, w.stiff, w.gamma_v, w.res_q)
    fold(top, w.cs, w.gamma_v)
    fold(top, w.cs, w.res_q)
    if stabilized:
        stabilize_tangents(top, w)
    force_tangents(top, w, q, v)
