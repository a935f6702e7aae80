"""Curves in the frame of a body: functions of one variable, given by an expression, a table or a number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator

from mbdkit.plugin import Number, SpecError, Table
from mbdkit.plugin.mechanisms import (
    columns_of,
    curve_of,
    function_of,
    number_or_table,
    value_of_table,
    value_of_text,
)


@dataclass(frozen=True)
class Curve:
    """A function of one variable.

    Parameters
    ----------
    function
        A number, a text that `function_of` accepted, or a table.
    variable
        Name of the variable in the text.
    """

    function: float | str | Table
    variable: str

    def __call__(self, at: Any) -> Any:
        """Return its value at an array, or at a number that records operations."""
        if isinstance(self.function, Table):
            return curve_of(self.function)(at) if isinstance(at, np.ndarray) else value_of_table(self.function, at)
        if isinstance(self.function, str):
            return value_of_text(self.function, {self.variable: at})
        return self.function + 0.0 * at


def curve_type(variable: str) -> Any:
    """Return the type of a field that is a smooth function of a variable."""
    shown = f"[[{variable}, ...], [value, ...]]"

    def columns(value: object, key: str = "") -> object:
        return columns_of(value, key, at=f"values of {variable}", shown=f"{variable}, value")

    class CurveTable(Table):
        """A smooth function of one variable, given by points and interpolated by a cubic or quintic spline."""

        COLUMNS: ClassVar[str] = shown

        table: Annotated[tuple[tuple[Number, ...], tuple[Number, ...]], BeforeValidator(columns)]
        interpolation: Literal["cubic", "quintic"] = "cubic"
        """A cubic or quintic spline, with two or four continuous derivatives."""

        @staticmethod
        def columns(value: object, key: str = "") -> object:
            """Return the two columns of a table as tuples of floats."""
            return columns(value, key)

    check = function_of(variable)
    wanted = f"a number, an expression of {variable}, or {{table: {shown}}}"

    def smooth(value: object) -> object:
        return check(value) if isinstance(value, str) else number_or_table(value, CurveTable, wanted)

    CurveTable.__name__ = CurveTable.__qualname__ = f"TableOf{variable.title()}"
    return Annotated[Number | str | CurveTable, BeforeValidator(smooth)]


if TYPE_CHECKING:
    OfAngle = float | str | Table
    OfX = float | str | Table
else:
    OfAngle = curve_type("angle")
    OfX = curve_type("x")

CLOSED = 1e-9
"""Largest jump of a closed curve, relative to its size, where its angle passes 180 degrees."""


def check_closed(radius: Curve, key: str) -> np.ndarray:
    """Raise SpecError unless a polar curve is closed and its radius is positive; return points (721,) of the radius."""
    angles = np.linspace(-np.pi, np.pi, 721)
    values = np.asarray(radius(angles), dtype=float)
    if not np.all(np.isfinite(values)) or np.min(values) <= 0.0:
        worst = float(angles[np.argmin(np.where(np.isfinite(values), values, -np.inf))])
        raise SpecError(f"the radius is not positive everywhere, for example at the angle {worst:.4g} rad", key=key)
    step = 1e-4
    begin, end = np.array([-np.pi, step - np.pi]), np.array([np.pi, np.pi + step])
    jump = float(np.max(np.abs(np.asarray(radius(begin)) - np.asarray(radius(end)))))
    if jump > CLOSED * float(np.max(values)):
        raise SpecError(
            f"the curve is not closed: its radius or slope differs by {jump:.3g} m between the angles -pi and pi; "
            "a table needs `ends: periodic` and covers 2*pi",
            key=key,
        )
    return values
