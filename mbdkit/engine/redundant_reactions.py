"""Reactions of redundant joints: of all that hold the mechanism alike, those of least norm."""

from __future__ import annotations

import numpy as np


def share_evenly(
    lam: np.ndarray,
    reactions: np.ndarray,
    self_stress: np.ndarray,
    its_reactions: np.ndarray,
    joint: np.ndarray,
    length: float,
) -> None:
    """Replace multipliers and reactions by those that minimise ``sum |force|^2 + (torque / length)^2`` over the joints.

    They are sought among all that give the same generalized forces: what is added is a combination of self-stresses.

    Parameters
    ----------
    lam : (T, P, 2) array
        Multipliers of some solution; replaced.
    reactions : (T, P, 3) array
        Force (x, y) [N] and torque [N m] of every pair of rows; replaced.
    self_stress, its_reactions : (T, D, P, 2) and (T, D, P, 3) arrays
        Multipliers that move nothing, independent of each other, and their reactions.
    joint : (P,) int array
        The joint that each pair belongs to; the reactions of its pairs add up.
    length
        Characteristic length of the mechanism [m].
    """
    rows, spare, pairs, _ = self_stress.shape
    order = np.argsort(joint, kind="stable")
    begin = np.flatnonzero(np.diff(joint[order], prepend=-1))
    weight = np.array([1.0, 1.0, 1.0 / length])

    def by_joint(x: np.ndarray) -> np.ndarray:
        summed = np.add.reduceat(x[..., order, :], begin, axis=-2) * weight
        return summed.reshape(*x.shape[:-2], -1)

    basis = by_joint(its_reactions).swapaxes(1, 2)
    q, r = np.linalg.qr(basis)
    for _ in range(2):  # once more for round-off
        projected = q.swapaxes(1, 2) @ by_joint(reactions)[..., None]
        share = np.linalg.solve(r, projected)[..., 0]
        lam -= (share[:, None] @ self_stress.reshape(rows, spare, -1)).reshape(lam.shape)
        reactions -= (share[:, None] @ its_reactions.reshape(rows, spare, -1)).reshape(rows, pairs, 3)
