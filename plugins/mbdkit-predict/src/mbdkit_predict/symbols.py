"""Numbers that are expressions of CasADi, with which functions written for numbers are executed.

A `Symbol` supports the operators, comparisons and functions that kernels, laws and quantities use. A condition on
symbols is a symbol, too: `where` selects by it. Where a function of Python branches on such a condition, `every_branch`
executes it once for each outcome and selects among the results.

Derivatives of a selection by CasADi are the sum of the derivatives of both operands, each times 0 or 1; 0 times an
infinite derivative would be NaN. Therefore divisions, roots, powers and logarithms are evaluated at 1 where they are
not defined, and replaced by NaN there, or by 0 for roots and powers of 0: their derivatives are finite everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from mbdkit.base import elementary

MOST_BRANCHES = 1000  #: Largest number of outcomes of the conditions of one function.


class BranchError(Exception):
    """A function branches on symbols where it must not, or has too many branches."""


class Symbol(NDArrayOperatorsMixin):
    """A number that is an expression of CasADi, the scalar `sx`."""

    __slots__ = ("sx",)

    def __init__(self, sx: Any):
        self.sx = sx if isinstance(sx, ca.SX) else ca.SX(float(sx))

    def __repr__(self) -> str:
        return f"Symbol({self.sx})"

    def __array_ufunc__(self, function: Any, method: str, *operands: Any, **options: object) -> object:
        if any(isinstance(x, np.ndarray) and x.ndim for x in operands):  # NumPy goes through the elements of arrays
            return getattr(function, method)(*(np.array(x, dtype=object) for x in operands), **options)
        return apply(function, *operands)

    def __array_function__(self, function: object, types: object, operands: Any, options: object) -> object:
        return where(*operands) if function is np.where else NotImplemented

    def __bool__(self) -> bool:
        return bool(float(self.sx)) if self.sx.is_constant() else _decided(self)

    def __float__(self) -> float:
        if not self.sx.is_constant():
            raise BranchError("its number is used where a constant is needed")
        return float(self.sx)

    def __int__(self) -> int:
        return int(float(self))

    def __hash__(self) -> int:
        return int(self.sx.element_hash())

    def __getattr__(self, name: str) -> Any:
        """Return a function of NumPy as a method, by which NumPy applies it to arrays of objects."""
        if name.startswith("_") or not isinstance(function := getattr(np, name, None), np.ufunc):
            raise AttributeError(name)
        return lambda *others: apply(function, self, *others)


def where(condition: object, x: object, y: object) -> Any:
    """Return `x` where the condition holds, else `y`; of numbers, symbols, or arrays of them."""
    if any(isinstance(given, np.ndarray) and given.ndim for given in (condition, x, y)):
        return np.frompyfunc(where, 3, 1)(condition, x, y)
    if not isinstance(condition, Symbol) or condition.sx.is_constant():
        return x if condition else y
    first, second = _expression(x), _expression(y)
    return x if ca.is_equal(first, second, 2) else Symbol(ca.if_else(condition.sx, first, second))


def symbols(array: Any) -> np.ndarray:
    """Return an array of objects that are all symbols, from an array of numbers and symbols."""
    result = np.empty(np.shape(array), dtype=object)
    for index, x in np.ndenumerate(array):
        result[index] = x if isinstance(x, Symbol) else Symbol(x)
    return result


def column(values: object) -> ca.SX:
    """Return numbers and symbols as a column of CasADi."""
    return ca.vertcat(ca.SX(0, 1), *(_expression(x) for x in np.ravel(np.array(values, dtype=object))))


def _expression(x: Any) -> ca.SX:
    return x.sx if isinstance(x, Symbol) else ca.SX(float(x))


def apply(function: np.ufunc, *operands: object) -> object:
    """Return the value of a function of NumPy at numbers and symbols."""
    if not any(isinstance(x, Symbol) for x in operands):
        with np.errstate(all="ignore"):
            return _OWN.get(function, function)(*operands)
    if function.__name__ not in _FUNCTIONS:
        raise BranchError(f"CasADi has no function for {function.__name__}")
    sx = [_expression(x) for x in operands]
    if function in _ORDER and (decided := _beyond(function, *sx)) is not None:
        return decided
    return Symbol(_FUNCTIONS[function.__name__](*sx))


def _beyond(function: np.ufunc, x: ca.SX, y: ca.SX) -> bool | None:
    """Return the result of a comparison with an infinite number, since symbols count as finite; None for others."""
    limits = [float(side) if side.is_constant() else 0.0 for side in (x, y)]
    return bool(function(*limits)) if any(map(math.isinf, limits)) else None


def _guarded(x: ca.SX, is_defined: ca.SX, function: Callable[[ca.SX], ca.SX], otherwise: Any = math.nan) -> ca.SX:
    """Return ``function(x)`` where it is defined; see the docstring of this module."""
    if x.is_constant():
        return function(x) if float(is_defined) else ca.SX(otherwise)
    return ca.if_else(is_defined, function(ca.if_else(is_defined, x, 1.0)), otherwise)


def _quotient(x: ca.SX, y: ca.SX) -> ca.SX:
    return x / y if y.is_constant() else _guarded(y, y != 0.0, lambda y: x / y)


def _root(x: ca.SX) -> ca.SX:
    return _guarded(x, x > 0.0, ca.sqrt, ca.if_else(x == 0.0, 0.0, math.nan))


def _power(x: ca.SX, y: ca.SX) -> ca.SX:
    if y.is_constant() and float(y).is_integer():
        exponent = abs(int(y))
        power = x**exponent if exponent else ca.SX(1.0)
        return power if float(y) >= 0.0 else _quotient(ca.SX(1.0), power)
    return _guarded(x, x > 0.0, lambda x: x**y, ca.if_else(ca.logic_and(x == 0.0, y > 0.0), 0.0, math.nan))


_INVERTED = ("sin", "cos", "tan", "sinh", "cosh", "tanh")
_PLAIN = (*_INVERTED, "exp", "expm1", "floor", "ceil")
_ORDER = (np.less, np.less_equal, np.greater, np.greater_equal)
#: Functions of CasADi by the names of those of NumPy.
_FUNCTIONS: dict[str, Callable[..., ca.SX]] = {
    "add": lambda x, y: x + y,
    "subtract": lambda x, y: x - y,
    "multiply": lambda x, y: x * y,
    "divide": _quotient,
    "power": _power,
    "square": lambda x: x * x,
    "remainder": lambda x, y: x - y * ca.floor(x / y),
    "negative": lambda x: -x,
    "positive": lambda x: x,
    "absolute": ca.fabs,
    "sign": ca.sign,
    "sqrt": _root,
    "log": lambda x: _guarded(x, x > 0.0, ca.log),
    "log1p": lambda x: _guarded(x, x > -1.0, ca.log1p),
    "arctan2": ca.atan2,
    "hypot": lambda x, y: _root(x * x + y * y),
    "less": lambda x, y: x < y,
    "less_equal": lambda x, y: x <= y,
    "greater": lambda x, y: x > y,
    "greater_equal": lambda x, y: x >= y,
    "equal": lambda x, y: x == y,
    "not_equal": lambda x, y: x != y,
    "bitwise_and": ca.logic_and,
    "bitwise_or": ca.logic_or,
    "invert": ca.logic_not,
    "minimum": lambda x, y: ca.if_else(x <= y, x, y),
    "maximum": lambda x, y: ca.if_else(x >= y, x, y),
    **{name: getattr(ca, name) for name in _PLAIN},
    **{f"arc{name}": getattr(ca, f"a{name}") for name in _INVERTED},
}
#: Elementary functions of mbdkit for numbers, by those of NumPy.
_OWN = {own.ufunc: own for own in elementary.FUNCTIONS.values()}

#: Of each function that `every_branch` executes: the given outcomes of its first conditions, and the conditions on
#: which it has branched so far, with their outcomes.
_executed: list[tuple[list[bool], list[tuple[Symbol, bool]]]] = []


def every_branch(function: Callable[[], Sequence[Any]]) -> list[Any]:
    """Return the numbers that a function returns, each selected by the conditions on which the function branches.

    The function returns the same number of values in all branches, and must not change anything outside. Raises
    BranchError if there are more than `MOST_BRANCHES` branches.
    """
    count = 0

    def results(given: list[bool]) -> list[Any]:
        nonlocal count
        if (count := count + 1) > MOST_BRANCHES:
            raise BranchError(f"its conditions have more than {MOST_BRANCHES} outcomes")
        _executed.append((given, []))
        try:
            values = list(function())
        finally:
            _, path = _executed.pop()
        for i in reversed(range(len(given), len(path))):
            others = results([*(outcome for _, outcome in path[:i]), False])
            values = [where(path[i][0], x, y) for x, y in zip(values, others, strict=True)]
        return values

    return results([])


def _decided(condition: Symbol) -> bool:
    """Return the outcome of a condition in the branch that is executed."""
    if not _executed:
        raise BranchError("it branches on a condition that depends on the state")
    given, path = _executed[-1]
    for known, outcome in path:
        if ca.is_equal(known.sx, condition.sx, 4):
            return outcome
    outcome = len(path) >= len(given) or given[len(path)]
    path.append((condition, outcome))
    return outcome
