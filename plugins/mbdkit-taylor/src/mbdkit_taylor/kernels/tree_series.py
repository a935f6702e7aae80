"""Taylor coefficients of the motion of a tree of pins, by articulated bodies: O(B p^2) operations for p orders.

Cosine c and sine s of an angle with the rate omega satisfy ``c' = -s omega`` and ``s' = c omega``. Points of a body are
linear in both, and so the accelerations of pins are linear in c'' and s''. Their coefficients of order k are

    c''_k = -s_0 alpha_k - (k + 1) sum_{j=1}^{k+1} s_j omega_{k+1-j},
    s''_k =  c_0 alpha_k - (k + 1) sum_{j=1}^{k+1} -c_j omega_{k+1-j},

whose sums contain coefficients of lower order only. The torque of all pins of a body about its centre of mass is
``c P - s Q``, where P and Q are sums of the components of forces times coordinates of the body's frame. The equations
for the accelerations and forces of order k are therefore those of order zero (`mbdkit.engine.kernels.articulated`) with
other right sides: the matrices are factorized once per step, and each order takes one substitution and four products
of series per body. The forces of the pins come with it.

Applied forces can be torques, forces at points, torsion springs and linear springs between two points. Drag, laws and
expressions of the state have no series here.
"""

from __future__ import annotations

from mbdkit.base import elementary
from mbdkit.engine.kernels.applied_forces import BODY_FORCE, PATHWAYS, POINT_FORCE, TORQUE
from mbdkit.engine.kernels.table_rows import LINEAR, LOAD, SPRING
from mbdkit.engine.kernels.tree import turned
from mbdkit.engine.native.functions import inlined, subkernel
from mbdkit_taylor.kernels.power_series import coefficient

#: Columns of `links` (B, 4), the bodies in the order of the tree: body, pair that pins it (-1: none), whether it is the
#: second body of this pair, and the place in this order of the body before (-1: ground, or none).
OF, PAIR, SIDE, BEFORE, LINK = range(5)
#: Rows of the series of a body: cosine, sine and rate of its angle, velocity of a free body, the sums P and Q, and the
#: centre of mass.
COSINE, SINE, OMEGA, VX, VY, P, Q, X, Y, SERIES = range(10)
#: Rows of the series of a spring between two points: the vector between them, its length, and tension over length.
DX, DY, LENGTH, PULL, OF_SPRING = range(5)

#: Columns of `bodies` (B + 1, 35), in the order of the tree, ground last.
#:
#: The articulated mass M, later K; h; 1 / I; h / I; the vector from the centre of mass to the body's pin; the vector
#: from the pin of the body before to this pin; both points of the pin in the frames of the body, and of the one before;
#: that vector in the frame of the one before; mass. Of the present order: applied forces and torque, later the bias of
#: articulated bodies; P and Q of the applied forces; c'' and s'' without alpha, and their sums; sums P and Q; bias of
#: the pin's acceleration; acceleration of the pin, and of the angle.
(
    MXX, MXY, MYY, HX, HY, INVERSE, GX, GY, RX, RY, DPX, DPY, OWN_X, OWN_Y, BEFORE_X, BEFORE_Y, EX, EY, MASS,
    FX, FY, TURN, FORCE_P, FORCE_Q, BEND_C, BEND_S, SUM_C, SUM_S, SUM_P, SUM_Q, WX, WY, AX, AY, ALPHA, OF_BODY,
) = range(36)  # fmt: skip

_TWO_POINTS, _RELATIVE_ANGLE = PATHWAYS["two_points"], PATHWAYS["relative_angle"]


