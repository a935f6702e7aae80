"""Plane geometry for pictures: convex hull, zigzag of a spring, and limits of the axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_COILS = 6
_MARGIN = 0.08  # on each side of a picture, as a share of its size
_FLAT = 1e-9  # corners that protrude by less than this share of the body's size are left out


def convex_hull(points: Array) -> list[int]:
    """Return the indices of the corners of the convex hull of `points` (K, 2), counterclockwise."""
    if (size := float(np.ptp(points, axis=0).max())) == 0.0:
        return [0]
    order = np.lexsort((points[:, 1], points[:, 0])).tolist()

    def half(sequence: list[int]) -> list[int]:
        corners: list[int] = []
        for index in sequence:
            while len(corners) >= 2:
                a, b = points[corners[-2]], points[corners[-1]]
                turn = (b[0] - a[0]) * (points[index, 1] - a[1]) - (b[1] - a[1]) * (points[index, 0] - a[0])
                if turn > _FLAT * size * size:
                    break
                corners.pop()
            corners.append(index)
        return corners[:-1]

    return half(order) + half(order[::-1])


def zigzag(start: Array, end: Array, width: float) -> Array:
    """Return the polyline of a spring between two points (..., 2), with `_COILS` coils of two corners each; shape (...,
    2 * _COILS + 4, 2). The amplitude `width` has the unit of the points, which is any unit of length.
    """
    along = end - start
    length = np.hypot(along[..., 0], along[..., 1])[..., None]
    unit = np.divide(along, length, out=np.zeros_like(along), where=length > 0)
    across = np.stack([-unit[..., 1], unit[..., 0]], axis=-1)
    share = np.concatenate([[0.0, 0.15], 0.15 + 0.7 * (np.arange(2 * _COILS) + 0.5) / (2 * _COILS), [0.85, 1.0]])
    side = np.concatenate([[0.0, 0.0], np.resize([1.0, -1.0], 2 * _COILS), [0.0, 0.0]]) * width
    corners: Array = start[..., None, :] + share[:, None] * along[..., None, :] + side[:, None] * across[..., None, :]
    return corners


def spiral(centre: Array, radius: float) -> Array:
    """Return the polyline (K, 2) of a spring between the angles of two bodies, within `radius` of its centre (2,)."""
    turn = np.linspace(0.0, 4.5 * np.pi, 40)
    away = radius * (0.16 + 0.84 * turn / turn[-1])
    return np.asarray(centre + away[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1))


def view_box(paths: Array, poses: Array) -> tuple[tuple[float, float], tuple[float, float], bool]:
    """Return the x limits and y limits [m] of a picture, and whether points lie outside them.

    The limits contain all finite points, unless the motion diverges. It diverges if it extends more than 300 times
    farther from its start than in its first tenth. The limits then contain only points that are at most three times as
    far from the start as those of that tenth and of the first pose: a motion from rest begins slowly, too.

    Parameters
    ----------
    paths
        Points [m] over time, shape (R, K, 2).
    poses
        Other points [m] to contain, of one pose or of several, shape (..., P, 2).
    """
    points = np.concatenate([paths.reshape(-1, 2), poses.reshape(-1, 2)])
    points = points[np.all(np.isfinite(points), axis=1)]
    if not len(points):
        return (-1.0, 1.0), (-1.0, 1.0), False
    first = poses.reshape(-1, *poses.shape[-2:])[0] - points[0]
    extent = float(np.max(np.abs(first), initial=0.0, where=np.isfinite(first)))
    inside = np.max(np.abs(points - points[0]), axis=1) <= _reach_before_divergence(paths - points[0], extent)
    low, high = points[inside].min(axis=0), points[inside].max(axis=0)
    size = float(np.max(high - low)) or 1.0
    lack = np.maximum(0.25 * size - (high - low), 0.0) / 2  # prevents the axes from collapsing for a straight path
    low, high = low - lack - _MARGIN * size, high + lack + _MARGIN * size
    return (float(low[0]), float(high[0])), (float(low[1]), float(high[1])), not bool(np.all(inside))


def _reach_before_divergence(paths: Array, size: float) -> float:
    """Return the largest distance from the start to show [m], at least three times the `size` of the mechanism there;
    infinite unless the motion diverges.
    """
    far = np.max(np.abs(paths), axis=(1, 2), initial=0.0)
    far = np.where(np.isfinite(far), far, np.inf)
    rows, reach = len(far), np.inf
    while rows >= 100:
        before = max(size, float(np.max(far[: rows // 10])))
        if float(np.max(far[:rows])) > 300.0 * before > 0.0:
            reach = 3.0 * before
        rows //= 10
    return reach
