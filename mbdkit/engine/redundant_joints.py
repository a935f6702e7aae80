"""Redundant joints: residuals that would remain without misalignment of the other rows, and reactions of least norm.

A self-stress is a combination of constraint rows whose gradient vanishes. If numerical error moves the mechanism off
its constraints, the same combination of the residuals Phi therefore vanishes to first order. This combination is the
residual that would remain in the redundant direction if all other rows were satisfied. If it does not vanish, the rows
are inconsistent, like those of two drivers whose motions diverge.

Reactions of redundant joints are not unique. Of all equivalent reactions, those of least norm are recorded.
"""

from __future__ import annotations

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.orthogonal import solve_each_least_squares
from mbdkit.engine.kernels.table_rows import SPARE

DEPENDENT = 1e-14  #: Self-stresses whose reactions depend on those of others to this share are rounding errors.


def units_of_pairs(mechanism: CompiledMechanism) -> np.ndarray:
    """Return the scale (P,) of the residuals of each pair: the characteristic length, or 1 rad."""
    units = np.ones(len(mechanism.topology.pairs))
    units[[row.pair for row in mechanism.rows if row.unit == "m"]] = mechanism.length
    return units


def unexplained_gaps(
    mechanism: CompiledMechanism, q: np.ndarray, phi: np.ndarray, distance: np.ndarray, self_stress: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals in D redundant directions that would remain if the other rows were satisfied, with their
    uncertainty.

    `q` ((T, 3 (B + 1)) array): positions, ground last. `phi` ((T, P, 2) array): residuals. `distance` ((T,) array):
    distance to singularity. `self_stress` ((T, D, P, 2) array): multipliers of the self-stresses, 1 in the redundant
    direction itself. Both results are (T, D) and relative to `units_of_pairs`. The uncertainty is of second order in
    the misalignment of the other rows: the sum of the absolute multipliers times the square of the displacement that
    satisfies these rows.
    """
    top, units = mechanism.topology, units_of_pairs(mechanism)
    relative = phi / units[:, None]
    multipliers = self_stress * (units[:, None] / units[top.spare[:, SPARE.pair], None, None])
    gap = np.abs(np.sum(multipliers * relative[:, None], axis=(2, 3)))
    others = relative.copy()
    for (pair, frame), (x, y) in zip(top.spare, top.spare_axes, strict=True):
        c, s = elementary.cos(q[:, 3 * frame + 2]), elementary.sin(q[:, 3 * frame + 2])
        along = np.column_stack([c * x - s * y, s * x + c * y])
        others[:, pair] -= np.sum(others[:, pair] * along, axis=1, keepdims=True) * along
    with np.errstate(all="ignore"):
        displacement = np.abs(others).max(axis=(1, 2)) / distance
        return gap, np.sum(np.abs(multipliers), axis=(2, 3)) * displacement[:, None] ** 2


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

    - `lam` ((T, P, 2) array): multipliers of any solution; overwritten by the result.
    - `reactions` ((T, P, 3) array): force (x, y) [N] and torque [N m] of each pair of rows; overwritten by the result.
    - `self_stress`, `its_reactions` ((T, D, P, 2) and (T, D, P, 3) arrays): D linearly independent self-stresses, which
      are multipliers without generalized forces, and their reactions.
    - `joint` ((P,) int array): the joint of each pair. The reaction of a joint is the sum over its pairs.
    - `length`: characteristic length of the mechanism [m].
    """
    rows, spare = self_stress.shape[:2]
    order = np.argsort(joint, kind="stable")
    begin = np.flatnonzero(np.diff(joint[order], prepend=-1))
    weight = np.array([1.0, 1.0, 1.0 / length])

    def by_joint(x: np.ndarray) -> np.ndarray:
        summed = np.add.reduceat(x[..., order, :], begin, axis=-2) * weight
        return summed.reshape(*x.shape[:-2], -1)

    basis = by_joint(its_reactions)
    share, right = np.empty((rows, spare)), np.zeros((rows, max(basis.shape[1:])))
    for _ in range(2):  # the second pass removes the round-off of the first
        right[:, : basis.shape[2]] = by_joint(reactions)
        work = np.empty(spare, dtype=np.int64), np.empty((spare, spare))
        solve_each_least_squares(basis.copy(), right, share, *work, DEPENDENT)
        lam -= np.sum(share[:, :, None, None] * self_stress, axis=1)
        reactions -= np.sum(share[:, :, None, None] * its_reactions, axis=1)
