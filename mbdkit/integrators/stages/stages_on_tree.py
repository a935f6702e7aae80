"""The map between the bodies and the coordinates of a spanning tree (`mbdkit.engine.kernels.tree`) in collocation.

The unknowns of stage i are the accelerations y''_i of the coordinates. With A the tableau,

    y'_i = y'_n + h sum_j A_ij y''_j,    y_i = y_n + h c_i y'_n + h^2 sum_j (A A)_ij y''_j

The coordinates place the bodies of each stage, and so determine their positions, velocities and, together with y''_i,
accelerations, which satisfy the constraints of the joints of the tree. On the index-1 equations, y''_i follows from the
accelerations of the bodies, so that cut joints are imposed on the accelerations; the other formulations impose them on
positions, velocities, or both.

Simplified Newton solves the systems of `mbdkit.integrators.stages.collocation_index1` and
`mbdkit.integrators.stages.collocation_constrained` for the accelerations of the bodies. A residual r of the coordinates
accelerates the bodies by T r, with T the derivative of the positions of the bodies with respect to the coordinates
(`mbdkit.engine.kernels.tree_displacements`); the change of the coordinates follows from that of the bodies by the
inverse of T. This neglects that T changes by O(h) over the step; in the coordinates of bodies, one tangent for all
stages neglects as much of the change of Phi_q. The residual is exact, so that only the contraction of the iteration
depends on this.

The step itself is that of `mbdkit.integrators.stages.collocation_step`: for its duration, the base state of the run
holds coordinates instead of bodies. `c` is the bundle of the run, `m` that of the stages.
"""

from __future__ import annotations

from mbdkit.engine.kernels.tree import BODY, PLACE, TURN, coordinates_of, place_bodies
from mbdkit.engine.kernels.tree_displacements import accelerate_bodies, take_changes
from mbdkit.engine.kernels.vectors import copy, fill_rows
from mbdkit.engine.native.functions import inlined, separate, subkernel
from mbdkit.integrators.run.run_state import AT_END_OF_LAST
from mbdkit.integrators.stages.collocation_stages import NEWTON, solves_multipliers
from mbdkit.integrators.stages.relative import BASE, BASE_RATES, V_STAGE, Y_RATES, Y, end_of_step, errors_of_bodies
from mbdkit.integrators.stages.stage_polynomials import stage_mean, stage_mean_of_pairs


@inlined
def is_on_tree(m):
    """Return whether the unknowns of the stages are accelerations of the coordinates of a tree."""
    return len(m.on_tree.relative.tree) > 0


@subkernel
def take_coordinates(c, m):
    """Replace the base state of the bodies by that of the coordinates of a tree until `restore_bodies` is called."""
    if is_on_tree(m):
        o = m.on_tree
        vectors = o.relative.vectors
        copy(c.from_q, o.from_q)
        copy(c.from_v, o.from_v)
        coordinates_of(c.top, o.relative.tree, o.from_q, o.from_v, vectors[BASE], vectors[BASE_RATES])
        copy(vectors[BASE], c.from_q)
        copy(vectors[BASE_RATES], c.from_v)


@subkernel
def restore_bodies(c, m):
    """Restore the base state of the bodies."""
    if is_on_tree(m):
        copy(m.on_tree.from_q, c.from_q)
        copy(m.on_tree.from_v, c.from_v)


@inlined
def first_state(c, m):
    """Return positions and velocities of the bodies at the beginning of the step, and where their accelerations are."""
    if is_on_tree(m):
        return m.on_tree.from_q, m.on_tree.from_v, m.on_tree.first_acc
    return c.from_q, c.from_v, m.first.acc


@separate
def place_stages(c, m, h):
    """Replace the coordinates in ``m.q_stage`` and ``m.v_stage`` by the state of the bodies.

    The accelerations of the bodies follow from those of the coordinates, except on the index-1 equations.
    """
    top, w, o, t = c.top, c.w, m.on_tree, m.previous.begin[0]
    tree = o.relative.tree
    for i in range(len(m.rk.c)):
        copy(m.q_stage[i], o.y[i])
        copy(m.v_stage[i], o.rates[i])
        place_bodies(top, w, tree, t + m.rk.c[i] * h, o.y[i], o.rates[i], m.q_stage[i], m.v_stage[i])
        if solves_multipliers(m):
            copy(m.acc[i], o.acc[i])
            accelerate_bodies(top, w, tree, o.y[i], o.rates[i], m.v_stage[i], o.acc[i])


@subkernel
def place_point(c, m, t, out):
    """Replace the coordinates in ``out.point_q`` and ``out.point_v`` at the time `t` by the state of the bodies."""
    relative = m.on_tree.relative
    vectors = relative.vectors
    copy(out.point_q, vectors[Y])
    copy(out.point_v, vectors[Y_RATES])
    place_bodies(c.top, c.w, relative.tree, t, vectors[Y], vectors[Y_RATES], out.point_q, out.point_v)


@subkernel
def take_mean_on_tree(c, m, t, h):
    """Take the tangents at the mean of the coordinates of all stages."""
    tangent, o = m.tangent, m.on_tree
    vectors = o.relative.vectors
    tangent.time[0] = t
    for i in range(len(m.rk.c)):
        tangent.time[0] += m.rk.c[i] * h / len(m.rk.c)
    stage_mean(o.y, vectors[Y], True)
    stage_mean(o.rates, vectors[Y_RATES], True)
    place_bodies(c.top, c.w, o.relative.tree, tangent.time[0], vectors[Y], vectors[Y_RATES], tangent.q, tangent.v)
    stage_mean(o.acc, tangent.acc, True)
    stage_mean_of_pairs(m.lam, tangent.lam, True)


@subkernel
def clear_rows_of_tree(c, m):
    """Set the residuals of the constraints of the tree, which are rounding errors, to zero."""
    tree = m.on_tree.relative.tree
    for n in range(len(tree)):
        for column in (PLACE, TURN):
            k = tree[n, column]
            if k >= 0:
                for i in range(len(m.rk.c)):
                    for r in range(c.top.rows[k]):
                        m.residual[i, c.solver.row_index[k, r]] = m.constraints.phi[i, k, r] = 0.0


@subkernel
def take_changes_of_stages(c, m):
    """Replace the changes of the bodies in ``m.change`` by those of the coordinates."""
    n3 = len(c.q) - 3  # the changes have no entries for ground, which does not move
    for i in range(len(m.change)):
        for d in range(n3):
            m.spread[i, d] = m.change[i, d]
        take_changes(c.top, m.on_tree.relative.tree, m.on_tree.arms, m.spread[i])
        for d in range(n3):
            m.change[i, d] = m.spread[i, d]


@subkernel
def begin_on_tree(c, m):
    """Begin an attempt in the coordinates of a tree, if there is one."""
    o = m.on_tree
    if is_on_tree(m):
        if c.base_state[0] == AT_END_OF_LAST:  # valid if ``m.first`` is taken over as well, and otherwise overwritten
            copy(o.acc[len(o.acc) - 1], o.first_acc)
        if not abs(m.previous.size[0]) > 0.0:  # free flight, as in `mbdkit.integrators.stages.collocation_step`
            fill_rows(o.acc, 0.0)
        take_coordinates(c, m)


@subkernel
def bodies_at_end(c, m, t, h, want_error):
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
