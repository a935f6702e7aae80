"""Gaps and rows of rigid contacts, and where convex polygons touch.

A row (a possible contact point, see `mbdkit_contact.contact.ContactPair`) of a polygon has several features, each
with a smooth gap. For a corner of another polygon, the features are the edges of the polygon; for a circle, one edge
and the corner before it. Circles and points touch the nearest feature. By the theorem of separating axes, two polygons
can touch only along the edge from which the other polygon is farthest, and along the edge of the other polygon that
faces it. A corner of one edge acts where it is opposite the other edge. When a corner slides past the end of an edge,
the corner of the other polygon therefore takes over, and the side of the polygon does not stop the motion.

A row on a polyline (`mbdkit_contact.kernels.uneven_ground`) belongs to a circle or to a corner of a polygon, and to all
pieces of one color: its features are the parts of the polyline. Or it belongs to all convex corners of one color: its
features are these corners on the edges of the polygon.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated, NamedTuple

import numpy as np

from mbdkit.engine.kernels.angles import cosine_and_sine
from mbdkit.engine.kernels.bundle_types import IntMatrix, IntVector, RealMatrix, RealVector
from mbdkit.engine.native.functions import subkernel
from mbdkit_contact.kernels.row_kernels import circles_gap, circles_row, hole_gap, hole_row, line_gap, line_row
from mbdkit_contact.kernels.uneven_ground import (
    EDGE,
    HIGH,
    LOW,
    OWN,
    SEGMENT,
    TURN,
    corners_window,
    height_over,
    height_over_segment,
    touched_part,
    touching_corner,
    window_around,
)

KINDS = ("line", "circles", "hole")  #: Kinds of features, by their numbers.
LINE, CIRCLES, HOLE = range(3)
#: Kinds of pairs of shapes: neither has a polygon, a polygon and a circle or point, two polygons, and a polyline with a
#: circle, point or polygon.
SINGLE, ROUND, POLYGONS, UNEVEN = range(4)
NOWHERE = -np.inf


class Shapes(NamedTuple):
    """C contacts (rows) of P pairs of shapes with F features, and Q polygons with N corners."""

    contacts: Annotated[IntMatrix, 4]  #: (C, 4) first and second body, first feature, and pair.
    kinds: IntVector  #: (F,) kinds of the features; see `KINDS`.
    numbers: Annotated[RealMatrix, 7]  #: (F, 7) parameters of the features.
    #: (P, 5) kind, first contact, number of contacts, and polygons of the first and of the second body (or -1); instead
    #: of the first polygon, the surface of a polyline.
    pairs: Annotated[IntMatrix, 5]
    outlines: Annotated[IntMatrix, 3]  #: (Q, 3) body, first corner and number of corners of the polygons.
    #: (N, 5) place of each corner, and the normal and length of the edge that starts there.
    corners: Annotated[RealMatrix, 5]
    around: Annotated[RealMatrix, 3]  #: (Q, 3) centre and radius of circles around the polygons.
    #: (S, 6) body of each polyline, body on it, index of its parameters in `surface`, number of edges of the polygon on
    #: it, number of segments, and number of contacts that belong to the circle or to corners of the polygon.
    surfaces: Annotated[IntMatrix, 6]
    surface: RealVector  #: Parameters of the polylines.
    reach: RealVector  #: (1,) largest distance from a polyline that is computed exactly [m].
    exact: RealVector  #: (1,) distance up to which a corner beyond the end of an edge still acts [m].
    #: (C,) index of the feature at which each closed contact stays; -1 for contacts that use the feature nearest to
    #: touching.
    held: IntVector
    #: (B + 1, 7) work array: place, cosine and sine of the angle, and velocities of the bodies, ground last.
    states: Annotated[RealMatrix, 7]
    #: (C,) work arrays: index of the feature of each contact, and a lower bound of its gap, which is the distance of
    #: the shapes where the feature does not act.
    features: IntVector
    least: RealVector


@subkernel
def place(s, q, v):
    """Write the states of all bodies at positions and velocities (n,) or longer."""
    for b in range(len(s.states) - 1):
        c, sine = cosine_and_sine(q[3 * b + 2])
        _place_body(s, b, c, sine, q, v)
    s.states[len(s.states) - 1, 2] = 1.0


@subkernel
def place_turned(s, cs, q, v):
    """Write the states of all bodies whose cosines and sines (B + 1, 2) are known; see `place`."""
    for b in range(len(s.states) - 1):
        _place_body(s, b, cs[b, 0], cs[b, 1], q, v)
    s.states[len(s.states) - 1, 2] = 1.0


@subkernel
def _place_body(s, b, c, sine, q, v):
    s.states[b, 0], s.states[b, 1], s.states[b, 2], s.states[b, 3] = q[3 * b], q[3 * b + 1], c, sine
    for d in range(3):
        s.states[b, 4 + d] = v[3 * b + d]


@subkernel
def _seen(s, body, frame, x, y):
    """Return a point of a body in the frame of another one."""
    b, f = s.states[body], s.states[frame]
    dx, dy = b[0] + b[2] * x - b[3] * y - f[0], b[1] + b[3] * x + b[2] * y - f[1]
    return f[2] * dx + f[3] * dy, f[2] * dy - f[3] * dx


@subkernel
def _distance(s, pair):
    """Return a lower bound of the distance between the shapes of a pair, at least one of which is a polygon."""
    first, second = s.pairs[pair, 3], s.pairs[pair, 4]
    a, b = s.contacts[s.pairs[pair, 1], 0], s.contacts[s.pairs[pair, 1], 1]
    if second >= 0:
        b, x, y, r = s.outlines[second, 0], s.around[second, 0], s.around[second, 1], s.around[second, 2]
    else:
        numbers = s.numbers[s.contacts[s.pairs[pair, 1], 2]]
        x, y, r = numbers[0], numbers[1], numbers[2]
    a = s.outlines[first, 0]
    x, y = _seen(s, b, a, x, y)
    dx, dy = x - s.around[first, 0], y - s.around[first, 1]
    return sqrt(dx * dx + dy * dy) - r - s.around[first, 2]


@subkernel
def height_over_edge(s, corner, x, y):
    """Return the height of a point over the edge that starts at a corner, and its place along this edge."""
    dx, dy = x - s.corners[corner, 0], y - s.corners[corner, 1]
    nx, ny = s.corners[corner, 2], s.corners[corner, 3]
    return dx * nx + dy * ny, dy * nx - dx * ny


@subkernel
def _choose_round(s, pair):
    """Choose the feature of each contact between a polygon and a circle or point."""
    first, count, polygon = s.pairs[pair, 1], s.pairs[pair, 2], s.pairs[pair, 3]
    begin, numbers = s.outlines[polygon, 1], s.numbers[s.contacts[first, 2]]
    x, y = _seen(s, s.contacts[first, 1], s.outlines[polygon, 0], numbers[0], numbers[1])
    highest, nearest, top, edge = NOWHERE, np.inf, 0, 0
    past = 0.0
    for e in range(count):
        height, along = height_over_edge(s, begin + e, x, y)
        beyond = max(-along, along - s.corners[begin + e, 4], 0.0)
        distance = sqrt(height * height + beyond * beyond)
        s.features[first + e], s.least[first + e] = 0, distance - numbers[2]
        if height > highest:
            highest, top = height, e
        if distance < nearest:
            nearest, edge, past = distance, e, along
    row = top
    if highest > 0.0:
        is_after = past > s.corners[begin + edge, 4]
        row = (edge + 1) % count if is_after else edge
        if is_after or past < 0.0:
            s.features[first + row] = 1
    for e in range(count):
        s.least[first + e] = NOWHERE if e == row else max(s.least[first + e], s.exact[0])


@subkernel
def _separation(s, one, other):
    """Return the edge of a polygon from which another one is farthest, and this distance."""
    best, apart = 0, NOWHERE
    for e in range(s.outlines[one, 1], s.outlines[one, 1] + s.outlines[one, 2]):
        least = np.inf
        for k in range(s.outlines[other, 1], s.outlines[other, 1] + s.outlines[other, 2]):
            x, y = _seen(s, s.outlines[other, 0], s.outlines[one, 0], s.corners[k, 0], s.corners[k, 1])
            least = min(least, height_over_edge(s, e, x, y)[0])
        if least > apart:
            best, apart = e - s.outlines[one, 1], least
    return best, apart


@subkernel
def _facing(s, one, edge, other):
    """Return the edge of another polygon that faces an edge of a polygon."""
    a, b = s.states[s.outlines[one, 0]], s.states[s.outlines[other, 0]]
    nx, ny = s.corners[s.outlines[one, 1] + edge, 2], s.corners[s.outlines[one, 1] + edge, 3]
    gx, gy = a[2] * nx - a[3] * ny, a[3] * nx + a[2] * ny
    mx, my = b[2] * gx + b[3] * gy, b[2] * gy - b[3] * gx
    best, least = 0, np.inf
    for f in range(s.outlines[other, 2]):
        k = s.outlines[other, 1] + f
        product = mx * s.corners[k, 2] + my * s.corners[k, 3]
        if product < least:
            best, least = f, product
    return best


@subkernel
def _choose_corners(s, first, one, edge, other, facing):
    """Choose the edge of a polygon for each corner of another one, whose contacts begin with `first`.

    The corners that act are the ends of the edge `facing` that lie between the ends of the edge.
    """
    begin, count = s.outlines[other, 1], s.outlines[other, 2]
    for k in range(count):
        x, y = _seen(s, s.outlines[other, 0], s.outlines[one, 0], s.corners[begin + k, 0], s.corners[begin + k, 1])
        acts = False
        if k == facing or k == (facing + 1) % count:
            along = height_over_edge(s, s.outlines[one, 1] + edge, x, y)[1]
            acts = -s.exact[0] <= along <= s.corners[s.outlines[one, 1] + edge, 4] + s.exact[0]
        highest = NOWHERE
        if not acts:
            for e in range(s.outlines[one, 1], s.outlines[one, 1] + s.outlines[one, 2]):
                highest = max(highest, height_over_edge(s, e, x, y)[0])
            highest = max(highest, s.exact[0])
        s.features[first + k], s.least[first + k] = edge, highest


@subkernel
def _turn(s, frame, body):
    """Return the cosine and sine of the angle of a body in the frame of another one."""
    f, b = s.states[frame], s.states[body]
    return f[2] * b[2] + f[3] * b[3], f[2] * b[3] - f[3] * b[2]


@subkernel
def _choose_uneven(s, pair):
    """Choose the part of a polyline, or its corner and an edge of a polygon, for each contact of a polyline."""
    g = s.surfaces[s.pairs[pair, 3]]
    ground, body, begin, n, count, own = g[0], g[1], g[2], g[3], g[4], g[5]
    turn, x, first, reach, sizes = _turn(s, ground, body), s.surface, s.pairs[pair, 1], s.reach[0], (n, count)
    for row in range(s.pairs[pair, 2]):
        r = x[begin + 2]
        if row < own:
            at = begin + OWN + EDGE * (row % n) if n > 0 else begin
            p = _seen(s, body, ground, x[at], x[at + 1])
            window = window_around(x, begin, sizes, p, r + reach)
            height, feature, acts = touched_part(x, begin, sizes, row, p, turn, window, s.exact[0])
            acts &= feature % 2 == 0 or x[begin + OWN + EDGE * n + SEGMENT * (feature // 2) + TURN] > 0.0
        else:
            origin = _seen(s, body, ground, 0.0, 0.0)
            window = corners_window(x, begin, sizes, origin, turn, reach)
            height, feature, acts = touching_corner(x, begin, sizes, row - own, origin, turn, window, s.exact[0])
        s.features[first + row] = feature
        s.least[first + row] = NOWHERE if acts else max(min(height - r, reach), s.exact[0])


@subkernel
def _uneven_margin(s, i, pair):
    """Return the distance by which a contact of a polyline may still slide until it leaves its feature."""
    g = s.surfaces[s.pairs[pair, 3]]
    ground, body, begin, n, own = g[0], g[1], g[2], g[3], g[5]
    x, row, feature, segments = s.surface, i - s.pairs[pair, 1], s.held[i], begin + OWN + EDGE * n
    if row >= own:
        corner, edge = segments + SEGMENT * (feature // n), begin + OWN + EDGE * (feature % n)
        px, py = _seen(s, ground, body, x[corner], x[corner + 1])
        along = height_over(x, edge, px, py)[1]
        return min(along, x[edge + 4] - along)
    at = begin + OWN + EDGE * (row % n) if n > 0 else begin
    px, py = _seen(s, body, ground, x[at], x[at + 1])
    k = segments + SEGMENT * (feature // 2)
    along = height_over_segment(x, k, px, py)[1]
    if feature % 2 == 0:
        return min(along - x[k + LOW], x[k + HIGH] - along) - s.exact[0]  # segments are lengthened by this distance
    before = height_over_segment(x, k - SEGMENT, px, py)[1] - x[k - SEGMENT + HIGH]
    return min(before, x[k + LOW] - along) + s.exact[0]


@subkernel
def choose(s, pair):
    """Choose the features of the contacts of a pair of shapes that are not held."""
    first, count = s.pairs[pair, 1], s.pairs[pair, 2]
    if s.pairs[pair, 0] == SINGLE:
        for i in range(first, first + count):
            s.features[i], s.least[i] = 0, NOWHERE
        return
    if s.pairs[pair, 0] == ROUND:
        _choose_round(s, pair)
    elif s.pairs[pair, 0] == UNEVEN:
        _choose_uneven(s, pair)
    else:
        one, other = s.pairs[pair, 3], s.pairs[pair, 4]
        edge, apart = _separation(s, one, other)
        facing, from_other = _separation(s, other, one)
        if apart >= from_other:
            facing = _facing(s, one, edge, other)
        else:
            edge = _facing(s, other, facing, one)
        _choose_corners(s, first, one, edge, other, facing)
        _choose_corners(s, first + s.outlines[other, 2], other, facing, one, edge)
    for i in range(first, first + count):
        if s.held[i] >= 0:
            s.features[i], s.least[i] = s.held[i], NOWHERE


@subkernel
def gap_of(s, i):
    """Return the gap of a contact at its chosen feature."""
    a, b, f = s.states[s.contacts[i, 0]], s.states[s.contacts[i, 1]], s.contacts[i, 2] + s.features[i]
    if s.kinds[f] == LINE:
        gap = line_gap(a, b, s.numbers[f])
    elif s.kinds[f] == CIRCLES:
        gap = circles_gap(a, b, s.numbers[f])
    else:
        gap = hole_gap(a, b, s.numbers[f])
    return max(gap, s.least[i])


@subkernel
def row_of(s, i, out):
    """Compute the quantities (16,) of a contact at its chosen feature; see `mbdkit_contact.contact_rows`."""
    a, b, f = s.states[s.contacts[i, 0]], s.states[s.contacts[i, 1]], s.contacts[i, 2] + s.features[i]
    if s.kinds[f] == LINE:
        line_row(a, b, s.numbers[f], out)
    elif s.kinds[f] == CIRCLES:
        circles_row(a, b, s.numbers[f], out)
    else:
        hole_row(a, b, s.numbers[f], out)
    out[0] = max(out[0], s.least[i])


@subkernel
def find_gaps(s, within, gaps):
    """Compute the gaps (C,) of all contacts in the states of the bodies.

    For a gap above `within`, the result may be a lower bound that is above `within` too.
    """
    for pair in range(len(s.pairs)):
        first, count = s.pairs[pair, 1], s.pairs[pair, 2]
        if s.pairs[pair, 0] == ROUND or s.pairs[pair, 0] == POLYGONS:
            apart = _distance(s, pair)
            if apart > within:
                for i in range(first, first + count):
                    gaps[i] = apart
                continue
        choose(s, pair)
        for i in range(first, first + count):
            gaps[i] = gap_of(s, i)


@subkernel
def hold(s, q, closed):
    """Fix the features of contacts for which `closed` (C,) is not 0, and release all others.

    Features that are fixed already stay, others are those nearest to touching at positions (n,).
    """
    place(s, q, q)
    for pair in range(len(s.pairs)):
        wanted = False
        for i in range(s.pairs[pair, 1], s.pairs[pair, 1] + s.pairs[pair, 2]):
            wanted |= closed[i] != 0
        if s.pairs[pair, 0] != SINGLE and wanted:
            choose(s, pair)
        for i in range(s.pairs[pair, 1], s.pairs[pair, 1] + s.pairs[pair, 2]):
            s.held[i] = s.features[i] if s.pairs[pair, 0] != SINGLE and closed[i] != 0 else -1


@subkernel
def find_margins(s, margins):
    """Compute the distances by which contacts (C,) may still slide until they leave their fixed features [m].

    They are negative beyond the end of a feature, and infinite for contacts without one. Requires `place`.
    """
    for i in range(len(margins)):
        margins[i] = np.inf
        pair = s.contacts[i, 3]
        if s.held[i] < 0 or s.pairs[pair, 0] == SINGLE:
            continue
        row, one, other = i - s.pairs[pair, 1], s.pairs[pair, 3], s.pairs[pair, 4]
        if s.pairs[pair, 0] == UNEVEN:
            margins[i] = _uneven_margin(s, i, pair)
        elif s.pairs[pair, 0] == ROUND:
            numbers = s.numbers[s.contacts[i, 2]]
            x, y = _seen(s, s.contacts[i, 1], s.outlines[one, 0], numbers[0], numbers[1])
            begin, count = s.outlines[one, 1], s.outlines[one, 2]
            along = height_over_edge(s, begin + row, x, y)[1]
            if s.held[i] == 0:
                margins[i] = min(along, s.corners[begin + row, 4] - along)
            else:
                before = begin + (row + count - 1) % count
                margins[i] = min(height_over_edge(s, before, x, y)[1] - s.corners[before, 4], -along)
        else:
            if row >= s.outlines[other, 2]:
                one, other, row = other, one, row - s.outlines[other, 2]
            k, edge = s.outlines[other, 1] + row, s.outlines[one, 1] + s.held[i]
            x, y = _seen(s, s.outlines[other, 0], s.outlines[one, 0], s.corners[k, 0], s.corners[k, 1])
            along = height_over_edge(s, edge, x, y)[1]
            margins[i] = min(along, s.corners[edge, 4] - along)
        margins[i] += 2.0 * s.exact[0]
