"""Where rigid polygons touch: the edge or corner at each contact point, and the distance from its end.

A row (a possible contact point, see `mbdkit.mechanism.contacts.ContactPair`) of a polygon has several features, each
with a smooth gap. For a corner of another polygon, the features are the edges of the polygon; for a circle, one edge
and
the corner before it. Circles and points touch the nearest feature. By the theorem of separating axes, two polygons can
touch only along the edge from which the other polygon is farthest, and along the edge of the other polygon that faces
it. A corner of one edge acts where it is opposite the other edge. When a corner slides past the end of an edge, the
corner of the other polygon therefore takes over, and the side of the polygon does not stop the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
    """One feature, as a contact of a smooth kind; see `ContactPair` for the arguments."""

    kind: tuple[str, int]
    bodies: tuple[int, int]
    numbers: tuple[float, ...]


class Chosen(NamedTuple):
    """The features at which the rows of a pair of shapes may touch.

    Attributes
    ----------
    features
        (R,) index of the feature of each row.
    acts
        (R,) whether the feature is opposite the other shape, so that they can touch there.
    distances
        (R,) gaps of the rows whose features do not act [m].
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
class _Outline:
    """A polygon of a body: its corners, and the outward normals, directions and lengths of the edges that start at
    them.

    Arrays are (n, 2), lengths (n,).
    """

    body: int
    corners: np.ndarray
    normals: np.ndarray
    along: np.ndarray
    lengths: np.ndarray

    @classmethod
    def of(cls, contact: ActingContact) -> _Outline:
        """Return the polygon of the first body of a row."""
        edges = _edges(contact.pair)
        corners, normals = edges[:, :2], edges[:, 2:]
        along = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
        lengths = np.sum((np.roll(corners, -1, axis=0) - corners) * along, axis=1)
        return cls(contact.bodies[0], corners, normals, along, lengths)

    def places(self, states: np.ndarray, body: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances of points (P, 2) of another body from the edges, and their positions along the edges,
        both (P, n).
        """
        seen = (_turned(states, body, points) + states[:2, body] - states[:2, self.body]) @ _turn(states, self.body)
        apart = seen[:, None, :] - self.corners
        return np.sum(apart * self.normals, axis=2), np.sum(apart * self.along, axis=2)


def _turn(states: np.ndarray, body: int) -> np.ndarray:
    c, s = states[2:4, body]
    return np.array([[c, -s], [s, c]])


def _turned(states: np.ndarray, body: int, vectors: np.ndarray) -> np.ndarray:
    """Return vectors (P, 2), given in the frame of a body, in the global frame."""
    return np.asarray(vectors @ _turn(states, body).T)


@dataclass(frozen=True)
class RoundAndPolygon:
    """A circle or point of one body, and a polygon. Each row has two features: an edge (0) and the corner before it
    (1).
    """

    rows: list[int]
    outline: _Outline
    body: int
    center: np.ndarray
    radius: float
    exact: float

    def chosen(self, states: np.ndarray) -> Chosen:
        """Return the features that may touch in states (7, B + 1) of all bodies; see `ContactKinematics`."""
        (heights,), (along,) = self.outline.places(states, self.body, self.center[None])
        lengths, count = self.outline.lengths, len(self.rows)
        distances = np.hypot(heights, along - np.clip(along, 0.0, lengths))
        features = np.zeros(count, dtype=int)
        if np.max(heights) <= 0.0:
            row = int(np.argmax(heights))
        else:
            row = int(np.argmin(distances))
            is_past = along[row] > lengths[row]
            is_at_corner = is_past or along[row] < 0.0
            row = (row + is_past) % count
            features[row] = is_at_corner
        return Chosen(features, np.arange(count) == row, distances - self.radius)

    def margin(self, states: np.ndarray, row: int, feature: int) -> float:
        """Return the distance of the contact of a row from the end of a feature [m]; negative beyond the end."""
        _, (along,) = self.outline.places(states, self.body, self.center[None])
        left = self.outline.lengths - along
        return float(min(-left[row - 1], -along[row]) if feature else min(along[row], left[row]))


@dataclass(frozen=True)
class TwoPolygons:
    """Two polygons. The rows are the corners of the second polygon, then those of the first; the features of a row are
    the edges of the other polygon.
    """

    rows: list[int]
    first: _Outline
    second: _Outline
    exact: float

    def chosen(self, states: np.ndarray) -> Chosen:
        """Return the features that may touch in states (7, B + 1) of all bodies; see `ContactKinematics`."""
        first, second = self.first, self.second
        over_first, along_first = first.places(states, second.body, second.corners)
        over_second, along_second = second.places(states, first.body, first.corners)
        facing = _turned(states, first.body, first.normals) @ _turned(states, second.body, second.normals).T
        apart = np.min(over_first, axis=0), np.min(over_second, axis=0)
        if np.max(apart[0]) >= np.max(apart[1]):
            own = int(np.argmax(apart[0]))
            other = int(np.argmin(facing[own]))
        else:
            other = int(np.argmax(apart[1]))
            own = int(np.argmin(facing[:, other]))
        acts = [self._opposite(along_first[:, own], first.lengths[own], other)]
        acts.append(self._opposite(along_second[:, other], second.lengths[other], own))
        features = np.repeat([own, other], [len(second.corners), len(first.corners)])
        distances = np.concatenate([np.max(over_first, axis=1), np.max(over_second, axis=1)])
        return Chosen(features, np.concatenate(acts), distances)

    def _opposite(self, along: np.ndarray, length: float, edge: int) -> np.ndarray:
        """Return which corners (P,) are ends of an edge and lie between the ends of the edge of the other polygon."""
        corners = np.arange(len(along))
        is_end = (corners == edge) | (corners == (edge + 1) % len(along))
        return is_end & (along >= -self.exact) & (along <= length + self.exact)

    def margin(self, states: np.ndarray, row: int, feature: int) -> float:
        """Return the distance of the contact of a row from the end of a feature [m]; negative beyond the end."""
        one, other, corner = self.first, self.second, row
        if row >= len(other.corners):
            one, other, corner = other, one, row - len(other.corners)
        _, along = one.places(states, other.body, other.corners[corner][None])
        return float(min(along[0, feature], one.lengths[feature] - along[0, feature]))


ShapePair = RoundAndPolygon | TwoPolygons
"""Two shapes, at least one of them a polygon, with the indices of their rows."""


def shape_pairs(contacts: Sequence[ActingContact], exact: float) -> list[ShapePair]:
    """Return the pairs of shapes that include a polygon; lengths below `exact` count as zero [m]."""
    found: list[ShapePair] = []
    rows = [i for i, one in enumerate(contacts) if one.pair.kind[0] in POLYGONS]
    for _, some in groupby(rows, lambda i: contacts[i].pair.name.rpartition(".")[0]):
        own = list(some)
        given = [contacts[i] for i in own]
        outline = _Outline.of(given[0])
        if given[0].pair.kind[0] == "edge":
            center, radius = given[0].pair.numbers[:2], given[0].pair.radius
            found.append(RoundAndPolygon(own, outline, given[0].bodies[1], np.array(center), radius, exact))
        else:
            found.append(TwoPolygons(own, outline, _Outline.of(given[-1]), exact))
    return found
