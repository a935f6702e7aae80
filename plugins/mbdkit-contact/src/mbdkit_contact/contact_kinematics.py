"""Geometry of rigid contacts as kernels read it: features, outlines and surfaces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

import numpy as np

from mbdkit_contact.acting_contacts import ActingContact, polygon_edges, surface_numbers
from mbdkit_contact.contact import ContactPair
from mbdkit_contact.kernels.kinematics import KINDS, LINE, NOWHERE, POLYGONS, ROUND, SINGLE, UNEVEN, Shapes
from mbdkit_contact.kernels.uneven_ground import EDGE, FAR, HIGH, LOW, OWN, SEGMENT

#: Distance, relative to the length of the mechanism, up to which a corner beyond the end of an edge still acts; closed
#: contacts remain closed up to twice this distance.
EXACT = 1e-9
#: Up to this number of segments, distances from polylines are computed exactly, else up to `REACH`.
SEGMENTS_IN_FULL = 32
#: Distance from a polyline, relative to the length of the mechanism, above which gaps may be too small.
REACH = 0.1


Feature = tuple[str, tuple[float, ...]]  #: Kind and parameters of a smooth gap.


def features_of(pair: ContactPair) -> list[Feature]:
    """Return the features of a row; only one if the row belongs neither to a polygon nor to a polyline."""
    kind, numbers = pair.kind[0], pair.numbers
    if kind in ("polyline", "corner"):
        return _features_on_polyline(pair)
    if kind not in ("inside", "edge"):
        return [(kind, numbers)]
    own, edges = numbers[:3], _edges(pair)[:, :4].tolist()
    if kind == "inside":
        return [("line", (*own, *edge)) for edge in edges]
    corner = numbers[5:7]
    after = next(edge for edge in edges if tuple(edge[:2]) == corner)
    return [("line", (*own, *after)), ("circles", (*own, *corner, 0.0))]


def _features_on_polyline(pair: ContactPair) -> list[Feature]:
    """Return the segments of a polyline, each followed by the corner at its start, or its corners on each edge of a
    polygon.
    """
    segments = np.reshape(pair.numbers[-SEGMENT * pair.kind[1] :], (-1, SEGMENT))[:, :4].tolist()
    if pair.kind[0] == "polyline":
        own = pair.numbers[:3]
        return [feature for s in segments for feature in (("line", (*own, *s)), ("circles", (*own, *s[:2], 0.0)))]
    edges = np.reshape(pair.numbers[OWN : -SEGMENT * pair.kind[1]], (-1, EDGE))[:, :4].tolist()
    return [("line", (*s[:2], 0.0, *edge)) for s in segments for edge in edges]


def _edges(pair: ContactPair) -> np.ndarray:
    """Return x and y of the start and of the normal of each edge, and its length (n, 5), for the polygon of a row."""
    return np.reshape(pair.numbers[-5 * pair.kind[1] :], (-1, 5))


def shapes_of(contacts: Sequence[ActingContact], bodies: int, exact: float) -> Shapes:
    """Return the geometry of the contacts of a mechanism with B bodies.

    A corner of a polygon still acts up to a distance `exact` [m] beyond the end of an edge.
    """
    features, rows, pairs = list[Feature](), list[tuple[int, ...]](), list[tuple[int, ...]]()
    outlines, corners, around = list[tuple[int, ...]](), list[np.ndarray](), list[tuple[float, ...]]()
    surfaces, surface = list[tuple[int, ...]](), list[float]()

    def outline(body: int, edges: np.ndarray) -> int:
        """Add a polygon of a body; return its index."""
        places = edges[:, :2]
        center = np.mean(places, axis=0)
        outlines.append((body, sum(map(len, corners)), len(edges)))
        corners.append(edges)
        around.append((*center, float(np.max(np.linalg.norm(places - center, axis=1)))))
        return len(outlines) - 1

    def polyline(own: Sequence[ActingContact]) -> int:
        """Add the polyline of the first body of rows; return its index."""
        kind, count = own[0].pair.kind
        numbers = surface_numbers(own[0])
        segments = np.reshape(numbers[-SEGMENT * count :], (-1, SEGMENT))
        segments[:, LOW] -= exact
        segments[:, HIGH] += exact
        edges, of_second = polygon_edges(own[0]), sum(contact.pair.kind[0] == kind for contact in own)
        surfaces.append((*own[0].bodies, len(surface), edges, count, of_second))
        surface.extend([*numbers[: -SEGMENT * count], *segments.ravel().tolist()])
        return len(surfaces) - 1

    def pair_of(place: tuple[int, ActingContact]) -> object:
        number, contact = place
        return number if contact.pair.kind[0] in KINDS else (contact.pair.key, frozenset(contact.pair.bodies))

    for _, some in groupby(enumerate(contacts), pair_of):
        own = [contact for _, contact in some]
        kind = {"edge": ROUND, "inside": POLYGONS, "polyline": UNEVEN}.get(own[0].pair.kind[0], SINGLE)
        first = second = -1
        if kind == UNEVEN:
            first = polyline(own)
            edges = np.reshape(surface_numbers(own[0])[OWN:][: EDGE * polygon_edges(own[0])], (-1, EDGE))
            second = outline(own[0].bodies[1], edges) if len(edges) else -1
        elif kind != SINGLE:
            first = outline(own[0].bodies[0], _edges(own[0].pair))
            second = outline(own[-1].bodies[0], _edges(own[-1].pair)) if kind == POLYGONS else -1
        pairs.append((kind, len(rows), len(own), first, second))
        begins = dict[tuple[object, ...], int]()  # rows of the same circle or corner share their features
        for contact in own:
            geometry = contact.pair.kind, contact.pair.numbers
            if geometry not in begins:
                begins[geometry] = len(features)
                features += features_of(contact.pair)
            rows.append((*contact.bodies, begins[geometry], len(pairs) - 1))
    count = len(contacts)
    numbers = np.zeros((len(features), 7))
    for row, (_, given) in zip(numbers, features, strict=True):
        row[: len(given)] = given
    return Shapes(
        np.array(rows, dtype=np.int64).reshape(-1, 4),
        np.array([KINDS.index(kind) for kind, _ in features], dtype=np.int64),
        numbers,
        np.array(pairs, dtype=np.int64).reshape(-1, 5),
        np.array(outlines, dtype=np.int64).reshape(-1, 3),
        np.concatenate([np.zeros((0, 5)), *corners]),
        np.array(around).reshape(-1, 3),
        np.array(surfaces, dtype=np.int64).reshape(-1, 6),
        np.array(surface),
        np.array([FAR if all(surface[4] <= SEGMENTS_IN_FULL for surface in surfaces) else REACH / EXACT * exact]),
        np.array([exact]),
        np.full(count, -1),
        np.zeros((bodies + 1, 7)),
        np.zeros(count, dtype=np.int64),
        np.full(count, NOWHERE),
    )


def arms_of(s: Shapes) -> np.ndarray:
    """Return the largest distances (C, 2) of the outlines that may touch from the origins of the frames of both bodies
    [m], infinite for lines and polylines.
    """

    def outline(polygon: int) -> float:
        first, count = s.outlines[polygon, 1:]
        return float(np.max(np.hypot(*s.corners[first : first + count, :2].T)))

    arms = np.empty((len(s.contacts), 2))
    for i, (_, _, number, pair) in enumerate(s.contacts.tolist()):
        kind, begin, _, first, second = s.pairs[pair].tolist()
        arms[i] = math.inf, math.hypot(*s.numbers[number, :2])
        if kind == SINGLE and s.kinds[number] != LINE:
            arms[i, 0] = math.hypot(*s.numbers[number, 3:5])
        elif kind == ROUND:
            arms[i, 0] = outline(first)
        elif kind == POLYGONS:
            arms[i, 0] = outline(first if i - begin < s.outlines[second, 2] else second)
        elif kind == UNEVEN and i - begin >= s.surfaces[first, 5]:
            arms[i] = outline(second), math.inf
    return arms
