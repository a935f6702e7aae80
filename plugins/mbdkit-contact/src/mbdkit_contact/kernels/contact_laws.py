"""The law of compliant contacts: where two shapes touch, with which forces, and the derivatives of these forces.

The first shape is a line, polyline, polygon, circle or hole, the second a polygon, circle or point; a point is a circle
of radius 0. A row (`mbdkit_contact.contact.ContactPair`) is a possible contact point. The normal n of a row points
from the first shape to the second. With the center c and radius r of the second body's circle, the normal force N and
the friction force T act at the point ``P = c - n (r + gap/2)``, midway between the two outlines. The velocity of the
second body at P, relative to that of the first body at P, has the component ``gap'`` along n and the slip along t,
which is n turned by -90 degrees. The force on the second body is ``N n + T t``. Rolling resistance adds a torque on
the second body, ``-e N`` times the sign of its angular velocity relative to the first body, and the opposite torque on
the first; e is the arm of the normal force. Below the transition speed, the sign is replaced by the ratio of the
rolling speed r omega to the transition speed.

A circle or point touches the part of a polygon that is nearest: an edge, or the corner between two edges. By the
theorem of separating axes, two polygons touch only along the edge from which the other polygon is farthest, and along
the edge of the other polygon that faces it. At each end of the interval in which these edges are opposite each other,
one corner acts: the end of the facing edge if it is opposite the first edge, and otherwise the end of the first edge.
In rows of the latter, the bodies change roles: the corner of a row always belongs to its second body.

The parameters of the law are `POSE` numbers for each body, the numbers of its force law (`STIFFNESS` and so on), and,
from `SHAPES` on, those of the shapes:

- line, circles, hole: `ROW` numbers for each row, which are the center and radius of the circle, then a point and the
  normal of the line, or the center and radius of the circle or hole of the first body;
- a polygon and a circle: center and radius of the circle, then `EDGE` numbers for each edge, which are the corner at
  which it starts, its normal and its length;
- two polygons: the edges of the first, then those of the second;
- a polyline and a circle or polygon: see `mbdkit_contact.kernels.uneven_ground`.

For the linear law and shapes without polygon, the side of each row follows: 1 if the force of spring and damper acts,
-1 if it does not, and 0 if it acts where the shapes overlap and it pushes them apart. Gradients need steps with
constant sides (`mbdkit_gradients.law_corners`), because a damper makes this force jump where shapes begin to touch.

The results depend on the mode: forces and torques on both bodies (6); their derivatives with respect to the positions
(36) and velocities (36) of both bodies; or the `VALUE` quantities of each row.
"""

from __future__ import annotations

from math import sqrt, tanh

from mbdkit.engine.kernels.angles import cosine_and_sine
from mbdkit.engine.kernels.bundle_types import IntMatrix, RealCube, RealMatrix, RealVector
from mbdkit.engine.kernels.vectors import fill
from mbdkit.engine.native.arithmetic import value_of
from mbdkit.engine.native.calls import call_law, integers_at, new_registers, numbers_at
from mbdkit.engine.native.functions import inlined, kernel, law_function
from mbdkit_contact.kernels.uneven_ground import (
    EDGE,
    OWN,
    SEGMENT,
    TURN,
    corners_window,
    spacing,
    touched_part,
    touching_corner,
    window_around,
)
from mbdkit_contact.kernels.uneven_ground import height_over as _over

FORCES, SLOPES, VALUES = range(3)  #: Modes: what the law computes.
#: Kinds of geometry; see `mbdkit_contact.contact.ContactPair`.
KINDS = ("line", "circles", "hole", "edge", "inside", "polyline")
_LINE, _CIRCLES, _HOLE, _EDGE, _INSIDE, _POLYLINE = range(len(KINDS))
FORCE_LAWS = ("none", "hertz", "linear", "smooth")  #: Laws of the normal force; rigid contacts have no law.
_NONE, _HERTZ, _LINEAR, _SMOOTH = range(len(FORCE_LAWS))
_BOTH = len(FORCE_LAWS)  #: The linear law of a row whose side is 1, which may also pull.

