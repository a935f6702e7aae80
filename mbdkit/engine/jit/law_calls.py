"""Calls of force laws from compiled kernels, by address and with a single C signature.

A law is a C function ``void law(double length, double rate, double time, const double *parameters, double *out)``. It
writes the force, its derivatives by length and by rate, and the potential into ``out[0..3]``; ``parameters[0]`` is the
number of parameters that follow. Kernels read the address of a law from an array, so that a new law does not require
them to be compiled again.

For dual numbers (`mbdkit.engine.jit.dual_types`), a law is compiled from the same source with pointers to dual numbers:
``void law(double *length, double *rate, double time, double *parameters, double *out)``.

This module uses the public API of Numba and llvmlite: `njit`, `intrinsic`, `is_jitted`, and the IR builder. It also
uses the helper ``context.make_array``, which is internal to Numba and has no public counterpart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic, is_jitted

from mbdkit.engine.jit.dual_arrays import ITEM, DualArray
from mbdkit.engine.jit.dual_types import DUAL
from mbdkit.engine.jit.lane_arrays import LaneArray
from mbdkit.engine.jit.lane_types import REAL
from mbdkit.engine.jit.lane_width import WIDTH

HAS_POTENTIAL, PASSIVE = 1, 2
"""Bits of the claims of a law. HAS_POTENTIAL: the force at zero rate is the derivative of the potential by length.
PASSIVE: all power that is not stored as potential energy is dissipated."""

SIGNATURE = types.void(
    types.float64, types.float64, types.float64, types.CPointer(types.float64), types.CPointer(types.float64)
)

DUAL_SIGNATURE = types.void(
    types.CPointer(types.float64), types.CPointer(types.float64), types.float64, types.CPointer(types.float64),
    types.CPointer(types.float64),
)  # fmt: skip
"""Signature of a law for dual numbers."""

PARAMETERS = types.Array(types.float64, 1, "C", readonly=True)
"""Type of the parameters passed to a law: they belong to the mechanism, so a law that changes them is not compiled."""


def _read_only(typing, array):
    """Return an array (N,) of floats as a read-only array, without copying it."""

    def generate(context, builder, signature, arguments):
        return arguments[0]

    return PARAMETERS(array), generate


read_only: Any = intrinsic(_read_only)


def _law_type() -> ir.FunctionType:
    """Return the type of a law in LLVM."""
    double, pointer = ir.DoubleType(), ir.DoubleType().as_pointer()
    return ir.FunctionType(ir.VoidType(), [double, double, double, pointer, pointer])


def _call_law(typing, address, length, rate, time, parameters, begin, out, row):
    """Call the law at `address` with `parameters` (N,) from index `begin` on; it writes row `row` of `out` (K, 4).

    In lanes, `parameters` are (WIDTH, N), and the law is called for one lane after the other.
    """
    if isinstance(out, LaneArray):
        return _call_in_lanes()
    if isinstance(out, DualArray):
        return _call_with_derivatives()
    number, real = types.int64, types.float64
    vector, matrix = types.Array(real, 1, "C"), types.Array(real, 2, "C")
    signature = types.void(number, real, real, real, vector, number, matrix, number)

    def generate(context, builder, signature, arguments):
        address, length, rate, time, parameters, begin, out, row = arguments
        function = _law_type()
        block = context.make_array(signature.args[4])(context, builder, parameters).data
        results = context.make_array(signature.args[6])(context, builder, out).data
        four = ir.Constant(row.type, 4)
        builder.call(
            builder.inttoptr(address, function.as_pointer()),
            [length, rate, time, builder.gep(block, [begin]), builder.gep(results, [builder.mul(row, four)])],
        )
        return context.get_dummy_value()

    return signature, generate


def _call_with_derivatives():
    """Return signature and code of `call_law` for dual numbers, but for the time."""
    number, vector, matrix = types.int64, DualArray(1), DualArray(2)
    signature = types.void(number, DUAL, DUAL, types.float64, vector, number, matrix, number)

    def generate(context, builder, signature, arguments):
        address, length, rate, time, parameters, begin, out, row = arguments
        double = ir.DoubleType()
        kind = ir.FunctionType(ir.VoidType(), [double.as_pointer()] * 2 + [double] + [double.as_pointer()] * 2)
        state = cgutils.alloca_once(builder, double, 2 * ITEM)
        second = DualArray.behind(builder, state, 1)
        DualArray.store(builder, length, state)
        DualArray.store(builder, rate, second)
        block, results = vector.place(builder, parameters, [begin]), matrix.place(builder, out, [row])
        builder.call(builder.inttoptr(address, kind.as_pointer()), [state, second, time, block, results])
        return context.get_dummy_value()

    return signature, generate


def _dual_at_typing(typing, pointer, index):
    """Return the dual number with an index behind a pointer."""

    def generate(context, builder, signature, arguments):
        return DualArray.load(builder, DualArray.behind(builder, *arguments))

    return DUAL(types.CPointer(types.float64), types.int64), generate


dual_at: Any = intrinsic(_dual_at_typing)


def _put_dual_typing(typing, pointer, index, x):
    """Store a dual number with an index behind a pointer."""

    def generate(context, builder, signature, arguments):
        DualArray.store(builder, arguments[2], DualArray.behind(builder, *arguments[:2]))
        return context.get_dummy_value()

    return types.void(types.CPointer(types.float64), types.int64, DUAL), generate


put_dual: Any = intrinsic(_put_dual_typing)


def _duals_behind_typing(typing, pointer, count):
    """Return `count` dual numbers as an array, beginning with the second one behind a pointer."""
    kind = DualArray(1)

    def generate(context, builder, signature, arguments):
        array = cgutils.create_struct_proxy(kind)(context, builder)
        array.data = DualArray.behind(builder, arguments[0], 1)
        array.shape = cgutils.pack_array(builder, [arguments[1], ir.IntType(64)(ITEM)])
        return array._getvalue()

    return kind(types.CPointer(types.float64), types.int64), generate


duals_behind: Any = intrinsic(_duals_behind_typing)


def _call_in_lanes():
    """Return signature and code of `call_law` for lanes; `parameters` are an array (WIDTH, N) of numbers."""
    number, matrix, lanes = types.int64, types.Array(types.float64, 2, "C"), LaneArray(2)
    signature = types.void(number, REAL, REAL, REAL, matrix, number, lanes, number)

    def generate(context, builder, signature, arguments):
        address, *state, parameters, begin, out, row = arguments
        word = ir.IntType(32)
        function = builder.inttoptr(address, _law_type().as_pointer())
        given = context.make_array(signature.args[4])(context, builder, parameters)
        size = cgutils.unpack_tuple(builder, given.shape)[1]
        results = cgutils.alloca_once(builder, ir.DoubleType(), 4)
        columns = [ir.Constant(context.get_value_type(REAL), ir.Undefined)] * 4
        for lane in range(WIDTH):
            numbers = [builder.extract_element(value, word(lane)) for value in state]
            block = builder.gep(given.data, [builder.add(builder.mul(size, size.type(lane)), begin)])
            builder.call(function, [*numbers, block, results])
            for i in range(4):
                one = builder.load(builder.gep(results, [word(i)]))
                columns[i] = builder.insert_element(columns[i], one, word(lane))
        for i in range(4):
            lanes.put(builder, out, [row, row.type(i)], columns[i])
        return context.get_dummy_value()

    return signature, generate


call_law: Any = intrinsic(_call_law)


def compiled(function: Callable[..., Any]) -> Any:
    """Return a law's function compiled by Numba and inlined into its caller; unchanged if its author compiled it."""
    return function if is_jitted(function) else njit(function, error_model="numpy", forceinline=True)
