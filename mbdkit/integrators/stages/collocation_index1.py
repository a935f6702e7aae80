"""Stage equations of collocation methods on the index-1 equations: accelerations are the unknowns.

Stage i, in second-order form, with A the tableau, the unknowns a_i and f the index-1 accelerations:

    v_i = v_n + h sum_j A_ij a_j,        q_i = q_n + h c_i v_n + h^2 sum_j (A A)_ij a_j,        a_i = f(t_i, q_i, v_i)

Simplified Newton with one tangent for all stages decouples along the eigenvectors of A (Butcher 1976, Bickart 1977).
The residual r = a - f of each eigenvalue mu takes one sparse system, complex for a pair of conjugate eigenvalues, with
all terms of the tangents of M a + Phi_q^T lambda - Q and of Phi_q a - gamma,

    [ M + h mu C + h^2 mu^2 K                               Phi_q^T ] [ x  ]   [ M r     ]
    [ Phi_q - h mu gamma_v + h^2 mu^2 (Phi_q a - gamma)_q   0       ] [ nu ] = [ Phi_q r ]

which is (1 - h mu f_v - h^2 mu^2 f_q) x = r without forming f_v and f_q. Because f is evaluated exactly at every
stage, only its derivatives are frozen, and the contraction of the iteration is O(h^2).

In the coordinates of a spanning tree, f and the change of the stages are those of
`mbdkit.integrators.stages.stages_on_tree`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbdkit.engine.kernels.accelerations import solve_accelerations
from mbdkit.engine.kernels.applied_forces import take_states
from mbdkit.engine.kernels.system import OK, evaluate_powers, evaluate_tangents, prepare
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.kernels.tree import accelerate_coordinates
from mbdkit.engine.kernels.tree_displacements import displace_bodies, take_arms
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.arithmetic import any_of
from mbdkit.engine.native.functions import entry, inlined, separate, subkernel
from mbdkit.integrators.run.run_state import FACTORIZATIONS, RHS, load_run_state
from mbdkit.integrators.stages.collocation_stages import NEWTON, StageKernels, load_stages
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
    ROUGH_CHANGE,
    accelerations_are_round_off,
    relative_to_accelerations,
)
from mbdkit.integrators.stages.element_states import solve_states
from mbdkit.integrators.stages.simplified_newton import factorize_all, newton_changes
from mbdkit.integrators.stages.stages_on_tree import is_on_tree, take_changes_of_stages
from mbdkit.integrators.stages.turning_beams import add_turned_forces, turn_accelerations_back, turns_stages

if TYPE_CHECKING:
    from mbdkit.engine.kernels.engine_bundles import Scatter
    from mbdkit.engine.kernels.lu import Pattern
    from mbdkit.engine.workspace import Workspace


@separate
def _tangents(c, m, t, h, at_start, wanted):
    """Evaluate and factorize the matrices of all eigenvalues unless Newton's method is not used; return a status."""
    if m.settings.solver[0] != NEWTON:
        return OK
    choose_tangent_state(c, m, t, h, at_start, wanted)
    top, w, tangent = c.top, c.w, m.tangent
    take_states(top, w, m.states.z[len(m.rk.c) - 1])
    evaluate_tangents(top, w, tangent.time[0], tangent.q, tangent.v, tangent.acc, tangent.lam)
    if is_on_tree(m):
        take_arms(top, w, m.on_tree.relative.tree, tangent.q, m.on_tree.arms)
    for p in range(len(top.pairs)):
        copy(w.jac[p], m.tangent.jac[p])
    return factorize_all(c, m, h, 1.0)


@separate
def evaluate_accelerations(c, m, t, h, refine, with_powers):
    """Evaluate the index-1 accelerations of every stage into ``m.spread``; return a status."""
    top, w, o = c.top, c.w, m.on_tree
    for i in range(len(m.rk.c)):
        acc = o.acc[i] if is_on_tree(m) else m.spread[i]
        prepare(top, w, t + m.rk.c[i] * h, m.q_stage[i])
        take_states(top, w, m.states.z[i])
        status = solve_accelerations(top, w, c.solver, m.q_stage[i], m.v_stage[i], acc, m.lam[i], refine)
        if status != OK:
            return status
        if with_powers:
            m.power[i, 0], m.power[i, 1] = evaluate_powers(top, w, m.q_stage[i], m.v_stage[i], m.lam[i])
        if is_on_tree(m):
            copy(acc, m.spread[i])
            accelerate_coordinates(top, w, o.relative.tree, o.y[i], m.v_stage[i], m.spread[i])
    c.counts[RHS] += len(m.rk.c)
    c.counts[FACTORIZATIONS] += len(m.rk.c)
    return OK


