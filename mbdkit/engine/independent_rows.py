"""Choice of the rows to remove from a redundant mechanism, such that the others stay independent during the motion.

A set of rows can be removed if the self-stresses, restricted to these rows, form an invertible matrix. Often only one
direction in the plane of the two rows of a pair, x and y, is redundant, and this direction rotates with a body. For
example, the redundant direction of a rod between two pins is the axis of the rod. Therefore a direction that is fixed
in the frame of a body is removed, not a row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WELL_HELD = 0.1
"""A row may be removed only if, at every position, the component of its pair in the self-stresses is at least this,
relative to the largest component. If no pair satisfies this, the one that comes closest is used.
"""

SAME_FRAME = 1e-6
"""Deviation (1 - cosine) below which a direction counts as fixed in the frame of a body."""


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

    Parameters
    ----------
    stresses
        (m, r) orthonormal self-stresses at each of K positions.
    pair, place
        (m,) pair of each row and its index in the pair, in the order of the joints.
    last_resort
        (m,) whether a row may be removed only if no other row is suitable.

    Returns
    -------
    list of (int, ndarray)
        For each of the r redundant directions: its pair, and the direction (K, 2) in the plane of the pair's rows at
        each position. A pair of two rows can occur twice.
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
            (a, b), (_, c) = x[best] @ x[best].T
            angle = np.arctan2(2 * b, a - c) / 2  # angle of the leading eigenvector
            direction = np.array([np.cos(angle), np.sin(angle)])
            taken = direction @ x[best]
            taken /= np.linalg.norm(taken)
            left[k] = x - (x @ taken)[..., None] * taken
            directions.append(direction)
        chosen.append((int(pairs[best]), np.array(directions)))
    return chosen


def _largest_part(x: np.ndarray) -> np.ndarray:
    """Return the largest singular value of each block (2, r) of `x` (P, 2, r)."""
    a, b, c = (np.einsum("pr,pr->p", x[:, i], x[:, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    return np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b))


def direction_frames(
    chosen: list[tuple[int, np.ndarray]], rows: np.ndarray, pairs: np.ndarray, angles: np.ndarray
) -> list[Spare]:
    """Find the frame in which each redundant direction is fixed.

    Parameters
    ----------
    chosen
        Result of `choose_spare`.
    rows
        (P,) number of rows of each pair.
    pairs
        (P, 4) for each pair its kind, first body, second body and motion.
    angles
        (K, B + 1) angle of each body at each position, ground last [rad].
    """
    ground = angles.shape[1] - 1
    spare: list[Spare] = []
    times = np.bincount([pair for pair, _ in chosen], minlength=len(rows))
    for pair, directions in chosen:
        if times[pair] == rows[pair]:  # the whole pair is redundant, so any basis is suitable
            second = any(one.pair == pair for one in spare)
            spare.append(Spare(pair, ground, (0.0, 1.0) if second else (1.0, 0.0)))
            continue
        near = [int(pairs[pair, 1]), int(pairs[pair, 2]), ground]
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
    c, s = np.cos(angle), np.sin(angle)
    x, y = directions.T
    own = np.column_stack([c * x + s * y, -s * x + c * y])
    axis = np.linalg.svd(own, full_matrices=False)[2][0]
    return float(1 - np.min(np.abs(own @ axis))), (float(axis[0]), float(axis[1]))
