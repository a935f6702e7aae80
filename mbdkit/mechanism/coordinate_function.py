"""Functions of named coordinates of a mechanism: the coordinates of path points that move in the frames of bodies."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BeforeValidator

from mbdkit.base.errors import SpecError
from mbdkit.expressions.operations import FUNCTIONS
from mbdkit.expressions.parser import Code, Compiler, ExpressionError
from mbdkit.expressions.program import Program, execute, with_slope
from mbdkit.mechanism.values import Columns, Number, SmoothTable, columns_of, curve_of, number_or_table

_COORDINATE = "coordinate:"  #: Prefix of the instructions that push a coordinate.


class CoordinateExpressionError(ExpressionError):
    """A function with a name that is not the name of a coordinate, or with a coordinate where it must be constant."""


class CoordinateCompiler(Compiler):
    """Compiles an expression of named coordinates; whether the names exist is checked later, with the mechanism."""

    wanted = "an expression of named coordinates, which consists of numbers, names of coordinates, pi"
    variable = ""

    def operand(self, node: ast.expr) -> Code:
        """Return the program of a coordinate; the base class rejects all other operands."""
        if isinstance(node, ast.Name) and node.id not in FUNCTIONS:
            return [(_COORDINATE + node.id, 0.0)]
        return super().operand(node)


@lru_cache(maxsize=1024)
def program_of(text: str) -> Program:
    """Return the program of an expression of coordinates; raises SpecError with the position of an error."""
    return tuple(CoordinateCompiler(text).program())


class CoordinateTable(SmoothTable):
    """A function of a named coordinate, given by points and interpolated by a cubic or quintic spline."""

    COLUMNS: ClassVar[str] = "[[coordinate, ...], [value, ...]]"
    columns: ClassVar[Callable[..., object]] = partial(columns_of, at="coordinates", shown="coordinate, value")

    table: Columns
    """Strictly increasing coordinates [rad or m] and the value at each coordinate [m]."""
    of: str
    """Name of the coordinate."""


def _function(value: object) -> object:
    """Accept numbers and valid expressions, and convert mappings to tables."""
    if isinstance(value, str):
        program_of(value)
    elif isinstance(value, Mapping):
        of = value.get("of")
        if not isinstance(of, str):
            raise SpecError("is missing: the name of the coordinate that the table is a function of", key="of")
        points = {key: entry for key, entry in value.items() if key != "of"}
        return number_or_table(points, CoordinateTable, WANTED, of=of)
    return value


WANTED = "a number, an expression of coordinates, or {table: [[coordinate, ...], [value, ...]], of: COORDINATE}"

#: A number, an expression of named coordinates, or a table of one named coordinate.
CoordinateFunction = Annotated[Number | str | CoordinateTable, BeforeValidator(_function)]


def names_of(function: CoordinateFunction) -> list[str]:
    """Return the names of the coordinates in a function, each once."""
    if isinstance(function, CoordinateTable):
        return [function.of]
    if not isinstance(function, str):
        return []
    used = (name for name, _ in program_of(function) if name.startswith(_COORDINATE))
    return [name.removeprefix(_COORDINATE) for name in dict.fromkeys(used)]


def value_and_slopes(
    function: CoordinateFunction, coordinates: Mapping[str, np.ndarray], frames: int
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the values (T,) of a function in T frames, and its derivatives (T,), by name of the coordinate.

    The derivatives are with respect to those coordinates that the function contains.

    `coordinates`: values (T,) of the coordinates by name. `frames`: the number T.
    """
    none = np.zeros(frames)
    if isinstance(function, CoordinateTable):
        curve, at = curve_of(function), coordinates[function.of]
        return curve(at), {function.of: curve(at, 1)}
    if not isinstance(function, str):
        return none + function, {}
    program = program_of(function)

    def along(text: str) -> tuple[np.ndarray, np.ndarray]:
        def step(name: str, number: float, *operands: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
            if name == "const":
                return none + number, none
            if name.startswith(_COORDINATE):
                used = name.removeprefix(_COORDINATE)
                return coordinates[used], none + float(used == text)
            return with_slope(name, number, operands, none)

        return execute(program, step)

    with np.errstate(all="ignore"):  # ignores overflow in second derivatives, which are not used
        if not (slopes := {name: along(name) for name in names_of(function)}):
            return along("")[0], {}
    return next(iter(slopes.values()))[0], {name: slope for name, (_, slope) in slopes.items()}
