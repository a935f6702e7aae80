"""Writes a table, such as a group of a run, as CSV, Parquet, MATLAB file, OpenSim storage or JSON.

To add a format, write its function and an item `mbdkit.plugin.TableFormat`.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.base.plain_data import json_text
from mbdkit.base.text import csv_cell, shown
from mbdkit.quantities.array import TEXT
from mbdkit.registry.seam import Seam
from mbdkit_report.group_table import TableColumn

MATLAB_LENGTH = 63  #: Longest name of a variable in MATLAB (``namelengthmax``).


class ExportedTable(Protocol):
    """Interface of a table that can be exported."""

    @property
    def group(self) -> str:
        """Name of the table."""

    @property
    def rows(self) -> int:
        """Number of rows."""

    @property
    def first(self) -> TableColumn:
        """The first column: times, or numbers of rows."""

    @property
    def columns(self) -> tuple[TableColumn, ...]:
        """The other columns."""

    def blocks(self) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
        """Yield the values of the first column and of the other columns, in blocks of rows."""

    def without_text(self) -> ExportedTable:
        """Return the table without its columns of text."""


@Seam
def table_writer(table: ExportedTable, path: Path, /) -> None:
    """Write a table to a file."""
    raise NotImplementedError


@Seam
def workbook_writer(tables: Mapping[str, ExportedTable], path: Path, /) -> None:
    """Write tables by name to one file."""
    raise NotImplementedError


@table_writer
def write_csv(table: ExportedTable, path: Path) -> None:
    """Write comma-separated values in UTF-8: one line with names and units, such as ``knee.force_x [N]``, then rows.

    Numbers have all their digits, so that reading returns the same values; those that are not finite are written as
    ``nan`` and ``inf``. An apostrophe precedes cells of text that spreadsheets would take for formulas.
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([csv_cell(name) for name in headings(table)])
        for row in rows_of(table):
            writer.writerow([csv_cell(cell) if isinstance(cell, str) else repr(cell) for cell in row])


@table_writer
def write_json(table: ExportedTable, path: Path) -> None:
    """Write one JSON object with the name of the group, columns with units and descriptions, and rows.

    Numbers that are not finite are null.
    """
    columns = [
        {"name": column.name, "units": column.units, "description": column.array.long_name} for column in _all(table)
    ]
    with path.open("w", encoding="utf-8") as file:
        file.write(f'{{"group": {json_text(table.group)},\n "columns": {json_text(columns)},\n "rows": [')
        for number, row in enumerate(rows_of(table)):
            file.write(f"{',' if number else ''}\n  {json_text(row)}")
        file.write("\n ]}\n")


@table_writer
def write_sto(table: ExportedTable, path: Path) -> None:
    """Write a storage file of OpenSim: a header, and numbers separated by tabulators with the time first.

    Angles are in radians. In names, white space and other characters that OpenSim would read as separators are replaced
    by ``_``. Text is left out.
    """
    table = table.without_text()
    labels = distinct(re.sub(r"[\s\x00-\x1f\x7f]+", "_", shown(name)) for name, _ in names_and_units(table))
    size = f"nRows={table.rows}", f"nColumns={len(labels)}"
    header = [f"mbdkit_{table.group}", "version=1", *size, "inDegrees=no", "endheader", "\t".join(labels)]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(header) + "\n")
        for row in rows_of(table):
            file.write("\t".join(map(repr, row)) + "\n")


@table_writer
def write_mat(table: ExportedTable, path: Path) -> None:
    """Write a MATLAB file, version 5: ``time`` and a column vector for each column, such as ``knee_force_x``.

    The structures ``units`` and ``names`` map the variables to their units and to the names in the archive.
    """
    from scipy.io import savemat

    pairs = list(names_and_units(table))
    variables = _matlab_names([name for name, _ in pairs])
    blocks = [[first, *others] for first, others in table.blocks()]
    columns = zip(*blocks, strict=True) if blocks else [[np.zeros(0)]] * len(variables)
    named: dict[str, object] = dict(zip(variables, [np.concatenate(parts) for parts in columns], strict=True))
    named["units"] = {variable: units for variable, (_, units) in zip(variables, pairs, strict=True)}
    named["names"] = {variable: name for variable, (name, _) in zip(variables, pairs, strict=True)}
    with path.open("wb") as file:
        savemat(file, named, long_field_names=True, oned_as="column", do_compression=True)


@table_writer
def write_parquet(table: ExportedTable, path: Path) -> None:
    """Write a Parquet file, whose columns have units and descriptions as metadata of their fields.

    Raises
    ------
    MbdkitError
        If pyarrow is not installed.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise MbdkitError("Parquet files need the package pyarrow: pip install pyarrow") from error
    kinds = {TEXT: pyarrow.string(), "<i8": pyarrow.int64()}
    fields = [
        pyarrow.field(
            column.name,
            kinds.get(column.array.dtype, pyarrow.float64()),
            metadata={"units": column.units, "description": column.array.long_name},
        )
        for column in _all(table)
    ]
    schema = pyarrow.schema(fields, metadata={"group": table.group})
    with parquet.ParquetWriter(path, schema) as writer:
        for time, values in table.blocks():
            writer.write_table(pyarrow.table([time, *values], schema=schema))


def names_and_units(table: ExportedTable) -> Iterator[tuple[str, str]]:
    """Yield name and units of each column."""
    return ((column.name, column.units) for column in _all(table))


def _all(table: ExportedTable) -> tuple[TableColumn, ...]:
    return table.first, *table.columns


def headings(table: ExportedTable) -> list[str]:
    """Return the names of the columns with their units, such as ``knee.force_x [N]``."""
    return [name if units == "1" else f"{name} [{units}]" for name, units in names_and_units(table)]


def rows_of(table: ExportedTable) -> Iterator[list[object]]:
    """Yield the rows of a table."""
    for time, values in table.blocks():
        yield from map(list, zip(time.tolist(), *(column.tolist() for column in values), strict=True))


def _matlab_names(names: Iterable[str]) -> list[str]:
    words = (re.sub(r"[^A-Za-z0-9_]", "_", name) for name in names)
    letters_first = (word if word[:1].isalpha() else f"x{word}" for word in words)
    return distinct(letters_first, MATLAB_LENGTH, taken=("units", "names"))


def distinct(
    names: Iterable[str], length: int = 1_000_000, taken: Sequence[str] = (), *, cased: bool = True
) -> list[str]:
    """Return the names, cut to a length, with ``_2``, ``_3`` and so on appended to those that occurred before; unless
    `cased`, names that differ in capitals count as the same.
    """
    used, texts = set(taken), []
    for name in names:
        new, number = name[:length], 2
        while (new if cased else new.lower()) in used:
            end = f"_{number}"
            new, number = name[: length - len(end)] + end, number + 1
        used.add(new if cased else new.lower())
        texts.append(new)
    return texts
