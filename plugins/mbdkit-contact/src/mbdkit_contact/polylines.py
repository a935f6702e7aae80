"""Uneven outlines of contacts: polylines with the material below them, and their division into convex pieces.

A *piece* is a longest part of a polyline with convex corners only. A circle or point touches a piece at one place at
most, and several pieces at once only if they are near each other. Pieces of the same *color* are so far from each other
that a circle or point cannot touch two of them; a contact therefore has one row for each color instead of one for each
piece. In the same way, convex corners of the same color are too far from each other to touch the same polygon.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError

Pair = tuple[float, float]

STRAIGHT = 1e-12  #: Sine of the angle up to which two segments in succession count as one.

#: Place at which the first segment begins and the last one ends [m]: they continue straight on.
ENDLESS = 1e300

#: How many numbers describe a segment: start (x, y), normal (x, y) out of the material, lowest and highest place along
#: the segment, depth of the material that belongs to it, color of its piece, turn of the corner at its start (1 convex,
#: -1 concave, 0 for the first segment), and color of this corner if it is convex, otherwise -1.
SEGMENT = 10


def check_polyline(points: Sequence[Pair]) -> None:
    """Raise SpecError unless points form a polyline along +x that does not turn back."""
    if len(points) < 2:
        raise SpecError(f"a polyline has at least two points, not {len(points)}")
    for i, ((ax, ay), (bx, by)) in enumerate(pairwise(points), 1):
        if (ax, ay) == (bx, by):
            raise SpecError("repeats the point before it", key=f"[{i}]")
        if bx < ax:
            raise SpecError(
                f"x decreases from {ax:g} to {bx:g} m; order the points from left to right, with the material below",
                key=f"[{i}]",
            )
    for i, (a, b, c) in enumerate(zip(points, points[1:], points[2:], strict=False), 1):
        if a[0] == b[0] == c[0] and (b[1] - a[1]) * (c[1] - b[1]) < 0.0:
            raise SpecError("the polyline turns back here along a vertical line", key=f"[{i}]")


class Surface(NamedTuple):
    """A polyline as a surface for circles and points, or for polygons.

    Attributes
    ----------
    segments
        The `SEGMENT` numbers of each segment, one after another. Places are distances from the start of a segment.
    segment_count
        Number of segments.
    colors, corner_colors
        Numbers of colors of the pieces and of the convex corners.
    """

    segments: tuple[float, ...]
    segment_count: int
    colors: int
    corner_colors: int


@lru_cache(maxsize=64)
def surface_of(points: tuple[Pair, ...], diameter: float, size: float) -> Surface:
    """Return the surface of a polyline.

    Parameters
    ----------
    diameter
        Diameter of the circles that touch it [m], 0 for points.
    size
        Diameter of the polygons that its corners touch [m].
    """
    corners = np.array(_without_straight_corners(points), dtype=float)
    along = np.diff(corners, axis=0)
    length = elementary.hypot(along[:, 0], along[:, 1])
    along /= length[:, None]
    turn = np.zeros(len(along))
    turn[1:] = np.where(along[:-1, 0] * along[1:, 1] - along[:-1, 1] * along[1:, 0] < 0.0, 1.0, -1.0)
    low, high = np.zeros(len(along)), length.copy()
    low[0], high[-1] = -ENDLESS, ENDLESS
    piece = np.cumsum(turn < 0.0)
    begins = corners[np.searchsorted(piece, np.arange(1, piece[-1] + 1)), 0]  # of all pieces but the first
    colors = np.array(_colors(np.append(-math.inf, begins), np.append(begins, math.inf), diameter))
    convex = np.flatnonzero(turn > 0.0)
    corner_color = np.full(len(along), -1)
    corner_color[convex] = _colors(corners[convex, 0], corners[convex, 0], size)
    depth = _depths(corners, along, low, high, piece)
    own = (corners[:-1], -along[:, 1], along[:, 0], low, high, depth, colors[piece], turn, corner_color)
    numbers = tuple(np.column_stack(own).ravel().tolist())
    return Surface(numbers, len(along), int(np.max(colors)) + 1, int(np.max(corner_color, initial=-1)) + 1)


@lru_cache(maxsize=64)
def reaching_segments(numbers: tuple[float, ...]) -> tuple[float, ...]:
    """Return the `SEGMENT` numbers of segments that reach into the material at concave corners.

    A point that has slightly penetrated both segments at the corner then still touches both. A segment ends half way to
    the place where it would leave the material.
    """
    segments = np.array(numbers).reshape(-1, SEGMENT)
    along, turn = np.column_stack([segments[:, 3], -segments[:, 2]]), segments[:, 8]
    size = float(np.max(np.ptp(segments[:, :2], axis=0))) or 1.0
    corners = np.append(segments[:, :2], segments[-1:, :2] + size * along[-1:], axis=0)
    far, tiny = _with_far_ends(corners)
    for j in np.flatnonzero(turn < 0.0):
        segments[j, 4] -= 0.5 * _way_out(far, corners[j], -along[j], tiny)
        segments[j - 1, 5] += 0.5 * _way_out(far, corners[j], along[j - 1], tiny)
    segments[:, 6] = _depths(corners, along, segments[:, 4], segments[:, 5], np.cumsum(turn < 0.0))
    return tuple(segments.ravel().tolist())


def _depths(corners: np.ndarray, along: np.ndarray, low: np.ndarray, high: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """Return the depth below each segment that belongs to it: half of the distance to other parts of the polyline
    behind it [m]. Of the neighbouring pieces, these are only segments at which material ends.
    """
    far, tiny = _with_far_ends(corners)
    depths = np.empty(len(along))
    for j in range(len(along)):
        ends = np.sum(along * along[j], axis=1) < 0.0
        counts = (np.abs(piece - piece[j]) > 1) | ((piece != piece[j]) & ends)
        depths[j] = 0.5 * _thickness(_ahead(far, corners[j], along[j]), counts, low[j], high[j], tiny)
    return depths


def _without_straight_corners(points: Sequence[Pair]) -> list[Pair]:
    kept = list(points[:1])
    for b, c in pairwise(points[1:]):
        (ax, ay), (bx, by), (cx, cy) = kept[-1], b, c
        across = (bx - ax) * (cy - by) - (by - ay) * (cx - bx)
        if abs(across) > STRAIGHT * elementary.hypot(bx - ax, by - ay) * elementary.hypot(cx - bx, cy - by):
            kept.append(b)
    return [*kept, points[-1]]


def _colors(lefts: np.ndarray, rights: np.ndarray, reach: float) -> list[int]:
    """Return the colors of intervals that begin in increasing order; those of the same color are more than `reach`
    apart.
    """
    ends, colors = list[float](), list[int]()  # ends: the last end of an interval of each color
    for left, right in zip(lefts.tolist(), rights.tolist(), strict=True):
        color = next((k for k, end in enumerate(ends) if left - end > reach), len(ends))
        ends[color:] = [right, *ends[color + 1 :]]
        colors.append(color)
    return colors


def _ahead(corners: np.ndarray, values: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return the corners (x, y) in a frame at a place, with the axis x in the direction `along`."""
    x, y = (corners - values).T
    return np.column_stack([x * along[0] + y * along[1], y * along[0] - x * along[1]])