#: Integers of the program: mode, kind of geometry, number of edges of the first shape (of rows, if it is no polygon, or
#: of segments of a polyline) and of the second (0, if it is no polygon, or only the second is one), law of the normal
#: force, whether torques act on the bodies, and the number of rows.
MODE, KIND, FIRST_COUNT, SECOND_COUNT, FORCE_LAW, FIRST_TURNS, SECOND_TURNS, ROWS = range(8)
_HEAD = 8
POSE = 7  #: Numbers of a body: x, y, cosine and sine of its angle, and its velocities.
#: Places of the parameters of the force law, see `mbdkit_contact.contact.Contact.law_numbers`, and of the shapes.
STIFFNESS, DISSIPATION, RELEASE, STATIC, KINETIC, TRANSITION, ROLLING, SHAPES = range(2 * POSE, 2 * POSE + 8)
ROW = 7  #: Parameters of a row without polygon.
#: Quantities of a row: gap, normal force, friction force, slip, the point P, the normal, and the torque of rolling
#: resistance on the second body.
VALUE = 9

#: Smoothing constants of Simbody's SmoothSphereHalfSpaceForce, with the default values of OpenSim.
_CF, _BD, _BV = 1e-5, 300.0, 50.0


@law_function
def contact(program, length, rate, time, parameters, out):
    """Evaluate the contact of two shapes; see this module."""
    head = integers_at(program, _HEAD)
    numbers = int(value_of(numbers_at(parameters, 0, 1, length)[0]))
    x = numbers_at(parameters, 1, numbers, length)
    mode, kind, count, other = head[MODE], head[KIND], head[FIRST_COUNT], head[SECOND_COUNT]
    rows = head[ROWS]
    results = numbers_at(out, 0, 6 if mode == FORCES else 72 if mode == SLOPES else VALUE * rows, length)
    fill(results, 0.0)
    points = new_registers(64, length)
    has_sides = head[FORCE_LAW] == _LINEAR and kind <= _HOLE
    edge, facing, start, end, own_start, own_end, is_corner = 0, 0, -1, -1, -1, -1, False
    height = 0.0 * x[0]
    if kind == _EDGE:
        start, is_corner = _nearest(head, x)
    elif kind == _INSIDE:
        edge, facing, start, end, own_start, own_end = _facing_edges(head, x, points)
    for row in range(rows):
        # The body of the line and that of the circle, the places of both among the parameters, and how they touch
        first, second, circle, feature, shape, acts = 0, POSE, SHAPES + ROW * row, SHAPES + ROW * row + 3, kind, True
        if kind == _EDGE:
            acts = row == start
            circle, feature, shape = SHAPES, SHAPES + 3 + EDGE * row, _CIRCLES if acts and is_corner else _LINE
        elif kind == _INSIDE and row < other:
            acts = (row == start) | (row == end)
            circle, feature, shape = SHAPES + EDGE * (count + row), SHAPES + EDGE * edge, _LINE
        elif kind == _INSIDE:
            acts = (row - other == own_start) | (row - other == own_end)
            first, second, shape = POSE, 0, _LINE
            circle, feature = SHAPES + EDGE * (row - other), SHAPES + EDGE * (count + facing)
        elif kind == _POLYLINE:
            first, second, circle, feature, shape, height, acts = _on_polyline(head, x, row)
        if not acts and mode != VALUES:
            continue
        r = 0.0 * x[circle] if kind == _INSIDE or (kind == _POLYLINE and other > 0) else x[circle + 2]
        cx, cy = _turned(x, second, x[circle], x[circle + 1])
        if shape == _LINE:
            ux, uy = _seen(x, first, second, cx, cy)
            gap, bend = _over(x, feature, ux, uy)[0] - r, 0.0 * r
            nx, ny = _turned(x, first, x[feature + 2], x[feature + 3])
            if not acts:
                least = 0.0 * gap
                if kind == _POLYLINE:
                    least = height - r
                elif kind == _EDGE:
                    least = sqrt(_beyond(x, feature, ux, uy)) - r
                elif row < other:
                    least = _height(x, SHAPES, count, ux, uy)
                else:
                    least = _height(x, SHAPES + EDGE * count, other, ux, uy)
                gap = least if least > gap else gap
                gap = gap if gap > 0.0 else 0.0 * r
        else:
            radius = 0.0 * r if kind in (_EDGE, _POLYLINE) else x[feature + 2]
            ox, oy = _turned(x, first, x[feature], x[feature + 1])
            distance, nx, ny, bend = _direction(x[second] + cx - x[first] - ox, x[second + 1] + cy - x[first + 1] - oy)
            gap = distance - r - radius
            if shape == _HOLE:  # the wall pushes the circle towards the center
                gap, nx, ny, bend = radius - r - distance, -nx, -ny, -bend
        touches, law = gap < 0.0, head[FORCE_LAW]
        if has_sides:
            side = x[numbers - rows + row]
            touches = (side > 0.0) | (touches & (side == 0.0))
            law = _BOTH if side > 0.0 else law
        law = law if acts and (touches or law == _SMOOTH) else _NONE
        _act(mode, law, x, first, second, row, gap, nx, ny, cx, cy, r, bend, results)
    if mode == SLOPES:
        _oppose(results)
    if mode != VALUES:
        for side in range(2):
            if head[FIRST_TURNS + side] == 0:
                _clear_torque(head, 3 * side + 2, results)


