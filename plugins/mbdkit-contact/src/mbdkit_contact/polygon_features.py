"""Where rigid polygons touch: the edge or corner at each contact point, and the distance from its end.

A row (a possible contact point, see `mbdkit.mechanism.contacts.ContactPair`) of a polygon has several features, each
with a smooth gap. For a corner of another polygon, the features are the edges of the polygon; for a circle, one edge
and the corner before it. Circles and points touch the nearest feature. By the theorem of separating axes, two polygons
can touch only along the edge from which the other polygon is farthest, and along the edge of the other polygon that
faces it. A corner of one edge acts where it is opposite the other edge. When a corner slides past the end of an edge,
the corner of the other polygon therefore takes over, and the side of the polygon does not stop the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import NamedTuple

import numpy as np

from mbdkit.engine.contact_forces import ActingContact
from mbdkit.mechanism.contacts import ContactPair

EXACT = 1e-9
"""Distance, relative to the length of the mechanism, up to which a corner beyond the end of an edge still acts; closed
contacts remain closed up to twice this distance.
"""

POLYGONS = ("inside", "edge")
"""Kinds of geometry that have several features."""


class Feature(NamedTuple):
    """One feature, as a contact of a smooth kind; see `ContactPair` for the attributes."""

    kind: tuple[str, int]
    bodies: tuple[int, int]
    numbers: tuple[float, ...]


class Chosen(NamedTuple):
    """The features at which k pairs of shapes, with R rows each, may touch.

    Attributes
    ----------
    features
        (k, R) index of the feature of each row.
    acts
        (k, R) whether the feature is opposite the other shape, so that they can touch there.
    distances
        (k, R) gaps of the rows whose features do not act [m].
    """

    features: np.ndarray
    acts: np.ndarray
    distances: np.ndarray


def features_of(contact: ActingContact) -> list[Feature]:
    """Return the features of a row; only one if the row does not belong to a polygon."""
    pair = contact.pair
    if pair.kind[0] not in POLYGONS:
        return [Feature(pair.kind, contact.bodies, pair.numbers)]
    own, edges = pair.numbers[:3], _edges(pair)
    if pair.kind[0] == "inside":
        return [Feature(("line", 0), contact.bodies, (*own, *edge)) for edge in edges.tolist()]
    corner = pair.numbers[5:7]
    after = next(edge for edge in edges.tolist() if tuple(edge[:2]) == corner)
    at_corner = Feature(("circles", 0), contact.bodies, (*own, *corner, 0.0))
    return [Feature(("line", 0), contact.bodies, (*own, *after)), at_corner]


def _edges(pair: ContactPair) -> np.ndarray:
    """Return x and y of a point and of the normal of each edge (n, 4), for the polygon of a row."""
    return np.reshape(pair.numbers[-4 * pair.kind[1] :], (-1, 4))


@dataclass(frozen=True)
class _Outlines:
    """K polygons of n corners.

    Their bodies (K,), their corners, the outward normals and directions of the edges that start at these (K, n, 2), and
    the lengths of the edges (K, n).
    """

    bodies: np.ndarray
    corners: np.ndarray
    normals: np.ndarray
    along: np.ndarray
    lengths: np.ndarray

    @classmethod
    def of(cls, contacts: Sequence[ActingContact]) -> _Outlines:
        """Return the polygons of the first bodies of rows."""
        edges = np.stack([_edges(one.pair) for one in contacts])
        corners, normals = edges[:, :, :2], edges[:, :, 2:]
        along = np.stack([-normals[..., 1], normals[..., 0]], axis=2)
        lengths = np.sum((np.roll(corners, -1, axis=1) - corners) * along, axis=2)
        return cls(np.array([one.bodies[0] for one in contacts]), corners, normals, along, lengths)

    def places(self, which: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances of points (k, P, 2), in the frames of the polygons with the indices `which` (k,), from
        the edges, and their positions along the edges, both (k, P, n).
        """
        apart = points[:, :, None] - self.corners[which, None]
        heights = (apart * self.normals[which, None]).sum(axis=3)
        return heights, (apart * self.along[which, None]).sum(axis=3)

    @cached_property
    def around(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres (K, 2) and radii (K,) of circles around the polygons."""
        centers = np.mean(self.corners, axis=1)
        return centers, np.max(np.linalg.norm(self.corners - centers[:, None], axis=2), axis=1)


class _Seen(NamedTuple):
    """Frames of k bodies relative to frames of k others: transposed rotations (k, 2, 2), and origins (k, 1, 2)."""

    turns: np.ndarray
    origins: np.ndarray

    @classmethod
    def of(cls, states: np.ndarray, bodies: np.ndarray, frames: np.ndarray) -> _Seen:
        """Return the frames of bodies (k,) in those of others (k,), in states (7, B + 1) of all bodies."""
        (x, y, c, s), (at_x, at_y, own_c, own_s) = states[:4, bodies], states[:4, frames]
        dx, dy, cos, sin = x - at_x, y - at_y, c * own_c + s * own_s, s * own_c - c * own_s
        origins = np.array([[own_c * dx + own_s * dy, own_c * dy - own_s * dx]])
        return cls(np.array([[cos, sin], [-sin, cos]]).transpose(2, 0, 1), origins.transpose(2, 0, 1))

    def points(self, points: np.ndarray) -> np.ndarray:
        """Return points (k, P, 2) of the bodies in the other frames."""
        return np.asarray(points @ self.turns + self.origins)


def _distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    return np.asarray(np.hypot(*(points - others).T))


@dataclass(frozen=True)
class RoundsAndPolygons:
    """K pairs of a circle or point and a polygon of n corners. Each of the rows (K, n) has two features: an edge (0)
    and the corner before it (1).
    """

    rows: np.ndarray
    outlines: _Outlines
    bodies: np.ndarray
    centers: np.ndarray
    radii: np.ndarray

    @classmethod
    def of(cls, pairs: Sequence[Sequence[int]], contacts: Sequence[ActingContact]) -> RoundsAndPolygons:
        """Return pairs that are given by the indices of their rows."""
        some = [contacts[own[0]] for own in pairs]
        bodies, centers = np.array([one.bodies[1] for one in some]), np.array([one.pair.numbers[:2] for one in some])
        radii = np.array([one.pair.radius for one in some])
        return cls(np.array(pairs), _Outlines.of(some), bodies, centers, radii)

    def chosen(self, states: np.ndarray, which: np.ndarray) -> Chosen:
        """Return the features that may touch, of the pairs with the indices `which` (k,), in states (7, B + 1) of all
        bodies; see `ContactKinematics`.
        """
        heights, along = self._places(states, which)
        lengths, count, every = self.outlines.lengths[which], self.rows.shape[1], np.arange(len(which))
        distances = np.hypot(heights, along - np.clip(along, 0.0, lengths))
        is_inside = np.max(heights, axis=1) <= 0.0
        nearest = np.argmin(distances, axis=1)
        place, length = along[every, nearest], lengths[every, nearest]
        is_at_corner = ~is_inside & ((place > length) | (place < 0.0))
        row = np.where(is_inside, np.argmax(heights, axis=1), (nearest + (place > length)) % count)
        features = np.zeros((len(which), count), dtype=int)
        features[every, row] = is_at_corner
        return Chosen(features, np.arange(count) == row[:, None], distances - self.radii[which, None])

    def _places(self, states: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen = _Seen.of(states, self.bodies[which], self.outlines.bodies[which])
        heights, along = self.outlines.places(which, seen.points(self.centers[which, None]))
        return heights[:, 0], along[:, 0]

    def bounds(self, states: np.ndarray) -> np.ndarray:
        """Return lower bounds (K,) of the distances between the shapes."""
        centers, radii = self.outlines.around
        seen = _Seen.of(states, self.bodies, self.outlines.bodies)
        return _distances(seen.points(self.centers[:, None])[:, 0], centers) - radii - self.radii

    def margin(self, states: np.ndarray, pair: int, row: int, feature: int) -> float:
        """Return the distance [m] of contact `row` of a pair from the nearer end of its feature; negative beyond it."""
        which = np.array([pair])
        along = self._places(states, which)[1][0]
        left = self.outlines.lengths[pair] - along
        return float(min(-left[row - 1], -along[row]) if feature else min(along[row], left[row]))


@dataclass(frozen=True)
class TwoPolygons:
    """K pairs of a polygon of n corners and one of m. The rows (K, m + n) are the corners of the second polygon, then
    those of the first; the features of a row are the edges of the other polygon.
    """

    rows: np.ndarray
    first: _Outlines
    second: _Outlines
    exact: float

    @classmethod
    def of(cls, pairs: Sequence[Sequence[int]], contacts: Sequence[ActingContact], exact: float) -> TwoPolygons:
        """Return pairs that are given by the indices of their rows."""
        first, second = (_Outlines.of([contacts[own[place]] for own in pairs]) for place in (0, -1))
        return cls(np.array(pairs), first, second, exact)

    def chosen(self, states: np.ndarray, which: np.ndarray) -> Chosen:
        """Return the features that may touch, of the pairs with the indices `which` (k,), in states (7, B + 1) of all
        bodies; see `ContactKinematics`.
        """
        first, second, every = self.first, self.second, np.arange(len(which))
        of_second = _Seen.of(states, second.bodies[which], first.bodies[which])
        of_first = _Seen.of(states, first.bodies[which], second.bodies[which])
        over_first, along_first = first.places(which, of_second.points(second.corners[which]))
        over_second, along_second = second.places(which, of_first.points(first.corners[which]))
        facing = first.normals[which] @ (second.normals[which] @ of_second.turns).transpose(0, 2, 1)
        apart = over_first.min(axis=1), over_second.min(axis=1)
        is_of_first = apart[0].max(axis=1) >= apart[1].max(axis=1)
        own, other = apart[0].argmax(axis=1), apart[1].argmax(axis=1)
        own, other = (
            np.where(is_of_first, own, facing[every, :, other].argmin(axis=1)),
            np.where(is_of_first, facing[every, own].argmin(axis=1), other),
        )
        acts = (
            self._opposite(along_first[every, :, own], first.lengths[which, own], other),
            self._opposite(along_second[every, :, other], second.lengths[which, other], own),
        )
        counts = over_first.shape[1], over_second.shape[1]
        features = np.repeat([own, other], counts, axis=0).T
        distances = np.concatenate([over_first.max(axis=2), over_second.max(axis=2)], axis=1)
        return Chosen(features, np.concatenate(acts, axis=1), distances)

    def _opposite(self, along: np.ndarray, lengths: np.ndarray, edges: np.ndarray) -> np.ndarray:
        """Return which corners (k, P) are ends of edges (k,) and lie between the ends of the other polygons' edges."""
        corners = np.arange(along.shape[1])
        is_end = (corners == edges[:, None]) | (corners == (edges[:, None] + 1) % along.shape[1])
        return np.asarray(is_end & (along >= -self.exact) & (along <= lengths[:, None] + self.exact))

    def bounds(self, states: np.ndarray) -> np.ndarray:
        """Return lower bounds (K,) of the distances between the shapes."""
        (first, radii), (second, others) = self.first.around, self.second.around
        seen = _Seen.of(states, self.second.bodies, self.first.bodies)
        return _distances(seen.points(second[:, None])[:, 0], first) - radii - others

    def margin(self, states: np.ndarray, pair: int, row: int, feature: int) -> float:
        """Return the distance [m] of contact `row` of a pair from the nearer end of its feature; negative beyond it."""
        one, other, corner, which = self.first, self.second, row, np.array([pair])
        if row >= other.corners.shape[1]:
            one, other, corner = other, one, row - other.corners.shape[1]
        seen = _Seen.of(states, other.bodies[which], one.bodies[which])
        _, along = one.places(which, seen.points(other.corners[which, corner][:, None]))
        place = along[0, 0, feature]
        return float(min(place, one.lengths[pair, feature] - place))


ShapePairs = RoundsAndPolygons | TwoPolygons
"""Pairs of shapes, at least one of them a polygon, with the indices of their rows."""


def shape_pairs(contacts: Sequence[ActingContact], exact: float) -> list[ShapePairs]:
    """Return the pairs of shapes that include a polygon; pairs with equal numbers of corners are in one object.

    A corner still acts up to a distance `exact` [m] beyond the end of an edge.
    """
    alike: dict[tuple[str, int, int], list[list[int]]] = {}
    polygons = [i for i, one in enumerate(contacts) if one.pair.kind[0] in POLYGONS]
    for _, some in groupby(polygons, lambda i: contacts[i].pair.name.rpartition(".")[0]):
        own = list(some)
        alike.setdefault((*contacts[own[0]].pair.kind, len(own)), []).append(own)
    return [
        RoundsAndPolygons.of(pairs, contacts) if kind == "edge" else TwoPolygons.of(pairs, contacts, exact)
        for (kind, *_), pairs in alike.items()
    ]
