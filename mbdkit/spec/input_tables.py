"""The section `inputs` of a run spec: the values of inputs over time, from tables or files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import did_you_mean, listed
from mbdkit.base.units import misfit, read_unit
from mbdkit.engine.input_schedule import InputSchedule
from mbdkit.mechanism.state_values import Input
from mbdkit.mechanism.values import Number, columns_of
from mbdkit.spec.sections import Section
from mbdkit.spec.table_files import read_columns


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
