"""Quantities of a mechanism that are evaluated together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbdkit.mechanism.mechanism_quantities import Quantity


class Quantities:
    """Several quantities, evaluated together.

    Parameters
    ----------
    quantities
        The K quantities.
    """

    def __init__(self, quantities: Sequence[Quantity]):
        self.quantities = tuple(quantities)
        self.is_angle = np.array([quantity.unit == "rad" for quantity in self.quantities], dtype=bool)
        self.scale = np.array([quantity.scale for quantity in self.quantities])

    def __len__(self) -> int:
        return len(self.quantities)

    def only(self, places: Sequence[int]) -> Quantities:
        """Return the quantities with the given indices."""
        return Quantities([self.quantities[place] for place in places])

    def sizes(self, length: float) -> np.ndarray:
        """Return the values (K,) that count as 1: 1 rad for angles, and `length` for lengths."""
        return np.asarray(np.where(self.is_angle, 1.0, length) * self.scale)

    def values(self, q: np.ndarray) -> np.ndarray:
        """Return the values (T, K)."""
        out = np.empty((len(q), len(self)))
        for index, quantity in enumerate(self.quantities):
            out[:, index] = quantity.value(q)
        return out

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return the Jacobian (T, K, n)."""
        out = np.zeros((len(q), len(self), q.shape[1]))
        for index, quantity in enumerate(self.quantities):
            quantity.add_gradient(q, out[:, index])
        return out

    def curvature(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the second time derivatives (T, K) that the quantities have if the accelerations of the coordinates
        are zero.
        """
        out = np.empty((len(q), len(self)))
        for index, quantity in enumerate(self.quantities):
            out[:, index] = quantity.curvature(q, v)
        return out
