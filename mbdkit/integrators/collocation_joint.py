"""Stage equations of collocation methods in the coordinates of a spanning tree (`mbdkit.engine.kernels.tree`).

The unknowns of stage i are the accelerations y''_i of the coordinates. With A the tableau,

    y'_i = y'_n + h sum_j A_ij y''_j,    y_i = y_n + h c_i y'_n + h^2 sum_j (A A)_ij y''_j,    y''_i = f(t_i, y_i, y'_i)

where f follows from the bodies: the coordinates place them, the index-1 equations give their accelerations, and these
those of the coordinates. Cut joints are therefore imposed on the accelerations.

Simplified Newton solves the system of `mbdkit.integrators.collocation_index1` for the accelerations of the bodies. A
residual r of the coordinates accelerates the bodies by T r, with T the derivative of the positions of the bodies with
respect to the coordinates (`mbdkit.engine.kernels.tree_displacements`); the change of the coordinates follows from that
of the bodies by the inverse of T. This neglects that T changes by O(h) over the step where a force is stiff. The
residual is exact, so that only the contraction of the iteration depends on this.

The step itself is that of `mbdkit.integrators.collocation_step`: for its duration, the base state of the run holds
coordinates instead of bodies.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_accelerations
from mbdkit.engine.kernels.applied_forces import state_rates, take_states
from mbdkit.engine.kernels.bundle_types import STATE, State
from mbdkit.engine.kernels.system import OK, evaluate_powers, evaluate_tangents, prepare
from mbdkit.engine.kernels.tree import BODY, PLACE, accelerate_coordinates, coordinates_of, place_bodies
from mbdkit.engine.kernels.tree_displacements import ARMS, displace_bodies, take_arms, take_changes
from mbdkit.engine.kernels.vectors import copy, fill_rows
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import entry, inlined, separate, subkernel
from mbdkit.integrators import collocation_index1
from mbdkit.integrators.collocation_stages import (
    NEWTON,
    Coefficients,
    Constraints,
    FirstAcceleration,
    PreviousStep,
    Settings,
    StageEquations,
    Stages,
    StageStates,
    Systems,
    TangentState,
    example_stages,
)
from mbdkit.integrators.collocation_step import evaluate_stages, keep_stages, move_stages, state_inside, try_step
from mbdkit.integrators.convergence import ROUGH_CHANGE
from mbdkit.integrators.element_states import solve_states
from mbdkit.integrators.relative import (
    BASE,
    BASE_RATES,
    V_STAGE,
    Y_RATES,
    Relative,
    Y,
    end_of_step,
    errors_of_bodies,
    new_relative,
)
from mbdkit.integrators.run_state import AT_END_OF_LAST, FACTORIZATIONS, RHS, load_run_state
from mbdkit.integrators.simplified_newton import factorize_all, newton_changes
from mbdkit.integrators.stage_polynomials import stage_mean, stage_mean_of_pairs


class OnTree(NamedTuple):
    """What the stages need in addition in the coordinates of a tree."""

    relative: Relative
    from_q: np.ndarray
    """(3 (B + 1),) base state of the bodies during an attempt."""
    from_v: np.ndarray
    y: np.ndarray
    """(s, 3 (B + 1)) coordinates of the stages, and their rates."""
    rates: np.ndarray
    acc: State
    """(s, 3 (B + 1)) accelerations of the bodies in the stages."""
    first_acc: State
    """(3 (B + 1),) accelerations of the bodies at the beginning of the step."""
    arms: np.ndarray
    """(B, 6) arms of the joints of the tree at the tangent state."""


class JointStages(NamedTuple):
    """The stages in the coordinates of a tree; see `mbdkit.integrators.collocation_stages.Stages`, whose fields it has.

    `acc`, `residual`, `change` and ``first.acc`` are those of the coordinates; `q_stage` and `v_stage` belong to the
    bodies.
    """

    rk: Coefficients
    systems: Systems
    settings: Settings
    previous: Annotated[PreviousStep, STATE]
    solved_apart: State
    turning: State
    nodes: np.ndarray
    acc: State
    lam: State
    q_stage: np.ndarray
    v_stage: np.ndarray
    residual: np.ndarray
    change: np.ndarray
    states: StageStates
    constraints: Constraints
    first: Annotated[FirstAcceleration, STATE]
    tangent: TangentState
    power: State
    weights: np.ndarray
    dense_weights: np.ndarray
    spread: np.ndarray
    pairs: np.ndarray
    on_tree: OnTree


def joint_stages(stages: Stages, tree: np.ndarray) -> JointStages:
    """Return the bundle of a method in the coordinates of a tree."""
    s, size = stages.acc.shape
    on_tree = OnTree(
        relative=new_relative(size, tree),
        from_q=np.zeros(size), from_v=np.zeros(size), y=np.zeros((s, size)), rates=np.zeros((s, size)),
        acc=np.zeros((s, size)), first_acc=np.zeros(size), arms=np.zeros((len(tree), ARMS)),
    )  # fmt: skip
    return JointStages(*stages, on_tree)


load_joint_stages = bundle_loader(lambda: joint_stages(example_stages(), new_relative(0).tree))


@subkernel
def _take_coordinates(c, m):
    """Replace the base state of the bodies by that of the coordinates, until `_restore_bodies` is called."""
    o = m.on_tree
    vectors = o.relative.vectors
    copy(c.from_q, o.from_q)
    copy(c.from_v, o.from_v)
    coordinates_of(c.top, o.relative.tree, o.from_q, o.from_v, vectors[BASE], vectors[BASE_RATES])
    copy(vectors[BASE], c.from_q)
    copy(vectors[BASE_RATES], c.from_v)


@subkernel
def _restore_bodies(c, m):
    """Restore the base state of the bodies."""
    copy(m.on_tree.from_q, c.from_q)
    copy(m.on_tree.from_v, c.from_v)


@separate
def _place_stages(c, m, h):
    """Replace the coordinates in ``m.q_stage`` and ``m.v_stage`` by the state of the bodies."""
    o, t = m.on_tree, m.previous.begin[0]
    for i in range(len(m.rk.c)):
        copy(m.q_stage[i], o.y[i])
        copy(m.v_stage[i], o.rates[i])
        place_bodies(c.top, c.w, o.relative.tree, t + m.rk.c[i] * h, o.y[i], o.rates[i], m.q_stage[i], m.v_stage[i])


@subkernel
def evaluate(c, m, h):
    """Evaluate coordinates and first-order states of every stage, and place the bodies."""
    evaluate_stages(c, m, h)
    _place_stages(c, m, h)


@subkernel
def _move(c, m, h, active):
    """Change the accelerations of the stages, and evaluate the stages."""
    move_stages(c, m, h, active)
    _place_stages(c, m, h)


@subkernel
def choose_tangent_state(c, m, t, h, at_start):
    """Choose the state where the tangents are taken: the start of the step, or the mean of all stages."""
    tangent, o = m.tangent, m.on_tree
    if at_start:
        tangent.time[0] = t
        copy(o.from_q, tangent.q)
        copy(o.from_v, tangent.v)
        copy(o.first_acc, tangent.acc)
        for k in range(len(tangent.lam)):
            copy(m.first.lam[k], tangent.lam[k])
        return
    vectors = o.relative.vectors
    tangent.time[0] = t
    for i in range(len(m.rk.c)):
        tangent.time[0] += m.rk.c[i] * h / len(m.rk.c)
    stage_mean(o.y, vectors[Y], True)
    stage_mean(o.rates, vectors[Y_RATES], True)
    place_bodies(c.top, c.w, o.relative.tree, tangent.time[0], vectors[Y], vectors[Y_RATES], tangent.q, tangent.v)
    stage_mean(o.acc, tangent.acc, True)
    stage_mean_of_pairs(m.lam, tangent.lam, True)


@separate
def _tangents(c, m, t, h, at_start, wanted):
    """Evaluate and factorize the matrices of all eigenvalues unless Newton's method is not used; return a status."""
    if m.settings.solver[0] != NEWTON:
        return OK
    choose_tangent_state(c, m, t, h, at_start)
    top, w, tangent, o = c.top, c.w, m.tangent, m.on_tree
    take_states(top, w, m.states.z[len(m.rk.c) - 1])
    evaluate_tangents(top, w, tangent.time[0], tangent.q, tangent.v, tangent.acc, tangent.lam)
    take_arms(top, w, o.relative.tree, tangent.q, o.arms)
    for p in range(len(top.pairs)):
        copy(w.jac[p], tangent.jac[p])
    return factorize_all(c, m, h, 1.0)