@inlined
def _oppose(out):
    """Write the derivatives with respect to translations of the first body: those of the second with opposite signs."""
    for row in range(12):
        out[6 * row] = 0.0 - out[6 * row + 3]
        out[6 * row + 1] = 0.0 - out[6 * row + 4]


@inlined
def _clear_torque(head, row, out):
    if head[MODE] == FORCES:
        out[row] = 0.0
    else:
        for i in range(6):
            out[6 * row + i] = 0.0
            out[36 + 6 * row + i] = 0.0


@inlined
def _turned(x, body, px, py):
    c, s = x[body + 2], x[body + 3]
    return c * px - s * py, s * px + c * py


@inlined
def _seen(x, first, second, px, py):
    """Return a point in the frame of the first body; it is given as global vector from the second body's centre."""
    c, s = x[first + 2], x[first + 3]
    gx, gy = x[second] + px - x[first], x[second + 1] + py - x[first + 1]
    return c * gx + s * gy, c * gy - s * gx


@inlined
def _direction(dx, dy):
    """Return the length of a vector, its direction and the inverse of the length; zeros where the length is 0."""
    square = dx * dx + dy * dy
    size, per = 0.0 * square, 0.0 * square
    if square > 0.0:
        size = sqrt(square)
        per = 1.0 / size
    return size, dx * per, dy * per, per


@inlined
def _nearest(head, x):
    """Return the row of a polygon that a circle touches (-1: none), and whether it does so at the corner of the row.

    A row consists of an edge and the corner at which it starts.
    """
    count, first = head[FIRST_COUNT], SHAPES + 3
    cx, cy = _turned(x, POSE, x[SHAPES], x[SHAPES + 1])
    ux, uy = _seen(x, 0, POSE, cx, cy)
    top, nearest = 0, 0
    highest, least = _over(x, first, ux, uy)[0], _beyond(x, first, ux, uy)
    for e in range(1, count):
        height, distance = _over(x, first + EDGE * e, ux, uy)[0], _beyond(x, first + EDGE * e, ux, uy)
        if height > highest:
            highest, top = height, e
        if distance < least:
            least, nearest = distance, e
    if head[MODE] != VALUES and highest >= x[SHAPES + 2]:
        return -1, False
    if highest <= 0.0:
        return top, False
    along = _over(x, first + EDGE * nearest, ux, uy)[1]
    if along > x[first + EDGE * nearest + 4]:
        return (nearest + 1) % count, True
    return nearest, along < 0.0