@inlined
def lift(c, m, x, b):
    """Write ``[M x, Phi_q x]`` into `b` (n + m,) for an acceleration `x` that is zero on the ground.

    On a tree, `x` is a change of the coordinates, which is first replaced by the displacements T x of the bodies.
    """
    if is_on_tree(m):
        displace_bodies(c.top, m.on_tree.relative.tree, m.on_tree.arms, x)
    top, row_index, jac = c.top, c.solver.row_index, m.tangent.jac
    pairs, rows, mass = top.pairs, top.rows, top.mass
    n3 = len(c.q) - 3
    for body in range(len(mass) - 1):
        for i in range(3):
            b[3 * body + i] = mass[body, i] * x[3 * body + i]
    for k in range(len(pairs)):
        first, second = 3 * pairs[k, PAIR.first], 3 * pairs[k, PAIR.second]
        for r in range(rows[k]):
            total = x[n3] * 0.0
            for i in range(3):
                total += jac[k, 6 * r + i] * x[first + i] + jac[k, 6 * r + 3 + i] * x[second + i]
            b[row_index[k, r]] = total


@inlined
def right_side(c, m, weights, rate, z, b):
    """Write the right-hand side of the system of an eigenvalue mu; it does not depend on ``rate = h mu``."""
    lift(c, m, z, b)
    if turns_stages(m):
        add_turned_forces(c, m, weights, b)


@subkernel
def _changes(c, m, t, h, before):
    """Write the change of the stage accelerations by one iteration; return a status."""
    status = solve_states(c, m, t, h)
    if status == OK:
        status = evaluate_accelerations(c, m, t, h, before < ROUGH_CHANGE, False)
    if status != OK:
        return status
    s, n3 = len(m.residual), len(c.q) - 3
    if m.settings.solver[0] == NEWTON:
        for i in range(s):
            for d in range(n3):
                m.residual[i, d] = m.acc[i, d] - m.spread[i, d]
        if turns_stages(m):
            turn_accelerations_back(m)
        newton_changes(c, m, h, right_side)
        if is_on_tree(m):
            take_changes_of_stages(c, m)
    else:
        for i in range(s):
            for d in range(n3):
                m.change[i, d] = m.spread[i, d] - m.acc[i, d]
    return OK


@subkernel
def _sizes(c, m, h):
    """Return the relative change of the accelerations; that of the positions is not needed."""
    now = relative_to_accelerations(m.acc, m.change, len(c.top.mass) - 1)
    return now, now


@subkernel
def _round_off(c, m, h, now, moved, idle):
    """Return whether a change of the accelerations that no longer decreases is round-off."""
    small = now <= NEGLIGIBLE_CHANGE
    if any_of(not small):
        small = small | accelerations_are_round_off(c, m, h, idle >= PATIENCE)
    return small


@subkernel
def stage_powers(c, m, t, h):
    """Write the power of loads, drivers and active laws, and the dissipated power, of each stage to ``m.power``."""
    return evaluate_accelerations(c, m, t, h, True, True)


KERNELS = StageKernels(_tangents, _changes, move_stages, _sizes, every_change_is_idle, _round_off, stage_powers, lift)


@entry
def attempt(run, method, t, h, want_error):
    """Try a step from the base state; see `mbdkit.integrators.loop.step_loop`."""
    return try_step(load_run_state(run), load_stages(method), t, h, want_error, KERNELS)


@entry
def dense(run, method, t, h, theta):
    """Write the state at ``t + theta h`` within the last attempt, by its collocation polynomial."""
    c = load_run_state(run)
    state_inside(c, load_stages(method), t, h, theta, c)
    return OK


def choose_pivots(workspace: Workspace, rate: complex | None) -> tuple[Pattern, Scatter]:
    """Choose pivots for stage matrices with ``rate = h mu``, or for one without tangents if that is None."""
    pattern, _, scatter = workspace.choose_pivots(rate)
    return pattern, scatter
