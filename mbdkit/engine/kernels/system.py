"""The terms of the index-1 system of a whole mechanism, and their tangents.

State vectors are flat, (3 (B + 1),), with ground last and at rest, so that elements on ground need no special case.
Multipliers are (P, 2), one row for each pair of constraint rows. `mbdkit.engine.kernels.accelerations` solves the
system.

Redundant directions are not solved for. `fold` removes them from the constraint rows, and `unfold_multipliers` restores
the multipliers of all rows afterwards.
"""

from __future__ import annotations

from mbdkit.engine.kernels.applied_forces import force_tangents, powers, take_multipliers
from mbdkit.engine.kernels.constraints import (
    constraint_accelerations,
    constraint_positions,
    constraint_tangents,
    turn_bodies,
)
from mbdkit.engine.kernels.motions import OF_CENTER, centers, motions
from mbdkit.engine.kernels.pose_functions import evaluate_functions, evaluate_third_derivatives
from mbdkit.engine.kernels.table_rows import PAIR, SPARE
from mbdkit.engine.kernels.vectors import fill, fill_rows
from mbdkit.engine.native.arithmetic import any_of, is_dual, is_lanes
from mbdkit.engine.native.functions import inlined, overload, subkernel

#: Status of a kernel: success; the index-1 system or the stage matrix needs new pivots; overflow; no convergence.
OK, REPIVOT, REPIVOT_STAGES, NOT_FINITE, DIVERGED = range(5)


@inlined
def prepare(top, w, t, q):
    """Evaluate the quantities that elements share at a time and position: motions, centers, cosines and sines,
    functions of the pose.
    """
    prepare_motions(top, w, t)
    prepare_angles(top, w, q)
    if len(top.functions) > 0:
        evaluate_functions(top, w, q)


@inlined
def prepare_motions(top, w, t):
    """Evaluate the part of `prepare` that depends on the time only."""
    w.time[0] = t
    # a step that begins at a discontinuity needs the limits from within the step
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
    work, lost = powers(top, w, v, lam)
    return work, lost + power_of_reactions(w, v)


def power_of_reactions(w, v):
    """Return the power that reactions of elements dissipate [W]; see `Reacting`."""
    return w.reacting.power[0]


@overload(power_of_reactions)
def _power_of_reactions(w, v):
    if is_lanes(v) or is_dual(v):  # such runs have no reactions of elements
        return lambda w, v: 0.0
    return lambda w, v: w.reacting.power[0]


@inlined
def constraint_rate(pairs, jac, phi_t, v, k, r):
    """Return row `r` of pair `k` of ``Phi_q v + Phi_t``, the time derivative of the constraints."""
    a, b = 3 * pairs[k, PAIR.first], 3 * pairs[k, PAIR.second]
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
            w.jac[top.spare[i, SPARE.pair], c] = 0.0
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
    c, s = cs[top.spare[i, SPARE.body], 0], cs[top.spare[i, SPARE.body], 1]
    x, y = top.spare_axes[i, 0], top.spare_axes[i, 1]
    return c * x - s * y, s * x + c * y


@subkernel
def fold(top, cs, x):
    """Reduce the two rows of six columns of every pair, `x` (P, 12), to the rows that are solved for, in place.

    Of a pair with one redundant direction, the combination of rows perpendicular to this direction becomes the first
    row. Of a pair with two redundant directions, nothing is left. All other rows become zero.
    """
    for i in range(len(top.spare)):
        k = top.spare[i, SPARE.pair]
        dx, dy = spare_direction(top, cs, i)
        for c in range(6):
            x[k, c] = dx * x[k, 6 + c] - dy * x[k, c] if top.rows[k] == 1 else 0.0
            x[k, 6 + c] = 0.0


@subkernel
def fold_values(top, cs, x):
    """Reduce the two values of every pair, `x` (P, 2), to those of the rows that are solved for; see `fold`."""
    for i in range(len(top.spare)):
        k = top.spare[i, SPARE.pair]
        dx, dy = spare_direction(top, cs, i)
        x[k, 0] = dx * x[k, 1] - dy * x[k, 0] if top.rows[k] == 1 else 0.0
        x[k, 1] = 0.0


@subkernel
def _remove_redundant_rows(top, w):
    """Reduce the Jacobian and gamma to the rows that are solved for; store the removed rows in ``w.loose``."""
    jac, loose = w.jac, w.loose
    for i in range(len(top.spare)):
        k = top.spare[i, SPARE.pair]
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
        k = top.spare[i, SPARE.pair]
        dx, dy = spare_direction(top, cs, i)
        # a single multiplier acts along the combination of rows that was solved for
        across = lam[k, 0] if top.rows[k] == 1 else 0.0
        lam[k, 0] = -dy * across
        lam[k, 1] = dx * across


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
    if len(top.functions) > 0:
        evaluate_third_derivatives(top, w, q)
    if stabilized:  # `stabilize_tangents` fills entries that element kernels never write
        fill_rows(w.gamma_v, 0.0)
        fill_rows(w.res_q, 0.0)
    constraint_tangents(top.pairs, top.pair_parameters, q, v, acc, w.cs, w.u, lam, w.stiff, w.gamma_v, w.res_q)
    fold(top, w.cs, w.gamma_v)
    fold(top, w.cs, w.res_q)
    if stabilized:
        stabilize_tangents(top, w)
    force_tangents(top, w, q, v)
