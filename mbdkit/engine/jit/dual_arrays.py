"""Arrays of dual numbers: `DualArray`, and the NumPy arrays that it reads.

This module uses the same parts of Numba as `mbdkit.engine.jit.item_arrays`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils
from numba.extending import register_model, typeof_impl

from mbdkit.engine.jit.dual_types import DIRECTIONS, DUAL, DUAL_COMPLEX, VECTOR, DualComplex, is_real
from mbdkit.engine.jit.item_arrays import ItemArray, ItemArrayModel

ITEM = 1 + DIRECTIONS
"""Number of doubles of a dual number in memory: the value, then the derivatives."""


class DualArray(ItemArray):
    """Numba type of a C-contiguous array of dual numbers."""

    REAL = DUAL
    DOUBLES = ITEM

    def accepts(self, kind: Any) -> bool:
        """Return whether a value of type `kind` can be stored."""
        return is_real(kind) or (self.item == DUAL_COMPLEX and isinstance(kind, DualComplex))

    @classmethod
    def load(cls, builder: Any, place: Any) -> Any:
        """Generate code that reads the dual number at an address."""
        return cgutils.pack_struct(builder, [builder.load(place), builder.load(_derivatives(builder, place), align=8)])

    @classmethod
    def store(cls, builder: Any, value: Any, place: Any) -> None:
        """Generate code that stores a dual number at an address."""
        number, derivatives = cgutils.unpack_tuple(builder, value, 2)
        builder.store(number, place)
        builder.store(derivatives, _derivatives(builder, place), align=8)


def _derivatives(builder: Any, place: Any) -> Any:
    """Generate code for the address of the derivatives of the dual number at an address."""
    return builder.bitcast(builder.gep(place, [ir.IntType(64)(1)], inbounds=True), VECTOR.as_pointer())


register_model(DualArray)(ItemArrayModel)


class Duals(np.ndarray):
    """An array of shape (..., ITEM), which kernels read as a `DualArray`."""


class ComplexDuals(np.ndarray):
    """An array of shape (..., 2, ITEM), which kernels read as a `DualArray` of DUAL_COMPLEX."""


def new_duals(*shape: int) -> Duals:
    """Return zeros of shape ``(*shape, ITEM)``."""
    return np.zeros((*shape, ITEM)).view(Duals)


def new_complex_duals(*shape: int) -> ComplexDuals:
    """Return zeros of shape ``(*shape, 2, ITEM)``."""
    return np.zeros((*shape, 2, ITEM)).view(ComplexDuals)


@typeof_impl.register(Duals)
def _typeof_duals(value: Duals, context: Any) -> DualArray:
    return DualArray(value.ndim - 1)


@typeof_impl.register(ComplexDuals)
def _typeof_complex_duals(value: ComplexDuals, context: Any) -> DualArray:
    return DualArray(value.ndim - 2, DUAL_COMPLEX)
