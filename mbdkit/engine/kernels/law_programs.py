"""Functions as programs, so that no compiler is needed to use them: force laws that are SymPy expressions, and recorded
functions (`mbdkit.engine.function_program`).

A program works on registers. The first ones hold its inputs, the next ones its constants, and the others the results of
its instructions. The inputs of a law are length, rate, time and the parameters; those of other functions are the
parameters and the time. An instruction has five integers: the operation, up to three operands, and the register of the
result. An operand is the number of a register, except for the exponent of ``power_of_integer``, which is the exponent
itself. The operands of ``table`` are the register of the argument, the place of the table behind the first constant,
and the order of the derivative.

The program at an address consists of the numbers of instructions, constants and results, the registers of the results,
the instructions, the constants, and the numbers of its tables, which need no registers.
"""

from __future__ import annotations

import math

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.native.arithmetic import is_dual, value_of, where
from mbdkit.engine.native.calls import integers_at, new_registers, numbers_at
from mbdkit.engine.native.functions import inlined, law_function, overload, subkernel
from mbdkit.laws import tabulated

REGISTERS = 512  #: Largest number of registers of a program.
HEAD = 3  #: Number of integers in front of the registers of the results.
WORDS = 5  #: Number of integers of an instruction.

_BINARY = ("add", "subtract", "multiply", "divide", "power", "remainder")
_COMPARED = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal")
_LOGICAL = ("and", "or", "not")
_OTHERS = ("negate", "power_of_integer", "select", "abs", "floor", "ceil")
#: Functions of one operand that are also defined for dual numbers.
SMOOTH = ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
_SMOOTH_OF_TWO = ("atan2", "hypot")
_OF_NUMBERS = (
    "asinh", "acosh", "atanh", "expm1", "log1p", "log10", "log2", "erf", "erfc", "gamma", "lgamma", "copysign",
)  # fmt: skip
#: Code of each operation.
OPCODES = {
    name: code
    for code, name in enumerate(
        (*_BINARY, *_COMPARED, *_LOGICAL, *_OTHERS, *SMOOTH, *_SMOOTH_OF_TWO, *_OF_NUMBERS, "table")
    )
}  # fmt: skip
ONLY_OF_NUMBERS = frozenset(_OF_NUMBERS)  #: Operations that dual numbers lack.

_ADD, _SUBTRACT, _MULTIPLY, _DIVIDE, _POWER, _REMAINDER = (OPCODES[name] for name in _BINARY)
_LESS, _LESS_EQUAL, _GREATER, _GREATER_EQUAL, _EQUAL, _NOT_EQUAL = (OPCODES[name] for name in _COMPARED)
_AND, _OR, _NOT = (OPCODES[name] for name in _LOGICAL)
_NEGATE, _POWER_OF_INTEGER, _SELECT, _ABS, _FLOOR, _CEIL = (OPCODES[name] for name in _OTHERS)
_SQRT, _EXP, _LOG, _SIN, _COS, _TAN, _ASIN, _ACOS, _ATAN, _SINH, _COSH, _TANH = (OPCODES[name] for name in SMOOTH)
_ATAN2, _HYPOT = (OPCODES[name] for name in _SMOOTH_OF_TWO)
_ASINH, _ACOSH, _ATANH, _EXPM1, _LOG1P, _LOG10, _LOG2, _ERF, _ERFC, _GAMMA, _LGAMMA, _COPYSIGN = (
    OPCODES[name] for name in _OF_NUMBERS
)
_TABLE = OPCODES["table"]


@law_function
def run_program(program, length, rate, time, parameters, out):
    """Run the program of a law at an address; see `mbdkit.engine.native.calls` and this module."""
    count = int(value_of(numbers_at(parameters, 0, 1, length)[0]))
    given = numbers_at(parameters, 1, count, length)
    x = new_registers(512, length)
    x[0] = length
    x[1] = rate
    x[2] = time
    for i in range(count):
        x[3 + i] = given[i]
    _run(program, 3 + count, x, length, out)