@separate
def _evaluate_accelerations(c, m, t, h, refine, with_powers):
    """Evaluate the accelerations of the coordinates of every stage into ``m.spread``; return a status."""
    top, w, o = c.top, c.w, m.on_tree
    for i in range(len(m.rk.c)):
        prepare(top, w, t + m.rk.c[i] * h, m.q_stage[i])
        take_states(top, w, m.states.z[i])
        status = solve_accelerations(top, w, c.solver, m.q_stage[i], m.v_stage[i], o.acc[i], m.lam[i], refine)
        if status != OK:
            return status
        if with_powers:
            m.power[i, 0], m.power[i, 1] = evaluate_powers(top, w, m.q_stage[i], m.v_stage[i], m.lam[i])
        copy(o.acc[i], m.spread[i])
        accelerate_coordinates(top, w, o.relative.tree, o.y[i], m.v_stage[i], m.spread[i])
    c.counts[RHS] += len(m.rk.c)
    c.counts[FACTORIZATIONS] += len(m.rk.c)
    return OK


@subkernel
def _estimate_side(c, m, z, b):
    """Write ``[M T z, Phi_q T z]`` into `b` (n + m,), and replace `z` by ``T z``."""
    displace_bodies(c.top, m.on_tree.relative.tree, m.on_tree.arms, z)
    collocation_index1.lift(c, m, z, b)


