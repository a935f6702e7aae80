"""The table of the runs of a study, in formats that other programs read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbdkit.archive.result_seams import exported_files
from mbdkit.base.errors import SpecError
from mbdkit.quantities.array import FLOAT, INTEGER, TEXT, Array
from mbdkit_report import TableColumn, write_tables
from mbdkit_report.group_table import BLOCK_VALUES
from mbdkit_studies.study import Study


@dataclass(frozen=True, eq=False)
class RunsTable:
    """The table of the runs of a study.

    Parameters
    ----------
    first
        The column of the numbers of the runs.
    columns
        The other columns.
    values
        (N,) values of the columns by name: numbers, or object arrays of texts.
    """

    first: TableColumn
    columns: tuple[TableColumn, ...]
    values: Mapping[str, np.ndarray]
    group: str = "runs"

    @property
    def rows(self) -> int:
        """Number of runs."""
        return len(self.values[self.first.name])

    def blocks(self) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
        """Yield the numbers of the runs and the values of the columns in blocks of rows."""
        size = max(1, BLOCK_VALUES // (len(self.columns) + 1))
        for start in range(0, self.rows, size):
            part = slice(start, start + size)
            yield self.values[self.first.name][part], [self.values[column.name][part] for column in self.columns]

    def without_text(self) -> RunsTable:
        """Return the table without its columns of text."""
        numbers = tuple(column for column in self.columns if column.array.dtype != TEXT)
        return RunsTable(self.first, numbers, self.values)


def export_runs(study: Study, folder: Path, to: str, *, overwrite: bool = False) -> list[Path]:
    """Write the table of the runs of a study to a file ``runs.FORMAT`` in a folder, and return the file in a list.

    Parameters
    ----------
    folder
        Folder of the file; it is created if its parent exists.
    to
        Format: ``csv``, ``parquet``, ``xlsx``, ``mat`` or ``json``.
    overwrite
        Whether an existing file may be replaced.

    Raises
    ------
    SpecError
        If the format is unknown or suitable only for data over time, or if the file exists or cannot be written.
    ResourceError
        If the disk is full or writing is not permitted.
    MbdkitError
        If a package that is needed is not installed.
    """
    if to == "sto":
        raise SpecError("the format sto is for data over time; export the table of a study as csv or parquet")
    values, units = {name: np.asarray(column) for name, column in study.columns().items()}, study.units
    columns = []
    for name, column in values.items():
        dtype = {"i": INTEGER, "f": FLOAT}.get(column.dtype.kind, TEXT)
        if dtype == TEXT:
            values[name] = np.array(["" if value is None else str(value) for value in column], object)
        unit = units.get(name, "1")
        what = study.described(name)[1] if name in units else name
        columns.append(TableColumn(name, unit, Array(f"runs/{name}", ("run",), unit, what, dtype), ()))
    return write_tables({"runs": RunsTable(columns[0], tuple(columns[1:]), values)}, folder, to, overwrite=overwrite)


@exported_files
def export_study(folder: Path, output: Path, to: str, *, overwrite: bool = False) -> list[Path]:
    """Export the table of runs of the study in a folder; see `export_runs`."""
    from mbdkit_studies.compute.carry_out import load_study

    return export_runs(load_study(folder), output, to, overwrite=overwrite)
