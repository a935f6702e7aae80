"""Own geometry of outlines in the plane, by which tests measure how far bodies overlap."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Outline:
    """A circle, a convex polygon (counterclockwise), or a polyline with the material below it.

    Attributes
    ----------
    kind
        ``circle``, ``polygon`` or ``polyline``.
    points
        (K, 2) its points in the frame of its body; the center of a circle.
    radius
        Radius of a circle [m].
    """

    kind: str
    points: np.ndarray
    radius: float = 0.0

    def shape(self) -> dict[str, Any]:
        """Return the shape as in specs."""
        if self.kind == "circle":
            return {"circle": {"center": self.points[0].tolist(), "radius": self.radius}}
        return {self.kind: self.points.tolist()}

    def moved(self, place: np.ndarray) -> np.ndarray:
        """Return the points (T, K, 2) at positions (T, 3): x, y and angle."""
        c, s = np.cos(place[:, 2]), np.sin(place[:, 2])
        turn = np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)
        return np.einsum("tij,kj->tki", turn, self.points) + place[:, None, :2]


def _sides(points: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for k in range(points.shape[1]):
        yield points[:, k], points[:, (k + 1) % points.shape[1]]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _distance(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the distances (T,) of points from segments."""
    along = b - a
    share = np.clip(np.sum((p - a) * along, axis=1) / np.sum(along * along, axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(p - a - share[:, None] * along, axis=1))


def _in_polygon(p: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Return the depths (T,) of points in polygons (T, K, 2), or minus their distances."""
    heights = [_cross(p - a, b - a) / np.linalg.norm(b - a, axis=1) for a, b in _sides(polygon)]
    apart = np.min([_distance(p, a, b) for a, b in _sides(polygon)], axis=0)
    highest = np.max(heights, axis=0)
    return np.where(highest <= 0.0, -highest, -apart)


def _of_polygons(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the depths (T,) of the overlaps of polygons by the theorem of separating axes, or minus a distance."""
    apart = [
        np.min(_cross(other - start[:, None], (end - start)[:, None]), axis=1) / np.linalg.norm(end - start, axis=1)
        for one, other in ((a, b), (b, a))
        for start, end in _sides(one)
    ]
    return -np.max(apart, axis=0)


def _below(p: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return the depths (T,) of points below a polyline (K, 2) that does not move, or minus their distances."""
    x = np.clip(p[:, 0], line[0, 0], line[-1, 0])
    k = np.clip(np.searchsorted(line[:, 0], x, side="right") - 1, 0, len(line) - 2)
    (ax, ay), (bx, by) = line[k].T, line[k + 1].T
    with np.errstate(divide="ignore", invalid="ignore"):
        height = p[:, 1] - np.where(ax == bx, ay, ay + (by - ay) * (x - ax) / (bx - ax))
    apart = np.min([_distance(p, a[None], b[None]) for a, b in pairwise(line)], axis=0)
    return np.where(height < 0.0, apart, -apart)


def overlap(first: Outline, at: np.ndarray, second: Outline, then: np.ndarray) -> np.ndarray:
    """Return the depths (T,) of the overlaps of two outlines at positions (T, 3) of their bodies; not positive where
    they are apart. A polyline belongs to the ground, and the first outline is no less a polygon than the second.
    """
    a, b = first.moved(at), second.moved(then)
    if first.kind == "circle":
        return first.radius + second.radius - np.asarray(np.linalg.norm(a[:, 0] - b[:, 0], axis=1))
    if second.kind == "circle":
        inside = _below(b[:, 0], first.points) if first.kind == "polyline" else _in_polygon(b[:, 0], a)
        return second.radius + inside
    if first.kind == "polygon":
        return _of_polygons(a, b)
    corners = [_below(b[:, k], first.points) for k in range(b.shape[1])]
    corners += [_in_polygon(np.broadcast_to(p, (len(b), 2)), b) for p in first.points[1:-1]]
    return np.asarray(np.max(corners, axis=0))