@law_function
def run_function(program, length, rate, time, parameters, out):
    """Run the program of a function of its parameters and the time; it writes as many results as the program has."""
    count = int(value_of(numbers_at(parameters, 0, 1, length)[0]))
    given = numbers_at(parameters, 1, count, length)
    x = new_registers(512, length)
    for i in range(count):
        x[i] = given[i]
    x[count] = time
    _run(program, count + 1, x, length, out)


@inlined
def _run(program, inputs, x, like, out):
    """Run the program at an address, with the inputs in the registers `x`; `like` is a number of their type."""
    head = integers_at(program, HEAD)
    length, results = int(head[0]), int(head[2])
    registers = integers_at(program + 8 * HEAD, results)
    begin = program + 8 * (HEAD + results)
    code = integers_at(begin, WORDS * length)
    numbers = begin + 8 * WORDS * length
    constants = numbers_at(numbers, 0, head[1], 0.0)
    for i in range(len(constants)):
        x[inputs + i] = constants[i]
    for i in range(length):
        k = WORDS * i
        # registers as unsigned numbers: signed indices are compared with 0 first, which takes a sixth of the time
        a, b, c, to = np.uint64(code[k + 1]), np.uint64(code[k + 2]), np.uint64(code[k + 3]), np.uint64(code[k + 4])
        if code[k] == _TABLE:
            x[to] = _piecewise_polynomial(x[a], numbers + 8 * int(code[k + 2]), code[k + 3])
        else:
            _execute(code[k], a, b, c, to, x)
    values = numbers_at(out, 0, results, like)
    for i in range(results):
        values[i] = x[registers[i]]


@subkernel
def _piecewise_polynomial(t, table, order):
    """Return a derivative of the piecewise polynomial at an address.

    The layout of its numbers, the choice of the piece and the rounding errors are those of
    `mbdkit.engine.kernels.motions`, which does not compute derivatives of a higher order than the second.
    """
    head = numbers_at(table, 0, 3, 0.0)
    pieces, terms, period = int(head[0]), int(head[1]), head[2]
    knots = numbers_at(table, 3, pieces + 1, 0.0)
    if period > 0.0:
        t = knots[0] + (t - knots[0]) % period
    low, high = 0, pieces
    while high - low > 1:
        middle = (low + high) // 2
        if knots[middle] <= value_of(t):
            low = middle
        else:
            high = middle
    x = t - knots[low]
    coefficients = numbers_at(table, 4 + pieces + terms * low, terms, 0.0)
    value = 0.0 * x
    for k in range(terms - 1, order - 1, -1):
        factor = 1
        for i in range(order):
            factor *= k - i
        value = value * x + factor * coefficients[k]
    return value


@inlined
def _execute(op, a, b, c, to, x):
    if op == _ADD:
        x[to] = x[a] + x[b]
    elif op == _SUBTRACT:
        x[to] = x[a] - x[b]
    elif op == _MULTIPLY:
        x[to] = x[a] * x[b]
    elif op == _DIVIDE:
        x[to] = x[a] / x[b]
    elif op == _NEGATE:
        x[to] = -x[a]
    elif op == _POWER_OF_INTEGER:
        x[to] = _power_of_integer(x[a], np.int64(b))
    elif op == _SELECT:
        x[to] = where(value_of(x[a]) != 0.0, x[b], x[c])
    elif op == _POWER:
        x[to] = elementary.pow(x[a], x[b])
    elif op == _REMAINDER:
        x[to] = x[a] % x[b]
    elif op == _ABS:
        x[to] = abs(x[a])
    elif op == _FLOOR:
        x[to] = np.floor(value_of(x[a]))
    elif op == _CEIL:
        x[to] = np.ceil(value_of(x[a]))
    elif op < _NEGATE:
        x[to] = 1.0 if _is_true(op, value_of(x[a]), value_of(x[b])) else 0.0
    elif op <= _HYPOT:
        _smooth(op, a, b, to, x)
    else:
        other_function(op, a, b, to, x)


