"""Stage equations of stiffly accurate collocation in the coordinates of a spanning tree, with cut joints imposed on
positions (index-3), velocities (index-2), or both (ggl).

The unknowns of stage i are the accelerations y''_i of the coordinates, from which coordinates and rates follow as in
`mbdkit.integrators.collocation_joint`, and the multipliers of all joints. The coordinates determine the positions q_i,
velocities v_i and accelerations a_i of the bodies, which satisfy the constraints of the joints of the tree. As in
`mbdkit.integrators.collocation_constrained`,

    M a_i + Phi_q(q_i)^T lambda_i = Q(t_i, q_i, v_i)

and the cut joints impose Phi(t_i, q_i) = 0, Phi_q v_i + Phi_t = 0, or both. In ggl, the coordinates of stage i are
shifted by ``-h sum_j A_ij w_j``. With T the derivative of the positions of the bodies with respect to the coordinates,
T w_j is the smallest change, in the mass metric, for which ``Phi_q T w_j = g_j`` in the cut joints; g_j replaces the
multipliers mu, and vanishes for the exact motion.

Simplified Newton solves the systems of `mbdkit.integrators.collocation_constrained` for the changes of the
accelerations of the bodies and of the multipliers; the residuals of the joints of the tree are zero. The changes of the
coordinates follow from those of the bodies by the inverse of T. This neglects that T changes by O(h) over the step. In
absolute coordinates, one tangent for all stages neglects as much of the change of Phi_q. The residual is exact, so that
only the contraction of the iteration depends on this.
"""

from __future__ import annotations

from mbdkit.engine.kernels.accelerations import solve_system
from mbdkit.engine.kernels.applied_forces import take_states
from mbdkit.engine.kernels.system import OK, evaluate_tangents, prepare, unfold_multipliers
from mbdkit.engine.kernels.tree import PLACE, TURN, coordinates_of, place_bodies
from mbdkit.engine.kernels.tree_displacements import accelerate_bodies, displace_bodies, take_arms, take_changes
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.functions import entry, inlined, separate, subkernel
from mbdkit.integrators import collocation_constrained
from mbdkit.integrators.collocation_constrained import (
    change_by_newton,
    evaluate_residual,
    multipliers_at_end,
    multipliers_inside,
    sizes_of_state,
)
from mbdkit.integrators.collocation_joint import (
    bodies_inside,
    choose_tangent_state,
    first_acceleration,
    keep,
    load_joint_stages,
    try_on_tree,
)
from mbdkit.integrators.collocation_stages import StageEquations, is_shifted
from mbdkit.integrators.collocation_step import evaluate_stages, move_stages
from mbdkit.integrators.element_states import solve_states
from mbdkit.integrators.relative import Y
from mbdkit.integrators.run_state import FACTORIZATIONS, load_run_state
from mbdkit.integrators.shifted_positions import add_terms_by_position, change_by_shift, take_shift_rows
from mbdkit.integrators.simplified_newton import factorize_all


@separate
def _place_stages(c, m, h):
    """Replace the coordinates in ``m.q_stage`` and ``m.v_stage`` by the state of the bodies; accelerate the bodies."""
    top, w, o, t = c.top, c.w, m.on_tree, m.previous.begin[0]
    tree = o.relative.tree
    for i in range(len(m.rk.c)):
        copy(m.q_stage[i], o.y[i])
        copy(m.v_stage[i], o.rates[i])
        place_bodies(top, w, tree, t + m.rk.c[i] * h, o.y[i], o.rates[i], m.q_stage[i], m.v_stage[i])
        copy(m.acc[i], o.acc[i])
        accelerate_bodies(top, w, tree, o.y[i], o.rates[i], m.v_stage[i], o.acc[i])


@subkernel
def _evaluate(c, m, h):
    """Evaluate coordinates and first-order states of every stage; place and accelerate the bodies."""
    evaluate_stages(c, m, h)
    _place_stages(c, m, h)


@subkernel
def _move(c, m, h, active):
    """Change the accelerations of the stages, and evaluate the stages."""
    move_stages(c, m, h, active)
    _place_stages(c, m, h)


@separate
def _tangents(c, m, t, h, at_start, wanted):
    """Evaluate and factorize the matrices of all eigenvalues; return a status."""
    choose_tangent_state(c, m, t, h, at_start)
    top, w, tangent, o = c.top, c.w, m.tangent, m.on_tree
    if not at_start:
        prepare(top, w, tangent.time[0], tangent.q)
        unfold_multipliers(top, w.cs, tangent.lam)
    take_states(top, w, m.states.z[len(m.rk.c) - 1])
    evaluate_tangents(top, w, tangent.time[0], tangent.q, tangent.v, tangent.acc, tangent.lam)
    take_arms(top, w, o.relative.tree, tangent.q, o.arms)
    return factorize_all(c, m, h, 0.5)


