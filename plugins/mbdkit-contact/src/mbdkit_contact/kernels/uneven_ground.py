"""Where a circle, a point, or a polygon touches a polyline.

A *part* of a polyline is a segment or the corner at its start. The height of a point over a part is negative in the
material. A point lies over a segment if it can be projected onto it, and over a corner if it lies beyond the ends of
both segments there: outside a convex corner, or in the material below a concave one. Of a convex piece
(`mbdkit_contact.polylines`), the part with the largest height is touched.

A corner of a polygon touches only segments that face one of its two edges, as with two polygons
(`mbdkit_contact.kernels.contact_laws`), so that a corner just inside the end of a segment is not pushed out sideways.
Convex corners of the polyline touch the edges of the polygon that face their segments, or that lie between these.

The parameters `x` contain, from index `at` on: center and radius of the circle, the number of colors, the `EDGE`
numbers of each of the n edges of the polygon (0 for a circle), and the `SEGMENT` numbers of each segment. `sizes` are
the numbers of edges and of segments, `turn` the cosine and sine of the angle of the second body relative to the first,
and `window` the first and the last segment that are searched. Points are in the frame of the first body.
"""

from __future__ import annotations

from math import sqrt

from mbdkit.engine.native.functions import inlined

#: Numbers of an edge of a polygon: start, normal and length; of a segment: see `mbdkit_contact.polylines.SEGMENT`.
EDGE, SEGMENT = 5, 10
LOW, HIGH, DEPTH, COLOR, TURN, CORNER_COLOR = range(4, SEGMENT)
OWN = 4  #: Numbers before the edges.
FAR = 1e300


@inlined
def height_over(x, edge, px, py):
    """Return the height of a point over an edge of a polygon, and its place along the edge."""
    dx, dy, nx, ny = px - x[edge], py - x[edge + 1], x[edge + 2], x[edge + 3]
    return dx * nx + dy * ny, dy * nx - dx * ny


@inlined
def height_over_segment(x, segment, px, py):
    """Return the height of a point over a segment, and its place along the segment, which has the material on its
    right, unlike the edges of a polygon.
    """
    height, back = height_over(x, segment, px, py)
    return height, -back


@inlined
def segment_at(x, ground, count, px):
    """Return the last segment that starts at or before a place; the first segment if there is none."""
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        if x[ground + SEGMENT * middle] <= px:
            low = middle
        else:
            high = middle
    return low


@inlined
def spacing(x, at, sizes):
    """Return the mean distance of the corners of a polyline along x."""
    ground, last = at + OWN + EDGE * sizes[0], sizes[1] - 1
    return (x[ground + SEGMENT * last] - x[ground]) / max(last, 1)


@inlined
def window_around(x, at, sizes, p, reach):
    """Return the first and the last segment with parts nearer to a point than `reach`; in the material, also the
    nearest part of all.
    """
    count, ground = sizes[1], at + OWN + EDGE * sizes[0]
    px, py = p
    below = ground + SEGMENT * segment_at(x, ground, count, px)
    height, ny = height_over(x, below, px, py)[0], x[below + 3]
    wide = reach + 0.0 * height
    if height < 0.0:  # the polyline is at most this far away
        if ny > 0.1:
            least = -height / ny
        else:
            dx, dy = px - x[below], py - x[below + 1]
            least = sqrt(dx * dx + dy * dy)
        wide = least if least > wide else wide
    return segment_at(x, ground, count, px - wide), segment_at(x, ground, count, px + wide)


@inlined
def _in_frame_of_polygon(x, segment, turn):
    """Return the normal of a segment in the frame of the polygon's body."""
    nx, ny = x[segment + 2], x[segment + 3]
    return turn[0] * nx + turn[1] * ny, turn[0] * ny - turn[1] * nx


@inlined
def _along_edge_normal(x, at, n, edge, m):
    """Return the component of a vector along the normal of an edge; -1 for the opposite of this normal."""
    k = at + OWN + EDGE * ((edge + n) % n)
    return m[0] * x[k + 2] + m[1] * x[k + 3]


@inlined
def _faces(x, at, n, corner, segment, turn):
    """Whether the edge of a polygon that faces a segment ends at a corner of the polygon."""
    m = _in_frame_of_polygon(x, segment, turn)
    own = min(_along_edge_normal(x, at, n, corner - 1, m), _along_edge_normal(x, at, n, corner, m))
    return own <= min(_along_edge_normal(x, at, n, corner - 2, m), _along_edge_normal(x, at, n, corner + 1, m))


