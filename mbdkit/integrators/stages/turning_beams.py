"""Simplified Newton for steps in which stiff beams turn: the frozen tangents turn with the nodes.

The stiffness of a beam turns with it: at stage i it is about ``R_i K R_i^T``, where K is the stiffness at the stage of
the tangents and R_i turns the force on each node by the angle phi_i by which the node has turned between these stages.
One tangent for all stages is therefore wrong by phi_i times the ratio of axial to bending stiffness, and the iteration
diverges for phi_i of a few hundredths. Let T be the matrix of Newton's method for all stages, with exact tangents, and
T_0 the one that is decoupled along the eigenvectors of A. Solving with ``R T_0``, that is, turning the forces of the
residual back by ``R_i^T`` before the decoupled solution, leaves an error of ``R_i K (I - R_i^T)``. In the solution, the
stiffness cancels: the iteration contracts by about the largest phi_i, for beams of any stiffness, and costs as much as
before. The changes of the stages are not turned: with ``R T_0 R^T``, an error proportional to ``R_i - R_j`` would
couple the stages, which converges more slowly. Nor are the rows of constraints, which do not turn where a beam is
pinned.

The tangents are those of a stage, because the mean of the positions of a beam that turns is a compressed beam, which
may buckle. The stages are predicted by a motion without strain. Extrapolated accelerations of a stiff beam are useless:
in such steps they alternate, and their polynomial grows.
"""

from __future__ import annotations

from mbdkit.engine.kernels.angles import cosine_and_sine
from mbdkit.engine.kernels.vectors import copy, fill_rows
from mbdkit.engine.native.arithmetic import any_of
from mbdkit.engine.native.functions import inlined, subkernel

#: Largest angle [rad] by which the node of a beam may turn in a step of this iteration; chosen.
#:
#: The equations of a longer step can have spurious solutions that do not approximate the motion. Iterations that
#: converge contract by about half the angle.
LONGEST_TURN = 0.5


@inlined
def turns_stages(m):
    """Return whether the tangents of the stages turn with the nodes of beams."""
    return m.turning[0] != 0


@subkernel
def predict_turned(c, m, h):
    """Predict that beams turn as in the previous step; without one, that their nodes move on circles.

    In a steady rotation, the accelerations of a stage turn from step to step by the angle of a step. On its circle, a
    node turns at its own rate, and its velocity turns with it: a beam that turns as a whole is not strained.
    """
    size = m.previous.size[0]
    is_known = any_of(abs(size) > 0.0)
    for e in range(len(m.nodes)):
        x = 3 * m.nodes[e]
        y, angle = x + 1, x + 2
        rate = c.from_v[angle]
        if is_known:
            turn = size * rate
            for i in range(len(m.acc)):
                turn += size * size * (m.rk.b2[i] - m.rk.b[i]) * m.acc[i, angle]
            cosine, sine = cosine_and_sine(turn * h / size)
            for i in range(len(m.acc)):
                along, across = m.acc[i, x], m.acc[i, y]
                m.acc[i, x] = cosine * along - sine * across
                m.acc[i, y] = sine * along + cosine * across
        else:
            for i in range(len(m.acc)):
                cosine, sine = cosine_and_sine(h * m.rk.c[i] * rate)
                m.acc[i, x] = -rate * (sine * c.from_v[x] + cosine * c.from_v[y])
                m.acc[i, y] = rate * (cosine * c.from_v[x] - sine * c.from_v[y])


@subkernel
def take_middle_stage(m, t, h):
    """Take the tangents at the middle one of the stages, or at the first one of two."""
    tangent, i = m.tangent, (len(m.rk.c) - 1) // 2
    tangent.time[0] = t + m.rk.c[i] * h
    copy(m.q_stage[i], tangent.q)
    copy(m.v_stage[i], tangent.v)
    copy(m.acc[i], tangent.acc)
    for k in range(len(tangent.lam)):
        copy(m.lam[i, k], tangent.lam[k])


@subkernel
def turn_residual_back(m):
    """Turn the forces on the nodes in ``m.residual``, the residual of forces and constraints, back to the tangents."""
    residual = m.residual
    for e in range(len(m.nodes)):
        x = 3 * m.nodes[e]
        for i in range(len(residual)):
            cosine, sine = cosine_and_sine(m.q_stage[i, x + 2] - m.tangent.q[x + 2])
            along, across = residual[i, x], residual[i, x + 1]
            residual[i, x] = cosine * along + sine * across
            residual[i, x + 1] = cosine * across - sine * along


@subkernel
def turn_accelerations_back(m):
    """Write what turning the residual accelerations back adds to them into ``m.spread``; see `add_turned_forces`."""
    residual, added = m.residual, m.spread
    fill_rows(added, 0.0)
    for e in range(len(m.nodes)):
        x = 3 * m.nodes[e]
        for i in range(len(residual)):
            cosine, sine = cosine_and_sine(m.q_stage[i, x + 2] - m.tangent.q[x + 2])
            along, across = residual[i, x], residual[i, x + 1]
            added[i, x] = cosine * along + sine * across - along
            added[i, x + 1] = cosine * across - sine * along - across


@inlined
def add_turned_forces(c, m, weights, b):
    """Turn the forces on the nodes in the right-hand side `b` of index-1; its constraint rows remain as they are.

    `weights` (s,) are those of the transformation of the residual to the eigenvector of this system.
    """
    for e in range(len(m.nodes)):
        x = 3 * m.nodes[e]
        for j in range(len(m.residual)):
            for d in range(2):
                b[x + d] += weights[j] * (c.top.mass[m.nodes[e], d] * m.spread[j, x + d])


@subkernel
def turns_far(c, m):
    """Return whether a node turns by more than `LONGEST_TURN` from the start of the step to a stage."""
    largest = 0.0
    for e in range(len(m.nodes)):
        angle = 3 * m.nodes[e] + 2
        for i in range(len(m.q_stage)):
            largest = max(largest, abs(m.q_stage[i, angle] - c.from_q[angle]))
    return any_of(largest > LONGEST_TURN)
