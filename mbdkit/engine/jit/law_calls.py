"""Calls of force laws from compiled kernels, by address and with a single C signature.

A law is a C function ``void law(double length, double rate, double time, const double *parameters, double *out)``. It
writes the force, its derivatives by length and by rate, and the potential into ``out[0..3]``; ``parameters[0]`` is the
number of parameters that follow. Kernels read the address of a law from an array, so that a new law does not require
them to be compiled again.

This module uses the public API of Numba and llvmlite: `njit`, `intrinsic`, `is_jitted`, and the IR builder. It also
uses the helper ``context.make_array``, which is internal to Numba and has no public counterpart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic, is_jitted

HAS_POTENTIAL, PASSIVE = 1, 2
"""Bits of the claims of a law. HAS_POTENTIAL: the force at zero rate is the derivative of the potential by length.
PASSIVE: all power that is not stored as potential energy is dissipated."""

SIGNATURE = types.void(
    types.float64, types.float64, types.float64, types.CPointer(types.float64), types.CPointer(types.float64)
)

PARAMETERS = types.Array(types.float64, 1, "C", readonly=True)
"""Type of the parameters passed to a law: they belong to the mechanism, so a law that changes them is not compiled."""


def _read_only(typing, array):
    """Return an array (N,) of floats as a read-only array, without copying it."""

    def generate(context, builder, signature, arguments):
        return arguments[0]

    return PARAMETERS(array), generate


read_only: Any = intrinsic(_read_only)


def _call_law(typing, address, length, rate, time, parameters, begin, out, row):
    """Call the law at `address` with `parameters` (N,) from index `begin` on; it writes row `row` of `out` (K, 4)."""
    number, real = types.int64, types.float64
    vector, matrix = types.Array(real, 1, "C"), types.Array(real, 2, "C")
    signature = types.void(number, real, real, real, vector, number, matrix, number)

    def generate(context, builder, signature, arguments):
        address, length, rate, time, parameters, begin, out, row = arguments
        double, pointer = ir.DoubleType(), ir.DoubleType().as_pointer()
        function = ir.FunctionType(ir.VoidType(), [double, double, double, pointer, pointer])
        block = context.make_array(signature.args[4])(context, builder, parameters).data
        results = context.make_array(signature.args[6])(context, builder, out).data
        four = ir.Constant(row.type, 4)
        builder.call(
            builder.inttoptr(address, function.as_pointer()),
            [length, rate, time, builder.gep(block, [begin]), builder.gep(results, [builder.mul(row, four)])],
        )
        return context.get_dummy_value()

    return signature, generate


call_law: Any = intrinsic(_call_law)


def compiled(function: Callable[..., Any]) -> Any:
    """Return a law's function compiled by Numba and inlined into its caller; unchanged if its author compiled it."""
    return function if is_jitted(function) else njit(function, error_model="numpy", forceinline=True)
