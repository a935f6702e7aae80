"""The shift w of positions in the stages of ggl (`mbdkit.integrators.stages.collocation_constrained`), and its change
by one iteration.

Both constraints together require ``Phi_q dw_i = sum_j (A^-1)_ij Phi_j / h - (Phi_q v + Phi_t)_i`` up to terms of O(h):
with dw_i in the range of M^-1 Phi_q^T, that is an index-1 system for each stage. The change of positions by dw enters
the equations of the stages with the exact K and gamma_v, so that stiff springs do not slow the iteration.

In the coordinates of a spanning tree, those of stage i are shifted by ``-h sum_j A_ij w_j``. With T the derivative of
the positions of the bodies with respect to the coordinates, T w_j is the smallest change, in the mass metric, for which
``Phi_q T w_j = g_j`` in the cut joints; g_j replaces the multipliers mu, and vanishes for the exact motion.
"""

from __future__ import annotations

from mbdkit.engine.kernels.accelerations import solve_system
from mbdkit.engine.kernels.equations import STIFFNESS
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.kernels.tree import coordinates_of
from mbdkit.engine.kernels.tree_displacements import displace_bodies
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.functions import separate, subkernel
from mbdkit.integrators.run.run_state import FACTORIZATIONS
from mbdkit.integrators.stages.relative import Y
from mbdkit.integrators.stages.stages_on_tree import clear_rows_of_tree


@subkernel
def _take_shift_rows(c, m, h, i):
    """Write the change of ``Phi_q w`` of stage `i` by which both constraints can be satisfied into ``c.w.gamma``, and
    the Jacobian of the stage into ``c.w.jac``.
    """
    top, w, room = c.top, c.w, m.constraints
    for k in range(len(top.pairs)):
        copy(room.jac[i, k], w.jac[k])
        w.gamma[k, 0] = w.gamma[k, 1] = 0.0
        for r in range(top.rows[k]):
            total = -m.residual[i, c.solver.row_index[k, r]]
            for j in range(len(m.rk.c)):
                total += m.rk.inverse[i, j] / h * room.phi[j, k, r]
            w.gamma[k, r] = total


@subkernel
def _change_by_shift(c, m, h, i):
    """Write the change of the positions of stage `i` by the change of w into ``m.spread``."""
    for d in range(len(c.q) - 3):
        total = 0.0
        for j in range(len(m.rk.c)):
            total -= h * m.rk.a[i, j] * m.constraints.shift_change[j, d]
        m.spread[i, d] = total


@subkernel
def _add_terms_by_position(m, i, source):
    """Add the effect of the change ``m.spread`` of the positions of stage `i` to its residual.

    The terms of the tangents are in `source`.
    """
    terms = m.constraints.by_position
    for e in range(len(terms)):
        factor = 1.0 if terms[e, 3] == STIFFNESS else -0.5
        m.residual[i, terms[e, 1]] += factor * source[terms[e, 0]] * m.spread[i, terms[e, 2]]


@separate
def change_shift(c, m, h, source, acc):
    """Change mu so that both constraints can be satisfied, and add the effect of the resulting change of positions to
    the residual (ggl).

    The terms of the tangents are in `source`; `acc` (3 (B + 1),) is a work array.
    """
    top, w = c.top, c.w
    room = m.constraints
    shift, shift_change = room.shift, room.shift_change
    s = len(m.rk.c)
    n3 = len(c.q) - 3
    for i in range(s):
        _take_shift_rows(c, m, h, i)
        status = solve_system(c.still, w, c.solver, False, acc, m.pairs, False)
        if status != OK:
            return status
        for d in range(n3):
            shift_change[i, d] = -shift[i, d]
            shift[i, d] = 0.0
        for k in range(len(top.pairs)):
            for r in range(top.rows[k]):
                room.mu[i, k, r] -= m.pairs[k, r]
                for side in range(2):
                    b = top.pairs[k, PAIR.first + side]
                    if 3 * b < n3:
                        for d in range(3):
                            g = top.weight[b, d] * w.jac[k, 6 * r + 3 * side + d]
                            shift[i, 3 * b + d] += g * room.mu[i, k, r]
        for d in range(n3):
            shift_change[i, d] += shift[i, d]
    c.counts[FACTORIZATIONS] += s
    for i in range(s):
        _change_by_shift(c, m, h, i)
        _add_terms_by_position(m, i, source)
    return OK


@separate
def change_shift_on_tree(c, m, h):
    """Change g, which is stored as mu, so that the cut joints can satisfy both constraints, and add the effect of the
    resulting change of positions to the residual (ggl).
    """
    o, room = m.on_tree, m.constraints
    tree, acc = o.relative.tree, m.tangent.acc
    for i in range(len(m.rk.c)):
        _take_shift_rows(c, m, h, i)
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
        _change_by_shift(c, m, h, i)
        displace_bodies(c.top, tree, o.arms, m.spread[i])
        _add_terms_by_position(m, i, c.w.source)
    clear_rows_of_tree(c, m)
    return OK
