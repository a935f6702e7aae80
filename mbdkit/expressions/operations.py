"""The table of all operators and functions that expressions can contain.

The parser, the compiled kernel of motions, dual numbers, the detection of discontinuities of motions, derivatives of
programs, events, measures and their gradients use this table. A new operation is one entry with its *rule*.

The rule of one operand x returns f(x), f'(x) and f''(x). The rule of two operands takes the value and the first two
derivatives of each one, (a0, a1, a2) and (b0, b1, b2), and returns those of the result. Rules are written once for all
kinds of numbers: they are compiled by Numba for numbers and for dual numbers, and evaluated on arrays and on programs.
They therefore consist of operators, `abs`, `mbdkit.base.elementary`, ``np.sqrt`` and `where`, and have no branches.
Powers with the exponent 2 are multiplications. The order of operations determines the last bits of compiled motions.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mbdkit.base import elementary

Rule = Callable[..., tuple[Any, Any, Any]]
Dimension = Literal["same", "common", "angle of common", "product", "quotient", "power", "root", "plain", "angle"]


@dataclass(frozen=True)
class Operation:
    """An operation of expressions.

    Parameters
    ----------
    name
        Name in programs; for a function, also its name in the text of an expression.
    arity
        Number of operands in programs.
    number
        The operation on numbers; used for constants and events.
    array
        The operation on arrays; used for measures.
    rule
        Value and derivatives; see the docstring of this module. The rule of ``powi`` has the exponent as its second
        argument.
    dimension
        How the unit of the result follows from those of the operands. ``same``: that of the only operand. ``common``:
        that of both operands, which must be equal. ``angle of common``: an angle, from operands of equal units.
        ``product``, ``quotient``, ``power``, ``root``: by that operation on units. ``plain``: a number without unit,
        ``angle``: an angle; the operand has no unit or is an angle.
    symbol
        The operator in the text; empty for functions.
    is_function
        Whether the text can contain it as a function.
    takes_more
        Whether the text can contain it with more than two operands; it is then applied repeatedly to two at a time.
    switch
        Where the operation changes its form, so that a derivative jumps: where its ``first`` operand or the
        ``difference`` of its operands changes sign; empty if it is smooth.
    jumps
        Whether its value jumps at a switch.
    is_periodic
        Whether its value is a periodic function of its operand.
    is_never_negative
        Whether its value is never negative.
    roundings
        Bound of the rounding error of its value, in units in the last place.
    """

    name: str
    arity: int
    number: Callable[..., float]
    array: Callable[..., np.ndarray]
    rule: Rule
    dimension: Dimension = "plain"
    symbol: str = ""
    is_function: bool = True
    takes_more: bool = False
    switch: Literal["", "first", "difference"] = ""
    jumps: bool = False
    is_periodic: bool = False
    is_never_negative: bool = False
    roundings: int = 1

    @property
    def ufunc(self) -> Any:
        """The function of NumPy by which operands of other types recognize the operation."""
        return self.array.ufunc if isinstance(self.array, elementary.ElementaryFunction) else self.array


def where(condition: Any, x: Any, y: Any) -> Any:
    """Return `x` where the condition holds, else `y`; both are evaluated."""
    if isinstance(condition, bool):
        return x if condition else y
    return np.where(condition, x, y)


def _sum(a0, a1, a2, b0, b1, b2):
    return a0 + b0, a1 + b1, a2 + b2


def _difference(a0, a1, a2, b0, b1, b2):
    return a0 - b0, a1 - b1, a2 - b2


def _product(a0, a1, a2, b0, b1, b2):
    return a0 * b0, a1 * b0 + a0 * b1, a2 * b0 + 2.0 * a1 * b1 + a0 * b2


def _quotient(a0, a1, a2, b0, b1, b2):
    f0 = a0 / b0
    f1 = (a1 - f0 * b1) / b0
    return f0, f1, (a2 - 2.0 * f1 * b1 - f0 * b2) / b0


def _angle(a0, a1, a2, b0, b1, b2):
    r2 = a0 * a0 + b0 * b0
    cross = b0 * a1 - a0 * b1
    turning = (b0 * a2 - a0 * b2) / r2
    return elementary.atan2(a0, b0), cross / r2, turning - 2.0 * cross * (a0 * a1 + b0 * b1) / (r2 * r2)


def _smaller(a0, a1, a2, b0, b1, b2):
    is_first = a0 <= b0
    return where(is_first, a0, b0), where(is_first, a1, b1), where(is_first, a2, b2)


def _larger(a0, a1, a2, b0, b1, b2):
    is_first = a0 >= b0
    return where(is_first, a0, b0), where(is_first, a1, b1), where(is_first, a2, b2)


def power(x, n):
    """Return x**n and its first two derivatives with respect to x, for a constant exponent.

    The derivatives of n = 0 and n = 1 are set explicitly, because the formula gives 0 * inf = NaN for them at x = 0.
    """
    first = where(n == 0.0, 0.0, n * elementary.pow(x, n - 1.0))
    second = where((n == 0.0) | (n == 1.0), 0.0, n * (n - 1.0) * elementary.pow(x, n - 2.0))
    return elementary.pow(x, n), first, second


def _general_power(a0, a1, a2, b0, b1, b2):
    """Return a**b as exp(g) with g = b ln a, so that f' = f g' and f'' = f (g'' + g'^2); see `power` for constant b.

    A constant exponent allows bases that are not positive.
    """
    f0, d1, d2 = power(a0, b0)
    is_constant = (b1 == 0.0) & (b2 == 0.0)
    ln = elementary.log(a0)
    g1 = b1 * ln + b0 * a1 / a0
    g2 = b2 * ln + 2.0 * b1 * a1 / a0 + b0 * (a2 / a0 - a1 * a1 / (a0 * a0))
    first = where(is_constant, d1 * a1, f0 * g1)
    return f0, first, where(is_constant, d2 * a1 * a1 + d1 * a2, f0 * (g2 + g1 * g1))


def _negated(x):
    return -x, -1.0, 0.0


def _sine(x):
    return elementary.sin(x), elementary.cos(x), -elementary.sin(x)


def _cosine(x):
    return elementary.cos(x), -elementary.sin(x), -elementary.cos(x)


def _tangent(x):
    f = elementary.tan(x)
    d = f**2 + 1.0
    return f, d, 2.0 * f * d


def _arcsine(x):
    d = 1.0 / np.sqrt(1.0 - x**2)
    return elementary.asin(x), d, x * d * d * d


def _arccosine(x):
    d = 1.0 / np.sqrt(1.0 - x**2)
    return elementary.acos(x), -d, -x * d * d * d


def _arctangent(x):
    d = 1.0 / (x**2 + 1.0)
    return elementary.atan(x), d, -2.0 * x * d * d


def _exponential(x):
    f = elementary.exp(x)
    return f, f, f


def _logarithm(x):
    return elementary.log(x), 1.0 / x, -1.0 / (x * x)


def _root(x):
    f = np.sqrt(x)
    return f, 0.5 / f, -0.25 / (f * x)


def _size(x):
    return abs(x), where(x >= 0.0, 1.0, -1.0), 0.0


def _hyperbolic_tangent(x):
    f = elementary.tanh(x)
    d = 1.0 - f**2
    return f, d, -2.0 * f * d


def _operator(
    name: str, symbol: str, number: Any, array: Any, rule: Rule, dimension: Dimension, roundings: int = 1
) -> Operation:
    return Operation(name, 2, number, array, rule, dimension, symbol=symbol, is_function=False, roundings=roundings)


_TABLE = (
    _operator("add", "+", operator.add, np.add, _sum, "common"),
    _operator("sub", "-", operator.sub, np.subtract, _difference, "common"),
    _operator("mul", "*", operator.mul, np.multiply, _product, "product"),
    _operator("div", "/", operator.truediv, np.divide, _quotient, "quotient", roundings=2),
    _operator("pow", "**", elementary.pow, elementary.pow, _general_power, "power"),
    Operation("powi", 1, elementary.pow, elementary.pow, power, "power", is_function=False),
    Operation("neg", 1, operator.neg, np.negative, _negated, "same", is_function=False, roundings=0),
    Operation("sin", 1, elementary.sin, elementary.sin, _sine, is_periodic=True),
    Operation("cos", 1, elementary.cos, elementary.cos, _cosine, is_periodic=True),
    Operation("tan", 1, elementary.tan, elementary.tan, _tangent, is_periodic=True),
    Operation("asin", 1, elementary.asin, elementary.asin, _arcsine, "angle"),
    Operation("acos", 1, elementary.acos, elementary.acos, _arccosine, "angle"),
    Operation("atan", 1, elementary.atan, elementary.atan, _arctangent, "angle"),
    Operation("atan2", 2, elementary.atan2, elementary.atan2, _angle, "angle of common", switch="first", jumps=True),
    Operation("exp", 1, elementary.exp, elementary.exp, _exponential, is_never_negative=True),
    Operation("log", 1, elementary.log, elementary.log, _logarithm),
    Operation("sqrt", 1, math.sqrt, np.sqrt, _root, "root", is_never_negative=True),
    Operation("abs", 1, abs, np.abs, _size, "same", switch="first", is_never_negative=True, roundings=0),
    Operation("tanh", 1, elementary.tanh, elementary.tanh, _hyperbolic_tangent),
    Operation("min", 2, min, np.minimum, _smaller, "common", takes_more=True, switch="difference", roundings=0),
    Operation("max", 2, max, np.maximum, _larger, "common", takes_more=True, switch="difference", roundings=0),
)
OPERATIONS: Mapping[str, Operation] = {one.name: one for one in _TABLE}
"""All operations by name."""

FUNCTIONS = (*(one.name for one in _TABLE if one.is_function), "degrees")
"""Names of the functions that the text of an expression can contain.

``degrees(45)`` is the angle of 45 degrees in radians; programs contain a multiplication instead.
"""

OF_PARTS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "norm": lambda values: elementary.hypot(values[0], values[1]),
    "along_max": lambda values: np.max(values, axis=0),
    "along_min": lambda values: np.min(values, axis=0),
}
"""Operations of measures on the components of vectors (2, T), and on values along a beam (elements, T)."""

REDUCE = "over time: "
"""Prefix of the operations of measures that reduce the values at all times to one value."""


def arity_of(operation: str) -> int:
    """Return the number of operands of an instruction; 0 if it only pushes a value."""
    if operation in OPERATIONS:
        return OPERATIONS[operation].arity
    if operation.startswith(REDUCE):
        return 2 if operation == REDUCE + "at" else 1  # `at` has a quantity and a time
    return 1 if operation in OF_PARTS else 0
