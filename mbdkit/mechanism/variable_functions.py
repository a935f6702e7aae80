"""Texts that are smooth functions of variables with given names, such as the equation of a coupling of two bodies."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from mbdkit.base.text import listed
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.parser import Code, Compiler, ExpressionError
from mbdkit.expressions.program import Program, execute, value_of
from mbdkit.mechanism.values import Table, curve_of

if TYPE_CHECKING:
    from mbdkit.expressions.recorded import Recorded

_VARIABLE = "variable:"
"""Prefix of the instructions that push a variable."""


class VariableExpressionError(ExpressionError):
    """An expression of variables that is not valid.

    Attributes
    ----------
    variables
        Names of the variables.
    """

    variables: tuple[str, ...] = ()


class VariableCompiler(Compiler):
    """Compiles an expression of variables with given names."""

    variable = ""
    error = VariableExpressionError

    def __init__(self, text: str, variables: tuple[str, ...], parameters: Mapping[str, float] | None = None):
        self.variables = variables
        self.wanted = f"an expression of {listed(variables, 'and')}, which consists of numbers, these names, pi"
        super().__init__(text, parameters)

    def refuse(self, message: str, place: ast.AST | int) -> Any:
        """Raise an error that knows the names of the variables."""
        try:
            super().refuse(message, place)
        except VariableExpressionError as error:
            error.variables = self.variables
            raise

    def names(self) -> tuple[str, ...]:
        """Return the names of the variables that error messages list."""
        return self.variables

    def operand(self, node: ast.expr) -> Code:
        """Return the program of a variable; the base class rejects all other operands."""
        if isinstance(node, ast.Name) and node.id in self.variables:
            return [(_VARIABLE + node.id, 0.0)]
        return super().operand(node)


@lru_cache(maxsize=1024)
def smooth_program(text: str, variables: tuple[str, ...]) -> Program:
    """Return the program of a text; raises SpecError if it is not valid, or not smooth."""
    compiler = VariableCompiler(text, variables)
    program = tuple(compiler.program())
    kinks = {name for name, _ in program if name in OPERATIONS and OPERATIONS[name].switch and name != "atan2"}
    if kinks:
        compiler.refuse(f"{listed(sorted(kinks), 'and')} cannot be used here, because a derivative is discontinuous", 0)
    return program


def function_of(*variables: str) -> Callable[[object], object]:
    """Return a validator, for `pydantic.BeforeValidator`, of texts that are smooth functions of these variables."""

    def check(value: object) -> object:
        if isinstance(value, str):
            smooth_program(value, variables)
        return value

    return check


def value_of_table(table: Table, at: Recorded) -> Recorded:
    """Return the value of the spline of a table at a number that records operations."""
    curve = curve_of(table)
    return at.recorder.table(curve.x, curve.c[::-1].T, at, table.period)


@lru_cache(maxsize=1024)
def with_numbers(text: str, variables: tuple[str, ...]) -> tuple[Program, tuple[float, ...]]:
    """Return the program of a text in which numbers are variables, and these numbers.

    Texts that differ in numbers then have the same program, and can be differentiated with respect to the numbers.
    Exponents stay numbers, because derivatives of powers with variable exponents need positive operands.

    Returns
    -------
    program
        Program for `value_of_program`, with variables ``0``, ``1``, ... for the numbers.
    numbers
        The numbers.
    """
    program = smooth_program(text, variables)

    def step(operation: str, place: float, *operands: frozenset[int]) -> frozenset[int]:
        if operation == "const":
            return frozenset((int(place),))
        return operands[0] if operation == "pow" else frozenset().union(*operands)

    varied = execute(tuple((operation, float(place)) for place, (operation, _) in enumerate(program)), step)
    names = {place: f"{_VARIABLE}{i}" for i, place in enumerate(sorted(varied))}
    changed = [(names[i], 0.0) if i in names else instruction for i, instruction in enumerate(program)]
    return tuple(changed), tuple(program[place][1] for place in names)


def value_of_program(program: Program, values: Mapping[str, Any]) -> Any:
    """Return the value of the program of a text, given the values of all its variables by name."""
    return value_of(program, lambda operation, number: values.get(operation.removeprefix(_VARIABLE), number))


def value_of_text(text: str, values: Mapping[str, Any]) -> Any:
    """Return the value of a function of variables.

    Parameters
    ----------
    text
        Text that `function_of` accepted.
    values
        Values of all its variables by name: numbers, arrays, or numbers that record operations.
    """
    return value_of_program(smooth_program(text, tuple(values)), values)
