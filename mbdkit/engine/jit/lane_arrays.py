"""Arrays of lanes: `LaneArray`, and the NumPy arrays that it reads.

This module uses the same parts of Numba as `mbdkit.engine.jit.item_arrays`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba.extending import register_model, typeof_impl

from mbdkit.engine.jit.item_arrays import ItemArray, ItemArrayModel
from mbdkit.engine.jit.lane_types import COMPLEX, REAL, VECTOR, is_operand
from mbdkit.engine.jit.lane_width import WIDTH

_ALIGNMENT = 8 * WIDTH


class LaneArray(ItemArray):
    """Numba type of a C-contiguous array of lanes."""

    REAL = REAL
    DOUBLES = WIDTH

    def accepts(self, kind: Any) -> bool:
        """Return whether a value of type `kind` can be stored."""
        return is_operand(kind, self.item)

    @classmethod
    def load(cls, builder: Any, place: Any) -> Any:
        """Generate code that reads the lanes at an address."""
        return builder.load(builder.bitcast(place, VECTOR.as_pointer()), align=_ALIGNMENT)

    @classmethod
    def store(cls, builder: Any, value: Any, place: Any) -> None:
        """Generate code that stores lanes at an address."""
        builder.store(value, builder.bitcast(place, VECTOR.as_pointer()), align=_ALIGNMENT)


register_model(LaneArray)(ItemArrayModel)


class Lanes(np.ndarray):
    """An array of shape (..., WIDTH), aligned to vector registers, which kernels read as a `LaneArray`."""


def new_lanes(*shape: int) -> Lanes:
    """Return zeros of shape ``(*shape, WIDTH)``."""
    size = math.prod(shape) * WIDTH
    block = np.zeros(size + WIDTH)
    first = -(block.ctypes.data // 8) % WIDTH
    return block[first : first + size].reshape(*shape, WIDTH).view(Lanes)


class ComplexLanes(Lanes):
    """An array of shape (..., 2, WIDTH), real and imaginary parts, which kernels read as a `LaneArray` of COMPLEX."""


@typeof_impl.register(ComplexLanes)
def _typeof_complex_lanes(value: ComplexLanes, context: Any) -> LaneArray:
    return LaneArray(value.ndim - 2, COMPLEX)


@typeof_impl.register(Lanes)
def _typeof_lanes(value: Lanes, context: Any) -> LaneArray:
    return LaneArray(value.ndim - 1)
