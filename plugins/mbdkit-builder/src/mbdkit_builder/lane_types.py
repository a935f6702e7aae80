"""SIMD lanes: several runs in one pass of compiled code, each in one element of a vector of floating-point numbers.

Kernels are compiled for the types of their arguments. If a bundle holds arrays of lanes instead of arrays of numbers
(`mbdkit_builder.lane_arrays`), the same source becomes a kernel that advances `WIDTH` runs at once: every
element of such an array is a vector of `WIDTH` doubles, one for each run, and arithmetic works lane by lane. Each
operation on a vector rounds like the operation on a number, and nothing is reassociated or contracted, so that the
result in a lane is bitwise identical to that of the single run.

A comparison of vectors is a mask (`LaneMask`), on which Python cannot branch. Code for both numbers and lanes therefore
uses `where` and ``&`` instead of branches, and the other functions defined in this module.

This module uses the public API of Numba (``numba.extending``) and llvmlite. It also uses internals of Numba:
`AbstractTemplate`, `infer_global` and `signature`.
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
from numba.extending import intrinsic, lower_builtin, models, overload, register_model

from mbdkit.engine.kernels.elementary import FUNCTIONS
from mbdkit.engine.kernels.elementary.exact_sums import bits_of, from_bits
from mbdkit.engine.kernels.elementary.tables import entry
from mbdkit.engine.native import arithmetic
from mbdkit.engine.native.arithmetic import any_of, where
from mbdkit.engine.native.levels import WIDTH
from mbdkit_builder.implementation import implement

DOUBLE, _BIT, _WORD = ir.DoubleType(), ir.IntType(1), ir.IntType(64)
VECTOR, _BITS, _WORDS, _POINTERS = (ir.VectorType(kind, WIDTH) for kind in (DOUBLE, _BIT, _WORD, ir.PointerType()))


class _Lanes(types.Type):
    """Numba type of `WIDTH` values, one for each lane."""

    def __init__(self) -> None:
        super().__init__(name=f"{type(self).__name__}{WIDTH}")

    def unify(self, typing_context: Any, other: Any) -> Any:
        """Return this type for plain values, so that a variable may begin as ``0.0``."""
        return self if is_operand(other, self) else None

    def can_convert_from(self, typing_context: Any, other: Any) -> Any:
        """Allow plain values, which become equal in all lanes."""
        return Conversion.safe if is_operand(other, self) else None


class LaneReal(_Lanes):
    """Numba type of `WIDTH` doubles."""

    arithmetic = "lanes"


class LaneMask(_Lanes):
    """Numba type of `WIDTH` truth values."""

    arithmetic = "lanes"


class LaneComplex(_Lanes):
    """Numba type of `WIDTH` complex numbers; see `mbdkit_builder.lane_complex`."""


class LaneInteger(_Lanes):
    """Numba type of `WIDTH` integers of 64 bits, in which elementary functions compute with the bits of doubles."""

    arithmetic = "lanes"


REAL, MASK, COMPLEX, INTEGER = LaneReal(), LaneMask(), LaneComplex(), LaneInteger()


def _register(kind: type[_Lanes], vector: ir.VectorType) -> None:
    @register_model(kind)
    class _Model(models.PrimitiveModel):
        def __init__(self, manager: Any, kind: Any):
            super().__init__(manager, kind, vector)


_register(LaneReal, VECTOR)
_register(LaneMask, _BITS)
_register(LaneInteger, _WORDS)


# --- numbers become equal in all lanes


def _splat(builder: Any, value: Any, kind: ir.VectorType) -> Any:
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.IntType(32)(0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), zeros)


@lower_cast(types.Number, LaneReal)
def _number_to_lanes(context, builder, given, wanted, value):
    return _splat(builder, context.cast(builder, value, given, types.float64), VECTOR)


@lower_cast(types.Integer, LaneInteger)
def _integer_to_lanes(context, builder, given, wanted, value):
    return _splat(builder, context.cast(builder, value, given, types.int64), _WORDS)


@lower_cast(types.Boolean, LaneMask)
def _truth_to_lanes(context, builder, given, wanted, value):
    return _splat(builder, builder.trunc(value, _BIT) if value.type != _BIT else value, _BITS)


# --- arithmetic and comparisons


def is_operand(kind: Any, item: Any) -> bool:
    """Return whether a value of type `kind` can be used as lanes of type `item`."""
    if isinstance(item, LaneMask):
        return isinstance(kind, LaneMask | types.Boolean)
    if isinstance(item, LaneInteger):
        return isinstance(kind, LaneInteger | types.Integer)
    if isinstance(item, LaneReal):
        return isinstance(kind, LaneReal | types.Number) and not isinstance(kind, types.Complex)
    return isinstance(kind, type(item) | LaneReal | types.Number)


def _define(function: Any, arity: int, kind: Any, result: Any, code: Callable[..., Any]) -> None:
    """Define `function` for arguments of the lane type `kind`, of which all but one may be plain values."""

    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            if len(arguments) != arity or not any(isinstance(one, type(kind)) for one in arguments):
                return None
            if not all(is_operand(argument, kind) for argument in arguments):
                return None
            return signature(result, *(kind,) * arity)

    @lower_builtin(function, *(kind,) * arity)
    def _lower(context, builder, signature, arguments):
        return code(builder, *arguments)


def _define_operators(names: dict[str, str], kind: Any) -> None:
    """Define operators of Python and their in-place forms by instructions of LLVM with these names."""
    for name, instruction in names.items():
        for function in (getattr(operator, name), getattr(operator, f"i{name.rstrip('_')}")):
            _define(function, 2, kind, kind, lambda b, x, y, code=instruction: getattr(b, code)(x, y))


_SIGNS = {operator.lt: "<", operator.le: "<=", operator.gt: ">", operator.ge: ">=", operator.eq: "=="}
_define_operators({"add": "fadd", "sub": "fsub", "mul": "fmul", "truediv": "fdiv"}, REAL)
_LOGICAL = {"and_": "and_", "or_": "or_"}
_define_operators(_LOGICAL, MASK)
_define_operators(_LOGICAL | {"add": "add", "sub": "sub", "mul": "mul"}, INTEGER)
_define_operators({"xor": "xor", "lshift": "shl", "rshift": "ashr"}, INTEGER)
for _function, _sign in _SIGNS.items():
    _define(_function, 2, REAL, MASK, lambda b, x, y, s=_sign: b.fcmp_ordered(s, x, y))
    _define(_function, 2, INTEGER, MASK, lambda b, x, y, s=_sign: b.icmp_signed(s, x, y))
_define(operator.ne, 2, REAL, MASK, lambda b, x, y: b.fcmp_unordered("!=", x, y))
_define(operator.ne, 2, INTEGER, MASK, lambda b, x, y: b.icmp_signed("!=", x, y))
_define(operator.neg, 1, REAL, REAL, lambda b, x: b.fneg(x))
_define(operator.neg, 1, INTEGER, INTEGER, lambda b, x: b.neg(x))
_define(operator.not_, 1, MASK, MASK, lambda b, x: b.not_(x))
# as for numbers: the second operand if it is larger (smaller); otherwise, and also if one is NaN, the first
_define(max, 2, REAL, REAL, lambda b, x, y: b.select(b.fcmp_ordered(">", y, x), y, x))
_define(min, 2, REAL, REAL, lambda b, x, y: b.select(b.fcmp_ordered("<", y, x), y, x))


def _by_intrinsic(name: str) -> Callable[..., Any]:
    def code(builder: Any, x: Any) -> Any:
        kind = ir.FunctionType(VECTOR, [VECTOR])
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{WIDTH}f64")
        return builder.call(function, [x])

    return code


_define(abs, 1, REAL, REAL, _by_intrinsic("fabs"))
_define(math.sqrt, 1, REAL, REAL, _by_intrinsic("sqrt"))
_define(np.sqrt, 1, REAL, REAL, _by_intrinsic("sqrt"))
_define(math.floor, 1, REAL, REAL, _by_intrinsic("floor"))


# --- functions for code that serves numbers and lanes


@infer_global(where)
class _Where(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        if len(arguments) != 3 or not isinstance(arguments[0], LaneMask | types.Boolean):
            return None
        if any(isinstance(one, LaneInteger) for one in arguments[1:]):
            return signature(INTEGER, MASK, INTEGER, INTEGER)
        if any(isinstance(one, LaneReal) for one in arguments[1:]) or isinstance(arguments[0], LaneMask):
            return signature(REAL, MASK, REAL, REAL)
        if not all(isinstance(one, types.Number) for one in arguments[1:]):
            return None
        are_integers = all(isinstance(one, types.Integer) for one in arguments[1:])
        kind = types.int64 if are_integers else types.float64
        return signature(kind, types.boolean, kind, kind)


@lower_builtin(where, LaneMask, LaneInteger, LaneInteger)
@lower_builtin(where, LaneMask, LaneReal, LaneReal)
def _where_lanes(context, builder, signature, arguments):
    return builder.select(*arguments)


@lower_builtin(where, types.Boolean, types.Integer, types.Integer)
@lower_builtin(where, types.Boolean, types.Float, types.Float)
def _where_number(context, builder, signature, arguments):
    return builder.select(context.is_true(builder, types.boolean, arguments[0]), *arguments[1:])


def _both_widths(function: Any, name: str) -> None:
    _define(function, 1, REAL, REAL, _by_intrinsic(name))

    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            is_number = len(arguments) == 1 and isinstance(arguments[0], types.Float)
            return signature(types.float64, types.float64) if is_number else None

    @lower_builtin(function, types.Float)
    def _lower(context, builder, signature, arguments):
        kind = ir.FunctionType(DOUBLE, [DOUBLE])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.f64"), arguments)


_both_widths(arithmetic.nearest, "rint")
_both_widths(arithmetic.below, "floor")


@implement(arithmetic.number_in)
def _number_in(typing_context, x, lane):
    def generate(context, builder, signature, arguments):
        return builder.extract_element(arguments[0], builder.trunc(arguments[1], ir.IntType(32)))

    return types.float64(REAL, types.int64), generate


@implement(arithmetic.put_in)
def _put_in(typing_context, x, lane, number):
    def generate(context, builder, signature, arguments):
        return builder.insert_element(arguments[0], arguments[2], builder.trunc(arguments[1], ir.IntType(32)))

    return REAL(REAL, types.int64, types.float64), generate


def _with_bits(function: Any, numbers: Any, lanes: Any) -> None:
    """Define a placeholder that changes the type of a value and not its bits; the signatures are for both widths."""

    def typing(typing_context: Any, x: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.bitcast(arguments[0], context.get_value_type(signature.return_type))

        return (lanes if isinstance(x, LaneReal | LaneInteger) else numbers), generate

    implement(function)(typing)


_with_bits(bits_of, types.int64(types.float64), INTEGER(REAL))
_with_bits(from_bits, types.float64(types.int64), REAL(INTEGER))


@implement(entry)
def _entry(typing_context, table, index):
    def generate(context, builder, signature, arguments):
        start = context.make_array(table)(context, builder, arguments[0]).data
        if index != INTEGER:
            return builder.load(builder.gep(start, arguments[1:]))
        offsets = builder.shl(arguments[1], ir.Constant(_WORDS, [3] * WIDTH))
        places = builder.add(_splat(builder, builder.ptrtoint(start, _WORD), _WORDS), offsets)
        kind = ir.FunctionType(VECTOR, [_POINTERS, ir.IntType(32), _BITS, VECTOR])
        gather = cgutils.get_or_insert_function(builder.module, kind, f"llvm.masked.gather.v{WIDTH}f64.v{WIDTH}p0")
        everywhere, nothing = ir.Constant(_BITS, [1] * WIDTH), ir.Constant(VECTOR, ir.Undefined)
        return builder.call(gather, [builder.inttoptr(places, _POINTERS), ir.IntType(32)(8), everywhere, nothing])

    return (REAL(table, INTEGER) if index == INTEGER else types.float64(table, types.int64)), generate


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


@overload(arithmetic.is_refused, inline="always")
def _is_refused(sound):
    if isinstance(sound, LaneMask):
        return lambda sound: False
    return lambda sound: not sound


@overload(arithmetic.usable, inline="always")
def _usable(x, sound):
    if isinstance(sound, LaneMask):
        return lambda x, sound: where(sound, x, np.nan)
    return lambda x, sound: x


@overload(arithmetic.renewed, inline="always")
def _renewed(new, old, condition):
    if isinstance(condition, LaneMask):
        return lambda new, old, condition: where(condition, new, old)
    return lambda new, old, condition: new


@overload(arithmetic.put_in_place)
def _put_in_place(values, place, x):
    if isinstance(x, LaneReal):

        def put(values, place, x):
            for lane in range(WIDTH):
                values[lane, place] = arithmetic.number_in(x, lane)

    else:

        def put(values, place, x):
            values[place] = x

    return put


@infer_global(operator.pow)
class _WholePower(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        base, exponent = arguments
        is_whole = isinstance(base, LaneReal) and isinstance(exponent, types.Integer)
        return signature(REAL, REAL, exponent) if is_whole else None


@lower_builtin(operator.pow, LaneReal, types.Integer)
def _power_of_lanes(context, builder, signature, arguments):
    kind = context.typing_context.resolve_function_type(operator.pow, (types.float64, signature.args[1]), {})
    power, result = context.get_function(operator.pow, kind), ir.Constant(VECTOR, ir.Undefined)
    exponent = context.cast(builder, arguments[1], signature.args[1], kind.args[1])
    for lane in map(ir.IntType(32), range(WIDTH)):
        one = power(builder, [builder.extract_element(arguments[0], lane), exponent])
        result = builder.insert_element(result, one, lane)
    return result


def _elementary(function: Any, own: Any) -> None:
    """Define a function of `math` for lanes by an elementary function; one of two arguments may be a number."""

    def of_two_lanes(x, y):
        return own(where(y == y, x, x), where(x == x, y, y))  # which makes lanes of a number

    def typed_for_two(x, y):
        is_defined = isinstance(x, LaneReal) or isinstance(y, LaneReal)
        return of_two_lanes if is_defined and all(isinstance(one, LaneReal | types.Float) for one in (x, y)) else None

    if own.__code__.co_argcount == 1:
        overload(function)(lambda x: own if isinstance(x, LaneReal) else None)
    else:
        overload(function)(typed_for_two)


_NAMES = {"pow": operator.pow, "tgamma": math.gamma}  #: Functions that have other names in the C library.
for _name, _own in FUNCTIONS.items():
    _elementary(_NAMES.get(_name) or getattr(math, _name), _own)
