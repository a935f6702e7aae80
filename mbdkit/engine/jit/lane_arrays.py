"""Arrays of lanes: `LaneArray`, the reading and storing of its elements, and the NumPy arrays that it reads.

This module uses the public API of Numba (``numba.extending``) and llvmlite. It also uses internals of Numba:
`AbstractTemplate`, `infer_global`, `signature`, and the memory layout of an array (`mbdkit.engine.jit.bundle`).
"""

from __future__ import annotations

import math
import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model, typeof_impl

from mbdkit.engine.jit.lane_types import COMPLEX, DOUBLE, REAL, VECTOR, LaneComplex, LaneReal, is_operand
from mbdkit.engine.jit.lane_width import WIDTH

_ALIGNMENT = 8 * WIDTH


class LaneArray(types.Type):
    """Numba type of a C-contiguous array of lanes.

    Parameters
    ----------
    ndim
        Number of dimensions without that of the lanes, which is the last one in memory.
    item
        Type of an element: REAL, or COMPLEX, whose real and imaginary parts are the last dimension but one.
    """

    def __init__(self, ndim: int, item: LaneReal | LaneComplex = REAL):
        self.ndim, self.item = ndim, item
        self.parts = 1 if item == REAL else 2
        super().__init__(name=f"{type(item).__name__}Array{ndim}_{WIDTH}")


@register_model(LaneArray)
class _ArrayModel(models.StructModel):
    """The members of an array of numbers with one more dimension; see `mbdkit.engine.jit.bundle`."""

    def __init__(self, manager: Any, kind: Any):
        sizes = types.UniTuple(types.intp, kind.ndim + kind.parts)
        members = [
            ("meminfo", types.voidptr), ("parent", types.voidptr), ("nitems", types.intp), ("itemsize", types.intp),
            ("data", types.CPointer(types.float64)), ("shape", sizes), ("strides", sizes),
        ]  # fmt: skip
        super().__init__(manager, kind, members)


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


# --- elements


def indices_of(context: Any, builder: Any, kind: Any, value: Any) -> list[Any]:
    """Return the indices of a subscript as words."""
    if isinstance(kind, types.Integer):
        return [context.cast(builder, value, kind, types.intp)]
    parts = cgutils.unpack_tuple(builder, value, len(kind))
    return [context.cast(builder, part, one, types.intp) for part, one in zip(parts, kind, strict=True)]


def count_of_indices(index: Any) -> int | None:
    """Return the number of indices of a subscript; None if it is not made of integers."""
    if isinstance(index, types.Integer):
        return 1
    parts = list(index) if isinstance(index, types.BaseTuple) else []  # type: ignore[call-overload]
    return len(parts) if parts and all(isinstance(one, types.Integer) for one in parts) else None


def _place(context: Any, builder: Any, kind: LaneArray, value: Any, indices: list[Any]) -> Any:
    """Return the address of the element, or of the first one of the row, with these leading indices."""
    shape = cgutils.unpack_tuple(builder, builder.extract_value(value, 5), kind.ndim + kind.parts)
    flat = indices[0]
    for size, index in zip(shape[1 : len(indices)], indices[1:], strict=True):
        flat = builder.add(builder.mul(flat, size), index)
    for size in shape[len(indices) : kind.ndim]:
        flat = builder.mul(flat, size)
    if kind.parts > 1:
        flat = builder.mul(flat, flat.type(kind.parts))
    data = builder.bitcast(builder.extract_value(value, 4), VECTOR.as_pointer())
    return builder.gep(data, [flat], inbounds=True)


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        array, index = arguments
        if not isinstance(array, LaneArray) or (count := count_of_indices(index)) is None or count > array.ndim:
            return None
        return signature(array.item if count == array.ndim else LaneArray(array.ndim - count, array.item), array, index)


@lower_builtin(operator.getitem, LaneArray, types.Integer)
@lower_builtin(operator.getitem, LaneArray, types.BaseTuple)
def _get(context, builder, signature, arguments):
    kind, index = signature.args
    place = _place(context, builder, kind, arguments[0], indices_of(context, builder, index, arguments[1]))
    result = signature.return_type
    if not isinstance(result, LaneArray):
        places = [builder.gep(place, [ir.IntType(32)(i)], inbounds=True) for i in range(kind.parts)]
        vectors = [builder.load(one, align=_ALIGNMENT) for one in places]
        return vectors[0] if result == REAL else cgutils.pack_struct(builder, vectors)
    dropped = kind.ndim - result.ndim
    row = cgutils.create_struct_proxy(result)(context, builder)
    row.data = builder.bitcast(place, DOUBLE.as_pointer())
    for name, place_of in (("shape", 5), ("strides", 6)):
        sizes = cgutils.unpack_tuple(builder, builder.extract_value(arguments[0], place_of), kind.ndim + kind.parts)
        setattr(row, name, cgutils.pack_array(builder, sizes[dropped:]))
    return row._getvalue()


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        array, index, value = arguments
        if isinstance(array, LaneArray) and count_of_indices(index) == array.ndim and is_operand(value, array.item):
            return signature(types.none, array, index, array.item)
        return None


def store_lanes(context: Any, builder: Any, kind: LaneArray, array: Any, indices: list[Any], value: Any) -> None:
    """Generate code that stores one element of an array of lanes."""
    place = _place(context, builder, kind, array, indices)
    vectors = [value] if kind.parts == 1 else cgutils.unpack_tuple(builder, value, kind.parts)
    for i, vector in enumerate(vectors):
        builder.store(vector, builder.gep(place, [ir.IntType(32)(i)], inbounds=True), align=_ALIGNMENT)


@lower_builtin(operator.setitem, LaneArray, types.Integer, LaneReal)
@lower_builtin(operator.setitem, LaneArray, types.BaseTuple, LaneReal)
@lower_builtin(operator.setitem, LaneArray, types.Integer, LaneComplex)
@lower_builtin(operator.setitem, LaneArray, types.BaseTuple, LaneComplex)
def _set(context, builder, signature, arguments):
    kind, index = signature.args[:2]
    indices = indices_of(context, builder, index, arguments[1])
    store_lanes(context, builder, kind, arguments[0], indices, arguments[2])
    return context.get_dummy_value()


@infer_global(len)
class _Len(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        return signature(types.intp, *arguments) if isinstance(arguments[0], LaneArray) else None


@lower_builtin(len, LaneArray)
def _length(context, builder, signature, arguments):
    return builder.extract_value(builder.extract_value(arguments[0], 5), 0)
