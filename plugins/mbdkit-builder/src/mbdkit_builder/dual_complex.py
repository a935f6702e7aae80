"""Arithmetic on complex dual numbers: the operations needed for linear systems with a complex matrix of plain
numbers.
"""

from __future__ import annotations

import operator
from typing import Any

from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_cast
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr, overload

from mbdkit_builder.dual_types import DUAL, DUAL_COMPLEX, DualComplex, DualNumber


@lower_cast(types.Number, DualComplex)
@lower_cast(DualNumber, DualComplex)
def _real_to_complex(context, builder, given, wanted, value):
    zero = context.cast(builder, context.get_constant(types.float64, 0.0), types.float64, DUAL)
    return cgutils.pack_struct(builder, [context.cast(builder, value, given, DUAL), zero])


def _joined_typing(typing_context, real, imaginary):
    def generate(context, builder, signature, arguments):
        return cgutils.pack_struct(builder, arguments)

    return DUAL_COMPLEX(DUAL, DUAL), generate


_joined: Any = intrinsic(_joined_typing)


@infer_getattr
class _Parts(AttributeTemplate):
    key = DualComplex

    def generic_resolve(self, value: Any, name: str) -> Any:  # type: ignore[override]
        """Return the type of a part."""
        return DUAL if name in ("real", "imag") else None


@lower_getattr(DualComplex, "real")
def _real(context, builder, kind, value):
    return builder.extract_value(value, 0)


@lower_getattr(DualComplex, "imag")
def _imaginary(context, builder, kind, value):
    return builder.extract_value(value, 1)


def _product(x, y):
    return _joined(x.real * y.real - x.imag * y.imag, x.real * y.imag + x.imag * y.real)


def _is_dual(kind: Any) -> bool:
    return isinstance(kind, DualComplex)


def _is_number(kind: Any) -> bool:
    return isinstance(kind, types.Float | types.Integer)


@overload(operator.imul)
@overload(operator.mul)
def _multiplied(x, y):
    if isinstance(x, types.Complex) and isinstance(y, DualNumber):
        return lambda x, y: _joined(x.real * y, x.imag * y)
    if (_is_dual(x) and isinstance(y, types.Complex)) or (isinstance(x, types.Complex) and _is_dual(y)):
        return _product
    if _is_dual(x) and _is_number(y):
        return lambda x, y: _joined(x.real * y, x.imag * y)
    if _is_number(x) and _is_dual(y):
        return lambda x, y: _joined(x * y.real, x * y.imag)
    return None


@overload(operator.truediv)
def _divided(x, y):
    if _is_dual(x) and isinstance(y, types.Complex):
        return lambda x, y: x * (1.0 / y)
    return None


@overload(operator.iadd)
@overload(operator.add)
def _added(x, y):
    if _is_dual(x) and _is_dual(y):
        return lambda x, y: _joined(x.real + y.real, x.imag + y.imag)
    return None


@overload(operator.isub)
@overload(operator.sub)
def _subtracted(x, y):
    if _is_dual(x) and _is_dual(y):
        return lambda x, y: _joined(x.real - y.real, x.imag - y.imag)
    return None