@subkernel
def _factorize(top, links, series, bodies):
    """Compute the articulated masses of all bodies at the present angles; see `mbdkit.engine.kernels.articulated`."""
    p = top.pair_parameters
    for n in range(len(links)):
        i, k, side, before = links[n, OF], links[n, PAIR], links[n, SIDE], links[n, BEFORE]
        x, mass, c, s = bodies[n], top.mass[i, 0], series[n, COSINE, 0], series[n, SINE, 0]
        x[MXX], x[MXY], x[MYY], x[MASS] = mass, 0.0, mass, mass
        x[OWN_X] = x[OWN_Y] = x[BEFORE_X] = x[BEFORE_Y] = x[WX] = x[WY] = 0.0
        if k >= 0:
            x[OWN_X], x[OWN_Y] = p[k, 2 * side], p[k, 2 * side + 1]
            x[BEFORE_X], x[BEFORE_Y] = p[k, 2 - 2 * side], p[k, 3 - 2 * side]
        if before >= 0:
            y = bodies[before]
            x[EX], x[EY] = x[BEFORE_X] - y[OWN_X], x[BEFORE_Y] - y[OWN_Y]
            x[DPX], x[DPY] = turned(series[before, COSINE, 0], series[before, SINE, 0], x[EX], x[EY])
        x[RX], x[RY] = turned(c, s, x[OWN_X], x[OWN_Y])
        x[HX], x[HY] = mass * x[RY], -mass * x[RX]
        x[INVERSE] = top.mass[i, 2] + mass * (x[RX] * x[RX] + x[RY] * x[RY])
    for n in range(len(links) - 1, -1, -1):
        x, before = bodies[n], links[n, BEFORE]
        x[INVERSE] = 1.0 / x[INVERSE]
        x[GX], x[GY] = x[HX] * x[INVERSE], x[HY] * x[INVERSE]
        kxx, kxy, kyy = x[MXX] - x[GX] * x[HX], x[MXY] - x[GX] * x[HY], x[MYY] - x[GY] * x[HY]
        x[MXX], x[MXY], x[MYY] = kxx, kxy, kyy
        if before >= 0:
            y, dx, dy = bodies[before], x[DPX], x[DPY]
            ux, uy = kxy * dx - kxx * dy, kyy * dx - kxy * dy
            y[MXX] += kxx
            y[MXY] += kxy
            y[MYY] += kyy
            y[HX] += ux
            y[HY] += uy
            y[INVERSE] += dx * uy - dy * ux


@inlined
def _push(x, series, px, py, fx, fy):
    """Add the coefficients (fx, fy) of a force at a point that is fixed in the frame of a body."""
    p, q = px * fy - py * fx, px * fx + py * fy
    x[FX] += fx
    x[FY] += fy
    x[FORCE_P] += p
    x[FORCE_Q] += q
    x[TURN] += series[COSINE, 0] * p - series[SINE, 0] * q


@subkernel
def _place_centres(links, inverses, bodies, series, k):
    """Compute coefficient `k` of the centres of mass of all bodies, k >= 1."""
    for n in range(len(links)):
        before = links[n, BEFORE]
        if links[n, PAIR] < 0:
            series[n, X, k], series[n, Y, k] = inverses[k] * series[n, VX, k - 1], inverses[k] * series[n, VY, k - 1]
            continue
        x = bodies[n]
        dx, dy = turned(series[n, COSINE, k], series[n, SINE, k], x[OWN_X], x[OWN_Y])
        series[n, X, k], series[n, Y, k] = -dx, -dy
        if before >= 0:
            ex, ey = turned(series[before, COSINE, k], series[before, SINE, k], x[BEFORE_X], x[BEFORE_Y])
            series[n, X, k] += series[before, X, k] + ex
            series[n, Y, k] += series[before, Y, k] + ey


@inlined
def _point(series, k, px, py):
    """Return coefficient `k` of the position of a point, given as (px, py) in the frame of its body."""
    x, y = turned(series[COSINE, k], series[SINE, k], px, py)
    return series[X, k] + x, series[Y, k] + y


@subkernel
def _stretch(p, a, b, s, k):
    """Compute coefficient `k` of the length of a spring between points `p` of bodies with the series `a` and `b`."""
    ax, ay = _point(a, k, p[0], p[1])
    bx, by = _point(b, k, p[2], p[3])
    s[DX, k], s[DY, k] = bx - ax, by - ay
    square = coefficient(s[DX], s[DX], k) + coefficient(s[DY], s[DY], k)
    if k == 0:
        s[LENGTH, 0] = elementary.pow(square, 0.5)
    else:
        for j in range(1, k):
            square -= s[LENGTH, j] * s[LENGTH, k - j]
        s[LENGTH, k] = square / (2.0 * s[LENGTH, 0])


@subkernel
def _pull(top, places, inverses, angles, series, springs, bodies, k):
    for n in range(len(top.springs)):
        first, second = top.springs[n, SPRING.first], top.springs[n, SPRING.second]
        stiffness, damping = top.linear[n, LINEAR.stiffness], top.linear[n, LINEAR.damping]
        x, y, a, b = bodies[places[first]], bodies[places[second]], series[places[first]], series[places[second]]
        if top.springs[n, SPRING.pathway] == _RELATIVE_ANGLE:
            pull = damping * (b[OMEGA, k] - a[OMEGA, k])
            if k == 0:
                pull += stiffness * (angles[3 * second + 2] - angles[3 * first + 2] - top.linear[n, LINEAR.free_length])
            else:
                pull += stiffness * inverses[k] * (b[OMEGA, k - 1] - a[OMEGA, k - 1])
            x[TURN] += pull
            y[TURN] -= pull
            continue
        s, p = springs[n], top.spring_points[n]
        if k == 0:
            _stretch(p, a, b, s, 0)
        _stretch(p, a, b, s, k + 1)
        pull = stiffness * s[LENGTH, k] + damping * (k + 1) * s[LENGTH, k + 1]
        if k == 0:
            pull -= stiffness * top.linear[n, LINEAR.free_length]
        for j in range(k):
            pull -= s[PULL, j] * s[LENGTH, k - j]
        s[PULL, k] = pull / s[LENGTH, 0]
        fx, fy = coefficient(s[PULL], s[DX], k), coefficient(s[PULL], s[DY], k)
        _push(x, a, p[0], p[1], fx, fy)
        _push(y, b, p[2], p[3], -fx, -fy)


