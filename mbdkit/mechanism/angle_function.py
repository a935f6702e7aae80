"""Functions of the relative angle of a joint that displace its center: numbers, expressions, and tables."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BeforeValidator

from mbdkit.base.strict_model import StrictModel
from mbdkit.base.text import listed
from mbdkit.expressions.jets import jet_and_switches
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.parser import Compiler, Expression, ExpressionError
from mbdkit.expressions.program import MAX_DEPTH, depth_of, derivative_of
from mbdkit.mechanism.values import Columns, Number, SmoothTable, Table, columns_of, curve_of, number_or_table

WANTED = 'a number, an expression of angle such as "0.02*sin(angle)", or {table: [[angle, ...], [value, ...]]}'


class AngleExpressionError(ExpressionError):
    """An expression of an angle that is not valid."""


class AngleCompiler(Compiler):
    """Compiles an expression of `angle`; in the program, the instruction ``t`` pushes the angle."""

    wanted = "an expression of angle, which consists of numbers, angle, pi"
    variable = "angle"
    error = AngleExpressionError


class AngleTable(SmoothTable):
    """A function of the relative angle, given by points and interpolated by a cubic or quintic spline.

    The joint must be within the table at the start of a run. If it leaves the table later, the first or last polynomial
    is extrapolated, with a warning. Steps do not end at the points: the third derivative of a cubic spline and the
    fifth one of a quintic spline are discontinuous there, which reduces the accuracy of methods of higher order.
    """

    COLUMNS: ClassVar[str] = "[[angle, ...], [value, ...]]"
    columns: ClassVar[Callable[..., object]] = partial(columns_of, at="angles", shown="angle, value")

    table: Columns
    """Strictly increasing angles [rad] and the value at each angle [m]: ``[[angle, ...], [value, ...]]``."""


def _angle_function(value: object) -> object:
    """Accept finite numbers and valid expressions of `angle`, and convert mappings to tables."""
    if isinstance(value, str):
        expression_of(value)
        return value
    if isinstance(value, Table) and not isinstance(value, AngleTable):
        value = value.model_dump(exclude_unset=True)
    return number_or_table(value, AngleTable, WANTED)


#: A function of a relative angle [rad]: a number, an expression of `angle`, or a table.
AngleFunction = Annotated[Number | str | AngleTable, BeforeValidator(_angle_function)]


class Center(StrictModel):
    """The displacement of the point of a joint on its first body, as a function of ``angle_b - angle_a``."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("x", "y")

    x: AngleFunction = 0.0
    """Component along the x axis of the first body [m]: number, expression of `angle`, or table."""
    y: AngleFunction = 0.0
    """Component along the y axis of the first body [m]: number, expression of `angle`, or table."""

    @property
    def functions(self) -> tuple[tuple[str, AngleFunction], ...]:
        """Keys and functions of both components."""
        return ("x", self.x), ("y", self.y)

    def at(self, angles: np.ndarray) -> np.ndarray:
        """Return the displacement (F, 2) [m] at relative angles (F,) [rad]."""
        return np.stack([value_at(function, angles) for _, function in self.functions], axis=-1)

    def outside(self, angle: float) -> tuple[str, AngleTable] | None:
        """Return key and table of the first component that is given by a table which does not cover a relative angle
        [rad]; None if there is none. Periodic tables cover all angles.
        """
        for key, function in self.functions:
            if isinstance(function, AngleTable) and not function.period:
                first, last = function.span
                if not first <= angle <= last:
                    return key, function
        return None


def value_at(function: AngleFunction, angles: np.ndarray) -> np.ndarray:
    """Return the values of a function of an angle at `angles` (F,) [rad]."""
    if isinstance(function, str):
        return jet_and_switches(expression_of(function).program, angles)[0].value
    if isinstance(function, AngleTable):
        return np.asarray(curve_of(function)(angles))
    return np.full(len(angles), float(function))


@lru_cache(maxsize=1024)
def expression_of(text: str) -> Expression:
    """Return an expression of `angle`; the instruction ``t`` of its program pushes the angle.

    Raises SpecError if the text is not valid, if a derivative of an operation is discontinuous, or if the expression is
    nested too deeply.
    """
    program = tuple(AngleCompiler(text).program())
    if kinks := sorted({name for name, _ in program if name in OPERATIONS and OPERATIONS[name].switch}):
        raise AngleExpressionError(
            f"{listed(kinks, 'and')} cannot be used here: a derivative is discontinuous, but a center must move "
            f"smoothly"
        )
    depth = max(depth_of(program), depth_of(derivative_of(program)))
    if depth > MAX_DEPTH:
        raise AngleExpressionError(
            f"the expression and its derivative need {depth} intermediate values at once, more than {MAX_DEPTH}; use "
            "less nesting, or a table"
        )
    return Expression(text, program, depth)
