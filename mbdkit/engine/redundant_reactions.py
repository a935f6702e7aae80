"""Reactions of redundant joints: the solution of least norm among all equivalent ones."""

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

    The generalized constraint forces are preserved: only a linear combination of self-stresses is added.

    Parameters
    ----------
    lam : (T, P, 2) array
        Multipliers of any solution; overwritten.
    reactions : (T, P, 3) array
        Force (x, y) [N] and torque [N m] of each pair of rows; overwritten.
    self_stress, its_reactions : (T, D, P, 2) and (T, D, P, 3) arrays
        D linearly independent self-stresses, which are multipliers without generalized forces, and their reactions.
    joint : (P,) int array
        The joint of each pair. The reaction of a joint is the sum over its pairs.
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
    for _ in range(2):  # the second pass removes the round-off of the first
        projected = q.swapaxes(1, 2) @ by_joint(reactions)[..., None]
        share = np.linalg.solve(r, projected)[..., 0]
        lam -= (share[:, None] @ self_stress.reshape(rows, spare, -1)).reshape(lam.shape)
        reactions -= (share[:, None] @ its_reactions.reshape(rows, spare, -1)).reshape(rows, pairs, 3)