@inlined
def _on_polyline(head, x, row):
    """Return how a row on a polyline touches: places of the two bodies, of the circle and of the part that it touches
    among the parameters, kind of this part, height over it, and whether the row acts.

    In the rows of corners of the polyline, which come last, the polygon's body is the first.
    """
    count, n = head[FIRST_COUNT], head[SECOND_COUNT]
    sizes, ground, corners = (n, count), SHAPES + OWN + EDGE * n, int(value_of(x[SHAPES + 3])) * max(n, 1)
    turn = (x[2] * x[POSE + 2] + x[3] * x[POSE + 3], x[2] * x[POSE + 3] - x[3] * x[POSE + 2])
    circle, r = SHAPES, x[SHAPES + 2]
    if n > 0 and row < corners:
        circle, r = SHAPES + OWN + EDGE * (row % n), 0.0 * r
    p = _seen(x, 0, POSE, 0.0 * r, 0.0 * r)  # the origin of the polygon
    if row < corners:
        px, py = _turned(x, POSE, x[circle], x[circle + 1])
        p = _seen(x, 0, POSE, px, py)
    # Forces need only what touches; quantities need what is nearest, which is searched at increasing distances.
    reach = 0.0 * r if head[MODE] != VALUES else spacing(x, SHAPES, sizes) + 0.0 * r
    while True:
        if row < corners:
            window = window_around(x, SHAPES, sizes, p, r + reach)
            height, part, acts = touched_part(x, SHAPES, sizes, row, p, turn, window, 0.0)
        else:
            window = corners_window(x, SHAPES, sizes, p, turn, reach)
            height, part, acts = touching_corner(x, SHAPES, sizes, row - corners, p, turn, window, 0.0)
        is_whole = window[0] == 0 and window[1] == count - 1
        if head[MODE] != VALUES or is_whole or height <= r + reach:
            break
        reach *= 4.0
    if row >= corners:
        return POSE, 0, ground + SEGMENT * (part // n), SHAPES + OWN + EDGE * (part % n), _LINE, height, acts
    feature, shape = ground + SEGMENT * (part // 2), _LINE
    if part % 2 == 1:
        shape = _CIRCLES if x[feature + TURN] > 0.0 else _HOLE
    return 0, POSE, circle, feature, shape, height, acts


@inlined
def _beyond(x, edge, px, py):
    """Return the squared distance of a point from an edge."""
    height, along = _over(x, edge, px, py)
    past = along - x[edge + 4]
    if along < 0.0:
        past = along
    elif past < 0.0:
        past = 0.0 * past
    return height * height + past * past


@inlined
def _facing_edges(head, x, points):
    """Return the edges of two polygons that face each other, and the corners that act (-1: none): two of the second
    polygon, then two of the first.

    `points` (64,) is a work array.
    """
    count, other = head[FIRST_COUNT], head[SECOND_COUNT]
    first, second = SHAPES, SHAPES + EDGE * count
    _see(x, 0, POSE, second, other, points, 0)
    edge, apart, nearest = _separation(x, first, count, points, 0, other, head[MODE])
    if head[MODE] != VALUES and apart >= 0.0:
        return 0, 0, -1, -1, -1, -1
    _see(x, POSE, 0, first, count, points, 32)
    facing, apart_of_other, nearest_of_other = _separation(x, second, other, points, 32, count, head[MODE])
    if head[MODE] != VALUES and apart_of_other >= 0.0:
        return 0, 0, -1, -1, -1, -1
    if apart >= apart_of_other:
        facing = _facing(x, first + EDGE * edge, second, other, points, 0, nearest)
        start, end, own_start, own_end = _acting(x, first, edge, count, points, 0, facing, other)
    else:
        edge = _facing(x, second + EDGE * facing, first, count, points, 32, nearest_of_other)
        own_start, own_end, start, end = _acting(x, second, facing, other, points, 32, edge, count)
    return edge, facing, start, end, own_start, own_end


@inlined
def _see(x, frame, body, polygon, count, points, begin):
    """Write the corners of a polygon of a body, in the frame of the other body, to `points` from `begin` on."""
    for k in range(count):
        px, py = _turned(x, body, x[polygon + EDGE * k], x[polygon + EDGE * k + 1])
        points[begin + 2 * k], points[begin + 2 * k + 1] = _seen(x, frame, body, px, py)


@inlined
def _height(x, polygon, count, px, py):
    """Return the largest height of a point over the edges of a polygon, but at least 0."""
    highest = 0.0 * px
    for e in range(count):
        height = _over(x, polygon + EDGE * e, px, py)[0]
        if height > highest:
            highest = height
    return highest


@inlined
def _separation(x, polygon, count, points, begin, other, mode):
    """Return the edge of a polygon from which another one is farthest, this distance, and the corner nearest to it.

    If only forces are wanted, any edge that separates the polygons is enough.
    """
    best, apart, corner = 0, 0.0 * points[begin], 0
    for e in range(count):
        least, nearest = _over(x, polygon + EDGE * e, points[begin], points[begin + 1])[0], 0
        for k in range(1, other):
            if e > 0 and least <= apart:  # another edge is farther
                break
            height = _over(x, polygon + EDGE * e, points[begin + 2 * k], points[begin + 2 * k + 1])[0]
            if height < least:
                least, nearest = height, k
        if e == 0 or least > apart:
            best, apart, corner = e, least, nearest
        if mode != VALUES and apart >= 0.0:
            break
    return best, apart, corner


@inlined
def _facing(x, edge, polygon, count, points, begin, corner):
    """Return the edge of a polygon that faces an edge of another one and has the end `corner`, which is nearest.

    Of the two edges at the corner, this is the one that is more nearly parallel to the other edge. If the corner lies
    beyond an end of the other edge, it is the one that leads back.
    """
    before, after = (corner + count - 1) % count, (corner + 1) % count
    along = _over(x, edge, points[begin + 2 * corner], points[begin + 2 * corner + 1])[1]
    lower = _over(x, edge, points[begin + 2 * after], points[begin + 2 * after + 1])[1]
    upper = _over(x, edge, points[begin + 2 * before], points[begin + 2 * before + 1])[1]
    if along > x[edge + 4]:
        return corner
    if along < 0.0:
        return before
    is_after = (along - lower) * x[polygon + EDGE * before + 4] >= (upper - along) * x[polygon + EDGE * corner + 4]
    return corner if is_after else before


@inlined
def _acting(x, polygon, edge, count, points, begin, facing, other):
    """Return the corners that act (-1: none): two of the polygon with the edge `facing`, two of that with `edge`.

    `points` from `begin` on are the corners of the former polygon, which has `other` corners.
    """
    after, at = (facing + 1) % other, polygon + EDGE * edge
    high = _over(x, at, points[begin + 2 * facing], points[begin + 2 * facing + 1])[1]
    low = _over(x, at, points[begin + 2 * after], points[begin + 2 * after + 1])[1]
    if low > high or low > x[at + 4] or high < 0.0:
        return -1, -1, -1, -1
    start, end, own_start, own_end = facing, after, -1, -1
    if high > x[at + 4]:
        start, own_start = -1, (edge + 1) % count
    if low < 0.0:
        end, own_end = -1, edge
    return start, end, own_start, own_end


@inlined
def _normal_force(law, x, depth, rate):
    """Return the normal force for an indentation and its rate, and its derivatives with respect to both."""
    k, c = x[STIFFNESS], x[DISSIPATION]
    none = 0.0 * k
    if law == _SMOOTH:
        square = depth * depth + _CF
        root = sqrt(square)
        size = k * root * sqrt(root)
        near, free = tanh(_BD * depth), tanh(_BV * (rate + x[RELEASE]))
        damped = 1.0 + 1.5 * c * rate
        touch, hold = 0.5 * (1.0 + near), 0.5 * (1.0 + free)
        by_depth = (1.5 * size * depth / square * touch + 0.5 * size * _BD * (1.0 - near * near)) * damped * hold
        by_rate = size * touch * (1.5 * c * hold + 0.5 * damped * _BV * (1.0 - free * free))
        return size * damped * touch * hold, by_depth, by_rate
    if law == _NONE:
        return none, none, none
    if law in (_LINEAR, _BOTH):
        force, by_depth, by_rate = k * depth + c * rate, k, c
    else:
        root = sqrt(depth)
        damped = 1.0 + 1.5 * c * rate
        size = k * depth * root
        force, by_depth, by_rate = size * damped, 1.5 * k * root * damped, 1.5 * c * size
    if force > 0.0 or law == _BOTH:
        return force, by_depth, by_rate
    return none, none, none


@inlined
def _friction_force(law, x, normal, slip):
    """Return the friction force and its derivatives with respect to normal force and slip.

    See `mbdkit.mechanism.joint_friction.regularised_friction`. The law ``smooth`` replaces the magnitude of the slip by
    ``sqrt(slip^2 + _CF)``, as SmoothSphereHalfSpaceForce does.
    """
    static, kinetic, per = x[STATIC], x[KINETIC], 1.0 / x[TRANSITION]
    soft = _CF if law == _SMOOTH else 0.0
    square = slip * slip + soft
    ratio = square * per * per
    share, by_slip, size = slip * per, per + 0.0 * slip, kinetic + 0.0 * ratio
    if ratio >= 1.0 and law == _SMOOTH:
        root = 1.0 / sqrt(square)
        share, by_slip = slip * root, soft * root * root * root
    elif ratio >= 1.0:
        share, by_slip = (1.0 if slip > 0.0 else -1.0) + 0.0 * slip, 0.0 * slip
    if static != kinetic:
        part = 1.0 / (1.0 + ratio)
        more = 2.0 * (static - kinetic) * part
        size += more
        by_slip = size * by_slip - 2.0 * more * part * slip * per * per * share
    else:
        by_slip = size * by_slip
    return 0.0 - normal * size * share, -size * share, -normal * by_slip


@inlined
def _act(mode, law, x, first, second, row, gap, nx, ny, cx, cy, r, bend, out):
    """Compute the forces of a row, and add them or their derivatives to `out`, or write the quantities of the row.

    (cx, cy) is the global vector from the second body's centre of mass to the center of its circle, which has the
    radius `r`. `bend` is the curvature by which n turns: 0 for a line, otherwise the inverse of the distance of both
    centers, negative for a hole.
    """
    if mode != VALUES and law == _NONE:
        return
    half = r + 0.5 * gap
    px, py = cx - half * nx, cy - half * ny
    ox, oy = x[second] + px - x[first], x[second + 1] + py - x[first + 1]
    vx = x[second + 4] - x[second + 6] * py - x[first + 4] + x[first + 6] * oy
    vy = x[second + 5] + x[second + 6] * px - x[first + 5] - x[first + 6] * ox
    slip, rate = vx * ny - vy * nx, vx * nx + vy * ny
    normal, by_depth, by_rate = _normal_force(law, x, -gap, -rate)
    friction, by_normal, by_slip = _friction_force(law, x, normal, slip)
    per = r / x[TRANSITION]
    share = per * (x[second + 6] - x[first + 6])
    if share > 1.0 or share < -1.0:
        share, per = share / abs(share), 0.0 * per
    torque = -x[ROLLING] * normal * share
    if mode == VALUES:
        at = VALUE * row
        out[at], out[at + 1], out[at + 2], out[at + 3] = gap, normal, friction, slip
        out[at + 4], out[at + 5], out[at + 6], out[at + 7] = x[second] + px, x[second + 1] + py, nx, ny
        out[at + 8] = torque
        return
    fx, fy = normal * nx + friction * ny, normal * ny - friction * nx
    one, two = 3 * (first // POSE), 3 * (second // POSE)
    if mode == FORCES:
        out[one] -= fx
        out[one + 1] -= fy
        out[one + 2] -= ox * fy - oy * fx + torque
        out[two] += fx
        out[two + 1] += fy
        out[two + 2] += px * fy - py * fx + torque
        return
    ax, ay = ox + half * nx, oy + half * ny  # from the first body's centre of mass to the circle
    for column in range(12):
        axis, of_second = column % 3, (column // 3) % 2 == two // 3
        if column % 6 < 2:  # forces depend on relative positions; see `_oppose`
            continue
        ex, ey, sign = 1.0 if axis == 0 else 0.0, 1.0 if axis == 1 else 0.0, 1.0 if of_second else -1.0
        qx, qy, hx, hy, turn = 0.0 * ax, 0.0 * ax, 0.0 * ax, 0.0 * ax, 0.0 * ax
        if column >= 6:
            if axis == 2:
                ex, ey = (-py, px) if of_second else (-oy, ox)
            dvx, dvy = sign * ex, sign * ey
            depth = 0.0 * gap
        else:
            if axis == 2:
                ex, ey = (-cy, cx) if of_second else (-ay, ax)
            widening = sign * (nx * ex + ny * ey)
            turn = sign * bend * (nx * ey - ny * ex)
            if axis == 2 and not of_second:
                turn += 1.0
            depth = -widening
            # displacements of P relative to both centres of mass
            qx, qy = half * ny * turn - 0.5 * widening * nx, -half * nx * turn - 0.5 * widening * ny
            hx, hy = qx, qy
            if of_second:
                hx, hy = hx + ex, hy + ey
                if axis == 2:
                    qx, qy = qx + ex, qy + ey
            elif axis < 2:
                hx, hy = hx - ex, hy - ey
            dvx = -x[second + 6] * qy + x[first + 6] * hy
            dvy = x[second + 6] * qx - x[first + 6] * hx
        d_rate = dvx * nx + dvy * ny - turn * slip
        d_slip = dvx * ny - dvy * nx + turn * rate
        d_normal = by_depth * depth - by_rate * d_rate
        d_friction = by_normal * d_normal + by_slip * d_slip
        along, across = d_normal + friction * turn, d_friction - normal * turn
        gx, gy = along * nx + across * ny, along * ny - across * nx
        at = 36 * (column // 6) + column % 6
        out[at + 6 * one] -= gx
        out[at + 6 * one + 6] -= gy
        by_spin = sign * per if column >= 6 and axis == 2 else 0.0 * per
        d_torque = -x[ROLLING] * (d_normal * share + normal * by_spin)
        out[at + 6 * one + 12] -= hx * fy - hy * fx + ox * gy - oy * gx + d_torque
        out[at + 6 * two] += gx
        out[at + 6 * two + 6] += gy
        out[at + 6 * two + 12] += qx * fy - qy * fx + px * gy - py * gx + d_torque


@kernel
def contact_rows(contacts: IntMatrix, parameters: RealVector, q: RealMatrix, v: RealMatrix, out: RealCube) -> None:
    """Compute the quantities (T, R, VALUE) of R rows of contacts at positions and velocities (T, 3 (B + 1)).

    A contact has the integers first body, second body, address of its law, address of its program, index in
    `parameters`, and first row.
    """
    for t in range(len(q)):
        for k in range(len(contacts)):
            begin = contacts[k, 4]
            for side in range(2):
                body, at = 3 * contacts[k, side], begin + 1 + POSE * side
                parameters[at], parameters[at + 1] = q[t, body], q[t, body + 1]
                parameters[at + 2], parameters[at + 3] = cosine_and_sine(q[t, body + 2])
                for i in range(3):
                    parameters[at + 4 + i] = v[t, body + i]
            call_law(contacts[k, 2], contacts[k, 3], 0.0, 0.0, 0.0, parameters, begin, out[t], contacts[k, 5], 9)
