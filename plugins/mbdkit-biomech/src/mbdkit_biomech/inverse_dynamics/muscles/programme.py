"""Convex programmes of recruitment: what is minimised in each frame, subject to what."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.linear_systems import products


@dataclass(frozen=True)
class Programme:
    """Convex programmes of T frames with N unknowns and K equations.

    Attributes
    ----------
    matrix, right
        Coefficients (T, K, N) and right sides (T, K) of the equations.
    low, high
        (T, N) bounds; may be infinite.
    weight
        (N,) weights of the unknowns, positive.
    lowest
        (T, K) lowest multipliers: -inf for equations, 0 for inequalities ``matrix x >= right``.
    """

    matrix: np.ndarray
    right: np.ndarray
    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray
    lowest: np.ndarray = field(default_factory=lambda: np.array(-np.inf))

    def __post_init__(self) -> None:
        object.__setattr__(self, "lowest", np.broadcast_to(self.lowest, self.right.shape))

    @property
    def size(self) -> np.ndarray:
        """Size (T, K) of each equation: magnitude of its right side, and sum of the magnitudes of its terms with all
        unknowns at their finite upper bounds.
        """
        largest = np.where(np.isfinite(self.high), np.abs(self.high), 0.0)
        size: np.ndarray = np.abs(self.right) + products(np.abs(self.matrix), largest)
        return np.where(size > 0, size, 1.0)

    def only(self, rows: np.ndarray) -> Programme:
        """Return the programmes of a selection of frames."""
        matrix, right, low, high, lowest = (
            one[rows] for one in (self.matrix, self.right, self.low, self.high, self.lowest)
        )
        return Programme(matrix, right, low, high, self.weight, lowest)

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Return what the equations lack (T, K) with unknowns (T, N)."""
        return np.asarray(self.right - products(self.matrix, x))


def slope_of_cost(x: np.ndarray, p: float) -> np.ndarray:
    """Return the derivatives of the costs ``|x|^p``."""
    return np.asarray(p * np.sign(x) * elementary.pow(np.abs(x), p - 1))
