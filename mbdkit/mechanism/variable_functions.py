"""Smooth functions of variables with given names, such as the profile of a cam or the equation of a coupling."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import BeforeValidator

from mbdkit.base.frozen import dataclass
from mbdkit.base.text import listed
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.parser import Code, Compiler, ExpressionError
from mbdkit.expressions.program import Program, execute, value_of
from mbdkit.expressions.recorded import Recorded
from mbdkit.expressions.recorded_derivatives import derivative
from mbdkit.mechanism.values import Number, SmoothTable, Table, columns_of, curve_of, number_or_table

_VARIABLE = "variable:"  #: Prefix of the instructions that push a variable.


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
def _smooth_program(text: str, variables: tuple[str, ...]) -> Program:
    """Return the program of a text; raises SpecError if it is not valid, or not smooth."""
    compiler = VariableCompiler(text, variables)
    program = tuple(compiler.program())
    kinks = {name for name, _ in program if name in OPERATIONS and OPERATIONS[name].switch and name != "atan2"}
    if kinks:
        compiler.refuse(f"{listed(sorted(kinks), 'and')} cannot be used here, because a derivative is discontinuous", 0)
    return program


#: Largest last change of a root by Newton's method, relative to the root or 1.
#:
#: The error of the root is about its square before the last step, and its fourth power after it.
CONVERGED = 1e-8


@dataclass(frozen=True)
class Profile:
    """A smooth function of variables, most often of one, such as the radius of a cam as a function of the angle.

    Profiles with the same function are equal, so that joints with such profiles share a program.

    Parameters
    ----------
    function
        A number, a table, the program of an expression, or a Python function.
    variables
        Names of the variables, in the order in which `value` takes them; needed for programs.
    """

    function: float | Table | Program | Callable[..., Any]
    variables: tuple[str, ...] = ()

    @classmethod
    def of(cls, function: float | str | Table | Callable[..., Any], *variables: str) -> Profile:
        """Return the profile that a number, an expression of these variables, a table or a Python function gives.

        Raises
        ------
        SpecError
            If an expression is not valid, or a derivative of it is discontinuous.
        """
        return cls(_smooth_program(function, variables) if isinstance(function, str) else function, variables)

    @classmethod
    def key(cls, variable: str) -> Any:
        """Return the type of a key of a spec: a number, an expression of a variable, or a table of a smooth spline."""

        class CurveTable(SmoothTable):
            """A smooth function of one variable, given by points and interpolated by a cubic or quintic spline."""

            COLUMNS: ClassVar[str] = f"[[{variable}, ...], [value, ...]]"
            columns: ClassVar[Callable[..., object]] = partial(
                columns_of, at=f"values of {variable}", shown=f"{variable}, value"
            )

        wanted = f"a number, an expression of {variable}, or {{table: {CurveTable.COLUMNS}}}"

        def smooth(value: object) -> object:
            if not isinstance(value, str):
                return number_or_table(value, CurveTable, wanted)
            cls.of(value, variable)
            return value

        CurveTable.__name__ = CurveTable.__qualname__ = f"TableOf{variable.title()}"
        return Annotated[Number | str | CurveTable, BeforeValidator(smooth)]

    def value(self, *at: Any, **numbers: Any) -> Any:
        """Return the value at arrays, or at numbers that record operations.

        Parameters
        ----------
        at
            Value of each variable.
        numbers
            The numbers that `with_numbers` has named.
        """
        if isinstance(self.function, tuple):
            given = dict(zip(self.variables, at, strict=True)) | numbers
            return value_of(self.function, lambda name, number: given.get(name.removeprefix(_VARIABLE), number))
        if isinstance(self.function, Table):
            curve, (x,) = curve_of(self.function), at
            if isinstance(x, np.ndarray):
                return curve(x)
            return x.recorder.table(curve.x, curve.c[::-1].T, x, self.function.period)
        return self.function(*at) if callable(self.function) else self.function + 0.0 * at[0]

    def with_slope(self, at: Recorded) -> tuple[Recorded, Recorded]:
        """Return the value and the derivative of a function of one variable at a recorded number.

        The number need not be an input. A Python function is called once.
        """
        recorder = at.recorder
        argument = recorder.input(f"argument {len(recorder.terms)}")
        value = recorder.constant(self.value(argument))
        slope = derivative(value, argument)
        return recorder.replaced(value, argument, at), recorder.replaced(slope, argument, at)

    def root(self, start: Recorded, iterations: int = 8) -> Recorded:
        """Return the number s near `start` where a function of one variable is 0; NaN if Newton's method fails.

        The program contains a fixed number of iterations of Newton's method, and one more that makes the solution exact
        to rounding errors, if the last of the others has changed s by less than `CONVERGED`. They are no part of
        derivatives, which are those of the implicit function: with g(x, s) = 0, ds/dx = -(dg/dx) / (dg/ds) (A.
        Griewank, A. Walther, Evaluating Derivatives, 2nd edition, SIAM 2008, chapter 15). This quotient is a function
        of x and s again, so that derivatives of all orders are exact.

        Parameters
        ----------
        start
            Value at which the iteration starts; derivatives do not depend on it. A Python function, which may contain
            other recorded numbers, is called once.
        iterations
            Number of iterations.
        """
        recorder = start.recorder
        unknown = recorder.input(f"unknown {len(recorder.terms)}")
        wanted = recorder.constant(self.value(unknown))
        step = wanted / derivative(wanted, unknown)
        s = last = start
        for _ in range(iterations):
            last, s = s, s - recorder.replaced(step, unknown, s)
        has_converged = np.absolute(s - last) <= CONVERGED * np.maximum(np.absolute(s), 1.0)
        value: Any = np.where(has_converged, s - recorder.replaced(step, unknown, s), np.nan)
        return recorder.apply("root", [value, wanted, unknown])

    def with_numbers(self, prefix: str) -> tuple[Profile, tuple[tuple[str, float], ...]]:
        """Return the profile of an expression in which numbers are parameters, with names and values of these.

        Profiles that differ in numbers then are equal, and can be differentiated with respect to the numbers. Exponents
        stay numbers, because derivatives of powers with variable exponents need positive operands.

        Parameters
        ----------
        prefix
            Prefix of the names, to which 0, 1, ... are appended.
        """
        assert isinstance(self.function, tuple)
        program = self.function

        def step(operation: str, place: float, *operands: frozenset[int]) -> frozenset[int]:
            if operation == "const":
                return frozenset((int(place),))
            return operands[0] if operation == "pow" else frozenset().union(*operands)

        varied = execute(tuple((operation, float(place)) for place, (operation, _) in enumerate(program)), step)
        names = {place: f"{prefix}{i}" for i, place in enumerate(sorted(varied))}
        changed = [(_VARIABLE + names[i], 0.0) if i in names else one for i, one in enumerate(program)]
        numbers = tuple((name, program[place][1]) for place, name in names.items())
        return Profile(tuple(changed), self.variables), numbers