@inlined
def _is_true(op, a, b):
    """Return the result of a comparison, or of a logical operation on 0 and 1."""
    if op == _LESS:
        return a < b
    if op == _LESS_EQUAL:
        return a <= b
    if op == _GREATER:
        return a > b
    if op == _GREATER_EQUAL:
        return a >= b
    if op == _EQUAL:
        return a == b
    if op == _NOT_EQUAL:
        return a != b
    if op == _AND:
        return (a != 0.0) & (b != 0.0)
    if op == _OR:
        return (a != 0.0) | (b != 0.0)
    return a == 0.0


@inlined
def _power_of_integer(x, n):
    """Return x**n for a constant integer n other than 0; the order of multiplications is that of compiled powers."""
    power, base, rest, is_first = x, x, abs(n), True
    while rest != 0:
        if rest & 1:
            power = base if is_first else power * base
            is_first = False
        rest >>= 1
        if rest != 0:
            base = base * base
    return 1.0 / power if n < 0 else power


@subkernel
def _smooth(op, a, b, to, x):
    if op == _SQRT:
        x[to] = math.sqrt(x[a])
    elif op == _EXP:
        x[to] = math.exp(x[a])
    elif op == _LOG:
        x[to] = math.log(x[a])
    elif op == _SIN:
        x[to] = math.sin(x[a])
    elif op == _COS:
        x[to] = math.cos(x[a])
    elif op == _TAN:
        x[to] = math.tan(x[a])
    elif op == _ASIN:
        x[to] = math.asin(x[a])
    elif op == _ACOS:
        x[to] = math.acos(x[a])
    elif op == _ATAN:
        x[to] = math.atan(x[a])
    elif op == _SINH:
        x[to] = math.sinh(x[a])
    elif op == _COSH:
        x[to] = math.cosh(x[a])
    elif op == _TANH:
        x[to] = math.tanh(x[a])
    elif op == _ATAN2:
        x[to] = math.atan2(x[a], x[b])
    else:
        x[to] = math.hypot(x[a], x[b])


def other_function(op, a, b, to, x):
    """Execute an instruction that is not defined for dual numbers."""
    _other_function(op, a, b, to, x)


@overload(other_function)
def _other(op, a, b, to, x):
    return (lambda op, a, b, to, x: None) if is_dual(x) else (lambda op, a, b, to, x: _other_function(op, a, b, to, x))


@subkernel
def _other_function(op, a, b, to, x):
    if op == _ASINH:
        x[to] = math.asinh(x[a])
    elif op == _ACOSH:
        x[to] = math.acosh(x[a])
    elif op == _ATANH:
        x[to] = math.atanh(x[a])
    elif op == _EXPM1:
        x[to] = math.expm1(x[a])
    elif op == _LOG1P:
        x[to] = math.log1p(x[a])
    elif op == _LOG10:
        x[to] = math.log10(x[a])
    elif op == _LOG2:
        x[to] = math.log2(x[a])
    elif op == _ERF:
        x[to] = math.erf(x[a])
    elif op == _ERFC:
        x[to] = math.erfc(x[a])
    elif op == _GAMMA:
        x[to] = math.gamma(x[a])
    elif op == _LGAMMA:
        x[to] = math.lgamma(x[a])
    else:
        x[to] = math.copysign(x[a], x[b])


_tabulated_law = inlined(tabulated.law)


@law_function
def table(program, length, rate, time, parameters, out):
    """Evaluate a tabulated spring (`mbdkit.laws.tabulated`)."""
    count = int(value_of(numbers_at(parameters, 0, 1, length)[0]))
    force, slope, damping, potential = _tabulated_law(length, rate, time, numbers_at(parameters, 1, count, length))
    results = numbers_at(out, 0, 4, length)
    results[0] = force
    results[1] = slope
    results[2] = damping
    results[3] = potential
