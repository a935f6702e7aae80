"""NumPy arrays that kernels read as arrays of lanes (one number for each of several runs) or of dual numbers."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.engine.native.arithmetic import DIRECTIONS
from mbdkit.engine.native.levels import WIDTH

ITEM = 1 + DIRECTIONS  #: Number of doubles of a dual number in memory: the value, then the derivatives.


class Lanes(np.ndarray):
    """An array of shape (..., WIDTH), aligned to vector registers: lanes."""


class ComplexLanes(Lanes):
    """An array of shape (..., 2, WIDTH), real and imaginary parts: complex lanes."""


class Duals(np.ndarray):
    """An array of shape (..., ITEM): dual numbers."""


class ComplexDuals(np.ndarray):
    """An array of shape (..., 2, ITEM), real and imaginary parts: complex dual numbers."""


def new_lanes(*shape: int) -> Lanes:
    """Return zeros of shape ``(*shape, WIDTH)``."""
    size = math.prod(shape) * WIDTH
    block = np.zeros(size + WIDTH)
    first = -(block.ctypes.data // 8) % WIDTH
    return block[first : first + size].reshape(*shape, WIDTH).view(Lanes)


def new_complex_lanes(*shape: int) -> ComplexLanes:
    """Return zeros of shape ``(*shape, 2, WIDTH)``."""
    return new_lanes(*shape, 2).view(ComplexLanes)


def new_duals(*shape: int) -> Duals:
    """Return zeros of shape ``(*shape, ITEM)``."""
    return np.zeros((*shape, ITEM)).view(Duals)


def new_complex_duals(*shape: int) -> ComplexDuals:
    """Return zeros of shape ``(*shape, 2, ITEM)``."""
    return np.zeros((*shape, 2, ITEM)).view(ComplexDuals)
