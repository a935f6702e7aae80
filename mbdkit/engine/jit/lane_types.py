"""Lanes: several runs side by side in compiled code, as one vector of floating-point numbers.

Kernels are compiled for the types of their arguments. If a bundle holds arrays of lanes (`LaneArray`) instead of arrays
of numbers, the same source becomes a kernel that advances `WIDTH` runs at once: every element of such an array is a
vector of `WIDTH` doubles, one for each run, and arithmetic works lane by lane. Each operation on a vector rounds as the
operation on a number does, and nothing is reassociated or contracted, so that a lane has the bits of the single run.

A comparison of vectors is a mask (`LaneMask`), on which Python cannot branch. Code that serves both widths uses `where`
and ``&`` instead of branches, and the other functions of this module.

This module uses the public API of Numba (``numba.extending``) and llvmlite. It also uses internals of Numba:
`AbstractTemplate`, `infer_global`, `signature`, and the memory layout of an array
(`mbdkit.engine.jit.bundle`).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_cast
from numba.core.typeconv import Conversion  # type: ignore[attr-defined]
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, overload, register_model, typeof_impl

from mbdkit.engine.jit.lane_width import WIDTH

_DOUBLE, _BIT = ir.DoubleType(), ir.IntType(1)
_VECTOR, _BITS = ir.VectorType(_DOUBLE, WIDTH), ir.VectorType(_BIT, WIDTH)
_ALIGNMENT = 8 * WIDTH


class LaneReal(types.Type):
    """Numba type of `WIDTH` doubles, one for each lane."""

    def __init__(self) -> None:
        super().__init__(name=f"LaneReal{WIDTH}")

    def unify(self, typing_context: Any, other: Any) -> Any:
        """Return this type for numbers, so that a variable may begin as ``0.0``."""
        return self if isinstance(other, types.Number) else None

    def can_convert_from(self, typing_context: Any, other: Any) -> Any:
        """Allow numbers, which become equal in all lanes."""
        return Conversion.safe if isinstance(other, types.Number) else None


class LaneMask(types.Type):
    """Numba type of `WIDTH` truth values."""

    def __init__(self) -> None:
        super().__init__(name=f"LaneMask{WIDTH}")

    def unify(self, typing_context: Any, other: Any) -> Any:
        """Return this type for truth values, so that a variable may begin as ``True``."""
        return self if isinstance(other, types.Boolean) else None

    def can_convert_from(self, typing_context: Any, other: Any) -> Any:
        """Allow truth values, which become equal in all lanes."""
        return Conversion.safe if isinstance(other, types.Boolean) else None


REAL, MASK = LaneReal(), LaneMask()


class LaneArray(types.Type):
    """Numba type of a C-contiguous array of lanes.

    Parameters
    ----------
    ndim
        Number of dimensions without that of the lanes, which is the last one in memory.
    """

    def __init__(self, ndim: int):
        self.ndim = ndim
        super().__init__(name=f"LaneArray{ndim}_{WIDTH}")


@register_model(LaneReal)
class _RealModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any):
        super().__init__(manager, kind, _VECTOR)


@register_model(LaneMask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any):
        super().__init__(manager, kind, _BITS)


@register_model(LaneArray)
class _ArrayModel(models.StructModel):
    """The members of an array of numbers with one more dimension; see `mbdkit.engine.jit.bundle`."""

    def __init__(self, manager: Any, kind: Any):
        sizes = types.UniTuple(types.intp, kind.ndim + 1)
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


@typeof_impl.register(Lanes)
def _typeof_lanes(value: Lanes, context: Any) -> LaneArray:
    return LaneArray(value.ndim - 1)


# --- numbers become equal in all lanes


def _splat(builder: Any, value: Any, kind: ir.VectorType) -> Any:
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.IntType(32)(0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), zeros)


@lower_cast(types.Number, LaneReal)
def _number_to_lanes(context, builder, given, wanted, value):
    return _splat(builder, context.cast(builder, value, given, types.float64), _VECTOR)


@lower_cast(types.Boolean, LaneMask)
def _truth_to_lanes(context, builder, given, wanted, value):
    return _splat(builder, builder.trunc(value, _BIT) if value.type != _BIT else value, _BITS)


# --- arithmetic and comparisons


def _is_operand(kind: Any) -> bool:
    return isinstance(kind, LaneReal | types.Number)


def _define(function: Any, arity: int, kind: Any, result: Any, code: Callable[..., Any], *, any_of: Any) -> None:
    """Define `function` for arguments of the lane type `kind`, of which all but one may be plain values."""

    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            if len(arguments) != arity or not any(isinstance(one, type(kind)) for one in arguments):
                return None
            if not all(isinstance(one, any_of) for one in arguments):
                return None
            return signature(result, *(kind,) * arity)

    @lower_builtin(function, *(kind,) * arity)
    def _lower(context, builder, signature, arguments):
        return code(builder, *arguments)


_NUMBERS = (LaneReal, types.Number)
_TRUTHS = (LaneMask, types.Boolean)

for _names, _code in (
    ((operator.add, operator.iadd), lambda b, x, y: b.fadd(x, y)),
    ((operator.sub, operator.isub), lambda b, x, y: b.fsub(x, y)),
    ((operator.mul, operator.imul), lambda b, x, y: b.fmul(x, y)),
    ((operator.truediv, operator.itruediv), lambda b, x, y: b.fdiv(x, y)),
):
    for _function in _names:
        _define(_function, 2, REAL, REAL, _code, any_of=_NUMBERS)
for _function, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
):  # fmt: skip
    _define(_function, 2, REAL, MASK, lambda b, x, y, s=_sign: b.fcmp_ordered(s, x, y), any_of=_NUMBERS)
_define(operator.ne, 2, REAL, MASK, lambda b, x, y: b.fcmp_unordered("!=", x, y), any_of=_NUMBERS)
for _names, _code in (
    ((operator.and_, operator.iand), lambda b, x, y: b.and_(x, y)),
    ((operator.or_, operator.ior), lambda b, x, y: b.or_(x, y)),
):
    for _function in _names:
        _define(_function, 2, MASK, MASK, _code, any_of=_TRUTHS)
_define(operator.neg, 1, REAL, REAL, lambda b, x: b.fneg(x), any_of=_NUMBERS)
# as for numbers: the second one if it is larger (smaller), else the first, also if one of them is NaN
_define(max, 2, REAL, REAL, lambda b, x, y: b.select(b.fcmp_ordered(">", y, x), y, x), any_of=_NUMBERS)
_define(min, 2, REAL, REAL, lambda b, x, y: b.select(b.fcmp_ordered("<", y, x), y, x), any_of=_NUMBERS)
_define(operator.not_, 1, MASK, MASK, lambda b, x: b.not_(x), any_of=_TRUTHS)


def _by_intrinsic(name: str) -> Callable[..., Any]:
    def code(builder: Any, x: Any) -> Any:
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{WIDTH}f64")
        return builder.call(function, [x])

    return code


_define(abs, 1, REAL, REAL, _by_intrinsic("fabs"), any_of=_NUMBERS)
_define(math.sqrt, 1, REAL, REAL, _by_intrinsic("sqrt"), any_of=_NUMBERS)
_define(np.sqrt, 1, REAL, REAL, _by_intrinsic("sqrt"), any_of=_NUMBERS)
_define(math.floor, 1, REAL, REAL, _by_intrinsic("floor"), any_of=_NUMBERS)


# --- elements of arrays


def _indices(context: Any, builder: Any, kind: Any, value: Any) -> list[Any]:
    """Return the indices of a subscript as words."""
    if isinstance(kind, types.Integer):
        return [context.cast(builder, value, kind, types.intp)]
    parts = cgutils.unpack_tuple(builder, value, len(kind))
    return [context.cast(builder, part, one, types.intp) for part, one in zip(parts, kind, strict=True)]


def _count(index: Any) -> int | None:
    """Return the number of indices of a subscript; None if it is not made of integers."""
    if isinstance(index, types.Integer):
        return 1
    parts = list(index) if isinstance(index, types.BaseTuple) else []  # type: ignore[call-overload]
    return len(parts) if parts and all(isinstance(one, types.Integer) for one in parts) else None


def _place(context: Any, builder: Any, kind: LaneArray, value: Any, indices: list[Any]) -> Any:
    """Return the address of the element, or of the first one of the row, with these leading indices."""
    shape = cgutils.unpack_tuple(builder, builder.extract_value(value, 5), kind.ndim + 1)
    flat = indices[0]
    for size, index in zip(shape[1 : len(indices)], indices[1:], strict=True):
        flat = builder.add(builder.mul(flat, size), index)
    for size in shape[len(indices) : kind.ndim]:
        flat = builder.mul(flat, size)
    data = builder.bitcast(builder.extract_value(value, 4), _VECTOR.as_pointer())
    return builder.gep(data, [flat], inbounds=True)


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        array, index = arguments
        if not isinstance(array, LaneArray) or (count := _count(index)) is None or count > array.ndim:
            return None
        return signature(REAL if count == array.ndim else LaneArray(array.ndim - count), array, index)


@lower_builtin(operator.getitem, LaneArray, types.Integer)
@lower_builtin(operator.getitem, LaneArray, types.BaseTuple)
def _get(context, builder, signature, arguments):
    kind, index = signature.args
    place = _place(context, builder, kind, arguments[0], _indices(context, builder, index, arguments[1]))
    if isinstance(signature.return_type, LaneReal):
        return builder.load(place, align=_ALIGNMENT)
    dropped, result = kind.ndim - signature.return_type.ndim, signature.return_type
    row = cgutils.create_struct_proxy(result)(context, builder)
    row.data = builder.bitcast(place, _DOUBLE.as_pointer())
    for name, place_of in (("shape", 5), ("strides", 6)):
        sizes = cgutils.unpack_tuple(builder, builder.extract_value(arguments[0], place_of), kind.ndim + 1)
        setattr(row, name, cgutils.pack_array(builder, sizes[dropped:]))
    return row._getvalue()


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        array, index, value = arguments
        if isinstance(array, LaneArray) and _count(index) == array.ndim and _is_operand(value):
            return signature(types.none, array, index, REAL)
        return None


def store_lanes(context: Any, builder: Any, kind: LaneArray, array: Any, indices: list[Any], value: Any) -> None:
    """Generate code that stores one element of an array of lanes."""
    builder.store(value, _place(context, builder, kind, array, indices), align=_ALIGNMENT)


@lower_builtin(operator.setitem, LaneArray, types.Integer, LaneReal)
@lower_builtin(operator.setitem, LaneArray, types.BaseTuple, LaneReal)
def _set(context, builder, signature, arguments):
    kind, index = signature.args[:2]
    indices = _indices(context, builder, index, arguments[1])
    store_lanes(context, builder, kind, arguments[0], indices, arguments[2])
    return context.get_dummy_value()


@infer_global(len)
class _Len(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        return signature(types.intp, *arguments) if isinstance(arguments[0], LaneArray) else None


@lower_builtin(len, LaneArray)
def _length(context, builder, signature, arguments):
    return builder.extract_value(builder.extract_value(arguments[0], 5), 0)


# --- functions for code that serves numbers and lanes


def where(condition, x, y):
    """Return `x` where the condition holds, else `y`; both are evaluated."""
    return x if condition else y


@infer_global(where)
class _Where(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        if len(arguments) != 3 or not isinstance(arguments[0], LaneMask | types.Boolean):
            return None
        if any(isinstance(one, LaneReal) for one in arguments[1:]) or isinstance(arguments[0], LaneMask):
            return signature(REAL, MASK, REAL, REAL)
        return signature(types.float64, types.boolean, types.float64, types.float64)


@lower_builtin(where, LaneMask, LaneReal, LaneReal)
def _where_lanes(context, builder, signature, arguments):
    return builder.select(*arguments)


@lower_builtin(where, types.Boolean, types.Float, types.Float)
def _where_number(context, builder, signature, arguments):
    return builder.select(context.is_true(builder, types.boolean, arguments[0]), *arguments[1:])


def _both_widths(function: Any, name: str) -> None:
    """Define a function of one number, and of lanes, by an intrinsic function of LLVM."""
    _define(function, 1, REAL, REAL, _by_intrinsic(name), any_of=_NUMBERS)

    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            is_number = len(arguments) == 1 and isinstance(arguments[0], types.Float)
            return signature(types.float64, types.float64) if is_number else None

    @lower_builtin(function, types.Float)
    def _lower(context, builder, signature, arguments):
        kind = ir.FunctionType(_DOUBLE, [_DOUBLE])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.f64"), arguments)


def nearest(x):
    """Return the nearest whole number as a float, ties to even."""
    return np.rint(x)


def below(x):
    """Return the largest whole number not above `x`, as a float."""
    return np.floor(x)


_both_widths(nearest, "rint")
_both_widths(below, "floor")


def _number_in_typing(typing_context, x, lane):
    """Return the number in one lane."""

    def generate(context, builder, signature, arguments):
        return builder.extract_element(arguments[0], builder.trunc(arguments[1], ir.IntType(32)))

    return types.float64(REAL, types.int64), generate


number_in: Any = intrinsic(_number_in_typing)


def _put_in_typing(typing_context, x, lane, number):
    """Return lanes with another number in one of them."""

    def generate(context, builder, signature, arguments):
        return builder.insert_element(arguments[0], arguments[2], builder.trunc(arguments[1], ir.IntType(32)))

    return REAL(REAL, types.int64, types.float64), generate


put_in: Any = intrinsic(_put_in_typing)


def any_of(condition):
    """Return whether the condition holds, in at least one lane."""
    return bool(condition)


@overload(any_of, inline="always")
def _any_of(condition):
    if isinstance(condition, LaneMask):
        return lambda condition: _any_lane(condition)
    return lambda condition: condition


def _any_lane_typing(typing_context, condition):
    def generate(context, builder, signature, arguments):
        word = ir.IntType(WIDTH)
        return builder.icmp_unsigned("!=", builder.bitcast(arguments[0], word), word(0))

    return types.boolean(condition), generate


_any_lane: Any = intrinsic(_any_lane_typing)


def is_refused(sound):
    """Return whether a kernel must give up because a condition does not hold.

    In lanes it never does: the values of that lane become NaN (`usable`), and its run is repeated alone.
    """
    return not sound


@overload(is_refused, inline="always")
def _is_refused(sound):
    if isinstance(sound, LaneMask):
        return lambda sound: False
    return lambda sound: not sound


def usable(x, sound):
    """Return `x`; NaN in lanes in which a condition does not hold."""
    return x


@overload(usable, inline="always")
def _usable(x, sound):
    if isinstance(sound, LaneMask):
        return lambda x, sound: where(sound, x, np.nan)
    return lambda x, sound: x


def _one_by_one(function: Any, of_numbers: Any) -> None:
    """Define a function that applies a compiled function of numbers to each lane."""

    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            if any(isinstance(one, LaneReal) for one in arguments):
                return signature(REAL, *(REAL,) * len(arguments))
            return signature(types.float64, *(types.float64,) * len(arguments))

    def call(context: Any, builder: Any, values: Any) -> Any:
        kind = types.float64(*(types.float64,) * len(values))
        return context.get_function(of_numbers, kind)(builder, values)

    @lower_builtin(function, types.VarArg(types.Float))
    def _lower_number(context, builder, signature, arguments):
        return call(context, builder, arguments)

    @lower_builtin(function, types.VarArg(LaneReal))
    def _lower_lanes(context, builder, signature, arguments):
        result = ir.Constant(_VECTOR, ir.Undefined)
        for lane in map(ir.IntType(32), range(WIDTH)):
            one = call(context, builder, [builder.extract_element(value, lane) for value in arguments])
            result = builder.insert_element(result, one, lane)
        return result


def sine_of_each(x):
    """Return the sine by the C library."""
    return math.sin(x)


def cosine_of_each(x):
    """Return the cosine by the C library."""
    return math.cos(x)


def hypot_of_each(x, y):
    """Return ``sqrt(x^2 + y^2)`` without overflow, by the C library."""
    return math.hypot(x, y)


_one_by_one(sine_of_each, math.sin)
_one_by_one(cosine_of_each, math.cos)
_one_by_one(hypot_of_each, math.hypot)
