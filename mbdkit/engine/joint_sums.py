"""Quantities of joints, summed over the pairs of constraint rows of each joint."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.misalignment import squared_misalignment


class JointSums:
    """Computes values of joints from values of pairs.

    `mechanism`: the compiled mechanism. Both rows of a pair have the same unit. `joint` ((P,) int array): index of the
    joint of each pair.
    """

    def __init__(self, mechanism: CompiledMechanism):
        self._joints = len(mechanism.joints)
        self.joint = mechanism.topology.pair_joint
        pairs = len(mechanism.topology.pairs)
        longest = max(map(len, mechanism.joint_pairs), default=0)
        self._rounds = [
            np.array([sorted(members)[index] for members in mechanism.joint_pairs if index < len(members)])
            for index in range(longest)
        ]
        #: Pairs of the first round in the order of the joints; None if some joint has no pair.
        self._first = None
        if longest and len(self._rounds[0]) == self._joints:
            self._first = self._rounds[0]
        self._is_length = np.zeros(pairs, dtype=bool)
        self._is_length[[row.pair for row in mechanism.rows if row.unit == "m"]] = True
        self._has_angles = not self._is_length.all()
        self._row_pair = np.array([row.pair for row in mechanism.rows], dtype=np.int64)
        self._row_place = np.array([row.place for row in mechanism.rows], dtype=np.int64)

    def misalignment(self, residual: np.ndarray) -> np.ndarray:
        """Return the misalignment of joints, (T, J) [m], from the residuals (T, P, 2) of their pairs.

        If the time derivatives of the residuals are given, the result is the velocity misalignment [m/s].
        """
        return self.misalignment_of_squares(squared_misalignment(residual[..., 0], residual[..., 1]))

    def misalignment_of_squares(self, squares: np.ndarray) -> np.ndarray:
        """Return the misalignment of joints, (..., J), from the squared norms (..., P) of the residuals of pairs."""
        lengths = np.where(self._is_length, squares, 0.0) if self._has_angles else squares
        return np.sqrt(self.sum(lengths[..., None])[..., 0])

    def angle_misalignment(self, residual: np.ndarray) -> np.ndarray:
        """Return the angular misalignment of joints, (T, J) [rad], from the residuals (T, P, 2) of their pairs."""
        if not self._has_angles:
            return np.zeros((*residual.shape[:-2], self._joints))
        angles = np.where(self._is_length, 0.0, np.abs(residual[..., 0]) + np.abs(residual[..., 1]))
        return self.sum(angles[..., None])[..., 0]

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Sum values (..., P, n) of pairs over each joint: (..., J, n)."""
        if self._first is None:
            out, rounds = np.zeros((*values.shape[:-2], self._joints, values.shape[-1])), self._rounds
        else:
            out, rounds = 0.0 + values.take(self._first, axis=-2), self._rounds[1:]
        for pairs in rounds:  # a fixed order of the pairs makes sums reproducible bit by bit
            out[..., self.joint[pairs], :] += values[..., pairs, :]
        return out

    def by_row(self, values: np.ndarray) -> np.ndarray:
        """Return the values (T, m) of constraint rows, in the order of the archive, from those of pairs (T, P, 2)."""
        return values[:, self._row_pair, self._row_place]


@lru_cache(maxsize=16)
def joint_sums(mechanism: CompiledMechanism) -> JointSums:
    """Return the `JointSums` of a mechanism, which are created only once."""
    return JointSums(mechanism)