@inlined
def _right_side(c, m, weights, rate, z, b):
    """Write the right-hand side of the system of an eigenvalue mu; it does not depend on ``rate = h mu``."""
    _estimate_side(c, m, z, b)


@subkernel
def _changes(c, m, t, h, before):
    """Write the change of the accelerations of the coordinates by one iteration; return a status."""
    status = solve_states(c, m, t, h)
    if status == OK:
        status = _evaluate_accelerations(c, m, t, h, before < ROUGH_CHANGE, False)
    if status != OK:
        return status
    n3 = len(c.q) - 3
    for i in range(len(m.residual)):
        for d in range(n3):
            m.residual[i, d] = m.acc[i, d] - m.spread[i, d]
            m.change[i, d] = -m.residual[i, d]
    if m.settings.solver[0] == NEWTON:
        newton_changes(c, m, h, _right_side)
        for i in range(len(m.change)):
            copy(m.change[i], m.spread[i])  # the changes have no entries for ground, which does not move
            take_changes(c.top, m.on_tree.relative.tree, m.on_tree.arms, m.spread[i])
            for d in range(n3):
                m.change[i, d] = m.spread[i, d]
    return OK


@subkernel
def _powers(c, m, t, h):
    """Write the power of loads, drivers and active laws, and the dissipated power, of each stage to ``m.power``."""
    return _evaluate_accelerations(c, m, t, h, True, True)


