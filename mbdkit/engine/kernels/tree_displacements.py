"""Small displacements of the bodies of a spanning tree, and the changes of its coordinates that cause them; and the
accelerations of the bodies.

If the angles of the two bodies of a joint change by alpha and beta, and the travel along its line by s, then the
displacements of their centers of mass satisfy

    d_b - d_a = A alpha + B beta + u s

with vectors A, B and u (zero without a line), the *arms* of the joint. Coordinates of a tree are as in
`mbdkit.engine.kernels.tree`; vectors may be complex.
"""

from __future__ import annotations

from mbdkit.engine.kernels.constraints import KINDS
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.kernels.tree import BODY, PLACE, PLACE_SIDE, TURN, TURN_SIDE, turned
from mbdkit.engine.native.functions import subkernel

AX, AY, BX, BY, UX, UY, ARMS = range(7)  #: Columns of the arms of a tree (B, 6), whose rows are those of the tree.

_LINE, _DRIVER, _CENTER = KINDS["point_on_line"], KINDS["driver_angle"], KINDS["moving_center"]


@subkernel
def take_arms(top, w, tree, q, arms):
    """Write the arms of all joints of a tree at the positions `q` of the bodies; requires `prepare`."""
    p, cs = top.pair_parameters, w.cs
    for n in range(len(tree)):
        k = tree[n, PLACE]
        if k < 0:
            continue
        a, b, m = top.pairs[k, PAIR.first], top.pairs[k, PAIR.second], top.pairs[k, PAIR.motion]
        bx, by = turned(cs[b, 0], cs[b, 1], p[k, 2], p[k, 3])
        x, y = q[3 * b] + bx - q[3 * a], q[3 * b + 1] + by - q[3 * a + 1]  # from the first center to the point of b
        tx = ty = ux = uy = 0.0
        if top.pairs[k, PAIR.kind] == _LINE:
            ux, uy = turned(cs[a, 0], cs[a, 1], p[k, 4], p[k, 5])
        elif top.pairs[k, PAIR.kind] == _CENTER:
            # the center moves on the first body as the second one turns relative to it
            tx, ty = turned(cs[a, 0], cs[a, 1], w.u[m, 1], w.u[m + 2, 1])
        # a rotation by a small angle displaces a point at (x, y) by (-y, x)
        arms[n, AX], arms[n, AY] = -y - tx, x - ty
        arms[n, BX], arms[n, BY] = by + tx, ty - bx
        arms[n, UX], arms[n, UY] = ux, uy


@subkernel
def displace_bodies(top, tree, arms, x):
    """Replace the changes of the coordinates in `x` by the displacements of the bodies; those of ground are zero."""
    for n in range(len(tree)):
        b, k = tree[n, BODY], tree[n, TURN]
        if k >= 0:
            x[3 * b + 2] = x[3 * top.pairs[k, PAIR.second - tree[n, TURN_SIDE]] + 2]
    for n in range(len(tree)):
        i, k, side = tree[n, BODY], tree[n, PLACE], tree[n, PLACE_SIDE]
        if k < 0:
            continue
        a, b = top.pairs[k, PAIR.first], top.pairs[k, PAIR.second]
        other, sign = top.pairs[k, PAIR.second - side], 2.0 * side - 1.0
        alpha, beta, travel = x[3 * a + 2], x[3 * b + 2], x[3 * i]
        for d in range(2):
            # the parent is known, because bodies come in order from the roots
            apart = arms[n, AX + d] * alpha + arms[n, BX + d] * beta + arms[n, UX + d] * travel
            x[3 * i + d] = x[3 * other + d] + sign * apart


@subkernel
def take_changes(top, tree, arms, x):
    """Replace the displacements of the bodies in `x` by the changes of the coordinates; the inverse of
    `displace_bodies`.
    """
    for n in range(len(tree) - 1, -1, -1):  # from the leaves, because the displacement of the parent is needed
        i, k = tree[n, BODY], tree[n, PLACE]
        if k >= 0:
            a, b = top.pairs[k, PAIR.first], top.pairs[k, PAIR.second]
            travel = x[3 * i] * 0.0
            for d in range(2):
                turning = arms[n, AX + d] * x[3 * a + 2] + arms[n, BX + d] * x[3 * b + 2]
                travel += arms[n, UX + d] * (x[3 * b + d] - x[3 * a + d] - turning)
            x[3 * i], x[3 * i + 1] = travel, 0.0
        if tree[n, TURN] >= 0:
            x[3 * i + 2] = 0.0


@subkernel
def accelerate_bodies(top, w, tree, y, rates, v, acc):
    """Replace the accelerations of the coordinates in `acc` by those of the bodies: the inverse of
    `mbdkit.engine.kernels.tree.accelerate_coordinates`.

    `y` and `rates` are the coordinates and their rates, `v` the velocities of the bodies; needs `place_bodies`.
    """
    p, cs, u = top.pair_parameters, w.cs, w.u
    for n in range(len(tree)):
        i, k, side = tree[n, BODY], tree[n, TURN], tree[n, TURN_SIDE]
        if k >= 0:
            acc[3 * i + 2] = acc[3 * top.pairs[k, PAIR.second - side] + 2]
            if top.pairs[k, PAIR.kind] == _DRIVER:
                acc[3 * i + 2] += (2.0 * side - 1.0) * u[top.pairs[k, PAIR.motion], 2]
    for n in range(len(tree)):
        i, k, side = tree[n, BODY], tree[n, PLACE], tree[n, PLACE_SIDE]
        if k < 0:
            continue
        a, b, m, sign = top.pairs[k, PAIR.first], top.pairs[k, PAIR.second], top.pairs[k, PAIR.motion], 2.0 * side - 1.0
        wa, wb, da, db = v[3 * a + 2], v[3 * b + 2], acc[3 * a + 2], acc[3 * b + 2]
        ax, ay = turned(cs[a, 0], cs[a, 1], p[k, 0], p[k, 1])
        bx, by = turned(cs[b, 0], cs[b, 1], p[k, 2], p[k, 3])
        x = db * by + wb * wb * bx - da * ay - wa * wa * ax
        z = wb * wb * by - db * bx + da * ax - wa * wa * ay
        if top.pairs[k, PAIR.kind] == _LINE:
            ux, uy = turned(cs[a, 0], cs[a, 1], p[k, 4], p[k, 5])
            s = y[3 * i]
            along, across = acc[3 * i] - wa * wa * s, 2.0 * wa * rates[3 * i] + da * s
            x += along * ux - across * uy
            z += along * uy + across * ux
        elif top.pairs[k, PAIR.kind] == _CENTER:
            hx, hy = turned(cs[a, 0], cs[a, 1], u[m, 0], u[m + 2, 0])
            tx, ty = turned(cs[a, 0], cs[a, 1], u[m, 1], u[m + 2, 1])
            cx, cy = turned(cs[a, 0], cs[a, 1], u[m, 2], u[m + 2, 2])
            turn = wb - wa
            x += (db - da) * tx + turn * turn * cx - 2.0 * wa * turn * ty - da * hy - wa * wa * hx
            z += (db - da) * ty + turn * turn * cy + 2.0 * wa * turn * tx + da * hx - wa * wa * hy
        other = top.pairs[k, PAIR.second - side]
        acc[3 * i], acc[3 * i + 1] = acc[3 * other] + sign * x, acc[3 * other + 1] + sign * z
