"""Numba types of arrays of lanes (one number for each of several runs), and of the NumPy arrays that hold them.

This module uses the same parts of Numba as `mbdkit_builder.item_arrays`.
"""

from __future__ import annotations

from typing import Any

from numba.extending import register_model, typeof_impl

from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.native.number_arrays import ComplexLanes, Lanes
from mbdkit_builder.item_arrays import ItemArray, ItemArrayModel
from mbdkit_builder.lane_types import COMPLEX, REAL, VECTOR, is_operand

_ALIGNMENT = 8 * WIDTH


class LaneArray(ItemArray):
    """Numba type of a C-contiguous array of lanes."""

    arithmetic = "lanes"
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


@typeof_impl.register(ComplexLanes)
def _typeof_complex_lanes(value: ComplexLanes, context: Any) -> LaneArray:
    return LaneArray(value.ndim - 2, COMPLEX)


@typeof_impl.register(Lanes)
def _typeof_lanes(value: Lanes, context: Any) -> LaneArray:
    return LaneArray(value.ndim - 1)