@subkernel
def _load(top, places, series, u, bodies, k):
    """Add the coefficients of order `k` of all loads, whose values have the series `u`."""
    for n in range(len(top.loads)):
        kind, place = top.loads[n, LOAD.kind], places[top.loads[n, LOAD.body]]
        x, px, py, first = bodies[place], top.load_points[n, 0], top.load_points[n, 1], u[top.loads[n, LOAD.x]]
        if kind == TORQUE:
            x[TURN] += first[k]
            bodies[places[top.loads[n, LOAD.reaction_body]], TURN] -= first[k]
            continue
        second = u[top.loads[n, LOAD.y]]
        if kind == POINT_FORCE:
            _push(x, series[place], px, py, first[k], second[k])
        elif kind == BODY_FORCE:
            c, s = series[place, COSINE], series[place, SINE]
            x[FX] += coefficient(c, first, k) - coefficient(s, second, k)
            x[FY] += coefficient(s, first, k) + coefficient(c, second, k)
            x[TURN] += px * second[k] - py * first[k]


@inlined
def _begin(links, series, bodies, k):
    """Compute the bias of each body alone, by coefficients of lower order than `k` and the applied forces.

    The sums end with the coefficients computed last, so that the processor can begin them before these are known.
    """
    for n in range(len(links)):
        x, before = bodies[n], links[n, BEFORE]
        c, s, omega, p, q = (
            series[n, COSINE], series[n, SINE], series[n, OMEGA], series[n, P], series[n, Q]
        )  # fmt: skip
        bend_c, bend_s, turn_p, turn_q = 0.0, 0.0, 0.0, 0.0
        for j in range(2, k + 1):
            rate = omega[k + 1 - j]
            bend_c += s[j] * rate
            bend_s += c[j] * rate
            turn_p += c[j] * p[k - j]
            turn_q += s[j] * q[k - j]
        bend_c += s[k + 1] * omega[0]
        bend_s += c[k + 1] * omega[0]
        if k > 0:
            p[k - 1], q[k - 1] = x[SUM_P], x[SUM_Q]
            bend_c += s[1] * omega[k]
            bend_s += c[1] * omega[k]
            turn_p += c[1] * x[SUM_P]
            turn_q += s[1] * x[SUM_Q]
        x[SUM_C], x[SUM_S] = bend_c, bend_s
        bend_c, bend_s = -(k + 1) * bend_c, (k + 1) * bend_s
        x[BEND_C], x[BEND_S] = bend_c, bend_s
        wx, wy = turned(bend_c, bend_s, x[OWN_X], x[OWN_Y])
        fx, fy = -(x[FX] + x[MASS] * wx), -(x[FY] + x[MASS] * wy)
        turn = -(x[TURN] + turn_p - turn_q + x[RX] * fy - x[RY] * fx)
        if before >= 0:  # the acceleration of the pin consists of W, which is known here, and a part that is not
            y = bodies[before]
            wx, wy = turned(y[BEND_C], y[BEND_S], x[EX], x[EY])
            along = x[HX] * wx + x[HY] * wy
            fx += x[MXX] * wx + x[MXY] * wy + x[GX] * along
            fy += x[MXY] * wx + x[MYY] * wy + x[GY] * along
            turn += along
            x[WX], x[WY] = wx, wy
        x[FX], x[FY], x[TURN] = fx, fy, turn
        x[SUM_P], x[SUM_Q] = x[FORCE_P], x[FORCE_Q]


@inlined
def _gather(links, bodies):
    """Compute the biases of articulated bodies from the leaves; see `mbdkit.engine.kernels.articulated`."""
    for n in range(len(links) - 1, -1, -1):
        x, before = bodies[n], links[n, BEFORE]
        fx, fy = x[FX] - x[GX] * x[TURN], x[FY] - x[GY] * x[TURN]
        x[FX], x[FY] = fx, fy
        if before >= 0:
            y = bodies[before]
            y[FX] += fx
            y[FY] += fy
            y[TURN] += x[DPX] * fy - x[DPY] * fx


