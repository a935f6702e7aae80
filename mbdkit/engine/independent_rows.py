"""Which rows to leave out of a redundant mechanism, so that the rest is independent wherever it goes.

A set of rows can be left out where the self-stresses, restricted to it, form an invertible matrix: each of them then
is held by one row of its own. Of the two rows of a pair, x and y, often one *direction* is redundant, and turns with
some body: a rod between two pins has its spare row along itself. So a direction fixed in a body's frame is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WELL_HELD = 0.1
"""Part in the self-stresses, relative to the largest, from which on a row may be left out."""

SAME_FRAME = 1e-6
"""Deviation of a direction from a body's frame, as 1 - cosine, that is as good as none."""


@dataclass(frozen=True)
class Spare:
    """A redundant direction: its pair, and a unit vector among the pair's rows in the frame of a body."""

    pair: int
    frame: int
    axis: tuple[float, float]


def choose_spare(
    stresses: list[np.ndarray], pair: np.ndarray, place: np.ndarray, last_resort: np.ndarray
) -> list[tuple[int, np.ndarray]]:
    """Choose the rows to leave out: late ones first.

    Parameters
    ----------
    stresses
        (m, r) orthonormal self-stresses at each of K positions.
    pair, place
        (m,) pair of each row and its place there, in the order of the joints.
    last_resort
        (m,) whether a row stays as long as any other will do.

    Returns
    -------
    list of (int, ndarray)
        The r pairs, one of two rows perhaps twice, each with the direction (K, 2) among its rows at each position.
    """
    pairs, unit = np.unique(pair, return_inverse=True)
    rows = np.full((len(pairs), 2), len(pair))  # a row of zeros stands behind the others
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
            angle = np.arctan2(2 * b, a - c) / 2  # of the leading eigenvector
            direction = np.array([np.cos(angle), np.sin(angle)])
            taken = direction @ x[best]
            taken /= np.linalg.norm(taken)
            left[k] = x - (x @ taken)[..., None] * taken
            directions.append(direction)
        chosen.append((int(pairs[best]), np.array(directions)))
    return chosen


def _largest_part(x: np.ndarray) -> np.ndarray:
    """Return the largest singular value of each of the blocks `x` (P, 2, r)."""
    a, b, c = (np.einsum("pr,pr->p", x[:, i], x[:, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    return np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b))


def direction_frames(
    chosen: list[tuple[int, np.ndarray]], rows: np.ndarray, pairs: np.ndarray, angles: np.ndarray
) -> list[Spare]:
    """Find for each redundant direction the frame in which it is fixed.

    Parameters
    ----------
    chosen
        What `choose_spare` returned.
    rows
        (P,) number of rows of each pair.
    pairs
        (P, 4) kind, first and second body of each pair, motion.
    angles
        (K, B + 1) tilt of every body at each position; ground comes last.
    """
    ground = angles.shape[1] - 1
    spare: list[Spare] = []
    times = np.bincount([pair for pair, _ in chosen], minlength=len(rows))
    for pair, directions in chosen:
        if times[pair] == rows[pair]:  # all of them: any basis will do
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
    """Return the largest deviation of directions (K, 2) from one that turns by `angle` (K,), and that direction."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = directions.T
    own = np.column_stack([c * x + s * y, -s * x + c * y])
    axis = np.linalg.svd(own, full_matrices=False)[2][0]
    return float(1 - np.min(np.abs(own @ axis))), (float(axis[0]), float(axis[1]))
