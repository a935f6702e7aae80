"""Choice of the rows to remove from a redundant mechanism, such that the others stay independent during the motion.

A set of rows can be removed if the self-stresses, restricted to these rows, form an invertible matrix. Often only one
direction in the plane of the two rows of a pair, x and y, is redundant, and this direction rotates with a body. For
example, the redundant direction of a rod between two pins is the axis of the rod. Therefore a direction that is fixed
in the frame of a body is removed, not a row.
"""

from __future__ import annotations

import math

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.frozen import dataclass
from mbdkit.engine.kernels.table_rows import PAIR

#: A row may be removed only if, at every position, the component of its pair in the self-stresses is at least this,
#: relative to the largest component. If no pair satisfies this, the one that comes closest is used.
WELL_HELD = 0.1

SAME_FRAME = 1e-6  #: Deviation (1 - cosine) below which a direction counts as fixed in the frame of a body.


@dataclass(frozen=True)
class Spare:
    """A redundant direction: its pair, and a unit vector in the plane of the pair's rows, in the frame of a body."""

    pair: int
    frame: int
    axis: tuple[float, float]


def choose_spare(
    stresses: list[np.ndarray], pair: np.ndarray, place: np.ndarray, last_resort: np.ndarray
) -> list[tuple[int, np.ndarray]]:
    """Choose the rows to remove. Rows that come later in the mechanism are preferred.

    `stresses`: (m, r) orthonormal self-stresses at each of K positions. `pair`, `place`: (m,) pair of each row and its
    index in the pair, in the order of the joints. `last_resort`: (m,) whether a row may be removed only if no other row
    is suitable. Returns for each of the r redundant directions: its pair, and the direction (K, 2) in the plane of the
    pair's rows at each position. A pair of two rows can occur twice.
    """
    pairs, unit = np.unique(pair, return_inverse=True)
    rows = np.full((len(pairs), 2), len(pair))  # index of a row of zeros that is appended below
    rows[unit, place] = np.arange(len(pair))
    late = np.where(rows < len(pair), rows, -1).max(axis=1)
    order = np.lexsort((-late, last_resort[late]))
    left = [np.vstack([x, np.zeros(x.shape[1])])[rows] for x in stresses]
    chosen: list[tuple[int, np.ndarray]] = []
    while len(chosen) < stresses[0].shape[1]:
        sizes = [_largest_part(x) for x in left]
        held = np.min([size / np.max(size) for size in sizes], axis=0)
        best = order[np.argmax(held[order] >= min(WELL_HELD, float(np.max(held))))]
        directions = []
        for k, x in enumerate(left):
            direction = _leading_axis(x[best])
            taken = direction[0] * x[best, 0] + direction[1] * x[best, 1]
            taken /= np.sqrt(np.sum(taken**2))
            left[k] = x - np.sum(x * taken, axis=-1, keepdims=True) * taken
            directions.append(direction)
        chosen.append((int(pairs[best]), np.array(directions)))
    return chosen


def _largest_part(x: np.ndarray) -> np.ndarray:
    a, b, c = _products(x[:, 0], x[:, 1])
    return np.asarray(np.sqrt((a + c) / 2 + np.sqrt(((a - c) / 2) ** 2 + b**2)))


def _products(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.sum(x * x, axis=-1), np.sum(x * y, axis=-1), np.sum(y * y, axis=-1)


def _leading_axis(x: np.ndarray) -> np.ndarray:
    """Return the unit vector (2,) whose product with a matrix (2, r) is largest; its first component is not negative.

    It is the leading eigenvector of ``[[a, b], [b, c]] = x x^T``, from the formulas for half an angle.
    """
    a, b, c = map(float, _products(x[0], x[1]))
    half = (a - c) / 2
    radius = math.sqrt(half * half + b * b)
    if radius == 0.0:
        return np.array([1.0, 0.0])
    larger = math.sqrt((1.0 + abs(half) / radius) / 2)
    smaller = b / (2 * radius * larger)
    if half >= 0.0:
        return np.array([larger, smaller])
    return np.array([abs(smaller), math.copysign(larger, b)])


def direction_frames(
    chosen: list[tuple[int, np.ndarray]], rows: np.ndarray, pairs: np.ndarray, angles: np.ndarray
) -> list[Spare]:
    """Find the frame in which each redundant direction is fixed.

    `chosen`: result of `choose_spare`. `rows`: (P,) number of rows of each pair. `pairs`: (P, 4) for each pair its
    kind, first body, second body and motion. `angles`: (K, B + 1) angle of each body at each position, ground last
    [rad].
    """
    ground = angles.shape[1] - 1
    spare: list[Spare] = []
    times = np.bincount([pair for pair, _ in chosen], minlength=len(rows))
    for pair, directions in chosen:
        if times[pair] == rows[pair]:  # the whole pair is redundant, so any basis is suitable
            second = any(direction.pair == pair for direction in spare)
            spare.append(Spare(pair, ground, (0.0, 1.0) if second else (1.0, 0.0)))
            continue
        near = [int(pairs[pair, PAIR.first]), int(pairs[pair, PAIR.second]), ground]
        fits = [_in_frame(directions, angles[:, body]) for body in near]
        if min(fit[0] for fit in fits) > SAME_FRAME:
            near = list(range(ground + 1))
            fits = [_in_frame(directions, angles[:, body]) for body in near]
        least = min(fit[0] for fit in fits)
        at = next(i for i, fit in enumerate(fits) if fit[0] <= 2 * least + 1e-12)
        spare.append(Spare(pair, near[at], fits[at][1]))
    return spare


def _in_frame(directions: np.ndarray, angle: np.ndarray) -> tuple[float, tuple[float, float]]:
    """Fit a direction that is fixed in a frame with angles `angle` (K,) to directions (K, 2).

    Returns the largest deviation (1 - cosine), and the fitted direction in this frame.
    """
    c, s = elementary.cos(angle), elementary.sin(angle)
    x, y = directions.T
    own = np.stack([c * x + s * y, -s * x + c * y])
    axis = _leading_axis(own)
    along = own[0] * axis[0] + own[1] * axis[1]
    return float(1 - np.min(np.abs(along))), (float(axis[0]), float(axis[1]))
