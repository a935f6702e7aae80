"""First touch of two shapes within a step, by bounds instead of samples.

The motion of the bodies is a cubic, or several of them one after another (*pieces*). A point of one body moves relative
to another body on a smooth path, whose fourth derivative is bounded. In any part of a piece, the path therefore stays
within the convex hull of the four control points of its cubic in Bezier's form, widened by the error of this cubic. If
a line separates this hull from the shape of the other body, they do not touch in this part. Otherwise, the part is
halved. Parts grow again where shapes are far from each other (conservative advancement: B. Mirtich, Impulse-based
Dynamic Simulation of Rigid Body Systems, University of California, Berkeley, 1996). Two outlines that are apart touch
first at a corner or a circle of one of them, so that the paths of these points suffice.

Paths are in units of the shares of a piece.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from mbdkit.engine.kernels.angles import cosine_and_sine
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.functions import separate, subkernel
from mbdkit_contact.kernels.event_bundle import NORMAL, UNKNOWN
from mbdkit_contact.kernels.kinematics import CIRCLES, LINE, POLYGONS, ROUND, SINGLE, choose, gap_of, height_over_edge
from mbdkit_contact.kernels.uneven_ground import (
    COLOR,
    CORNER_COLOR,
    EDGE,
    HIGH,
    LOW,
    OWN,
    SEGMENT,
    height_over_segment,
    segment_at,
)
from mbdkit_contact.modes import OPEN

#: Two shapes do not touch in a step if their distances at its ends exceed this times the way of both. It covers the
#: difference between a cubic and the motion of the method.
CLEAR = 1.1
#: Overlaps up to this many times ``Shapes.exact`` are ignored: contacts that slide past the end of an edge stay closed
#: for twice this distance. The first touch is located within this way, in the same unit.
IGNORED, NARROW = 4.0, 1e3
#: Largest number of parts that are examined for one contact; then, the step is shortened to this share. Its motion may
#: be far from any solution, before the error control of the method rejects it.
MOST_PARTS, SHORTER = 1000, 0.25
REBOUND = 8  #: Number of parts of a step in which a rebound is sampled.
#: What is known of a part of a piece: shapes overlap at its end, or may touch within it, or do not touch.
TOUCHES, UNCLEAR, IS_CLEAR = range(3)


@separate
def set_piece(m, q0, v0, q1, v1, h):
    """Use the cubic through two states as the motion of a piece of duration `h`, and compute bounds of its rates."""
    c, bounds = m.touch.piece, m.touch.bounds
    for d in range(len(q0)):
        begin, end, change = h * v0[d], h * v1[d], q1[d] - q0[d]
        c[0, d], c[1, d], c[2, d], c[3, d] = q0[d], begin, 3.0 * change - 2.0 * begin - end, begin + end - 2.0 * change
    # a polynomial stays between its control points in Bezier's form, so that these bound its derivatives for the whole
    # piece
    for b in range(len(bounds) - 1):
        x, y, r = 3 * b, 3 * b + 1, 3 * b + 2
        largest = turning = 0.0
        for k in range(3):  # control points of the rates
            two, three = float(k), 3.0 if k == 2 else 0.0
            vx, vy = c[1, x] + two * c[2, x] + three * c[3, x], c[1, y] + two * c[2, y] + three * c[3, y]
            largest = max(largest, vx * vx + vy * vy)
            turning = max(turning, abs(c[1, r] + two * c[2, r] + three * c[3, r]))
        ax, ay, bx, by = 2.0 * c[2, x], 2.0 * c[2, y], 6.0 * c[3, x], 6.0 * c[3, y]
        sx, sy = ax + bx, ay + by
        rate = max(abs(2.0 * c[2, r]), abs(2.0 * c[2, r] + 6.0 * c[3, r]))
        square, jerk = turning * turning, abs(6.0 * c[3, r])
        bounds[b, 0] = sqrt(largest)
        bounds[b, 1] = sqrt(max(ax * ax + ay * ay, sx * sx + sy * sy))
        bounds[b, 2] = sqrt(bx * bx + by * by)
        bounds[b, 3], bounds[b, 4] = turning, square + rate
        bounds[b, 5] = turning * (square + 3.0 * rate) + jerk
        bounds[b, 6] = square * (square + 6.0 * rate) + 4.0 * turning * jerk + 3.0 * rate * rate


@separate
def find_near(m, before, after):
    """Mark the open contacts that may touch within a piece; return whether there are any.

    `before` and `after` (C,) are their gaps at its ends. Requires `set_piece`.
    """
    s, c, any_near = m.closed.shapes, m.touch, False
    for i in range(len(c.near)):
        c.near[i] = 0
        if m.known.modes[i] != OPEN:
            continue
        way = 0.0
        for side in range(2):
            bound = c.bounds[s.contacts[i, side]]
            way += bound[0]
            if bound[3] > 0.0:
                way += bound[3] * c.arms[i, side]
        # a touch within the piece takes both gaps out of the way of the bodies; a gap that is nan counts as near
        if not before[i] + after[i] > CLEAR * way:
            c.near[i], any_near = 1, True
    return any_near


@subkernel
def _place(m, body, s):
    c, x, d = m.touch.piece, m.closed.shapes.states[body], 3 * body
    for k in range(2):
        x[k] = c[0, d + k] + s * (c[1, d + k] + s * (c[2, d + k] + s * c[3, d + k]))
        x[4 + k] = c[1, d + k] + s * (2.0 * c[2, d + k] + 3.0 * s * c[3, d + k])
    x[2], x[3] = cosine_and_sine(c[0, d + 2] + s * (c[1, d + 2] + s * (c[2, d + 2] + s * c[3, d + 2])))
    x[6] = c[1, d + 2] + s * (2.0 * c[2, d + 2] + 3.0 * s * c[3, d + 2])


@subkernel
def set_states(m, i, s):
    """Write the states of the bodies of a contact at a share of the piece to the shapes."""
    contacts = m.closed.shapes.contacts
    for side in range(2):
        if contacts[i, side] < len(m.closed.shapes.states) - 1:
            _place(m, contacts[i, side], s)


@subkernel
def _begin_at_states(m, i):
    """Let the next part begin at the states in the shapes."""
    s = m.closed.shapes
    for side in range(2):
        copy(s.states[s.contacts[i, side]], m.touch.before[s.contacts[i, side]])


@subkernel
def _seen(f, b, x, y):
    """Return place and rate of a point of a body in the frame of another one; `f` and `b` are their states."""
    rx, ry = b[2] * x - b[3] * y, b[3] * x + b[2] * y
    dx, dy = b[0] + rx - f[0], b[1] + ry - f[1]
    vx, vy = b[4] - b[6] * ry - f[4] + f[6] * dy, b[5] + b[6] * rx - f[5] - f[6] * dx
    return f[2] * dx + f[3] * dy, f[2] * dy - f[3] * dx, f[2] * vx + f[3] * vy, f[2] * vy - f[3] * vx


@subkernel
def _enclose(m, frame, body, x, y, w):
    """Write the control points of the path of a point of a body, in the frame of another one, in the part of size `w`
    that ends at the states in the shapes; return the error of the path.
    """
    c, states, hull = m.touch, m.closed.shapes.states, m.touch.hull
    x0, y0, u0, v0 = _seen(c.before[frame], c.before[body], x, y)
    x1, y1, u1, v1 = _seen(states[frame], states[body], x, y)
    hull[0, 0], hull[0, 1], hull[3, 0], hull[3, 1] = x0, y0, x1, y1
    hull[1, 0], hull[1, 1] = x0 + w * u0 / 3.0, y0 + w * v0 / 3.0
    hull[2, 0], hull[2, 1] = x1 - w * u1 / 3.0, y1 - w * v1 / 3.0
    # the cubic of Hermite through both ends differs from the path by at most h^4/384 times its fourth derivative
    f, b, arm = c.bounds[frame], c.bounds[body], sqrt(x * x + y * y)
    fourth = arm * b[6]
    if f[3] > 0.0:  # derivatives of a product: of the distance, and of the rotation of the frame
        first, second, third = f[0] + b[0] + arm * b[3], f[1] + b[1] + arm * b[4], f[2] + b[2] + arm * b[5]
        far = sqrt(x0 * x0 + y0 * y0) + w * first
        fourth += 4.0 * f[3] * third + 6.0 * f[4] * second + 4.0 * f[5] * first + f[6] * far
    square = w * w
    return fourth * square * square / 384.0


@subkernel
def _least(hull, nx, ny):
    """Return the least component of the control points along a direction."""
    return min(
        min(hull[0, 0] * nx + hull[0, 1] * ny, hull[1, 0] * nx + hull[1, 1] * ny),
        min(hull[2, 0] * nx + hull[2, 1] * ny, hull[3, 0] * nx + hull[3, 1] * ny),
    )


@subkernel
def _middle(hull):
    x = 0.125 * (hull[0, 0] + 3.0 * (hull[1, 0] + hull[2, 0]) + hull[3, 0])
    return x, 0.125 * (hull[0, 1] + 3.0 * (hull[1, 1] + hull[2, 1]) + hull[3, 1])


@subkernel
def _beside_point(m, x, y, margin):
    """Return whether the hull stays away from a point by more than a margin."""
    hull = m.touch.hull
    mx, my = _middle(hull)
    dx, dy = mx - x, my - y
    size = sqrt(dx * dx + dy * dy)
    return size > 0.0 and _least(hull, dx / size, dy / size) - (dx * x + dy * y) / size > margin


@subkernel
def _at_circle(m, number, radius, error, ignored):
    """Look at a path beside a circle, or within one; `number` are the parameters of the feature."""
    s, hull = m.closed.shapes, m.touch.hull
    x, y, other = s.numbers[number, 3], s.numbers[number, 4], s.numbers[number, 5]
    dx, dy = hull[3, 0] - x, hull[3, 1] - y
    if s.kinds[number] == CIRCLES:
        if _beside_point(m, x, y, radius + other + error - ignored):
            return IS_CLEAR
        return TOUCHES if sqrt(dx * dx + dy * dy) < radius + other - ignored else UNCLEAR
    room, largest = other - radius + ignored, 0.0
    for k in range(4):
        px, py = hull[k, 0] - x, hull[k, 1] - y
        largest = max(largest, sqrt(px * px + py * py))
    if largest + error < room:
        return IS_CLEAR
    return TOUCHES if sqrt(dx * dx + dy * dy) > room else UNCLEAR


@subkernel
def _corner_before(s, polygon, corner):
    first = s.outlines[polygon, 1]
    return corner - 1 if corner > first else first + s.outlines[polygon, 2] - 1


@subkernel
def _nearest_corner(s, polygon, x, y):
    """Return the corner of a polygon that is nearest to a point; -1 if an edge is, or if the point is inside."""
    first = s.outlines[polygon, 1]
    for e in range(first, first + s.outlines[polygon, 2]):
        before = _corner_before(s, polygon, e)
        if height_over_edge(s, e, x, y)[1] < 0.0 and height_over_edge(s, before, x, y)[1] > s.corners[before, 4]:
            return e
    return -1


@subkernel
def _at_polygon(m, polygon, radius, error, ignored):
    s, hull, margin = m.closed.shapes, m.touch.hull, radius + error - ignored
    first, highest = s.outlines[polygon, 1], -np.inf
    for e in range(first, first + s.outlines[polygon, 2]):
        x, y, nx, ny = s.corners[e, 0], s.corners[e, 1], s.corners[e, 2], s.corners[e, 3]
        if _least(hull, nx, ny) - (nx * x + ny * y) > margin:
            return IS_CLEAR
        highest = max(highest, (hull[3, 0] - x) * nx + (hull[3, 1] - y) * ny)
    mx, my = _middle(hull)
    e = _nearest_corner(s, polygon, mx, my)
    if e >= 0 and _beside_point(m, s.corners[e, 0], s.corners[e, 1], margin):
        return IS_CLEAR
    if highest >= radius - ignored:
        return UNCLEAR
    e = _nearest_corner(s, polygon, hull[3, 0], hull[3, 1])
    if e >= 0:
        dx, dy = hull[3, 0] - s.corners[e, 0], hull[3, 1] - s.corners[e, 1]
        if sqrt(dx * dx + dy * dy) >= radius - ignored:
            return UNCLEAR
    return TOUCHES


@subkernel
def _is_beside_segment(m, k, radius, margin, ignored):
    """Return whether a path stays in front of a segment, behind it, or beyond one of its ends."""
    x, hull = m.closed.shapes.surface, m.touch.hull
    nx, ny = x[k + 2], x[k + 3]
    height = nx * x[k] + ny * x[k + 1]
    if _least(hull, nx, ny) - height > margin or _least(hull, -nx, -ny) + height > margin + 2.0 * ignored:
        return True
    mx, my = _middle(hull)
    along = height_over_segment(x, k, mx, my)[1]
    if x[k + LOW] < along < x[k + HIGH]:
        return False
    end = x[k + LOW] if along <= x[k + LOW] else x[k + HIGH]
    return _beside_point(m, x[k] + end * ny, x[k + 1] - end * nx, margin)


@subkernel
def _distance_from_segment(x, k, px, py):
    height, along = height_over_segment(x, k, px, py)
    past = max(x[k + LOW] - along, along - x[k + HIGH], 0.0)
    return sqrt(height * height + past * past)


@subkernel
def _at_segments(m, surface, color, radius, error, ignored):
    """Look at a path over the segments of one color of a polyline."""
    s, hull = m.closed.shapes, m.touch.hull
    x, begin, n, count = s.surface, s.surfaces[surface, 2], s.surfaces[surface, 3], s.surfaces[surface, 4]
    ground, wide = begin + OWN + EDGE * n, radius + error + ignored
    px, py, result = hull[3, 0], hull[3, 1], IS_CLEAR
    left, right = _least(hull, 1.0, 0.0) - wide, -_least(hull, -1.0, 0.0) + wide
    for j in range(segment_at(x, ground, count, left), segment_at(x, ground, count, right) + 1):
        k = ground + SEGMENT * j
        if x[k + COLOR] != color or _is_beside_segment(m, k, radius, radius + error - ignored, ignored):
            continue
        result = min(result, TOUCHES if _distance_from_segment(x, k, px, py) < radius - ignored else UNCLEAR)
    if result == UNCLEAR:
        below = ground + SEGMENT * segment_at(x, ground, count, px)
        if height_over_segment(x, below, px, py)[0] < -ignored:
            return TOUCHES
    return result


@subkernel
def _at_corners(m, i, pair, color, w, ignored):
    """Look at the paths of the corners of one color of a polyline beside a polygon."""
    s, c = m.closed.shapes, m.touch
    surface, polygon = s.pairs[pair, 3], s.pairs[pair, 4]
    body, ground = s.contacts[i, 0], s.contacts[i, 1]
    x, begin, n, count = s.surface, s.surfaces[surface, 2], s.surfaces[surface, 3], s.surfaces[surface, 4]
    segments, result = begin + OWN + EDGE * n, IS_CLEAR
    error = _enclose(m, ground, body, 0.0, 0.0, w)
    wide = c.arms[i, 0] + error + ignored
    left, right = _least(c.hull, 1.0, 0.0) - wide, -_least(c.hull, -1.0, 0.0) + wide
    for j in range(segment_at(x, segments, count, left), segment_at(x, segments, count, right) + 1):
        k = segments + SEGMENT * j
        if x[k + CORNER_COLOR] == color and left <= x[k] <= right:
            error = _enclose(m, body, ground, x[k], x[k + 1], w)
            result = min(result, _at_polygon(m, polygon, 0.0, error, ignored))
    return result


@separate
def _look(m, i, w, ignored):
    """Return what is known of a contact in the part of size `w` that ends at the states in the shapes."""
    s, pair = m.closed.shapes, m.closed.shapes.contacts[i, 3]
    kind, row, number = s.pairs[pair, 0], i - s.pairs[pair, 1], s.contacts[i, 2]
    surface, polygon, color = s.pairs[pair, 3], s.pairs[pair, 3], 0
    if kind > POLYGONS:
        n, own = s.surfaces[surface, 3], s.surfaces[surface, 5]
        if row >= own:
            return _at_corners(m, i, pair, row - own, w, ignored)
        color = row // n if n > 0 else row
    elif kind == POLYGONS and row >= s.outlines[s.pairs[pair, 4], 2]:
        polygon = s.pairs[pair, 4]
    x, y, radius = s.numbers[number, 0], s.numbers[number, 1], s.numbers[number, 2]
    error = _enclose(m, s.contacts[i, 0], s.contacts[i, 1], x, y, w)
    if kind > POLYGONS:
        return _at_segments(m, surface, color, radius, error, ignored)
    if kind != SINGLE:
        return _at_polygon(m, polygon, radius, error, ignored)
    if s.kinds[number] != LINE:
        return _at_circle(m, number, radius, error, ignored)
    px, py, nx, ny = s.numbers[number, 3], s.numbers[number, 4], s.numbers[number, 5], s.numbers[number, 6]
    height = px * nx + py * ny + radius - ignored
    if _least(m.touch.hull, nx, ny) - height > error:
        return IS_CLEAR
    return TOUCHES if m.touch.hull[3, 0] * nx + m.touch.hull[3, 1] * ny < height else UNCLEAR


@subkernel
def _is_examined_elsewhere(m, i):
    """Return whether a contact belongs to a circle beside a polygon, which has a row for each edge, but touches only
    one of them, and an earlier row or a closed one stands for it.
    """
    s, pair = m.closed.shapes, m.closed.shapes.contacts[i, 3]
    if s.pairs[pair, 0] != ROUND:
        return False
    for k in range(s.pairs[pair, 1], s.pairs[pair, 1] + s.pairs[pair, 2]):
        if m.known.modes[k] != OPEN or (k < i and m.touch.near[k] != 0):
            return True
    return False


@subkernel
def _note_touch(m, i, apart, share):
    """Let the contacts of a pair be examined that overlap at the states in the shapes, at a share of the step; if none
    overlaps, contact `i`. Before, at the share `apart` of the piece and of the step, they do not.
    """
    s, x, pair = m.closed.shapes, m.search, m.closed.shapes.contacts[i, 3]
    any_overlaps = False
    choose(s, pair)
    for k in range(s.pairs[pair, 1], s.pairs[pair, 1] + s.pairs[pair, 2]):
        if m.known.modes[k] == OPEN and gap_of(s, k) - x.level[k] < -x.limits[NORMAL, k]:
            x.high[NORMAL, k], any_overlaps = min(x.high[NORMAL, k], share), True
    if not any_overlaps:
        x.high[NORMAL, i] = min(x.high[NORMAL, i], share)
    set_states(m, i, apart[0])
    choose(s, pair)
    for k in range(s.pairs[pair, 1], s.pairs[pair, 1] + s.pairs[pair, 2]):
        value = gap_of(s, k) - x.level[k]
        if x.high[NORMAL, k] == share and (value > 0.0 or x.best[NORMAL, k, 0] > share):
            x.best[NORMAL, k, 0], x.best[NORMAL, k, 1] = apart[1], value


@separate
def _find_touch(m, i, share, size, until):
    """Search for the first touch of a contact in the piece that begins at a share of the step and has this size;
    return the share of the piece at which it is, at most `until`.
    """
    s, x = m.closed.shapes, m.search
    pair, first, second = s.contacts[i, 3], m.touch.bounds[s.contacts[i, 0]], m.touch.bounds[s.contacts[i, 1]]
    way = first[0] + second[0] + (first[3] + second[3]) * m.limits[1]
    ignored = IGNORED * s.exact[0]
    for k in range(s.pairs[pair, 1], s.pairs[pair, 1] + s.pairs[pair, 2]):
        ignored = max(ignored, IGNORED * s.exact[0] - x.level[k])
    apart = begin = 0.0
    w, least, touches = until, s.exact[0], False
    set_states(m, i, 0.0)
    _begin_at_states(m, i)
    if _look(m, i, 0.0, ignored) == TOUCHES:  # inside, but beyond the ends of all features that act
        return until
    for _ in range(MOST_PARTS):
        end = begin + w if begin + w < until else until
        set_states(m, i, end)
        result = _look(m, i, end - begin, ignored)
        if result == TOUCHES:
            touches, until = True, end
        if touches and (until - begin) * way <= NARROW * s.exact[0]:
            set_states(m, i, until)
            _note_touch(m, i, (apart, share + apart * size), share + until * size)
            return until
        if result == IS_CLEAR or w * way <= least:
            least = s.exact[0] if result == IS_CLEAR else min(2.0 * w * way, NARROW * s.exact[0])
            apart, begin = begin, end  # the overlap at `begin` may be one that is ignored
            _begin_at_states(m, i)
            if begin >= until:
                return until
            w = min(2.0 * w, 0.5 * (until - begin) if touches else until - begin)
        else:
            w *= 0.5
    x.first[0], x.event[0] = SHORTER, UNKNOWN
    return begin


@separate
def find_touches(m, share, size):
    """Search for the first touches of the contacts that are near in the piece that begins at a share of the step and
    has this size; return whether there are any.
    """
    until = 1.0
    for i in range(len(m.touch.near)):
        if m.touch.near[i] != 0 and not _is_examined_elsewhere(m, i):
            until = _find_touch(m, i, share, size, until)
    return until < 1.0


@separate
def find_rebounds(m):
    """Sample the gaps of near contacts that begin at zero and end below it: those of rebounds, however small.

    Requires `find_near` for the whole step, with the gaps ``m.gaps`` at its end.
    """
    s, x = m.closed.shapes, m.search
    for i in range(len(m.gaps)):
        if m.touch.near[i] == 0 or x.best[NORMAL, i, 1] > 0.0 or not m.gaps[i] < x.level[i]:
            continue
        for k in range(1, REBOUND):
            set_states(m, i, k / REBOUND)
            choose(s, s.contacts[i, 3])
            value = gap_of(s, i) - x.level[i]
            if value > x.best[NORMAL, i, 1]:
                x.best[NORMAL, i, 0], x.best[NORMAL, i, 1] = k / REBOUND, value
