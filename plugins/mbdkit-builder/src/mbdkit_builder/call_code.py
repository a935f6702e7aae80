"""Compiled code of `mbdkit.engine.native.calls`: calls of functions, and arrays of numbers, at given addresses."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils

from mbdkit.engine.native.calls import call_entry, call_law, integers_at, new_registers, numbers_at
from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.native.number_arrays import ITEM
from mbdkit_builder.dual_arrays import DualArray
from mbdkit_builder.dual_types import DUAL
from mbdkit_builder.implementation import implement
from mbdkit_builder.lane_arrays import LaneArray
from mbdkit_builder.lane_types import REAL


@implement(call_entry)
def _call_entry(typing_context, address, first, second, t, h, x):
    def generate(context, builder, signature, arguments):
        word, real = ir.IntType(64), ir.DoubleType()
        kind = ir.FunctionType(word, [word, word, real, real, real])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])

    return types.int64(types.int64, types.int64, types.int64, types.float64, types.float64, types.float64), generate


def _law_type() -> ir.FunctionType:
    double, pointer = ir.DoubleType(), ir.DoubleType().as_pointer()
    return ir.FunctionType(ir.VoidType(), [ir.IntType(64), double, double, double, pointer, pointer])


@implement(call_law)
def _call_law(typing, address, program, length, rate, time, parameters, begin, out, row, count):
    if not isinstance(count, types.IntegerLiteral):
        return None
    if isinstance(out, LaneArray):
        return _call_in_lanes(count)
    if isinstance(out, DualArray):
        return _call_with_derivatives()
    number, real = types.int64, types.float64
    vector, matrix = types.Array(real, 1, "C"), types.Array(real, 2, "C")
    signature = types.void(number, number, real, real, real, vector, number, matrix, number, number)

    def generate(context, builder, signature, arguments):
        address, program, length, rate, time, parameters, begin, out, row, count = arguments
        function = _law_type()
        block = context.make_array(signature.args[5])(context, builder, parameters).data
        results = context.make_array(signature.args[7])(context, builder, out).data
        builder.call(
            builder.inttoptr(address, function.as_pointer()),
            [program, length, rate, time, builder.gep(block, [begin]), builder.gep(results, [builder.mul(row, count)])],
        )
        return context.get_dummy_value()

    return signature, generate


def _call_with_derivatives():
    """Return signature and code of `call_law` for dual numbers; the time is an ordinary number."""
    number, vector, matrix = types.int64, DualArray(1), DualArray(2)
    signature = types.void(number, number, DUAL, DUAL, types.float64, vector, number, matrix, number, number)

    def generate(context, builder, signature, arguments):
        address, program, length, rate, time, parameters, begin, out, row, _ = arguments
        double = ir.DoubleType()
        pointers = [double.as_pointer()] * 2
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64), *pointers, double, *pointers])
        state = cgutils.alloca_once(builder, double, 2 * ITEM)
        second = DualArray.behind(builder, state, 1)
        DualArray.store(builder, length, state)
        DualArray.store(builder, rate, second)
        block, results = vector.place(builder, parameters, [begin]), matrix.place(builder, out, [row])
        builder.call(builder.inttoptr(address, kind.as_pointer()), [program, state, second, time, block, results])
        return context.get_dummy_value()

    return signature, generate


def _call_in_lanes(literal):
    """Return signature and code of `call_law` for lanes; `parameters` are an array (WIDTH, N) of numbers.

    The number of results is part of the signature: Numba keeps one code for each signature.
    """
    number, matrix, lanes = types.int64, types.Array(types.float64, 2, "C"), LaneArray(2)
    signature = types.void(number, number, REAL, REAL, REAL, matrix, number, lanes, number, literal)
    count = literal.literal_value

    def generate(context, builder, signature, arguments):
        address, program, *state, parameters, begin, out, row, _ = arguments
        word = ir.IntType(32)
        function = builder.inttoptr(address, _law_type().as_pointer())
        given = context.make_array(signature.args[5])(context, builder, parameters)
        size = cgutils.unpack_tuple(builder, given.shape)[1]
        results = cgutils.alloca_once(builder, ir.DoubleType(), count)
        columns = [ir.Constant(context.get_value_type(REAL), ir.Undefined)] * count
        for lane in range(WIDTH):
            numbers = [builder.extract_element(value, word(lane)) for value in state]
            block = builder.gep(given.data, [builder.add(builder.mul(size, size.type(lane)), begin)])
            builder.call(function, [program, *numbers, block, results])
            for i in range(count):
                one = builder.load(builder.gep(results, [word(i)]))
                columns[i] = builder.insert_element(columns[i], one, word(lane))
        for i in range(count):
            lanes.put(builder, out, [row, row.type(i)], columns[i])
        return context.get_dummy_value()

    return signature, generate


def array_at(context, builder, kind, data, count):
    """Generate code for a one-dimensional array of `count` items at an address."""
    array = cgutils.create_struct_proxy(kind)(context, builder)
    array.data = builder.bitcast(data, ir.DoubleType().as_pointer())
    sizes = [count] if kind == NUMBERS else [count, ir.IntType(64)(ITEM)]
    array.shape = cgutils.pack_array(builder, sizes)
    array.strides = cgutils.pack_array(builder, [ir.IntType(64)(8)] * len(sizes))
    return array._getvalue()


NUMBERS = types.Array(types.float64, 1, "C")


@implement(integers_at)
def _integers_at(typing_context, address, count):
    kind = types.Array(types.int64, 1, "C")

    def generate(context, builder, signature, arguments):
        address, count = arguments
        array = cgutils.create_struct_proxy(kind)(context, builder)
        array.data = builder.inttoptr(address, ir.IntType(64).as_pointer())
        array.shape = cgutils.pack_array(builder, [count])
        array.strides = cgutils.pack_array(builder, [ir.IntType(64)(8)])
        return array._getvalue()

    return kind(types.int64, types.int64), generate


@implement(numbers_at)
def _numbers_at(typing_context, address, first, count, like):
    kind = DualArray(1) if like == DUAL else NUMBERS

    def generate(context, builder, signature, arguments):
        address, first, count, _ = arguments
        data = builder.inttoptr(address, ir.DoubleType().as_pointer())
        words = ITEM if like == DUAL else 1
        data = builder.gep(data, [builder.mul(first, first.type(words))])
        return array_at(context, builder, kind, data, count)

    return kind(types.int64, types.int64, types.int64, like), generate


@implement(new_registers)
def _new_registers(typing_context, count, like):
    if not isinstance(count, types.IntegerLiteral):
        return None
    kind, size = (DualArray(1) if like == DUAL else NUMBERS), count.literal_value

    def generate(context, builder, signature, arguments):
        words = size * (ITEM if kind != NUMBERS else 1)
        data = cgutils.alloca_once(builder, ir.DoubleType(), words)
        return array_at(context, builder, kind, data, ir.IntType(64)(size))

    return kind(types.int64, like), generate