@inlined
def touched_part(x, at, sizes, row, p, turn, window, exact):
    """Return the height of a point over the part that it touches, the part, and whether it lies over this part.

    The part is twice the number of its segment, plus 1 for the corner at its start. If the point does not lie over any
    part, the result is its distance from the nearest segment. `row` is the number of the corner of the polygon that is
    the point, plus the number of corners times the color of the pieces that are searched. For circles, it is the color.
    A point that is outside a piece by at most `exact` may be in the material behind its other segments.
    """
    n, ground = sizes[0], at + OWN + EDGE * sizes[0]
    corner, color = (row % n, row // n) if n > 0 else (0, row)
    px, py = p
    best, part, acts = FAR + 0.0 * px, 2 * window[0], False
    highest, top, is_over, is_outside = -FAR + 0.0 * px, 2 * window[0], False, False
    least, nearest = FAR + 0.0 * px, 2 * window[0]
    for j in range(window[0], window[1] + 1):
        k = ground + SEGMENT * j
        if x[k + COLOR] != color:
            continue
        if j == window[0] or x[k - SEGMENT + COLOR] != color:  # a piece begins
            highest, top, is_over, is_outside = -FAR + 0.0 * px, 2 * j, False, False
            least, nearest = FAR + 0.0 * px, 2 * j
        height, along = height_over_segment(x, k, px, py)
        is_outside = is_outside or height > exact
        own, past, faces = 2 * j, 0.0 * height, n == 0 or _faces(x, at, n, corner, k, turn)
        if along > x[k + HIGH]:
            past, own = along - x[k + HIGH], -1
        elif along < x[k + LOW]:
            past, own = along - x[k + LOW], -1
        square = height * height + past * past
        if square < least:
            least, nearest = square, 2 * j
        may_touch = x[k + TURN] < 0.0 or (x[k + TURN] > 0.0 and n == 0)
        if along < x[k + LOW] and may_touch and height_over_segment(x, k - SEGMENT, px, py)[1] > x[k - SEGMENT + HIGH]:
            own, height = 2 * j + 1, x[k + TURN] * sqrt(height * height + along * along)
            faces = faces or _faces(x, at, n, corner, k - SEGMENT, turn)
        if own >= 0 and faces and height >= -x[k + DEPTH] and height > highest:
            highest, top, is_over = height, own, True
        if j < window[1] and x[k + SEGMENT + COLOR] == color:
            continue
        if not is_over or (is_outside and highest < 0.0):
            highest, top, is_over = sqrt(least), nearest, False
        if highest < best:
            best, part, acts = highest, top, is_over
    return best, part, acts


@inlined
def corners_window(x, at, sizes, origin, turn, reach):
    """Return the first and the last segment that may start at a corner of the polyline within a polygon, or left or
    right of it by at most `reach`. `origin` is the origin of the frame of the polygon's body.
    """
    n, count = sizes
    ground = at + OWN + EDGE * n
    left, right = FAR + 0.0 * origin[0], -FAR + 0.0 * origin[0]
    for k in range(n):
        edge = at + OWN + EDGE * k
        px = origin[0] + turn[0] * x[edge] - turn[1] * x[edge + 1]
        left, right = (px if px < left else left), (px if px > right else right)
    return segment_at(x, ground, count, left - reach), segment_at(x, ground, count, right + reach)


@inlined
def _facing_edge(x, at, n, segment, turn):
    """Return the edge of a polygon that faces a segment."""
    m = _in_frame_of_polygon(x, segment, turn)
    best, least = 0, FAR + 0.0 * m[0]
    for e in range(n):
        product = _along_edge_normal(x, at, n, e, m)
        if product < least:
            best, least = e, product
    return best


@inlined
def touching_corner(x, at, sizes, color, origin, turn, window, exact):
    """Return the height of a convex corner of the polyline over an edge of a polygon, the part, and whether the corner
    lies over this edge, or beyond its ends by at most `exact`.

    The part is n times the number of the segment that starts at the corner, plus the number of the edge. If no corner
    lies over an edge that faces it, the result is a lower bound of the distance.
    """
    n, ground = sizes[0], at + OWN + EDGE * sizes[0]
    best, part, acts = FAR + 0.0 * origin[0], 0, False
    for j in range(window[0], window[1] + 1):
        k = ground + SEGMENT * j
        if x[k + CORNER_COLOR] != color:
            continue
        dx, dy = x[k] - origin[0], x[k + 1] - origin[1]
        px, py = turn[0] * dx + turn[1] * dy, turn[0] * dy - turn[1] * dx
        # The edges that face one of the two segments, and those between them, may touch the corner.
        facing = _facing_edge(x, at, n, k - SEGMENT, turn)
        more = (facing - _facing_edge(x, at, n, k, turn) + n) % n
        highest, top, over, apart = -FAR + 0.0 * px, facing, False, 0.0 * px
        for e in range(n):
            edge = at + OWN + EDGE * e
            height, along = height_over(x, edge, px, py)
            apart = height if height > apart else apart
            faces = (facing - e + n) % n <= more
            if faces and -exact <= along and along <= x[edge + 4] + exact and height > highest:
                highest, top, over = height, e, True
        if not over or (apart > exact and highest < 0.0):
            highest, over = apart, False
        if highest < best:
            best, part, acts = highest, n * j + top, over
    return best, part, acts