@separate
def first_acceleration(c, m, t):
    """Solve for the accelerations at the beginning of a step unless they are known; return a status."""
    first, o = m.first, m.on_tree
    if first.known[0] != 0:
        return OK
    prepare(c.top, c.w, t, o.from_q)
    take_states(c.top, c.w, c.from_z)
    status = solve_accelerations(c.top, c.w, c.solver, o.from_q, o.from_v, o.first_acc, first.lam, False)
    if status == OK:
        state_rates(c.top, c.w, o.from_v, m.states.first_rate)
        copy(o.first_acc, first.acc)
        accelerate_coordinates(c.top, c.w, o.relative.tree, c.from_q, o.from_v, first.acc)
        c.counts[RHS] += 1
        c.counts[FACTORIZATIONS] += 1
        first.known[0] = 1
    return status


_KERNELS = collocation_index1.KERNELS._replace(
    tangents=_tangents,
    changes=_changes,
    move=_move,
    powers=_powers,
    right_side=_right_side,
    estimate_side=_estimate_side,
    evaluate=evaluate,
    first_acceleration=first_acceleration,
)


@subkernel
def _bodies_at_end(c, m, t, h, want_error):
    """Replace increments and errors of the coordinates by those of the bodies at the end `t` of the step."""
    o = m.on_tree
    relative = o.relative
    tree = relative.tree
    for n in range(len(tree)):
        if tree[n, PLACE] >= 0:  # the travel is not part of the state, whose velocities have low parts
            c.dq[3 * tree[n, BODY]] -= h * c.v_low[3 * tree[n, BODY]]
    end_of_step(c, relative, t)
    if want_error != 0.0:
        if m.settings.solver[0] == NEWTON:  # the filter gives displacements of the bodies
            take_changes(c.top, tree, o.arms, c.est_q)
            take_changes(c.top, tree, o.arms, c.est_v)
        errors_of_bodies(c, relative, t, c.est_q, c.est_v, m.spread[0], relative.vectors[V_STAGE])


@inlined
def try_on_tree(c, m, t, h, want_error, kernels):
    """Try a step in the coordinates of the tree from the base state of the bodies; return a status."""
    o = m.on_tree
    if c.base_state[0] == AT_END_OF_LAST:  # valid if ``m.first`` is taken over as well, and otherwise overwritten
        copy(o.acc[len(o.acc) - 1], o.first_acc)
    if not abs(m.previous.size[0]) > 0.0:  # free flight, as in `mbdkit.integrators.collocation_step`
        fill_rows(o.acc, 0.0)
    _take_coordinates(c, m)
    status = try_step(c, m, t, h, want_error, kernels)
    _restore_bodies(c, m)
    if status == OK:
        _bodies_at_end(c, m, t + h, h, want_error)
    return status


@entry
def attempt(run, method, t, h, want_error):
    """Try a step from the base state; see `mbdkit.integrators.step_loop`."""
    return try_on_tree(load_run_state(run), load_joint_stages(method), t, h, want_error, _KERNELS)


@subkernel
def bodies_inside(c, m, t, h, theta):
    """Write the state of the bodies at ``t + theta h`` within the last attempt."""
    vectors = m.on_tree.relative.vectors
    _take_coordinates(c, m)
    state_inside(c, m, h, theta, c)
    _restore_bodies(c, m)
    copy(c.point_q, vectors[Y])
    copy(c.point_v, vectors[Y_RATES])
    tree = m.on_tree.relative.tree
    place_bodies(c.top, c.w, tree, t + theta * h, vectors[Y], vectors[Y_RATES], c.point_q, c.point_v)


@entry
def dense(run, method, t, h, theta):
    """Write the state at ``t + theta h`` within the last attempt, by the collocation polynomial of the coordinates."""
    bodies_inside(load_run_state(run), load_joint_stages(method), t, h, theta)
    return OK


@entry
def keep(run, method, t, h, unused):
    """Store the stages of the last attempt as quadrature nodes; see `mbdkit.integrators.step_loop`."""
    c, m = load_run_state(run), load_joint_stages(method)
    _take_coordinates(c, m)
    evaluate(c, m, h)
    _restore_bodies(c, m)
    keep_stages(c, m, t, h)
    return OK


EQUATIONS = StageEquations(attempt, dense, collocation_index1.EQUATIONS.choose_pivots, keep)
