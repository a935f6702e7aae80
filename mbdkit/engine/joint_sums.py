"""Quantities of joints, summed over the pairs of constraint rows of each joint."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.misalignment import squared_misalignment


class JointSums:
    """Computes values of joints from values of pairs.

    Parameters
    ----------
    mechanism
        The compiled mechanism. Both rows of a pair have the same unit.

    Attributes
    ----------
    joint : (P,) int array
        Number of the joint of each pair.
    """

    def __init__(self, mechanism: CompiledMechanism):
        self._joints = len(mechanism.joints)
        self.joint = mechanism.topology.pair_joint
        pairs = len(mechanism.topology.pairs)
        self._is_length = np.zeros(pairs, dtype=bool)
        self._is_length[[row.pair for row in mechanism.rows if row.unit == "m"]] = True

    def misalignment(self, residual: np.ndarray) -> np.ndarray:
        """Return the misalignment of joints, (T, J) [m], from the residuals (T, P, 2) of their pairs.

        From the time derivatives of the residuals, the result is the velocity misalignment [m/s].
        """
        return self.misalignment_of_squares(squared_misalignment(residual[..., 0], residual[..., 1]))

    def misalignment_of_squares(self, squares: np.ndarray) -> np.ndarray:
        """Return the misalignment of joints, (..., J), from the squared norms (..., P) of the residuals of pairs."""
        return np.sqrt(self.sum(np.where(self._is_length, squares, 0.0)[..., None])[..., 0])

    def angle_misalignment(self, residual: np.ndarray) -> np.ndarray:
        """Return the angular misalignment of joints, (T, J) [rad], from the residuals (T, P, 2) of their pairs."""
        angles = np.where(self._is_length, 0.0, np.abs(residual[..., 0]) + np.abs(residual[..., 1]))
        return self.sum(angles[..., None])[..., 0]

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Sum values (..., P, n) of pairs over each joint: (..., J, n)."""
        out = np.zeros((*values.shape[:-2], self._joints, values.shape[-1]))
        for pair, joint in enumerate(self.joint.tolist()):  # in this order, so that sums have the same bits
            out[..., joint, :] += values[..., pair, :]
        return out
