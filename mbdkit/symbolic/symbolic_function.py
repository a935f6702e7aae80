"""Constraints that are functions of the pose as SymPy expressions, with their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import sympy as sp
from numpy.polynomial import Polynomial
from sympy.core.function import AppliedUndef

from mbdkit.base.errors import PluginError, SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.expressions.recorded_derivatives import derivatives
from mbdkit.mechanism.joint_base import PoseFunction, record_function

#: Functions of SymPy for operations of recorded functions without data.
_OPERATIONS: Mapping[str, Callable[..., sp.Basic]] = {
    "add": sp.Add, "subtract": lambda x, y: x - y, "multiply": sp.Mul, "divide": lambda x, y: x / y, "power": sp.Pow,
    "negate": lambda x: -x, "remainder": sp.Mod, "abs": sp.Abs, "floor": sp.floor, "ceil": sp.ceiling,
    "minimum": sp.Min, "maximum": sp.Max, "sqrt": sp.sqrt, "exp": sp.exp, "log": sp.log, "sin": sp.sin, "cos": sp.cos,
    "tan": sp.tan, "asin": sp.asin, "acos": sp.acos, "atan": sp.atan, "atan2": sp.atan2, "sinh": sp.sinh,
    "cosh": sp.cosh, "tanh": sp.tanh, "hypot": lambda x, y: sp.sqrt(x**2 + y**2), "less": sp.Lt, "less_equal": sp.Le,
    "greater": sp.Gt, "greater_equal": sp.Ge, "equal": sp.Eq, "not_equal": sp.Ne,
    "select": lambda condition, x, y: sp.Piecewise((x, condition), (y, True)), "detached": lambda x: x,
}  # fmt: skip


def symbolic_function(
    function: PoseFunction,
    joint: str,
    pose: Sequence[sp.Expr],
    parameters: Mapping[str, sp.Expr],
    number: Callable[[float], sp.Expr],
    table: Callable[[Callable[[float], float], int, int], Callable[[sp.Expr], sp.Expr]],
) -> list[sp.Expr]:
    """Return the value of a function of the pose and its first and second derivatives.

    Parameters
    ----------
    function
        The function.
    joint
        Name of its joint, for messages.
    pose
        Expressions of the entries of a `Pose`, by which the derivatives are partial ones.
    parameters
        Expressions of the parameters of the function by name.
    number
        Function that returns a constant as an expression.
    table
        Function that returns a derivative of a table as a function of SymPy, given a function that evaluates it, the
        index of the table, and the order of the derivative. Its pieces would make the second derivatives too long.

    Returns
    -------
    list
        (21,) the value, its derivatives by entry i, and those by i <= j in lexicographic order.

    Raises
    ------
    SpecError
        If the function cannot be recorded or differentiated, or is the root of an equation.
    """
    value, inputs, given = record_function(function.function, list(parameters), joint)
    try:
        results = derivatives(value, inputs, order=2)
    except PluginError as error:
        raise SpecError(f"the constraint of joint '{joint}': {error}") from None
    known = dict(zip((entry.index for entry in inputs), pose, strict=True))
    known |= {given[name].index: expression for name, expression in parameters.items()}
    recorder = value.recorder
    needed = recorder.ancestors(results, known)
    if any(recorder.terms[index].operation == "root" for index in needed):
        raise SpecError(f"joint '{joint}' has no symbolic form, because its constraint is the root of an equation")
    for index in needed:
        term = recorder.terms[index]
        operands = [known[operand] for operand in term.operands]
        match term.operation:
            case "constant":
                known[index] = number(term.data)
            case "power_of_integer":
                known[index] = operands[0] ** term.data
            case "table":
                known[index] = table(_TableValue(tuple(recorder.tables[term.data[0]]), term.data[1]), *term.data)(
                    *operands
                )
            case _:
                known[index] = _OPERATIONS[term.operation](*operands)
    return [_shortened(known[result.index]) for result in results]


def _shortened(expr: sp.Expr) -> sp.Expr:
    """Return an expression with fewer operations if there is one: derivatives of atan2 contain sums of squares."""
    if expr.has(sp.Piecewise, sp.floor, sp.ceiling, sp.Mod, AppliedUndef):
        return expr
    return min((expr, sp.trigsimp(sp.factor(expr))), key=sp.count_ops)


@dataclass(frozen=True)
class _TableValue:
    """A derivative of a table in numbers, whose first and last pieces also extrapolate; see `Recorder.table`."""

    numbers: tuple[float, ...]
    order: int

    def __call__(self, at: float) -> float:
        """Return its value."""
        count, terms, period = int(self.numbers[0]), int(self.numbers[1]), self.numbers[2]
        knots = np.array(self.numbers[3 : 4 + count])
        coefficients = np.array(self.numbers[4 + count :]).reshape(count, terms)
        if period:
            at = knots[0] + (at - knots[0]) % period
        piece = int(np.clip(np.searchsorted(knots, at, side="right") - 1, 0, count - 1))
        return float(Polynomial(coefficients[piece]).deriv(self.order)(at - knots[piece]))
