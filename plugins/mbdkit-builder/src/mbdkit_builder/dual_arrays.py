"""Numba types of arrays of dual numbers (values with derivatives), and of the NumPy arrays that hold them.

This module uses the same parts of Numba as `mbdkit_builder.item_arrays`.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.extending import register_model, typeof_impl

from mbdkit.engine.native.number_arrays import ITEM, ComplexDuals, Duals
from mbdkit_builder.dual_types import DUAL, DUAL_COMPLEX, VECTOR, DualComplex, is_real
from mbdkit_builder.item_arrays import ItemArray, ItemArrayModel


class DualArray(ItemArray):
    """Numba type of a C-contiguous array of dual numbers."""

    arithmetic = "dual"
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
    return builder.bitcast(builder.gep(place, [ir.IntType(64)(1)], inbounds=True), VECTOR.as_pointer())


register_model(DualArray)(ItemArrayModel)


@typeof_impl.register(Duals)
def _typeof_duals(value: Duals, context: Any) -> DualArray:
    return DualArray(value.ndim - 1)


@typeof_impl.register(ComplexDuals)
def _typeof_complex_duals(value: ComplexDuals, context: Any) -> DualArray:
    return DualArray(value.ndim - 2, DUAL_COMPLEX)
