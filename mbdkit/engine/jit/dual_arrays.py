"""Arrays of dual numbers: `DualArray`, the reading and storing of its elements, and the NumPy arrays that it reads.

This module uses the same parts of Numba as `mbdkit.engine.jit.lane_arrays`.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model, typeof_impl

from mbdkit.engine.jit.dual_types import (
    DIRECTIONS,
    DOUBLE,
    DUAL,
    DUAL_COMPLEX,
    VECTOR,
    DualComplex,
    DualNumber,
    is_real,
)
from mbdkit.engine.jit.lane_arrays import count_of_indices, indices_of

ITEM = 1 + DIRECTIONS
"""Number of doubles of a dual number in memory: the value, then the derivatives."""


class DualArray(types.Type):
    """Numba type of a C-contiguous array of dual numbers.

    Parameters
    ----------
    ndim
        Number of dimensions without those of an element.
    item
        Type of an element: DUAL, or DUAL_COMPLEX, whose real and imaginary parts are the last dimension but one.
    """

    def __init__(self, ndim: int, item: DualNumber | DualComplex = DUAL):
        self.ndim, self.item = ndim, item
        self.parts = 1 if item == DUAL else 2
        super().__init__(name=f"{type(item).__name__}Array{ndim}_{DIRECTIONS}")


@register_model(DualArray)
class _ArrayModel(models.StructModel):
    """The members of an array of numbers with more dimensions; see `mbdkit.engine.jit.bundle`."""

    def __init__(self, manager: Any, kind: Any):
        sizes = types.UniTuple(types.intp, kind.ndim + kind.parts)
        members = [
            ("meminfo", types.voidptr), ("parent", types.voidptr), ("nitems", types.intp), ("itemsize", types.intp),
            ("data", types.CPointer(types.float64)), ("shape", sizes), ("strides", sizes),
        ]  # fmt: skip
        super().__init__(manager, kind, members)


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


# --- elements


def _place(builder: Any, kind: DualArray, value: Any, indices: list[Any]) -> Any:
    """Return the address of the element, or of the first one of the row, with these leading indices."""
    shape = cgutils.unpack_tuple(builder, builder.extract_value(value, 5), kind.ndim + kind.parts)
    flat = indices[0]
    for size, index in zip(shape[1 : len(indices)], indices[1:], strict=True):
        flat = builder.add(builder.mul(flat, size), index)
    for size in shape[len(indices) : kind.ndim]:
        flat = builder.mul(flat, size)
    data = builder.bitcast(builder.extract_value(value, 4), DOUBLE.as_pointer())
    return builder.gep(data, [builder.mul(flat, flat.type(ITEM * kind.parts))], inbounds=True)


def _behind(builder: Any, place: Any, count: int) -> Any:
    return builder.gep(place, [ir.IntType(64)(count)], inbounds=True)


def load_dual(builder: Any, place: Any) -> Any:
    """Generate code that reads the dual number at an address."""
    vector = builder.bitcast(_behind(builder, place, 1), VECTOR.as_pointer())
    return cgutils.pack_struct(builder, [builder.load(place), builder.load(vector, align=8)])


def store_dual(builder: Any, value: Any, place: Any) -> None:
    """Generate code that stores a dual number at an address."""
    number, derivatives = cgutils.unpack_tuple(builder, value, 2)
    vector = builder.bitcast(_behind(builder, place, 1), VECTOR.as_pointer())
    builder.store(number, place)
    builder.store(derivatives, vector, align=8)


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        array, index = arguments
        if not isinstance(array, DualArray) or (count := count_of_indices(index)) is None or count > array.ndim:
            return None
        return signature(array.item if count == array.ndim else DualArray(array.ndim - count, array.item), array, index)


@lower_builtin(operator.getitem, DualArray, types.Integer)
@lower_builtin(operator.getitem, DualArray, types.BaseTuple)
def _get(context, builder, signature, arguments):
    kind, index = signature.args
    place = _place(builder, kind, arguments[0], indices_of(context, builder, index, arguments[1]))
    result = signature.return_type
    if not isinstance(result, DualArray):
        parts = [load_dual(builder, _behind(builder, place, ITEM * i)) for i in range(kind.parts)]
        return parts[0] if result == DUAL else cgutils.pack_struct(builder, parts)
    dropped = kind.ndim - result.ndim
    row = cgutils.create_struct_proxy(result)(context, builder)
    row.data = place
    for name, place_of in (("shape", 5), ("strides", 6)):
        sizes = cgutils.unpack_tuple(builder, builder.extract_value(arguments[0], place_of), kind.ndim + kind.parts)
        setattr(row, name, cgutils.pack_array(builder, sizes[dropped:]))
    return row._getvalue()


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        array, index, value = arguments
        if not isinstance(array, DualArray) or count_of_indices(index) != array.ndim:
            return None
        if is_real(value) or (array.item == DUAL_COMPLEX and isinstance(value, DualComplex)):
            return signature(types.none, array, index, array.item)
        return None


@lower_builtin(operator.setitem, DualArray, types.Integer, DualNumber)
@lower_builtin(operator.setitem, DualArray, types.BaseTuple, DualNumber)
@lower_builtin(operator.setitem, DualArray, types.Integer, DualComplex)
@lower_builtin(operator.setitem, DualArray, types.BaseTuple, DualComplex)
def _set(context, builder, signature, arguments):
    kind, index = signature.args[:2]
    place = _place(builder, kind, arguments[0], indices_of(context, builder, index, arguments[1]))
    parts = [arguments[2]] if kind.parts == 1 else cgutils.unpack_tuple(builder, arguments[2], kind.parts)
    for i, part in enumerate(parts):
        store_dual(builder, part, _behind(builder, place, ITEM * i))
    return context.get_dummy_value()


@infer_global(len)
class _Len(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        return signature(types.intp, *arguments) if isinstance(arguments[0], DualArray) else None


@lower_builtin(len, DualArray)
def _length(context, builder, signature, arguments):
    return builder.extract_value(builder.extract_value(arguments[0], 5), 0)
