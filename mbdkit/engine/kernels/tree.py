"""Coordinates of the joints of a spanning tree, and the states of all bodies that follow from them.

Coordinates are stored in vectors with three numbers for each body, as positions are. The first two are x and y if no
joint of the tree places the body; the travel along the line and zero if a constraint to a line places it; and zeros if
a pin or a moving center places it. The third is the angle of the body, or zero if a weld, a slide or a driver
determines it.
Angles are absolute. They differ from angles relative to the parent body in the tree by a linear transformation with
constant coefficients, under which the steps of Runge-Kutta methods are invariant.

Bodies are processed from the root, so that the state of the parent is known: O(B) operations for B bodies.
Accelerations of bodies come from the equations with multipliers, which include those of the joints of the tree.
"""

from __future__ import annotations

from mbdkit.engine.kernels.angles import cosine_and_sine
from mbdkit.engine.kernels.constraints import KINDS
from mbdkit.engine.kernels.pose_functions import evaluate_functions
from mbdkit.engine.kernels.system import prepare_angles, prepare_motions
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.native.functions import inlined, subkernel

#: Columns of a tree (B, 5), whose rows are the bodies in order from the roots: the body; the pair of constraint rows
#: that places it (-1: none), and whether it is the second body of that pair; the pair that determines its angle (-1:
#: none), and whether it is the second body of that pair.
BODY, PLACE, PLACE_SIDE, TURN, TURN_SIDE, COLUMNS = range(6)

_LINE, _DRIVER, _CENTER = KINDS["point_on_line"], KINDS["driver_angle"], KINDS["moving_center"]


@inlined
def turned(c, s, x, y):
    """Return the global components of a vector (x, y) given in a frame with the cosine `c` and the sine `s`."""
    return c * x - s * y, s * x + c * y


@subkernel
def _travel(top, k, q, v):
    p, a, b = top.pair_parameters, top.pairs[k, PAIR.first], top.pairs[k, PAIR.second]
    ca, sa = cosine_and_sine(q[3 * a + 2])
    cb, sb = cosine_and_sine(q[3 * b + 2])
    ux, uy = turned(ca, sa, p[k, 4], p[k, 5])
    ax, ay = turned(ca, sa, p[k, 0], p[k, 1])
    bx, by = turned(cb, sb, p[k, 2], p[k, 3])
    wa, wb = v[3 * a + 2], v[3 * b + 2]
    x, y = q[3 * b] - q[3 * a] + bx - ax, q[3 * b + 1] - q[3 * a + 1] + by - ay
    # the line turns with body a; the rate along it contains no term of its own turning, because the point lies on it
    vx, vy = v[3 * b] - v[3 * a] - wb * by + wa * ay, v[3 * b + 1] - v[3 * a + 1] + wb * bx - wa * ax
    return ux * x + uy * y, ux * vx + uy * vy


@subkernel
def coordinates_of(top, tree, q, v, y, rates):
    """Write the coordinates of the tree and their rates at the state `q`, `v` into `y` and `rates`."""
    for n in range(len(tree)):
        b, k = tree[n, BODY], tree[n, PLACE]
        for d in range(2):
            if k < 0:
                y[3 * b + d], rates[3 * b + d] = q[3 * b + d], v[3 * b + d]
            else:
                y[3 * b + d] = rates[3 * b + d] = 0.0
        if k >= 0 and top.pairs[k, PAIR.kind] == _LINE:
            y[3 * b], rates[3 * b] = _travel(top, k, q, v)
        if tree[n, TURN] < 0:
            y[3 * b + 2], rates[3 * b + 2] = q[3 * b + 2], v[3 * b + 2]
        else:
            y[3 * b + 2] = rates[3 * b + 2] = 0.0


@subkernel
def _turn(top, w, tree, y, rates, q, v):
    """Write the angles of all bodies and their rates into `q` and `v`; needs `prepare_motions`."""
    for n in range(len(tree)):
        b, k, side = tree[n, BODY], tree[n, TURN], tree[n, TURN_SIDE]
        if k < 0:
            q[3 * b + 2], v[3 * b + 2] = y[3 * b + 2], rates[3 * b + 2]
            continue
        # a driver or weld gives the angle of the second body minus that of the first
        other, sign = top.pairs[k, PAIR.second - side], 2.0 * side - 1.0
        q[3 * b + 2], v[3 * b + 2] = q[3 * other + 2], v[3 * other + 2]
        if top.pairs[k, PAIR.kind] == _DRIVER:
            m = top.pairs[k, PAIR.motion]
            q[3 * b + 2] += sign * w.u[m, 0]
            v[3 * b + 2] += sign * w.u[m, 1]
        else:
            q[3 * b + 2] += sign * top.pair_parameters[k, 4]