def _way_out(corners: np.ndarray, values: np.ndarray, along: np.ndarray, tiny: float) -> float:
    """Return how far a ray that begins at a corner goes through the material before it leaves it [m]."""
    seen = _ahead(corners, values, along)
    (ax, ay), (bx, by) = seen[:-1].T, seen[1:].T
    with np.errstate(divide="ignore", invalid="ignore"):
        at = ax - ay * (bx - ax) / (by - ay)
    return float(np.min(at[(ay * by <= 0.0) & (ay != by) & (at > tiny)], initial=ENDLESS))


def _thickness(seen: np.ndarray, counts: np.ndarray, low: float, high: float, tiny: float) -> float:
    """Return the least distance between a segment and other segments behind it that count [m].

    `seen` are the corners of the polyline in the frame of the segment, which has the places from `low` to `high`.
    """
    (ax, ay), (bx, by) = (part[counts].T for part in (seen[:-1], seen[1:]))
    low, high = np.maximum(np.minimum(ax, bx), low), np.minimum(np.maximum(ax, bx), high)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(ax == bx, 0.0, (by - ay) / (bx - ax))
    heights = np.concatenate([ay + slope * (low - ax), ay + slope * (high - ax), np.where(ax == bx, by, -ENDLESS)])
    return -float(np.max(heights[np.tile(low <= high, 3) & (heights < -tiny)], initial=-ENDLESS))


def _with_far_ends(corners: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the corners with both ends moved outwards by a hundred times the size of the polyline, and a length that
    counts as zero.
    """
    far = corners.copy()
    size = float(np.max(np.ptp(corners, axis=0)))
    for end, inner in ((0, 1), (-1, -2)):
        direction = corners[end] - corners[inner]
        far[end] += 100.0 * size * direction / elementary.hypot(*direction)
    return far, 1e-9 * size
