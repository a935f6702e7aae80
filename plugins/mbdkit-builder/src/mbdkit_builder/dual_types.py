"""Dual numbers: forward-mode automatic differentiation of compiled code with respect to `DIRECTIONS` parameters.

A dual number is a value with its derivatives with respect to several parameters. Kernels are compiled for the types of
their arguments. If a bundle holds arrays of dual numbers (`mbdkit_builder.dual_arrays`), the same source
becomes a kernel that differentiates what it computes. Unlike lanes (`mbdkit_builder.lane_types`), dual numbers
have a single control flow: comparisons compare values and return ordinary truth values. The values are computed by the
same operations as without derivatives and are therefore bitwise identical.

This module uses the same parts of Numba as `mbdkit_builder.lane_types`.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_cast
from numba.core.typeconv import Conversion  # type: ignore[attr-defined]
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, overload, register_model

from mbdkit.base import elementary
from mbdkit.engine.native import arithmetic
from mbdkit.engine.native.arithmetic import DIRECTIONS, value_of, where
from mbdkit.engine.native.operation_rules import compiled_rule
from mbdkit.expressions.operations import OPERATIONS, Operation
from mbdkit_builder.implementation import implement

DOUBLE = ir.DoubleType()
VECTOR = ir.VectorType(DOUBLE, DIRECTIONS)

Pair = tuple[Any, Any]  #: Value and derivatives, as LLVM values.


class DualNumber(types.Type):
    """Numba type of a dual number."""

    arithmetic = "dual"

    def __init__(self) -> None:
        super().__init__(name=f"Dual{DIRECTIONS}")

    def unify(self, typing_context: Any, other: Any) -> Any:
        """Return this type for numbers, so that a variable may begin as ``0.0``."""
        return self if is_real(other) else None

    def can_convert_from(self, typing_context: Any, other: Any) -> Any:
        """Allow numbers, which become constants."""
        return Conversion.safe if is_real(other) else None


class _Derivatives(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"Derivatives{DIRECTIONS}")


class DualComplex(types.Type):
    """Numba type of a complex dual number; see `mbdkit_builder.dual_complex`."""

    def __init__(self) -> None:
        super().__init__(name=f"DualComplex{DIRECTIONS}")


DUAL, DUAL_COMPLEX, _DERIVATIVES = DualNumber(), DualComplex(), _Derivatives()


@register_model(_Derivatives)
class _DerivativesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any):
        super().__init__(manager, kind, VECTOR)


@register_model(DualNumber)
class _DualModel(models.StructModel):
    def __init__(self, manager: Any, kind: Any):
        super().__init__(manager, kind, [("value", types.float64), ("derivatives", _DERIVATIVES)])


@register_model(DualComplex)
class _ComplexModel(models.StructModel):
    def __init__(self, manager: Any, kind: Any):
        super().__init__(manager, kind, [("real", DUAL), ("imag", DUAL)])


def is_real(kind: Any) -> bool:
    """Return whether a value of this type can be used as a dual number."""
    return isinstance(kind, DualNumber | types.Number) and not isinstance(kind, types.Complex)


def _repeated(builder: Any, value: Any) -> Any:
    one = builder.insert_element(ir.Constant(VECTOR, ir.Undefined), value, ir.IntType(32)(0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), DIRECTIONS), [0] * DIRECTIONS)
    return builder.shuffle_vector(one, ir.Constant(VECTOR, ir.Undefined), zeros)


def no_derivatives() -> Any:
    """Return the derivatives of a constant."""
    return ir.Constant(VECTOR, [0.0] * DIRECTIONS)


@lower_cast(types.Number, DualNumber)
def _number_to_dual(context, builder, given, wanted, value):
    return cgutils.pack_struct(builder, [context.cast(builder, value, given, types.float64), no_derivatives()])


# --- arithmetic and comparisons


def _scaled(b: Any, factor: Any, vector: Any) -> Any:
    return b.fmul(_repeated(b, factor), vector)


def _added(b: Any, x: Any, y: Any) -> Any:
    """Return the sum of two vectors of derivatives; None stands for zeros."""
    return y if x is None else x if y is None else b.fadd(x, y)


def _add(b: Any, x: Pair, y: Pair) -> Pair:
    return b.fadd(x[0], y[0]), _added(b, x[1], y[1])


def _subtract(b: Any, x: Pair, y: Pair) -> Pair:
    if y[1] is None:
        return b.fsub(x[0], y[0]), x[1]
    return b.fsub(x[0], y[0]), b.fneg(y[1]) if x[1] is None else b.fsub(x[1], y[1])


def _multiply(b: Any, x: Pair, y: Pair) -> Pair:
    left = None if x[1] is None else _scaled(b, y[0], x[1])
    right = None if y[1] is None else _scaled(b, x[0], y[1])
    return b.fmul(x[0], y[0]), _added(b, left, right)


def _divide(b: Any, x: Pair, y: Pair) -> Pair:
    quotient = b.fdiv(x[0], y[0])
    rest = x[1]
    if y[1] is not None:
        lost = _scaled(b, quotient, y[1])
        rest = b.fneg(lost) if rest is None else b.fsub(rest, lost)
    return quotient, _scaled(b, b.fdiv(DOUBLE(1.0), y[0]), rest)


def _chosen(sign: str) -> Callable[[Any, Pair, Pair], Pair]:
    """Return the code of ``max`` or ``min``: the second operand if it is larger (smaller), else the first."""

    def code(b: Any, x: Pair, y: Pair) -> Pair:
        is_second = b.fcmp_ordered(sign, y[0], x[0])
        one, other = (no_derivatives() if d is None else d for d in (x[1], y[1]))
        return b.select(is_second, y[0], x[0]), b.select(is_second, other, one)

    return code


def _compared(sign: str) -> Callable[[Any, Pair, Pair], Any]:
    return lambda b, x, y: b.fcmp_ordered(sign, x[0], y[0])


def _define(function: Any, code: Callable[[Any, Pair, Pair], Any], result: Any = DUAL) -> None:
    """Define a function of two dual numbers, of which one may be an ordinary number.

    `code` gets None in place of the derivatives of an ordinary number.
    """

    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            if len(arguments) != 2 or not all(map(is_real, arguments)):
                return None
            if not any(isinstance(one, DualNumber) for one in arguments):
                return None
            kinds = (one if isinstance(one, DualNumber) else types.float64 for one in arguments)
            return signature(result, *kinds)

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pairs = (
            cgutils.unpack_tuple(builder, value, 2) if isinstance(kind, DualNumber) else (value, None)
            for kind, value in zip(signature.args, arguments, strict=True)
        )
        found = code(builder, *pairs)
        return cgutils.pack_struct(builder, found) if isinstance(found, tuple) else found

    for kinds in ((DualNumber, DualNumber), (DualNumber, types.Float), (types.Float, DualNumber)):
        lower_builtin(function, *kinds)(lower)


_ARITHMETIC: Mapping[Any, Callable[[Any, Pair, Pair], Pair]] = {
    operator.add: _add, operator.iadd: _add, operator.sub: _subtract, operator.isub: _subtract,
    operator.mul: _multiply, operator.imul: _multiply, operator.truediv: _divide, operator.itruediv: _divide,
    max: _chosen(">"), min: _chosen("<"),
}  # fmt: skip
for _function, _code in _ARITHMETIC.items():
    _define(_function, _code)
for _function, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
):  # fmt: skip
    _define(_function, _compared(_sign), types.boolean)
_define(operator.ne, lambda b, x, y: b.fcmp_unordered("!=", x[0], y[0]), types.boolean)


# --- parts


def _value_typing(typing_context, x):
    if not isinstance(x, DualNumber):
        return None

    def generate(context, builder, signature, arguments):
        return builder.extract_value(arguments[0], 0)

    return types.float64(x), generate


_value: Any = intrinsic(_value_typing)


@overload(value_of, inline="always")
def _value_of(x):
    if isinstance(x, DualNumber):
        return lambda x: _value(x)
    return lambda x: x


@implement(arithmetic.with_value)
def _with_value(typing_context, x, value):
    def generate(context, builder, signature, arguments):
        return builder.insert_value(arguments[0], arguments[1], 0)

    return DUAL(DUAL, types.float64), generate


@implement(arithmetic.chain)
def _chain(typing_context, x, value, slope):
    def generate(context, builder, signature, arguments):
        derivatives = _scaled(builder, arguments[2], builder.extract_value(arguments[0], 1))
        return cgutils.pack_struct(builder, [arguments[1], derivatives])

    return DUAL(DUAL, types.float64, types.float64), generate


@implement(arithmetic.larger_derivatives)
def _larger_derivatives(typing_context, x, y):
    """Return a dual number whose derivatives are the larger absolute values of those of `x` and `y`; its value is that
    of `x`.
    """

    def generate(context, builder, signature, arguments):
        kind = ir.FunctionType(VECTOR, [VECTOR])
        size = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fabs.v{DIRECTIONS}f64")
        one, other = (builder.call(size, [builder.extract_value(x, 1)]) for x in arguments)
        is_first = builder.fcmp_ordered(">=", one, other)  # not if the second is not a number
        return builder.insert_value(arguments[0], builder.select(is_first, one, other), 1)

    return DUAL(DUAL, DUAL), generate


@implement(arithmetic.largest_quotient)
def _largest_quotient(typing_context, x, y):
    """Return the largest quotient of a derivative of `x` and the same derivative of `y`, none of which is negative.

    0 / 0 counts as 0. The result is infinite if a quotient is NaN.
    """

    def generate(context, builder, signature, arguments):
        above, below = (builder.extract_value(x, 1) for x in arguments)
        largest = DOUBLE(0.0)
        for i in map(ir.IntType(32), range(DIRECTIONS)):
            one = builder.extract_element(above, i)
            quotient = builder.fdiv(one, builder.extract_element(below, i))
            quotient = builder.select(builder.fcmp_ordered("==", one, DOUBLE(0.0)), DOUBLE(0.0), quotient)
            quotient = builder.select(builder.fcmp_unordered("uno", quotient, quotient), DOUBLE(np.inf), quotient)
            largest = builder.select(builder.fcmp_ordered(">", quotient, largest), quotient, largest)
        return largest

    return types.float64(DUAL, DUAL), generate


# --- functions


@infer_global(where)
class _Where(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        if len(arguments) != 3 or not isinstance(arguments[0], types.Boolean):
            return None
        if any(isinstance(one, DualNumber) for one in arguments[1:]) and all(map(is_real, arguments[1:])):
            return signature(DUAL, types.boolean, DUAL, DUAL)
        return None


@lower_builtin(where, types.Boolean, DualNumber, DualNumber)
def _where_dual(context, builder, signature, arguments):
    condition = context.is_true(builder, types.boolean, arguments[0])
    pairs = (cgutils.unpack_tuple(builder, one, 2) for one in arguments[1:])
    return cgutils.pack_struct(builder, [builder.select(condition, x, y) for x, y in zip(*pairs, strict=True)])


def _of_one(function: Any, code: Callable[..., Any]) -> None:
    @overload(function)
    def _typed(x):
        return code if isinstance(x, DualNumber) else None


def _functions_of(operation: Operation) -> set[Any]:
    return {getattr(math, operation.name, operation.number), operation.ufunc}


def _by_rule(rule: Any) -> Callable[..., Any]:
    def code(x):
        value, slope, _ = rule(_value(x))
        return arithmetic.chain(x, value, slope)

    return code


for _operation in OPERATIONS.values():
    if _operation.arity == 1 and _operation.name != "powi":
        for _function in _functions_of(_operation):
            _of_one(_function, _by_rule(compiled_rule(_operation)))
_FUNCTIONS: tuple[tuple[Any, Callable[[Any], Any]], ...] = (
    (math.fabs, lambda x: abs(x)),
    (math.sinh, lambda x: arithmetic.chain(x, math.sinh(_value(x)), math.cosh(_value(x)))),
    (math.cosh, lambda x: arithmetic.chain(x, math.cosh(_value(x)), math.sinh(_value(x)))),
    (operator.pos, lambda x: x),
    (float, lambda x: x),
    (int, lambda x: int(_value(x))),
    (math.floor, lambda x: math.floor(_value(x))),
    (math.isnan, lambda x: math.isnan(_value(x))),
    (np.isnan, lambda x: math.isnan(_value(x))),
)
for _function, _function_code in _FUNCTIONS:
    _of_one(_function, _function_code)


@overload(operator.pow)
def _power(x, n):
    if isinstance(x, DualNumber) and isinstance(n, types.Integer | types.Float):
        return lambda x, n: arithmetic.chain(x, _value(x) ** n, 0.0 if n == 0 else n * _value(x) ** (n - 1.0))
    if isinstance(n, DualNumber) and is_real(x):
        return _general_power
    return None


def _general_power(x, n):
    """Return x**n; if the base is not positive, there is no derivative with respect to the exponent, which is then
    treated as constant.
    """
    base, exponent = value_of(x), _value(n)
    value = base**exponent
    by_exponent = value * math.log(base) if base > 0.0 else 0.0
    constant = (x * 0.0 + n * 0.0) * 0.0
    by_base = 0.0 if exponent == 0.0 else exponent * base ** (exponent - 1.0)
    return arithmetic.with_value(constant + by_base * (x - base) + by_exponent * (n - exponent), value)


def _of_two(function: Any, code: Callable[..., Any]) -> None:
    @overload(function)
    def _typed(x, y):
        has_dual = isinstance(x, DualNumber) or isinstance(y, DualNumber)
        return code if has_dual and is_real(x) and is_real(y) else None


def _by_rule_of_two(rule: Any) -> Callable[..., Any]:
    def code(x, y):
        a, b = value_of(x), value_of(y)
        value, by_first, _ = rule(a, 1.0, 0.0, b, 0.0, 0.0)
        _, by_second, _ = rule(a, 0.0, 0.0, b, 1.0, 0.0)
        return arithmetic.with_value(by_first * x + by_second * y, value)

    return code


def _remainder(x, y):
    whole = math.floor(value_of(x) / value_of(y))
    return arithmetic.with_value(x - whole * y, value_of(x) % value_of(y))


def _length(x, y):
    a, b = value_of(x), value_of(y)
    size = math.hypot(a, b)
    scale = size if size > 0.0 else 1.0
    return arithmetic.with_value((a / scale) * x + (b / scale) * y, size)


for _operation in OPERATIONS.values():
    if _operation.arity == 2 and _operation.number not in (*_ARITHMETIC, elementary.pow):
        for _function in _functions_of(_operation):
            _of_two(_function, _by_rule_of_two(compiled_rule(_operation)))
_of_two(operator.mod, _remainder)
_of_two(math.hypot, _length)
