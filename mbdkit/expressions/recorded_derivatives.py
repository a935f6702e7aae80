"""Derivatives of recorded functions, also of those that are defined implicitly.

The derivative of a term is a sum over its operands, forward through the graph (A. Griewank, A. Walther, Evaluating
Derivatives, 2nd edition, SIAM 2008, chapter 3). It is recorded in the same graph, in which equal terms occur once, and
can be differentiated again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from mbdkit.base.errors import PluginError
from mbdkit.expressions.recorded import Recorded, Term

#: Derivatives with respect to each operand; f is the value of the operation.
_SLOPES: Mapping[str, tuple[Callable[..., Any], ...]] = {
    "add": (lambda f, x, y: 1.0, lambda f, x, y: 1.0),
    "subtract": (lambda f, x, y: 1.0, lambda f, x, y: -1.0),
    "multiply": (lambda f, x, y: y, lambda f, x, y: x),
    "divide": (lambda f, x, y: 1.0 / y, lambda f, x, y: -f / y),
    "power": (lambda f, x, y: y * x ** (y - 1.0), lambda f, x, y: f * np.log(x)),
    "power_of_integer": (lambda f, x: f.term.data * x ** (f.term.data - 1),),
    "negate": (lambda f, x: -1.0,),
    "sqrt": (lambda f, x: 0.5 / f,),
    "exp": (lambda f, x: f,),
    "log": (lambda f, x: 1.0 / x,),
    "sin": (lambda f, x: np.cos(x),),
    "cos": (lambda f, x: -np.sin(x),),
    "tan": (lambda f, x: 1.0 + f * f,),
    "asin": (lambda f, x: 1.0 / np.sqrt(1.0 - x * x),),
    "acos": (lambda f, x: -1.0 / np.sqrt(1.0 - x * x),),
    "atan": (lambda f, x: 1.0 / (1.0 + x * x),),
    "atan2": (lambda f, y, x: x / (x * x + y * y), lambda f, y, x: -y / (x * x + y * y)),
    "sinh": (lambda f, x: np.cosh(x),),
    "cosh": (lambda f, x: np.sinh(x),),
    "tanh": (lambda f, x: 1.0 - f * f,),
    "hypot": (lambda f, x, y: x / f, lambda f, x, y: y / f),
    "table": (lambda f, x: _slope_of_table(f, x),),
}

#: Operations whose derivatives are 0.
_CONSTANT = frozenset(
    ("input", "constant", "detached", "less", "less_equal", "greater", "greater_equal", "equal", "not_equal")
)

_NOT_SMOOTH = {
    "abs": "has no derivative where its operand is 0",
    "minimum": "has no derivative where its operands are equal",
    "maximum": "has no derivative where its operands are equal",
    "floor": "jumps at integers",
    "ceil": "jumps at integers",
    "remainder": "jumps at multiples of its divisor",
}


def derivative(of: Recorded, by: Recorded) -> Recorded:
    """Return the derivative of a recorded number with respect to an input.

    Raises
    ------
    PluginError
        If the number contains an operation without derivative, such as abs, of an operand that depends on the input.
    """
    recorder = of.recorder
    if by.term.operation != "input" or by.recorder is not recorder:
        raise PluginError("a derivative must be one with respect to an input of the recorded function")
    zero = recorder.constant(0.0).index
    memo = recorder.slopes.setdefault(by.index, {by.index: recorder.constant(1.0).index})
    outer = recorder.place
    try:
        for index in recorder.ancestors([of], memo, _varying):
            recorder.place = recorder.terms[index].place
            memo[index] = _slope(Recorded(recorder, index), by, memo, zero).index
    finally:
        recorder.place = outer
    return Recorded(recorder, memo[of.index])


def derivatives(of: Recorded, by: Sequence[Recorded], order: int) -> list[Recorded]:
    """Return the value, then all first derivatives, then all second derivatives, and so on up to an order.

    Derivatives of one order are those by the combinations of inputs (i <= j <= k) in lexicographic order.
    """
    known: dict[tuple[int, ...], Recorded] = {(): of}
    for size in range(1, order + 1):
        for chosen in combinations_with_replacement(range(len(by)), size):
            known[chosen] = derivative(known[chosen[:-1]], by[chosen[-1]])
    return list(known.values())


def _varying(term: Term) -> tuple[int, ...]:
    """Return those operands of a term whose derivatives its derivative contains."""
    match term.operation:
        case "select":
            return term.operands[1:]
        case "root":
            return term.operands[1:2]
    return () if term.operation in _CONSTANT else term.operands


def _slope(recorded: Recorded, by: Recorded, memo: Mapping[int, int], zero: int) -> Recorded:
    """Return the derivative of a number, given those of its operands."""
    recorder, term = recorded.recorder, recorded.term
    operands = [Recorded(recorder, operand) for operand in term.operands]
    own = [Recorded(recorder, memo[operand]) for operand in _varying(term)]
    is_bound = term.operation == "root" and term.operands[-1] == by.index  # by its own unknown
    if is_bound or all(slope.index == zero for slope in own):
        return Recorded(recorder, zero)
    match term.operation:
        case "select":
            return recorder.apply("select", [operands[0], *own])
        case "root":
            _, condition, unknown = operands
            steepness = recorder.replaced(derivative(condition, unknown), unknown, recorded)
            return -recorder.replaced(own[0], unknown, recorded) / steepness  # type: ignore[no-any-return]
        case name if name in _NOT_SMOOTH:
            raise PluginError(
                f"'{name}' {_NOT_SMOOTH[name]}, so it cannot be part of a function that must be differentiated, such "
                "as a constraint"
            )
    total: Any = 0.0
    for factor, slope in zip(_SLOPES[term.operation], own, strict=True):
        if slope.index != zero:
            total = total + factor(recorded, *operands) * slope
    return recorder.constant(total)


def _slope_of_table(recorded: Recorded, at: Recorded) -> Recorded | float:
    number, order = recorded.term.data
    is_zero = order + 1 >= recorded.recorder.tables[number][1]  # above the degree
    return 0.0 if is_zero else recorded.recorder.apply("table", [at], (number, order + 1))
