"""Recorded quantities of force elements, of joints (in the frames of their bodies) and of markers, at one state."""

from __future__ import annotations

import math

from mbdkit.engine.kernels.applied_forces import PATHWAYS, TORQUE, path_rate, point_force
from mbdkit.engine.kernels.table_rows import JOINT, LAW_ROW, LOAD, PAIR, SPRING, TENSION
from mbdkit.engine.native.arithmetic import where
from mbdkit.engine.native.calls import HAS_POTENTIAL
from mbdkit.engine.native.functions import subkernel

#: Kinds of the coordinate of a joint: relative angle, or distance along a line of the first body.
ANGLE, TRAVEL = range(2)

_RELATIVE_ANGLE = PATHWAYS["relative_angle"]


@subkernel
def force_values(top, w, q, v, out):
    """Write length, rate, value, power and potential of every force element into `out` (F, 5).

    Requires `applied_forces` at the same state. The value of an element on a pathway is its tension [N], or its torque
    on the second body [N m]. The value of a load is its torque on the loaded body, or the magnitude of its force. The
    length of a force at a point is 0; its rate is the velocity of the point along the force, or 0 if the force is zero.
    The power is that supplied to the bodies.
    """
    springs, loads, place, tension, u = top.springs, top.loads, top.force_place, w.tension, w.u
    for k in range(len(springs)):
        # only the first segment has the length, rate and tension of the whole pathway
        if springs[k, SPRING.segments] == 0:
            continue
        row, law, pull = place[k], springs[k, SPRING.law], tension[k, TENSION.force]
        rate = path_rate(k, springs, v, w.grad)
        out[row, 0] = w.s[k, 0]
        out[row, 1] = rate
        turns = springs[k, SPRING.pathway] == _RELATIVE_ANGLE
        out[row, 2] = 0.0 - pull if turns else pull  # 0.0 - x, because -x could be -0.0
        out[row, 3] = 0.0 - pull * rate
        has_potential = law < 0 or top.laws[law, LAW_ROW.claims] & HAS_POTENTIAL != 0
        out[row, 4] = tension[k, TENSION.potential] if has_potential else 0.0
    for k in range(len(loads)):
        row, body, other = place[len(springs) + k], loads[k, LOAD.body], loads[k, LOAD.reaction_body]
        out[row, 4] = 0.0
        if loads[k, LOAD.kind] == TORQUE:
            rate = v[3 * body + 2] - v[3 * other + 2]
            out[row, 0] = q[3 * body + 2] - q[3 * other + 2]
            out[row, 1] = rate
            out[row, 2] = u[loads[k, LOAD.x], 0]
            out[row, 3] = u[loads[k, LOAD.x], 0] * rate
        else:
            fx, fy, px, py = point_force(top, w, k)
            spin = v[3 * body + 2]
            size = math.hypot(fx, fy)
            power = fx * (v[3 * body] - spin * py) + fy * (v[3 * body + 1] + spin * px)
            # without a force the direction is undefined, and so is a velocity along it
            out[row, 0] = 0.0
            out[row, 1] = where(size > 0.0, power / size, 0.0)
            out[row, 2] = size
            out[row, 3] = power


@subkernel
def joint_values(top, w, q, lam, reactions, out):
    """Write coordinate, driver power, and reaction force in the frames of both bodies of every joint into `out` (J, 6).

    The coordinate is the angle of the second body relative to the first, or the travel of the second body along a line
    of the first.
    Requires `prepare` and ``w.phi_t`` at the same state, and the `reactions` (P, 3) of the multipliers `lam` (P, 2).
    """
    pairs, joints, lines, cs = top.pairs, top.joints, top.joint_lines, w.cs
    for j in range(len(joints)):
        a, b = joints[j, JOINT.first], joints[j, JOINT.second]
        if joints[j, JOINT.kind] == ANGLE:
            out[j, 0] = q[3 * b + 2] - q[3 * a + 2]
        else:
            c, s, bx, by = cs[b, 0], cs[b, 1], lines[j, 2], lines[j, 3]
            x, y = q[3 * b] + c * bx - s * by - q[3 * a], q[3 * b + 1] + s * bx + c * by - q[3 * a + 1]
            c, s = cs[a, 0], cs[a, 1]
            out[j, 0] = lines[j, 4] * (c * x + s * y - lines[j, 0]) + lines[j, 5] * (c * y - s * x - lines[j, 1])
        out[j, 1] = out[j, 2] = out[j, 3] = 0.0
    for k in range(len(pairs)):
        # a joint may have several pairs of rows, whose reactions add up
        j = top.pair_joint[k]
        out[j, 2] += reactions[k, 0]
        out[j, 3] += reactions[k, 1]
        if pairs[k, PAIR.motion] >= 0:
            out[j, 1] += lam[k, 0] * w.phi_t[k, 0] + lam[k, 1] * w.phi_t[k, 1]
    for j in range(len(joints)):
        # only now, because reactions of several pairs add up in the global frame
        a, b, x, y = joints[j, JOINT.first], joints[j, JOINT.second], out[j, 2], out[j, 3]
        out[j, 2] = cs[a, 0] * x + cs[a, 1] * y
        out[j, 3] = cs[a, 0] * y - cs[a, 1] * x
        out[j, 4] = cs[b, 0] * x + cs[b, 1] * y
        out[j, 5] = cs[b, 0] * y - cs[b, 1] * x


@subkernel
def marker_values(top, w, q, v, out):
    """Write position (x, y) and velocity (x, y) of every marker into `out` (K, 4); requires `prepare`."""
    for k in range(len(top.markers)):
        body = top.markers[k]
        c, s, px, py = w.cs[body, 0], w.cs[body, 1], top.marker_points[k, 0], top.marker_points[k, 1]
        x, y, spin = c * px - s * py, s * px + c * py, v[3 * body + 2]
        out[k, 0] = q[3 * body] + x
        out[k, 1] = q[3 * body + 1] + y
        out[k, 2] = v[3 * body] - spin * y
        out[k, 3] = v[3 * body + 1] + spin * x
