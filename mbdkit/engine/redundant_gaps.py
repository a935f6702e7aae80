"""Residuals of redundant rows that the misalignment of the other rows does not explain.

A self-stress is a combination of constraint rows whose gradient vanishes. Therefore the same combination of the
residuals Phi vanishes too, to first order, for any deviation of the mechanism from its constraints by numerical error.
It is the residual in the redundant direction that would remain if all other rows were satisfied. If it does not vanish,
the rows are inconsistent, like those of two drivers whose motions diverge.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism


def units_of_pairs(mechanism: CompiledMechanism) -> np.ndarray:
    """Return the scale (P,) of the residuals of each pair: the characteristic length, or 1 rad."""
    units = np.ones(len(mechanism.topology.pairs))
    units[[row.pair for row in mechanism.rows if row.unit == "m"]] = mechanism.length
    return units


def unexplained_gaps(
    mechanism: CompiledMechanism, q: np.ndarray, phi: np.ndarray, distance: np.ndarray, self_stress: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals in D redundant directions that remain if the other rows are satisfied, and their
    uncertainty.

    Parameters
    ----------
    mechanism
        The mechanism.
    q : (T, 3 (B + 1)) array
        Positions, ground last.
    phi : (T, P, 2) array
        Residuals.
    distance : (T,) array
        Distance to singularity.
    self_stress : (T, D, P, 2) array
        Multipliers of the self-stresses, 1 in the redundant direction itself.

    Returns
    -------
    gap, uncertainty : (T, D) arrays
        Relative to `units_of_pairs`. The uncertainty is of second order in the misalignment of the other rows: the sum
        of the absolute multipliers times the square of the displacement that satisfies these rows.
    """
    top, units = mechanism.topology, units_of_pairs(mechanism)
    relative = phi / units[:, None]
    multipliers = self_stress * (units[:, None] / units[top.spare[:, 0], None, None])
    gap = np.abs(np.sum(multipliers * relative[:, None], axis=(2, 3)))
    others = relative.copy()
    for (pair, frame), (x, y) in zip(top.spare, top.spare_axes, strict=True):
        c, s = np.cos(q[:, 3 * frame + 2]), np.sin(q[:, 3 * frame + 2])
        along = np.column_stack([c * x - s * y, s * x + c * y])
        others[:, pair] -= np.sum(others[:, pair] * along, axis=1, keepdims=True) * along
    with np.errstate(all="ignore"):
        displacement = np.abs(others).max(axis=(1, 2)) / distance
        return gap, np.sum(np.abs(multipliers), axis=(2, 3)) * displacement[:, None] ** 2
