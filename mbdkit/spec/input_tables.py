"""Tables in files, and the section `inputs` of a run spec: values of inputs over time, from tables or files."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.files_read import read_data
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import counted, did_you_mean, listed, shortened, shown
from mbdkit.base.units import NUMBER, misfit, read_unit
from mbdkit.engine.input_schedule import InputSchedule
from mbdkit.mechanism.state_values import Input
from mbdkit.mechanism.values import Number, columns_of
from mbdkit.spec.sections import Section

LARGEST_FILE = 16 * 2**20  #: Largest size of a file [bytes].


def read_columns(path: Path, columns: Sequence[str]) -> list[list[float]]:
    """Return the numbers in the columns of a CSV file with the given headings, in the order of `columns`.

    The file has a line of headings, and commas, semicolons or tabs between its cells; lines that begin with ``#`` are
    ignored. Raises SpecError, with the file and line, if it has no such columns, if a cell is not a finite number in
    ASCII digits, or if a row has another number of cells than the headings.
    """
    content = read_data(path, LARGEST_FILE, "keep the rows and columns that are used")
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise SpecError("this file is not valid UTF-8 text", file=path) from None
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not numbered:
        message = "this file is empty; it should have a line of headings, and numbers in each further line"
        raise SpecError(message, file=path)
    delimiter = max(",;\t", key=numbered[0][1].count)
    rows = [_cells(line, delimiter, path, number) for number, line in numbered]
    headings = [heading.strip() for heading in rows[0]]
    for column in columns:
        if headings.count(column) != 1:
            known = did_you_mean(column, headings) or f"; columns: {listed([shown(one) for one in headings], 'and')}"
            raise SpecError(f"there should be one column '{column}'{known}", file=path, line=numbered[0][0])
    places = [headings.index(column) for column in columns]
    numbers: list[list[float]] = [[] for _ in columns]
    for (line, _), row in zip(numbered[1:], rows[1:], strict=True):
        if len(row) != len(headings) and (len(row) < len(headings) or any(row[len(headings) :])):
            message = f"this row has {counted(len(row), 'cell')}, but there are {counted(len(headings), 'heading')}"
            raise SpecError(message, file=path, line=line)
        for own, place, column in zip(numbers, places, columns, strict=True):
            cell = row[place].strip()
            if not (re.fullmatch(NUMBER, cell) and math.isfinite(float(cell))):
                message = f"the column '{column}' should have a number here, not '{shortened(shown(cell))}'"
                raise SpecError(message, file=path, line=line)
            own.append(float(cell))
    return numbers


def _cells(line: str, delimiter: str, path: Path, number: int) -> list[str]:
    is_open, most = line.count('"') % 2 == 1, csv.field_size_limit()
    with suppress(csv.Error):  # the cell is too long
        if not is_open:
            return next(csv.reader([line], delimiter=delimiter))
    parts = enumerate(line.split(delimiter), 1)
    column = next((i for i, part in parts if part.count('"') % 2 or len(part) > most), 1)
    why = "has a quotation mark that is not closed" if is_open else f"has more than {most} characters"
    raise SpecError(f"cell {column} of this row {why}", file=path, line=number)


def _columns(value: object) -> Any:
    return columns_of(value, least=1)


class InputTable(Section):
    """Values of an input: a table, or two columns of a file."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("table", "file", "x", "y", "unit")

    table: Annotated[tuple[tuple[Number, ...], tuple[Number, ...]], BeforeValidator(_columns)] | None = None
    """Strictly increasing times [s] and the value at each time: ``[[t, ...], [value, ...]]``. Before the first time,
    the input has its `initial` value, and after the last time, the last value."""
    file: str | None = None
    """File with a table, as an alternative to `table`: CSV with a line of headings, relative to the folder of the spec.
    """
    x: str = "time"
    """Heading of the column of the file with the times [s]."""
    y: str = ""
    """Heading of the column of the file with the values; by default, the name of the input."""
    unit: str | None = None
    """Unit of the values; by default, the unit of the input."""

    @model_validator(mode="after")
    def _one(self) -> InputTable:
        if self.table is None:
            raise SpecError("needs `table: [[t, ...], [value, ...]]`, or `file`, `x` and `y` in a spec that is loaded")
        if self.file is not None:
            raise SpecError("give either `table` or `file`, not both", key="file")
        return self

    def schedule(self, of: Input) -> InputSchedule:
        """Return the values in the unit of the input; raise SpecError if they do not fit the input."""
        assert self.table is not None
        times, values = self.table
        factor = self._factor(of)
        values = tuple(factor * value for value in values) if factor != 1.0 else values
        for row, value in enumerate(values):
            if not of.is_within(value):
                raise SpecError(f"{of.beyond(value)}, at t = {times[row]:g} s", key=f"table[1][{row}]")
        return InputSchedule.of(times, values, is_linear=of.hold == "linear")

    def _factor(self, of: Input) -> float:
        if self.unit is None or self.unit == of.unit:
            return 1.0
        with SpecError.locate("unit"):
            given = read_unit(self.unit)
            if not given.fits(read_unit(of.unit)):
                raise SpecError(misfit(self.unit, given, (of.unit,)))
        return given.factor


def schedules_of(tables: Mapping[str, InputTable], inputs: Mapping[str, Input]) -> tuple[InputSchedule, ...]:
    """Return the schedule of each input of a mechanism; inputs without a table are never set.

    Raises SpecError if a table is that of an unknown input, or does not fit its input.
    """
    for name in tables:
        if name not in inputs:
            known = f"; it has {listed([*inputs], 'and')}" if inputs else "; it has none"
            message = f"the mechanism has no input '{name}'{did_you_mean(name, inputs) or known}"
            raise SpecError(message, key=f"inputs.{quoted(name)}")
    schedules = []
    for name, item in inputs.items():
        with SpecError.locate(f"inputs.{quoted(name)}"):
            schedules.append(tables[name].schedule(item) if name in tables else InputSchedule())
    return tuple(schedules)


def read_input_files(inputs: Mapping[str, object], folder: Path) -> None:
    """Replace each `file` in the plain data of the section by the table in the file.

    `folder`: folder of the spec. Raises SpecError if a file is not a table with the named columns, with the file and
    line or the key.
    """
    for name, given in inputs.items():
        if isinstance(given, dict) and isinstance(given.get("file"), str) and given.get("table") is None:
            columns = [str(given.pop(key, default)) for key, default in (("x", "time"), ("y", name))]
            given["table"] = read_columns(folder / given.pop("file"), columns)