@subkernel
def _place(top, w, tree, y, rates, q, v):
    """Write the positions of all bodies and their rates into `q` and `v`; needs the angles and `prepare_angles`."""
    p, cs = top.pair_parameters, w.cs
    for n in range(len(tree)):
        i, k, side = tree[n, BODY], tree[n, PLACE], tree[n, PLACE_SIDE]
        if k < 0:
            for d in range(2):
                q[3 * i + d], v[3 * i + d] = y[3 * i + d], rates[3 * i + d]
            continue
        a, b, m, sign = top.pairs[k, PAIR.first], top.pairs[k, PAIR.second], top.pairs[k, PAIR.motion], 2.0 * side - 1.0
        wa, wb = v[3 * a + 2], v[3 * b + 2]
        ax, ay = turned(cs[a, 0], cs[a, 1], p[k, 0], p[k, 1])
        bx, by = turned(cs[b, 0], cs[b, 1], p[k, 2], p[k, 3])
        gx, gy = ax - bx, ay - by  # from the centre of mass of the first body to that of the second
        # the arms turn with their bodies
        vx, vy = wb * by - wa * ay, wa * ax - wb * bx
        if top.pairs[k, PAIR.kind] == _LINE:
            ux, uy = turned(cs[a, 0], cs[a, 1], p[k, 4], p[k, 5])
            s, rate = y[3 * i], rates[3 * i]
            gx += s * ux
            gy += s * uy
            # the point slides along the line, which turns with the first body
            vx += rate * ux - wa * s * uy
            vy += rate * uy + wa * s * ux
        elif top.pairs[k, PAIR.kind] == _CENTER:
            hx, hy = turned(cs[a, 0], cs[a, 1], w.u[m, 0], w.u[m + 2, 0])
            tx, ty = turned(cs[a, 0], cs[a, 1], w.u[m, 1], w.u[m + 2, 1])
            gx += hx
            gy += hy
            vx += (wb - wa) * tx - wa * hy
            vy += (wb - wa) * ty + wa * hx
        other = top.pairs[k, PAIR.second - side]
        q[3 * i], q[3 * i + 1] = q[3 * other] + sign * gx, q[3 * other + 1] + sign * gy
        v[3 * i], v[3 * i + 1] = v[3 * other] + sign * vx, v[3 * other + 1] + sign * vy


@subkernel
def turn_tree(top, w, tree, t, y, rates, q, v):
    """Write the angles of all bodies and their rates into `q` and `v`; evaluate motions, cosines and sines at `t`."""
    prepare_motions(top, w, t)
    _turn(top, w, tree, y, rates, q, v)
    prepare_angles(top, w, q)


@subkernel
def place_bodies(top, w, tree, t, y, rates, q, v):
    """Write the state of all bodies into `q` and `v`; evaluate motions, centers, functions of the pose, cosines
    and sines at `t`.
    """
    turn_tree(top, w, tree, t, y, rates, q, v)
    _place(top, w, tree, y, rates, q, v)
    if len(top.functions) > 0:
        evaluate_functions(top, w, q)


@subkernel
def accelerate_coordinates(top, w, tree, y, v, acc):
    """Replace the accelerations of the bodies in `acc` by those of the coordinates of the tree.

    `y` are the coordinates and `v` the velocities of the bodies; needs `place_bodies`.
    """
    p, cs = top.pair_parameters, w.cs
    for n in range(len(tree) - 1, -1, -1):  # from the leaves, since the acceleration of the parent is needed
        i, k = tree[n, BODY], tree[n, PLACE]
        if k >= 0:
            if top.pairs[k, PAIR.kind] == _LINE:
                a, b = top.pairs[k, PAIR.first], top.pairs[k, PAIR.second]
                ux, uy = turned(cs[a, 0], cs[a, 1], p[k, 4], p[k, 5])
                ax, ay = turned(cs[a, 0], cs[a, 1], p[k, 0], p[k, 1])
                bx, by = turned(cs[b, 0], cs[b, 1], p[k, 2], p[k, 3])
                wa, wb, da, db = v[3 * a + 2], v[3 * b + 2], acc[3 * a + 2], acc[3 * b + 2]
                x = acc[3 * b] - acc[3 * a] - db * by - wb * wb * bx + da * ay + wa * wa * ax
                z = acc[3 * b + 1] - acc[3 * a + 1] + db * bx - wb * wb * by - da * ax + wa * wa * ay
                acc[3 * i] = ux * x + uy * z + wa * wa * y[3 * i]
            else:
                acc[3 * i] = 0.0
            acc[3 * i + 1] = 0.0
        if tree[n, TURN] >= 0:
            acc[3 * i + 2] = 0.0