@subkernel
def _clear_rows(c, m):
    """Set the residuals of the constraints of the tree, which are rounding errors, to zero."""
    tree = m.on_tree.relative.tree
    for n in range(len(tree)):
        for column in (PLACE, TURN):
            k = tree[n, column]
            if k >= 0:
                for i in range(len(m.rk.c)):
                    for r in range(c.top.rows[k]):
                        m.residual[i, c.solver.row_index[k, r]] = m.constraints.phi[i, k, r] = 0.0


@separate
def _change_shift(c, m, h):
    """Change g, which is stored as mu, so that the cut joints can satisfy both constraints, and add the effect of the
    resulting change of positions to the residual (ggl).
    """
    o, room = m.on_tree, m.constraints
    tree, acc = o.relative.tree, m.tangent.acc
    for i in range(len(m.rk.c)):
        take_shift_rows(c, m, h, i)
        for k in range(len(c.top.pairs)):
            for r in range(c.top.rows[k]):
                room.mu[i, k, r] += c.w.gamma[k, r]
                c.w.gamma[k, r] = room.mu[i, k, r]
        status = solve_system(c.still, c.w, c.solver, False, acc, m.pairs, False)
        if status != OK:
            return status
        copy(room.shift[i], room.shift_change[i])
        coordinates_of(c.top, tree, m.q_stage[i], acc, o.relative.vectors[Y], room.shift[i])
        for d in range(len(c.q) - 3):
            room.shift_change[i, d] = room.shift[i, d] - room.shift_change[i, d]
    c.counts[FACTORIZATIONS] += len(m.rk.c)
    for i in range(len(m.rk.c)):
        change_by_shift(c, m, h, i)
        displace_bodies(c.top, tree, o.arms, m.spread[i])
        add_terms_by_position(m, i, c.w.source)
    return OK


@subkernel
def _changes(c, m, t, h, before):
    """Write the change of the accelerations of the coordinates by one iteration, and change the multipliers."""
    status = solve_states(c, m, t, h)
    if status != OK:
        return status
    o = m.on_tree
    evaluate_residual(c, m, o.acc, t, h)
    _clear_rows(c, m)
    if is_shifted(m):
        status = _change_shift(c, m, h)
        if status != OK:
            return status
        _clear_rows(c, m)
    change_by_newton(c, m, h)
    n3 = len(c.q) - 3
    for i in range(len(m.rk.c)):
        for d in range(n3):
            m.spread[i, d] = m.change[i, d]
        take_changes(c.top, o.relative.tree, o.arms, m.spread[i])
        for d in range(n3):
            m.change[i, d] = m.spread[i, d]
    return OK


@subkernel
def _sizes(c, m, h):
    """Return the relative change of the coordinates and their rates, and that of the coordinates."""
    return sizes_of_state(c, m, h, m.on_tree.rates)


@inlined
def _estimate_side(c, m, z, b):
    """Write ``[M T z, 0]``, and replace `z` by ``T z``."""
    displace_bodies(c.top, m.on_tree.relative.tree, m.on_tree.arms, z)
    collocation_constrained.estimate_side(c, m, z, b)


_KERNELS = collocation_constrained.KERNELS._replace(
    tangents=_tangents,
    changes=_changes,
    move=_move,
    sizes=_sizes,
    estimate_side=_estimate_side,
    evaluate=_evaluate,
    first_acceleration=first_acceleration,
)


@entry
def attempt(run, method, t, h, want_error):
    """Try a step from the base state; see `mbdkit.integrators.step_loop`."""
    c, m = load_run_state(run), load_joint_stages(method)
    status = try_on_tree(c, m, t, h, want_error, _KERNELS)
    if status == OK:
        multipliers_at_end(c, m, t + h)
    return status


@entry
def dense(run, method, t, h, theta):
    """Write state and multipliers at ``t + theta h`` within the last attempt, by the collocation polynomials."""
    c, m = load_run_state(run), load_joint_stages(method)
    bodies_inside(c, m, t, h, theta)
    multipliers_inside(c, m, t + theta * h, theta)
    return OK


EQUATIONS = StageEquations(attempt, dense, collocation_constrained.choose_pivots, keep)
