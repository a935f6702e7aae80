"""Measured functions of time in specs of predictions."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from pydantic import model_validator

from mbdkit.base.errors import SpecError
from mbdkit.base.units import read_unit
from mbdkit.mechanism.values import Columns, Ends, Interpolation, Table, number_or_table
from mbdkit.spec.sections import Section
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table


class MeasuredFunction(Section):
    """A function of time: a table, or two columns of a file."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("table", "interpolation", "ends", "file", "x", "y", "unit")

    table: Columns | None = None
    """Times [s] and values: `[[t, ...], [value, ...]]`."""
    interpolation: Interpolation = "cubic"
    """A cubic or quintic spline, or straight lines between the points."""
    ends: Ends = "not-a-knot"
    """Condition at the ends of a spline, as in tables of drivers."""
    file: str | None = None
    """File with a table, such as CSV with a line of headings, or .mot, relative to the folder of the spec; as an
    alternative to `table`."""
    x: str = "time"
    """Heading of the column with the times [s]."""
    y: str = ""
    """Heading of the column with the values."""
    unit: str | None = None
    """Unit of the values, such as deg or mm, or 1 for a number; by default, that in the file, or SI units."""

    @model_validator(mode="after")
    def _one(self) -> MeasuredFunction:
        if (self.table is None) == (self.file is None) or (self.file and not self.y):
            raise SpecError("needs either `table: [[t, ...], [value, ...]]` or `file`, `x`, `y` and `unit`")
        return self

    def read(self, folder: Path) -> Table:
        """Return the function in SI units; raise SpecError if the file, or what it contains, is wrong."""
        unit = None if self.unit is None else read_unit(self.unit)
        if self.table is None:
            columns = read_table(folder / str(self.file), "file").function(self.x, self.y, unit)
        else:
            columns = [*self.table[0]], [(1.0 if unit is None else unit.factor) * value for value in self.table[1]]
        options = {"interpolation": self.interpolation, "ends": self.ends}
        function: Table = number_or_table({"table": columns, **options}, Table, "")
        return function
