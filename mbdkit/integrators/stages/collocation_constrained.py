"""Stage equations of stiffly accurate collocation on the constraints themselves: index 3, index 2, and both (ggl).

Stage i, in second-order form, with A the tableau and its last row the weights of the step:

    M a_i + Phi_q(q_i)^T lambda_i = Q(t_i, q_i, v_i)                 v_i = v_n + h sum_j A_ij a_j
    q_i = q_n + h c_i v_n + h^2 sum_j (A A)_ij a_j - h sum_j A_ij w_j,    w_j = M^-1 Phi_q(q_j)^T mu_j

index-3 imposes Phi(t_i, q_i) = 0 and index-2 imposes Phi_q v_i + Phi_t = 0, both with mu = 0. ggl imposes both (Gear,
Leimkuhler and Gupta 1985), with multipliers mu that vanish for the exact motion. The factor M^-1, which their paper
omits, makes w the smallest change in the mass metric, independent of the units of lengths and angles. The change of w
comes first in every iteration (`mbdkit.integrators.stages.shifted_positions`).

Simplified Newton with one tangent for all stages decouples along the eigenvectors of A, as on the index-1 equations
(`mbdkit.integrators.stages.collocation_index1`). With r = h mu of an eigenvalue, the changes of accelerations and
multipliers solve

    [ M + r C + r^2 K          Phi_q^T ] [ da      ]     [ M a + Phi_q^T lambda - Q                     ]
    [ Phi_q - g gamma_v        0       ] [ dlambda ] = - [ Phi / r^2,  or  (Phi_q v + Phi_t) / r        ]

with g = 0 (index 3), or r / 2 because d(Phi_q v + Phi_t)/dq is -gamma_v / 2 (index 2, ggl). The rows are scaled by
powers of r, so that the matrix is as well conditioned as that of index 1 for any small step; the round-off of index-3
multipliers, about eps / h^2 of a coordinate, is inherent in the formulation.

In the coordinates of a spanning tree, the unknowns a_i are the accelerations y''_i of the coordinates, which determine
q_i, v_i and the accelerations of the bodies (`mbdkit.integrators.stages.stages_on_tree`), and only the cut joints
impose constraints. The systems are those above, for the changes of the accelerations of the bodies and of the
multipliers of all joints; the residuals of the joints of the tree are zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.formulation import FORMULATIONS
from mbdkit.engine.iteration_matrix import chosen_pivots, classes_of
from mbdkit.engine.kernels.applied_forces import any_forces, applied_forces, take_multipliers, take_states
from mbdkit.engine.kernels.engine_bundles import Scatter
from mbdkit.engine.kernels.equations import DAMPING, GAMMA_V, JACOBIAN, MASS, STIFFNESS
from mbdkit.engine.kernels.projection import STAGNANT, position_rows, rate_rows
from mbdkit.engine.kernels.system import (
    OK,
    evaluate_powers,
    evaluate_tangents,
    prepare,
    solved_rows,
    unfold_multipliers,
)
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.kernels.tree_displacements import displace_bodies, take_arms
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.functions import entry, inlined, separate, subkernel
from mbdkit.integrators.run.run_state import RHS, load_run_state
from mbdkit.integrators.stages.collocation_stages import StageKernels, is_shifted, load_stages, solves_positions_only
from mbdkit.integrators.stages.collocation_step import (
    choose_tangent_state,
    every_change_is_idle,
    move_stages,
    state_inside,
    try_step,
)
from mbdkit.integrators.stages.convergence import (
    NEGLIGIBLE_CHANGE,
    PATIENCE,
    accelerations_are_round_off,
    moves_by_roundings,
    relative_to_state,
)
from mbdkit.integrators.stages.element_states import solve_states
from mbdkit.integrators.stages.shifted_positions import change_shift, change_shift_on_tree
from mbdkit.integrators.stages.simplified_newton import factorize_all, newton_changes
from mbdkit.integrators.stages.stage_polynomials import extrapolation_weights
from mbdkit.integrators.stages.stages_on_tree import clear_rows_of_tree, is_on_tree, take_changes_of_stages
from mbdkit.integrators.stages.turning_beams import turn_residual_back, turns_stages

if TYPE_CHECKING:
    from mbdkit.engine.kernels.lu import Pattern
    from mbdkit.engine.workspace import Workspace


@separate
def _tangents(c, m, t, h, at_start, wanted):
    """Evaluate and factorize the matrices of all eigenvalues; return a status."""
    choose_tangent_state(c, m, t, h, at_start, wanted)
    top, w, tangent = c.top, c.w, m.tangent
    if not at_start:
        prepare(top, w, tangent.time[0], tangent.q)
        unfold_multipliers(top, w.cs, tangent.lam)
    take_states(top, w, m.states.z[len(m.rk.c) - 1])
    evaluate_tangents(top, w, tangent.time[0], tangent.q, tangent.v, tangent.acc, tangent.lam)
    if is_on_tree(m):
        take_arms(top, w, m.on_tree.relative.tree, tangent.q, m.on_tree.arms)
    return factorize_all(c, m, h, 0.5)


@separate
def evaluate_residual(c, m, acc, t, h):
    """Evaluate the residual of the equations of motion and of the constraints of every stage into ``m.residual``.

    `acc` (s, 3 (B + 1)) are the accelerations of the bodies in the stages.
    """
    top, w = c.top, c.w
    n3 = len(c.q) - 3
    has_forces = any_forces(top)
    for i in range(len(m.rk.c)):
        q, v, lack = m.q_stage[i], m.v_stage[i], m.residual[i]
        position_rows(top, w, t + m.rk.c[i] * h, q)
        solved_rows(top, w, q, v)
        for b in range(len(top.mass) - 1):
            lack[3 * b] = top.mass[b, 0] * (acc[i, 3 * b] - top.gravity[0])
            lack[3 * b + 1] = top.mass[b, 1] * (acc[i, 3 * b + 1] - top.gravity[1])
            lack[3 * b + 2] = top.mass[b, 2] * acc[i, 3 * b + 2]
        if has_forces:
            take_states(top, w, m.states.z[i])
            take_multipliers(top, w, m.lam[i])
            applied_forces(top, w, q, v)
            for d in range(n3):
                lack[d] -= w.force[d]
        rate_rows(top, w.jac, w.phi_t, v, m.pairs)
        for k in range(len(top.pairs)):
            for r in range(top.rows[k]):
                for side in range(2):
                    at = 3 * top.pairs[k, PAIR.first + side]
                    if at < n3:
                        for d in range(3):
                            lack[at + d] += w.jac[k, 6 * r + 3 * side + d] * m.lam[i, k, r]
                m.constraints.phi[i, k, r] = w.phi[k, r]
                in_position = solves_positions_only(m)
                lack[c.solver.row_index[k, r]] = w.phi[k, r] if in_position else m.pairs[k, r]
            copy(w.jac[k], m.constraints.jac[i, k])
    c.counts[RHS] += len(m.rk.c)


@inlined
def right_side(c, m, weights, rate, z, b):
    """Write the transformed residual with its constraint rows scaled by ``rate = h mu``."""
    scale = rate * rate if solves_positions_only(m) else rate
    n3 = len(c.q) - 3
    for d in range(n3):
        b[d] = z[d]
    for d in range(n3, len(b)):
        b[d] = z[d] / scale


@subkernel
def _changes(c, m, t, h, before):
    """Write the change of accelerations and multipliers by one iteration, and change the multipliers."""
    status = solve_states(c, m, t, h)
    if status != OK:
        return status
    if is_on_tree(m):
        evaluate_residual(c, m, m.on_tree.acc, t, h)
        clear_rows_of_tree(c, m)
    else:
        evaluate_residual(c, m, m.acc, t, h)
    if turns_stages(m):
        turn_residual_back(m)
    if is_shifted(m):
        if is_on_tree(m):
            status = change_shift_on_tree(c, m, h)
        else:
            status = change_shift(c, m, h, c.w.source, m.tangent.acc)
        if status != OK:
            return status
    newton_changes(c, m, h, right_side)
    for i in range(len(m.rk.c)):
        for k in range(len(c.top.pairs)):
            for r in range(c.top.rows[k]):
                m.lam[i, k, r] += m.change[i, c.solver.row_index[k, r]]
    if is_on_tree(m):
        take_changes_of_stages(c, m)
    return OK


@subkernel
def _change_of_positions(c, m, h):
    shifted = is_shifted(m)
    for i in range(len(m.rk.c)):
        for d in range(len(c.q) - 3):
            total = 0.0
            for j in range(len(m.rk.c)):
                total += h * h * m.rk.a2[i, j] * m.change[j, d]
                if shifted:
                    total -= h * m.rk.a[i, j] * m.constraints.shift_change[j, d]
            m.spread[i, d] = total


@subkernel
def _change_of_velocities(c, m, h):
    for i in range(len(m.rk.c)):
        for d in range(len(c.q) - 3):
            total = 0.0
            for j in range(len(m.rk.c)):
                total += h * m.rk.a[i, j] * m.change[j, d]
            m.spread[i, d] = total


@subkernel
def _sizes(c, m, h):
    """Return the relative change of the state, and that of the positions; on a tree, those of its coordinates.

    With index 3 only positions have to converge, because constraints on positions determine velocities only to the
    round-off of positions over h.
    """
    bodies = len(c.top.mass) - 1
    rates = m.on_tree.rates if is_on_tree(m) else m.v_stage
    _change_of_positions(c, m, h)
    now = moved = relative_to_state(m.spread, c.from_q, bodies)
    if not solves_positions_only(m):
        _change_of_velocities(c, m, h)
        now = max(now, relative_to_state(m.spread, rates[len(m.rk.c) - 1], bodies))
        moved = max(moved, h * relative_to_state(m.spread, c.from_q, bodies))
    return now, moved


@subkernel
def round_off(c, m, h, now, moved, idle):
    """Return whether a change that no longer decreases is the round-off of positions or of single forces.

    The round-off of forces is large where forces of stiff springs cancel. It is accepted only if positions change by at
    most `STAGNANT`.
    """
    if moves_by_roundings(moved):
        return True
    if idle < PATIENCE:
        return False
    return now <= NEGLIGIBLE_CHANGE or (moved <= STAGNANT and accelerations_are_round_off(c, m, h, True))


@separate
def unfold(c, t, q, lam, out):
    """Expand the multipliers `lam` of the rows that are solved for to those of the pairs of rows, `out`.

    Calls `prepare` for the position `q`.
    """
    prepare(c.top, c.w, t, q)
    for k in range(len(out)):
        out[k, 0], out[k, 1] = lam[k, 0], lam[k, 1]
    unfold_multipliers(c.top, c.w.cs, out)


@subkernel
def stage_powers(c, m, t, h):
    """Evaluate the powers of the stages."""
    for i in range(len(m.rk.c)):
        unfold(c, t + m.rk.c[i] * h, m.q_stage[i], m.lam[i], m.pairs)
        take_states(c.top, c.w, m.states.z[i])
        take_multipliers(c.top, c.w, m.pairs)
        applied_forces(c.top, c.w, m.q_stage[i], m.v_stage[i])
        m.power[i, 0], m.power[i, 1] = evaluate_powers(c.top, c.w, m.q_stage[i], m.v_stage[i], m.pairs)
    c.counts[RHS] += len(m.rk.c)
    return OK


@inlined
def estimate_side(c, m, z, b):
    """Write ``[M z, 0]``: components of `z` that violate the constraints are omitted, because they do not accumulate as
    errors. On a tree, `z` is first replaced by the displacements T z of the bodies.
    """
    if is_on_tree(m):
        displace_bodies(c.top, m.on_tree.relative.tree, m.on_tree.arms, z)
    n3 = len(c.q) - 3
    for d in range(n3):
        b[d] = c.top.mass[d // 3, d % 3] * z[d]
    for d in range(n3, len(b)):
        b[d] = 0.0


KERNELS = StageKernels(
    _tangents, _changes, move_stages, _sizes, every_change_is_idle, round_off, stage_powers, estimate_side
)


@entry
def attempt(run, method, t, h, want_error):
    """Try a step from the base state; see `mbdkit.integrators.loop.step_loop`."""
    c, m = load_run_state(run), load_stages(method)
    status = try_step(c, m, t, h, want_error, KERNELS)
    if status == OK:  # the multipliers at the end of the step are those of the last stage
        last = len(m.rk.c) - 1
        unfold(c, t + h, m.q_stage[last], m.lam[last], c.own_lam)
    return status


@entry
def dense(run, method, t, h, theta):
    """Write state and multipliers at ``t + theta h`` within the last attempt, by its collocation polynomial."""
    c, m = load_run_state(run), load_stages(method)
    state_inside(c, m, t, h, theta, c)
    extrapolation_weights(theta, 0.0, m.rk.c, m.weights)  # each row has the weights of the polynomial at theta
    m.pairs[:, :] = 0.0
    for i in range(len(m.rk.c)):
        for k in range(len(m.pairs)):
            for r in range(2):
                m.pairs[k, r] += m.weights[0, i] * m.lam[i, k, r]
    unfold(c, t + theta * h, c.point_q, m.pairs, c.point_lam)
    return OK


def choose_pivots(workspace: Workspace, rate: complex | None) -> tuple[Pattern, Scatter]:
    """Choose pivots for stage matrices with ``rate = h mu``.

    In rows of constraints on velocities, -gamma_v has the factor ``h mu / 2``.
    """
    if rate is None:
        raise ValueError("stages on the constraints are solved by Newton's method only")
    row_share = 0.5 if "velocity" in FORMULATIONS[workspace.formulation].holds else 0.0
    coefficients = np.zeros(6, dtype=type(rate))
    coefficients[[MASS, JACOBIAN, DAMPING, STIFFNESS]] = 1.0, 1.0, rate, rate**2
    coefficients[GAMMA_V] = -row_share * rate
    pivots = chosen_pivots(workspace, classes_of(workspace), coefficients)
    classes = ((MASS, JACOBIAN), (DAMPING,), (GAMMA_V,), (STIFFNESS,))
    chosen = (np.isin(pivots.scatter[:, 2], some) for some in classes)
    return pivots.pattern, Scatter(*(np.ascontiguousarray(pivots.scatter[some, :2]) for some in chosen))
