"""Force laws as programs: SymPy expressions are translated to programs, so that no compiler is needed to use them.

A program works on registers. The first ones hold length, rate and time, the next ones the parameters and the constants
of the program, and the others the results of its instructions. An instruction has five integers: the operation, up to
three operands, and the register of the result. An operand is the number of a register, except for the exponent of
``power_of_integer``, which is the exponent itself.

The program at an address consists of the numbers of instructions and of constants, the registers of the four results,
the instructions, and the constants.
"""

from __future__ import annotations

import math

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.native.arithmetic import is_dual, value_of, where
from mbdkit.engine.native.calls import integers_at, new_registers, numbers_at
from mbdkit.engine.native.functions import inlined, law_function, overload, subkernel
from mbdkit.laws import tabulated

REGISTERS = 512
"""Largest number of registers of a program."""
HEAD = 6
"""Number of integers in front of the instructions."""

WORDS = 5
"""Number of integers of an instruction."""

_BINARY = ("add", "subtract", "multiply", "divide", "power", "remainder")
_COMPARED = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal")
_LOGICAL = ("and", "or", "not")
_OTHERS = ("negate", "power_of_integer", "select", "abs", "floor", "ceil")
SMOOTH = ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
"""Functions of one operand that are also defined for dual numbers."""
_OF_NUMBERS = ("asinh", "acosh", "atanh", "expm1", "log1p", "log10", "log2", "erf", "erfc", "gamma", "lgamma")
_OF_TWO_NUMBERS = ("atan2", "hypot", "copysign")
OPCODES = {
    name: code
    for code, name in enumerate(
        (*_BINARY, *_COMPARED, *_LOGICAL, *_OTHERS, *SMOOTH, *_OF_NUMBERS, *_OF_TWO_NUMBERS)
    )
}  # fmt: skip
"""Code of each operation."""
ONLY_OF_NUMBERS = frozenset((*_OF_NUMBERS, *_OF_TWO_NUMBERS))
"""Operations that dual numbers lack."""

_ADD, _SUBTRACT, _MULTIPLY, _DIVIDE, _POWER, _REMAINDER = (OPCODES[name] for name in _BINARY)
_LESS, _LESS_EQUAL, _GREATER, _GREATER_EQUAL, _EQUAL, _NOT_EQUAL = (OPCODES[name] for name in _COMPARED)
_AND, _OR, _NOT = (OPCODES[name] for name in _LOGICAL)
_NEGATE, _POWER_OF_INTEGER, _SELECT, _ABS, _FLOOR, _CEIL = (OPCODES[name] for name in _OTHERS)
_SQRT, _EXP, _LOG, _SIN, _COS, _TAN, _ASIN, _ACOS, _ATAN, _SINH, _COSH, _TANH = (OPCODES[name] for name in SMOOTH)
_ASINH, _ACOSH, _ATANH, _EXPM1, _LOG1P, _LOG10, _LOG2, _ERF, _ERFC, _GAMMA, _LGAMMA = (
    OPCODES[name] for name in _OF_NUMBERS
)
_ATAN2, _HYPOT, _COPYSIGN = (OPCODES[name] for name in _OF_TWO_NUMBERS)


@law_function
def run_program(program, length, rate, time, parameters, out):
    """Run the program at an address; see `mbdkit.engine.native.calls` and this module."""
    head = integers_at(program, HEAD)
    code = integers_at(program + 8 * HEAD, WORDS * head[0])
    constants = numbers_at(program + 8 * (HEAD + WORDS * head[0]), 0, head[1], 0.0)
    count = int(value_of(numbers_at(parameters, 0, 1, length)[0]))
    given = numbers_at(parameters, 1, count, length)
    x = new_registers(512, length)
    x[0] = length
    x[1] = rate
    x[2] = time
    for i in range(count):
        x[3 + i] = given[i]
    for i in range(len(constants)):
        x[3 + count + i] = constants[i]
    for i in range(head[0]):
        k = WORDS * i
        # registers as unsigned numbers: signed indices are compared with 0 first, which takes a sixth of the time
        a, b, c, to = np.uint64(code[k + 1]), np.uint64(code[k + 2]), np.uint64(code[k + 3]), np.uint64(code[k + 4])
        _execute(code[k], a, b, c, to, x)
    results = numbers_at(out, 0, 4, length)
    for i in range(4):
        results[i] = x[head[2 + i]]


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
    elif op <= _TANH:
        _smooth(op, a, to, x)
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
def _smooth(op, a, to, x):
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
    else:
        x[to] = math.tanh(x[a])


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
    elif op == _ATAN2:
        x[to] = math.atan2(x[a], x[b])
    elif op == _HYPOT:
        x[to] = math.hypot(x[a], x[b])
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