@inlined
def _spread(links, inverses, series, bodies, k):
    """Compute the accelerations of order `k` from the roots, and with them the next coefficients of all series."""
    share, next_share = inverses[k + 1], inverses[k + 2]
    for n in range(len(links)):
        x, before, c, s = bodies[n], links[n, BEFORE], series[n, COSINE], series[n, SINE]
        ax, ay = 0.0, 0.0
        if links[n, PAIR] < 0:
            scale = 1.0 / (x[MXX] * x[MYY] - x[MXY] * x[MXY])
            ax, ay = scale * (x[MXY] * x[FY] - x[MYY] * x[FX]), scale * (x[MXY] * x[FX] - x[MXX] * x[FY])
            series[n, VX, k + 1], series[n, VY, k + 1] = share * ax, share * ay
        else:
            fx, fy = x[FX], x[FY]
            if before >= 0:
                y = bodies[before]
                alpha = y[ALPHA]
                ax, ay = y[AX] - alpha * x[DPY], y[AY] + alpha * x[DPX]
                fx += x[MXX] * ax + x[MXY] * ay
                fy += x[MXY] * ax + x[MYY] * ay
                y[SUM_P] -= x[BEFORE_X] * fy - x[BEFORE_Y] * fx
                y[SUM_Q] -= x[BEFORE_X] * fx + x[BEFORE_Y] * fy
            x[SUM_P] += x[OWN_X] * fy - x[OWN_Y] * fx
            x[SUM_Q] += x[OWN_X] * fx + x[OWN_Y] * fy
        alpha = -x[INVERSE] * (x[HX] * ax + x[HY] * ay + x[TURN])
        x[ALPHA], x[AX], x[AY] = alpha, ax + x[WX], ay + x[WY]
        x[FX] = x[FY] = x[TURN] = x[FORCE_P] = x[FORCE_Q] = 0.0  # of the next order
        rate = share * alpha
        series[n, OMEGA, k + 1] = rate
        c[k + 2] = -next_share * (s[0] * rate + x[SUM_C])
        s[k + 2] = next_share * (c[0] * rate + x[SUM_S])


@subkernel
def expand_tree(top, cs, m, q, v):
    """Compute the Taylor coefficients of the motion of a tree of pins.

    Parameters
    ----------
    cs : (B + 1, 2) array
        Cosine and sine of every angle.
    q, v : (3 (B + 1),) array
        Positions and velocities of the bodies.
    m
        Bundle of the following arrays (`mbdkit_taylor.kernels.taylor_series.Taylor`).
    links : (B, 4) array of int
        The bodies in the order of the tree.
    places : (B + 1,) array of int
        Place of every body in this order; B for ground.
    inverses : (p + 3,) array
        Inverses of 0 (not used), 1, 2, ...
    motions : (motions, p + 2) array
        Series of the values of loads.
    series : (B + 1, SERIES, p + 2) array
        The coefficients: of rates up to order p, of angles' cosines and sines up to p + 1. Those of ground are zero,
        except for its cosine.
    springs, bodies
        Work arrays, (S, OF_SPRING, p + 2) and (B + 1, OF_BODY).
    """
    links, places, inverses, series, springs, bodies = m.links, m.places, m.inverses, m.series, m.springs, m.bodies
    order = series.shape[2] - 2
    has_points = False
    for n in range(len(top.springs)):
        has_points = has_points or top.springs[n, SPRING.pathway] == _TWO_POINTS
    series[len(links), COSINE, 0] = 1.0
    for n in range(len(links)):
        i, x = links[n, OF], bodies[n]
        c, s, omega = cs[i, 0], cs[i, 1], v[3 * i + 2]
        series[n, COSINE, 0], series[n, SINE, 0], series[n, OMEGA, 0] = c, s, omega
        series[n, COSINE, 1], series[n, SINE, 1] = -s * omega, c * omega
        series[n, X, 0], series[n, Y, 0] = q[3 * i], q[3 * i + 1]
        if links[n, PAIR] < 0:
            series[n, VX, 0], series[n, VY, 0] = v[3 * i], v[3 * i + 1]
        x[FX], x[FY] = top.mass[i, 0] * top.gravity[0], top.mass[i, 0] * top.gravity[1]
        x[TURN] = x[FORCE_P] = x[FORCE_Q] = 0.0
    _factorize(top, links, series, bodies)
    for k in range(order):
        if has_points:
            _place_centres(links, inverses, bodies, series, k + 1)
        if len(top.springs) > 0:
            _pull(top, places, inverses, q, series, springs, bodies, k)
        if len(top.loads) > 0:
            _load(top, places, series, m.motions, bodies, k)
        _begin(links, series, bodies, k)
        _gather(links, bodies)
        _spread(links, inverses, series, bodies, k)
