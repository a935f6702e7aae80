"""Accelerations of trees of pins by articulated bodies: O(B) operations without multipliers.

The force that a pin exerts on the bodies behind it is linear in the acceleration A of the pin, ``F = K A + f``, with
the symmetric 2 x 2 articulated mass K (Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 7). Angles are absolute,
so that only the pin couples a body to the one before it, and no 3 x 3 inertias are needed. With the sums over the pins
of the next bodies, the force on a body and the torque about its pin are

    F = M A + h alpha + b,      0 = h . A + I alpha + c,

which gives alpha as a function of A, and so K and f. Accelerations follow in a second pass from the roots, where A is
zero at ground; the reference point of a free body is its centre of mass, where F is zero. The multipliers of the pins
are not needed for a step; those of recorded states are solved for by `mbdkit.engine.kernels.system`.
"""

from __future__ import annotations

from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.kernels.tree import BODY, PLACE, PLACE_SIDE, turned
from mbdkit.engine.native.functions import subkernel

#: Columns of `bodies` (B + 1, 13): entries of M; h; I, later 1 / I; b; c; the vector r from the pin of the body to its
#: centre of mass; and the vector d to this pin from that of the body before. The second pass puts A into the first two.
MXX, MXY, MYY, HX, HY, INERTIA, BX, BY, TORQUE, RX, RY, DX, DY, ARTICULATED = range(14)


@subkernel
def _begin(top, cs, tree, has_forces, force, v, bodies):
    """Write the contributions of each body itself: its mass, inertia and applied forces, with respect to its pin."""
    p = top.pair_parameters
    for n in range(len(tree)):
        i, k, side = tree[n, BODY], tree[n, PLACE], tree[n, PLACE_SIDE]
        x, mass, inertia = bodies[i], top.mass[i, 0], top.mass[i, 2]
        # gravity belongs to the bias of each body: the acceleration of ground is zero
        fx, fy = mass * top.gravity[0], mass * top.gravity[1]
        x[MXX], x[MYY] = mass, mass
        x[MXY] = x[RX] = x[RY] = x[HX] = x[HY] = x[TORQUE] = 0.0
        if has_forces:
            fx += force[3 * i]
            fy += force[3 * i + 1]
            x[TORQUE] = -force[3 * i + 2]
        if k >= 0:
            sx, sy = turned(cs[i, 0], cs[i, 1], p[k, 2 * side], p[k, 2 * side + 1])
            # moments refer to the pin: Steiner's term, the torque of the force, and the centripetal force
            square = v[3 * i + 2] * v[3 * i + 2]
            x[RX], x[RY] = -sx, -sy
            x[HX], x[HY] = mass * sy, -mass * sx
            inertia += mass * (sx * sx + sy * sy)
            x[TORQUE] += sx * fy - sy * fx
            fx -= mass * square * sx
            fy -= mass * square * sy
        x[INERTIA], x[BX], x[BY] = inertia, -fx, -fy


@subkernel
def _gather(top, cs, tree, v, bodies):
    """Add the articulated mass and bias of each body to the body before, from the leaves."""
    ground, p = len(top.mass) - 1, top.pair_parameters
    for n in range(len(tree) - 1, -1, -1):
        i, k, side = tree[n, BODY], tree[n, PLACE], tree[n, PLACE_SIDE]
        if k < 0:
            continue
        x, before = bodies[i], top.pairs[k, PAIR.second - side]
        inverse = 1.0 / x[INERTIA]
        x[INERTIA] = inverse
        if before == ground:
            continue
        y = bodies[before]
        dx, dy = turned(cs[before, 0], cs[before, 1], p[k, 2 - 2 * side], p[k, 3 - 2 * side])
        dx += y[RX]
        dy += y[RY]
        x[DX], x[DY] = dx, dy
        # eliminate alpha: what is left of the body is a mass K and a bias at its pin
        gx, gy = x[HX] * inverse, x[HY] * inverse
        kxx, kxy, kyy = x[MXX] - gx * x[HX], x[MXY] - gx * x[HY], x[MYY] - gy * x[HY]
        square = v[3 * before + 2] * v[3 * before + 2]
        bx = x[BX] - gx * x[TORQUE] - square * (kxx * dx + kxy * dy)
        by = x[BY] - gy * x[TORQUE] - square * (kxy * dx + kyy * dy)
        ux, uy = kxy * dx - kxx * dy, kyy * dx - kxy * dy  # K times d turned by a right angle
        y[MXX] += kxx
        y[MXY] += kxy
        y[MYY] += kyy
        y[HX] += ux
        y[HY] += uy
        y[INERTIA] += dx * uy - dy * ux
        y[BX] += bx
        y[BY] += by
        y[TORQUE] += dx * by - dy * bx


@subkernel
def _spread(top, tree, v, bodies, acc):
    """Compute the accelerations of the coordinates from the roots to the leaves."""
    ground = len(top.mass) - 1
    for n in range(len(tree)):
        i, k = tree[n, BODY], tree[n, PLACE]
        x = bodies[i]
        if k < 0:
            inverse = 1.0 / x[INERTIA]
            gx, gy = x[HX] * inverse, x[HY] * inverse
            kxx, kxy, kyy = x[MXX] - gx * x[HX], x[MXY] - gx * x[HY], x[MYY] - gy * x[HY]
            fx, fy = x[BX] - gx * x[TORQUE], x[BY] - gy * x[TORQUE]
            # a free body: no force acts at its reference point, so K A = -f
            scale = 1.0 / (kxx * kyy - kxy * kxy)
            ax, ay = scale * (kxy * fy - kyy * fx), scale * (kxy * fx - kxx * fy)
            x[INERTIA], x[MXX], x[MXY] = inverse, ax, ay
            acc[3 * i], acc[3 * i + 1] = ax, ay
        else:
            before = top.pairs[k, PAIR.second - tree[n, PLACE_SIDE]]
            if before == ground:
                x[MXX] = x[MXY] = 0.0
            else:
                y, square, alpha = bodies[before], v[3 * before + 2] * v[3 * before + 2], acc[3 * before + 2]
                x[MXX] = y[MXX] - alpha * x[DY] - square * x[DX]
                x[MXY] = y[MXY] + alpha * x[DX] - square * x[DY]
            acc[3 * i] = acc[3 * i + 1] = 0.0
        acc[3 * i + 2] = -x[INERTIA] * (x[HX] * x[MXX] + x[HY] * x[MXY] + x[TORQUE])


@subkernel
def articulated_accelerations(top, cs, tree, has_forces, force, v, bodies, acc):
    """Write the accelerations of the coordinates of a tree of pins and free bodies into `acc`.

    Parameters
    ----------
    cs : (B + 1, 2) array
        Cosine and sine of every angle.
    has_forces, force
        Whether there are generalized forces besides gravity, and the (3 (B + 1),) array of these forces.
    v : (3 (B + 1),) array
        Angular velocities of the bodies in every third element; the others are not used.
    bodies : (B + 1, 13) array
        Work array.
    """
    _begin(top, cs, tree, has_forces, force, v, bodies)
    _gather(top, cs, tree, v, bodies)
    _spread(top, tree, v, bodies, acc)
