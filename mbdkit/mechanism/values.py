"""Types of the values of elements, with validation: numbers, points, functions of time and tables."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import BeforeValidator, Field

from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.text import did_you_mean, listed
from mbdkit.base.traced_numbers import as_float
from mbdkit.expressions.parser import Expression


class TextForNumberError(SpecError):
    """There is a text in place of a number; it may be an expression of parameters."""


def _shown(value: object) -> str:
    """Return a value as text for an error message, shortened to at most 60 characters."""
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def pair(wanted: str) -> Callable[[object], Any]:
    """Return a validator for a list, tuple or array of two items; `wanted` describes the pair in error messages."""

    def check(value: object) -> object:
        plain = value.tolist() if hasattr(value, "tolist") else value
        if isinstance(plain, list):
            plain = tuple(plain)
        if not isinstance(plain, tuple):
            is_number = isinstance(plain, str | int | float) and re.match(r"[-+]?\.?\d", str(plain)) is not None
            down = f"-{str(plain).lstrip('+-')}"  # a single number is mostly that of gravity
            example = f", such as [0, {down}], where y points up" if is_number and wanted.endswith("[x, y]") else ""
            raise SpecError(f"should be {wanted}{example}, not {_shown(plain)}")
        if len(plain) != 2:
            raise SpecError(f"should be {wanted}, not {len(plain)} item{'s' * (len(plain) != 1)}")
        return plain

    return check


def sequence(value: object) -> object:
    """Return a list or array as a tuple, and any other value unchanged."""
    plain = value.tolist() if hasattr(value, "tolist") else value
    return tuple(plain) if isinstance(plain, list) else plain


def motion(value: Any) -> Any:
    """Accept finite numbers and valid expressions of time, and convert mappings to tables."""
    if isinstance(value, str):
        Expression.parse(value)
        return value
    wanted = 'a number, an expression of t such as "0.5*sin(2*pi*t)", or {table: [[t, ...], [value, ...]]}'
    return number_or_table(value, Table, wanted)


def number_or_table(value: Any, kind: type[Table], wanted: str, **further: object) -> Any:
    """Accept finite numbers and tables of the class `kind`, and convert mappings to such tables.

    `wanted` describes the expected value in error messages.
    """
    if isinstance(value, Mapping):
        choices = {key: get_args(kind.model_fields[key].annotation) for key in ("interpolation", "ends")}
        if "table" not in value or not {*value} <= {"table", *choices}:
            raise SpecError(
                f"should be {{table: {kind.COLUMNS}}}, with the options interpolation and ends, not a mapping "
                f"with the keys {_shown([*value])}"
            )
        options = {key: option for key, option in value.items() if key in choices}
        for key, option in options.items():
            if option not in (known := choices[key]):
                hint = did_you_mean(option, known) if isinstance(option, str) else ""
                raise SpecError(f"should be {listed(known, 'or')}, not {_shown(option)}{hint}", key=key)
        return _consistent(kind(table=kind.columns(value["table"], "table"), **options, **further))
    if isinstance(value, kind):
        return _consistent(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SpecError(f"should be {wanted}, not {_shown(value)}")
    if not abs(value) <= sys.float_info.max:
        raise SpecError(f"should be a finite number, not {value!r}")
    return value


def columns_of(
    value: object, key: str = "", *, at: str = "times", of: str = "values", shown: str = "t, value", least: int = 2
) -> Any:
    """Return the two columns of a table as tuples of floats.

    Parameters
    ----------
    value
        Two columns of equal length; the first column must be strictly increasing.
    key
        Key of the table, for error messages.
    at, of
        Plural nouns for the contents of the first and second columns, for error messages.
    shown
        Names of one entry of each column, for error messages.
    least
        Smallest number of rows.

    Raises
    ------
    SpecError
        If `value` is not such a table.
    """
    first, second = shown.split(", ")
    with SpecError.locate(key):
        columns = pair(f"a column of {at} and a column of {of}, [[{first}, ...], [{second}, ...]]")(value)
    columns = [sequence(column) for column in columns]
    for number, column in enumerate(columns):
        if not isinstance(column, tuple):
            raise SpecError(f"should be a list of numbers, not {_shown(column)}", key=f"{key}[{number}]")
        for row, x in enumerate(column):
            if isinstance(x, bool) or not isinstance(x, int | float) or not abs(x) <= sys.float_info.max:
                kind = TextForNumberError if isinstance(x, str) else SpecError
                raise kind(f"should be a finite number, not {_shown(x)}", key=f"{key}[{number}][{row}]")
    times, values = (tuple(map(as_float, column)) for column in columns)
    if len(times) != len(values):
        raise SpecError(f"a table needs as many {of} as {at}; it has {len(values)} and {len(times)}", key=key)
    if len(times) < least:
        raise SpecError(f"a table needs {'two points' if least == 2 else 'a point'} or more, not {len(times)}", key=key)
    for row in range(1, len(times)):
        if not times[row - 1] < times[row]:
            falls = all(before > after for before, after in pairwise(times))
            advice = f"; reverse the order of both the {at} and the {of}" if falls else ""
            raise SpecError(
                f"{at} must increase: {times[row]!r} comes after {times[row - 1]!r}{advice}", key=f"{key}[0][{row}]"
            )
    return times, values


def _consistent(table: Table) -> Table:
    """Return a table unchanged; raise SpecError if its options contradict its points or each other."""
    times, values = table.table
    if table.interpolation == "linear" and table.ends in ("natural", "clamped"):
        raise SpecError(
            f"linear interpolation does not support the ends {table.ends}; use `interpolation: cubic` or quintic, "
            f"or omit `ends`",
            key="ends",
        )
    if table.interpolation == "quintic" and table.ends == "not-a-knot" and len(times) < 6:
        raise SpecError(
            f"a quintic spline needs six points or more, not {len(times)}, unless its ends are natural, clamped or "
            "periodic",
            key="interpolation",
        )
    if table.ends == "periodic" and not abs(values[-1] - values[0]) <= 1e-12 * max(map(abs, values)):
        raise SpecError(
            f"the first and the last value of a periodic table must be equal, not {values[0]!r} and {values[-1]!r}",
            key="ends",
        )
    return table


# `StrictModel` also sets allow_inf_nan. It is repeated here because these types are validated outside models, too.
Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Point = Annotated[tuple[Number, Number], BeforeValidator(pair("two numbers [x, y]"))]
Points = Annotated[tuple[Point, Point], BeforeValidator(pair("two points, one in each body's frame, [[x, y], [x, y]]"))]
BodyPair = Annotated[tuple[str, str], BeforeValidator(pair("two body names [first, second]"))]
Interpolation = Literal["cubic", "quintic", "linear"]
Ends = Literal["natural", "clamped", "periodic", "not-a-knot"]
Columns = Annotated[tuple[tuple[Number, ...], tuple[Number, ...]], BeforeValidator(columns_of)]


class Table(StrictModel):
    """A function of time given by points and interpolated by a cubic or quintic spline, or by lines.

    A cubic spline has two continuous derivatives, and a quintic spline four. With the default ends, a cubic spline
    through three points is a parabola, and through two points a line; a quintic spline needs six points. Steps end at
    points with a discontinuous derivative that affects the method. The table must cover the time span of the run,
    unless it is periodic.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("interpolation", "ends")
    COLUMNS: ClassVar[str] = "[[t, ...], [value, ...]]"
    """The form of `table`, for messages."""

    table: Columns
    """Strictly increasing times [s] and the value at each time: ``[[t, ...], [value, ...]]``."""
    interpolation: Interpolation = "cubic"
    """A cubic or quintic spline, or straight lines between the points. Straight lines have a discontinuous rate at the
    points, so that a driver needs `impacts: allow`."""
    ends: Ends = "not-a-knot"
    """Condition at the ends of a spline: `not-a-knot` (the outer pieces continue the polynomials of their neighbours),
    `natural` (the second derivative is zero at the ends; for a quintic spline, the third and fourth), `clamped` (the
    first derivative is zero; for a quintic spline, the first and second), or `periodic` (the table repeats; its first
    and last values must be equal)."""

    @staticmethod
    def columns(value: object, key: str = "") -> object:
        """Return the two columns of a table as tuples of floats; see `columns_of`."""
        return columns_of(value, key)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time [s]."""
        return self.table[0][0], self.table[0][-1]

    @property
    def period(self) -> float:
        """Time after which the table repeats [s]; 0 if it does not."""
        return self.span[1] - self.span[0] if self.ends == "periodic" else 0.0


class SmoothTable(Table):
    """A smooth function of one variable, given by points and interpolated by a cubic or quintic spline."""

    interpolation: Literal["cubic", "quintic"] = "cubic"
    """A cubic or quintic spline, with two or four continuous derivatives."""


#: Orders and values of the derivatives that are prescribed at the two ends of a quintic spline, by the name of the
#: condition. SciPy knows the other conditions by name.
QUINTIC_ENDS = {
    "natural": ([(3, 0.0), (4, 0.0)], [(3, 0.0), (4, 0.0)]),
    "clamped": ([(1, 0.0), (2, 0.0)], [(1, 0.0), (2, 0.0)]),
}


@lru_cache(maxsize=64)
def curve_of(table: Table) -> Any:
    """Return the curve of a table as ``scipy.interpolate.PPoly``.

    Beyond the table, it continues its outer pieces or, if it is periodic, repeats. Raises ValueError or LinAlgError if
    the curve cannot be computed in double precision.
    """
    from scipy.interpolate import CubicSpline, PPoly, make_interp_spline

    times, values = (np.array(column) for column in table.table)
    beyond: Any = "periodic" if table.ends == "periodic" else True
    if beyond == "periodic":
        values[-1] = values[0]  # equal up to rounding errors, which `Table` has checked
    if table.interpolation == "linear":
        return PPoly(np.array([np.diff(values) / np.diff(times), values[:-1]]), times, extrapolate=beyond)
    if table.interpolation == "cubic":
        return CubicSpline(times, values, bc_type=table.ends, extrapolate=beyond)
    spline = make_interp_spline(times, values, k=5, bc_type=QUINTIC_ENDS.get(table.ends, table.ends))
    curve = PPoly.from_spline(spline)
    # The five pieces at each end are empty, or lie outside the period.
    return PPoly(curve.c[:, 5:-5], curve.x[5:-5], extrapolate=beyond)


#: A function of time: a number, an expression of t, or a table.
Motion = Annotated[Number | str | Table, BeforeValidator(motion)]
MotionPair = Annotated[tuple[Motion, Motion], BeforeValidator(pair("two numbers, expressions of t or tables [x, y]"))]
