"""Arithmetic on complex lanes (`LaneComplex`: one complex number for each run), needed for complex stage matrices.

Every operation rounds like that of Numba on complex numbers; real operands are converted to complex first, as in Numba.
This module uses the same parts of Numba as `mbdkit_builder.lane_types`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_cast
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_global, signature
from numba.extending import infer_getattr, lower_builtin, lower_getattr, models, register_model

from mbdkit_builder.lane_types import COMPLEX, MASK, REAL, LaneComplex, LaneReal

Parts = tuple[Any, Any]  #: Real and imaginary parts, as vectors of LLVM.


@register_model(LaneComplex)
class _ComplexModel(models.StructModel):
    def __init__(self, manager: Any, kind: Any):
        super().__init__(manager, kind, [("real", REAL), ("imag", REAL)])


def _parts(builder: Any, value: Any) -> Parts:
    real, imaginary = cgutils.unpack_tuple(builder, value, 2)
    return real, imaginary


# --- numbers and real lanes become complex ones


@lower_cast(LaneReal, LaneComplex)
def _real_to_complex(context, builder, given, wanted, value):
    return cgutils.pack_struct(builder, [value, context.get_constant_null(REAL)])


@lower_cast(types.Number, LaneComplex)
def _number_to_complex(context, builder, given, wanted, value):
    number = context.cast(builder, value, given, types.complex128)
    parts = [context.cast(builder, part, types.float64, REAL) for part in _parts(builder, number)]
    return cgutils.pack_struct(builder, parts)


# --- arithmetic


def _is_complex(arguments: Any) -> bool:
    if any(isinstance(one, LaneComplex) for one in arguments):
        return all(isinstance(one, LaneComplex | LaneReal | types.Number) for one in arguments)
    is_mixed = any(isinstance(one, LaneReal) for one in arguments)
    return is_mixed and any(isinstance(one, types.Complex) for one in arguments)


def _define(function: Any, code: Callable[[Any, Parts, Parts], Any], result: Any = COMPLEX) -> None:
    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            is_defined = len(arguments) == 2 and _is_complex(arguments)
            return signature(result, COMPLEX, COMPLEX) if is_defined else None

    @lower_builtin(function, LaneComplex, LaneComplex)
    def _lower(context, builder, signature, arguments):
        found = code(builder, *(_parts(builder, one) for one in arguments))
        return cgutils.pack_struct(builder, found) if isinstance(found, tuple) else found


def _product(b: Any, x: Parts, y: Parts) -> Parts:
    real = b.fsub(b.fmul(x[0], y[0]), b.fmul(x[1], y[1]))
    return real, b.fadd(b.fmul(x[0], y[1]), b.fmul(x[1], y[0]))


def _size(b: Any, x: Any) -> Any:
    kind = ir.FunctionType(x.type, [x.type])
    return b.call(cgutils.get_or_insert_function(b.module, kind, f"llvm.fabs.v{x.type.count}f64"), [x])


def _quotient(b: Any, x: Parts, y: Parts) -> Parts:
    """Return x / y by Smith's method, as Numba and CPython do; NaN where y is zero or not a number."""
    size, other = _size(b, y[0]), _size(b, y[1])
    is_real = b.fcmp_ordered(">=", size, other)  # the real part of y is the larger one
    large, small = b.select(is_real, y[0], y[1]), b.select(is_real, y[1], y[0])
    ratio = b.fdiv(small, large)
    divisor = b.fadd(large, b.fmul(small, ratio))
    along, across = b.select(is_real, x[0], x[1]), b.select(is_real, x[1], x[0])
    real = b.fdiv(b.fadd(along, b.fmul(across, ratio)), divisor)
    by_real, by_imaginary = b.fsub(x[1], b.fmul(x[0], ratio)), b.fsub(b.fmul(x[1], ratio), x[0])
    return real, b.fdiv(b.select(is_real, by_real, by_imaginary), divisor)


for _functions, _code in (
    ((operator.add, operator.iadd), lambda b, x, y: (b.fadd(x[0], y[0]), b.fadd(x[1], y[1]))),
    ((operator.sub, operator.isub), lambda b, x, y: (b.fsub(x[0], y[0]), b.fsub(x[1], y[1]))),
    ((operator.mul, operator.imul), _product),
    ((operator.truediv, operator.itruediv), _quotient),
):
    for _function in _functions:
        _define(_function, _code)
_define(
    operator.ne,
    lambda b, x, y: b.or_(b.fcmp_unordered("!=", x[0], y[0]), b.fcmp_unordered("!=", x[1], y[1])),
    MASK,
)


# --- parts


@infer_getattr
class _RealParts(AttributeTemplate):
    key = LaneReal

    def generic_resolve(self, value: Any, name: str) -> Any:  # type: ignore[override]
        """Return the type of a part."""
        return REAL if name in ("real", "imag") else None


@infer_getattr
class _ComplexParts(AttributeTemplate):
    key = LaneComplex

    def generic_resolve(self, value: Any, name: str) -> Any:  # type: ignore[override]
        """Return the type of a part."""
        return REAL if name in ("real", "imag") else None


@lower_getattr(LaneReal, "real")
def _real_of_real(context, builder, kind, value):
    return value


@lower_getattr(LaneReal, "imag")
def _imaginary_of_real(context, builder, kind, value):
    return context.get_constant_null(REAL)


@lower_getattr(LaneComplex, "real")
def _real_of_complex(context, builder, kind, value):
    return _parts(builder, value)[0]


@lower_getattr(LaneComplex, "imag")
def _imaginary_of_complex(context, builder, kind, value):
    return _parts(builder, value)[1]
