"""Arrays whose elements consist of several doubles: common base of arrays of lanes and arrays of dual numbers.

An element is an *item*: lanes, that is, one number for each of several runs (`mbdkit_builder.lane_types`), or a
dual number, that is, a value with derivatives (`mbdkit_builder.dual_types`). A complex item has two parts,
which are real items.

This module uses the public API of Numba (``numba.extending``) and llvmlite. It also uses internals of Numba:
`AbstractTemplate`, `infer_global`, `signature`, and the memory layout of an array (`mbdkit.engine.native.bundle`).
"""

from __future__ import annotations

import operator
from abc import abstractmethod
from typing import Any, ClassVar

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models


class ItemArray(types.Type):
    """Numba type of a C-contiguous array of items.

    Parameters
    ----------
    ndim
        Number of dimensions without those of an item.
    item
        Type of an item: `REAL` of the class, or a complex item, whose real and imaginary parts are the last dimension
        but one.
    """

    REAL: ClassVar[types.Type]  #: Type of real items.
    DOUBLES: ClassVar[int]  #: Number of doubles of a real item in memory.

    def __init__(self, ndim: int, item: types.Type | None = None):
        self.ndim, self.item = ndim, item or self.REAL
        self.parts = 1 if self.item == self.REAL else 2
        super().__init__(name=f"{type(self.item).__name__}Array{ndim}_{self.DOUBLES}")

    @abstractmethod
    def accepts(self, kind: Any) -> bool:
        """Return whether a value of type `kind` can be stored."""

    @classmethod
    @abstractmethod
    def load(cls, builder: Any, place: Any) -> Any:
        """Generate code that reads the real item at an address."""

    @classmethod
    @abstractmethod
    def store(cls, builder: Any, value: Any, place: Any) -> None:
        """Generate code that stores a real item at an address."""

    @classmethod
    def behind(cls, builder: Any, place: Any, count: Any) -> Any:
        """Generate code for the address that is `count` real items after the address `place`."""
        words = count * cls.DOUBLES if isinstance(count, int) else builder.mul(count, count.type(cls.DOUBLES))
        return builder.gep(place, [ir.IntType(64)(words) if isinstance(words, int) else words], inbounds=True)

    def place(self, builder: Any, array: Any, indices: list[Any]) -> Any:
        """Generate code for the address of the element with these indices.

        If there are fewer indices than dimensions, it is the address of the first element that has them.
        """
        shape = cgutils.unpack_tuple(builder, builder.extract_value(array, 5), self.ndim + self.parts)
        flat = indices[0]
        for size, index in zip(shape[1 : len(indices)], indices[1:], strict=True):
            flat = builder.add(builder.mul(flat, size), index)
        for size in shape[len(indices) : self.ndim]:
            flat = builder.mul(flat, size)
        if self.parts > 1:
            flat = builder.mul(flat, flat.type(self.parts))
        data = builder.bitcast(builder.extract_value(array, 4), ir.DoubleType().as_pointer())
        return self.behind(builder, data, flat)

    def put(self, builder: Any, array: Any, indices: list[Any], value: Any) -> None:
        """Generate code that stores one element."""
        place = self.place(builder, array, indices)
        parts = [value] if self.parts == 1 else cgutils.unpack_tuple(builder, value, self.parts)
        for i, part in enumerate(parts):
            self.store(builder, part, self.behind(builder, place, i))


class ItemArrayModel(models.StructModel):
    """Represents an array of items as an array of numbers, with further dimensions for the parts of an item.

    Its members are those of `mbdkit.engine.native.bundle`.
    """

    def __init__(self, manager: Any, kind: Any):
        sizes = types.UniTuple(types.intp, kind.ndim + kind.parts)
        members = [
            ("meminfo", types.voidptr), ("parent", types.voidptr), ("nitems", types.intp), ("itemsize", types.intp),
            ("data", types.CPointer(types.float64)), ("shape", sizes), ("strides", sizes),
        ]  # fmt: skip
        super().__init__(manager, kind, members)


def _indices_of(context: Any, builder: Any, kind: Any, value: Any) -> list[Any]:
    if isinstance(kind, types.Integer):
        return [context.cast(builder, value, kind, types.intp)]
    parts = cgutils.unpack_tuple(builder, value, len(kind))
    return [context.cast(builder, part, one, types.intp) for part, one in zip(parts, kind, strict=True)]


def _count_of_indices(index: Any) -> int | None:
    """Return the number of indices of a subscript; None if it is not made of integers."""
    if isinstance(index, types.Integer):
        return 1
    parts = list(index) if isinstance(index, types.BaseTuple) else []  # type: ignore[call-overload]
    return len(parts) if parts and all(isinstance(one, types.Integer) for one in parts) else None


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        array, index = arguments
        if not isinstance(array, ItemArray) or (count := _count_of_indices(index)) is None or count > array.ndim:
            return None
        row = array.item if count == array.ndim else type(array)(array.ndim - count, array.item)
        return signature(row, array, index)


@lower_builtin(operator.getitem, ItemArray, types.Integer)
@lower_builtin(operator.getitem, ItemArray, types.BaseTuple)
def _get(context, builder, signature, arguments):
    kind, index = signature.args
    place = kind.place(builder, arguments[0], _indices_of(context, builder, index, arguments[1]))
    result = signature.return_type
    if not isinstance(result, ItemArray):
        parts = [kind.load(builder, kind.behind(builder, place, i)) for i in range(kind.parts)]
        return parts[0] if kind.parts == 1 else cgutils.pack_struct(builder, parts)
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
        if isinstance(array, ItemArray) and _count_of_indices(index) == array.ndim and array.accepts(value):
            return signature(types.none, array, index, array.item)
        return None


@lower_builtin(operator.setitem, ItemArray, types.Integer, types.Any)
@lower_builtin(operator.setitem, ItemArray, types.BaseTuple, types.Any)
def _set(context, builder, signature, arguments):
    kind, index = signature.args[:2]
    kind.put(builder, arguments[0], _indices_of(context, builder, index, arguments[1]), arguments[2])
    return context.get_dummy_value()


@infer_global(len)
class _Len(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        return signature(types.intp, *arguments) if isinstance(arguments[0], ItemArray) else None


@lower_builtin(len, ItemArray)
def _length(context, builder, signature, arguments):
    return builder.extract_value(builder.extract_value(arguments[0], 5), 0)
