"""Places names in a drawing so that, as far as there is room, they do not overlap each other or the lines of the
drawing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit_report.figures.plane_geometry import Array

CHARACTER, LINE = 7.3, 15.0  #: Mean width of a character and height of a line at a font size of 12 px [px].
SWATCH = 14.0  #: Width reserved for a patch of colour in front of a name [px].
_DIRECTIONS = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
_DISTANCES = np.array([7.0, 13.0, 21.0, 32.0, 46.0, 64.0, 84.0])
_OUTSIDE, _ON_NAME, _ON_LINE = 1e6, 1e4, 12.0
LEADER = 24.0  #: A name and its point are connected by a line if their distance is larger than this [px].


@dataclass(frozen=True)
class Name:
    """A name to place beside any of several `points` (K, 2) [px], of an element of this `kind`: ``body``, ``joint``,
    ``force``, ``load`` or ``marker``. `color` is the name of the colour of a patch in front of the name, see
    `mbdkit_report.figures.palette.color_key`; empty for no patch.
    """

    text: str
    kind: str
    points: Array
    color: str = ""

    @property
    def width(self) -> float:
        """Approximate width [px]."""
        return CHARACTER * len(self.text) + 4.0 + (SWATCH if self.color else 0.0)


@dataclass(frozen=True)
class PlacedName:
    """A name, the left and upper edge of its box, and the point that it names [px]."""

    name: Name
    left: float
    top: float
    point: tuple[float, float]

    @property
    def leader(self) -> tuple[float, float] | None:
        """The end of a line from the point to the name, which is the nearest point of the box; None if they are
        close.
        """
        x = float(np.clip(self.point[0], self.left, self.left + self.name.width))
        y = float(np.clip(self.point[1], self.top, self.top + LINE))
        return (x, y) if np.hypot(x - self.point[0], y - self.point[1]) > LEADER else None


def place_names(names: Sequence[Name], ink: Array, width: float, height: float) -> list[PlacedName]:
    """Place names one after the other, each at the best remaining place.

    Parameters
    ----------
    ink
        (N, 2) points on the lines of the drawing, a few pixels apart [px].
    width, height
        Size of the drawing [px].
    """
    taken = np.empty((0, 4))
    results = []
    for name in names:
        boxes, points, cost = _candidates(name)
        outside = np.maximum(0.0, 2.0 - boxes[:, :2]).sum(axis=1)
        outside += np.maximum(0.0, boxes[:, 2:] - (width - 2.0, height - 2.0)).sum(axis=1)
        cost += _OUTSIDE * outside + _ON_NAME * _overlaps(boxes, taken) + _ON_LINE * _points_inside(boxes, ink)
        best = int(np.argmin(cost))
        taken = np.vstack([taken, boxes[best]])
        left, top = boxes[best, :2].tolist()
        results.append(PlacedName(name, left, top, (float(points[best, 0]), float(points[best, 1]))))
    return results


def _candidates(name: Name) -> tuple[Array, Array, Array]:
    """Return candidates for the place of a name: boxes (C, 4) of left, top, right and bottom, with their points and
    costs.
    """
    half = np.array([name.width / 2, LINE / 2])
    direction = np.stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)], axis=-1)
    reach = direction[None] * _DISTANCES[:, None, None]
    centre = name.points[:, None, None] + reach + direction * half  # (K, distances, directions, 2)
    boxes = np.concatenate([centre - half, centre + half], axis=-1).reshape(-1, 4)
    points = np.broadcast_to(name.points[:, None, None], centre.shape).reshape(-1, 2)
    return boxes, points, np.broadcast_to(_DISTANCES[None, :, None], centre.shape[:-1]).reshape(-1).copy()


def _overlaps(boxes: Array, values: Array) -> Array:
    apart = (boxes[:, None, :2] >= values[None, :, 2:]) | (boxes[:, None, 2:] <= values[None, :, :2])
    return np.asarray(np.sum(~np.any(apart, axis=-1), axis=1), dtype=float)


def _points_inside(boxes: Array, ink: Array) -> Array:
    inside = np.all((ink[None] > boxes[:, None, :2]) & (ink[None] < boxes[:, None, 2:]), axis=-1)
    return np.asarray(np.sum(inside, axis=1), dtype=float)
