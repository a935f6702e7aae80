"""Tables of measured data: CSV, Vicon, Qualisys, OpenSim .mot and .sto, .trc and C3D files, and columns from Python."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError, file_error
from mbdkit.base.text import did_you_mean, listed, shown
from mbdkit.base.units import read_quantity, read_unit
from mbdkit.inverse_dynamics.c3d_file import read_c3d
from mbdkit.inverse_dynamics.motion_capture_tables import (
    Columns,
    is_qualisys,
    is_vicon,
    read_qualisys,
    read_vicon,
)

GAPS = ("", "nan", "na", "n/a", "null")
"""Texts, in lower case, of cells without a value."""

HEAD = 10
"""Number of lines in which the delimiter of a Vicon file is searched."""

HEADINGS_SHOWN = 30

LARGEST_FILE = 128 * 2**20
"""Largest size of a file that is read [bytes]."""

MOST_CELLS = 10_000_000
"""Largest number of cells of a table; a cell takes about 70 bytes of memory."""


@dataclass(frozen=True)
class Table:
    """A table of numbers, whose cells are converted when a column is used.

    Parameters
    ----------
    file
        Name of the file, for messages; empty for data from Python.
    headings
        Headings of the columns.
    cells
        Rows of cells, each a text or a number; None is a gap.
    lines
        Number of the line of each row in the file; empty if the format has no lines.
    units
        Units that the file states, by heading.
    in_degrees
        Whether the file states that rotations are in degrees, without naming their columns.
    remark
        Contents of the file that could not be read, as a clause for messages; empty if nothing is missing.
    """

    file: str
    headings: Sequence[str]
    cells: Sequence[Sequence[Any]]
    lines: Sequence[int] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    in_degrees: bool = False
    remark: str = ""
    _place: dict[str, int] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        for index, heading in enumerate(self.headings):
            if heading in self._place and heading:
                raise self.error(f"two columns have the heading '{shown(heading)}'")
            self._place[heading] = index
        without_subject = [heading.rpartition(":")[2] for heading in self.headings]
        for index, heading in enumerate(without_subject):  # Vicon names markers Subject:LKNE
            if heading not in self._place and without_subject.count(heading) == 1:
                self._place[heading] = index

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def name(self) -> str:
        """Name of the table in messages."""
        return Path(self.file).name if self.file else "the data"

    def error(self, message: str, *, row: int | None = None, key: str = "") -> SpecError:
        """Return an error about this table, or about one of its rows."""
        line = self.lines[row] if row is not None and row < len(self.lines) else None
        where = f"row {row + 1}: " if row is not None and line is None else ""
        return SpecError(f"{where}{message}", key=key, file=self.file or None, line=line)

    def unit(self, heading: str) -> str | None:
        """Return the unit that the file states for a column; None if it states none."""
        place = self._place.get(heading)
        return None if place is None else self.units.get(self.headings[place])

    def column(self, heading: str, key: str) -> np.ndarray:
        """Return the numbers of a column, (T,); gaps are nan.

        Parameters
        ----------
        key
            Key of the spec that names the column, for messages.

        Raises
        ------
        SpecError
            If there is no such column, or a cell is not a number.
        """
        place = self._place.get(heading)
        if place is None:
            names = [shown(name) for name in self.headings if name]
            some = listed(names[:HEADINGS_SHOWN]) + (", ..." if len(names) > HEADINGS_SHOWN else "")
            hint = did_you_mean(heading, names) or f"; its columns: {some}"
            remark = f" ({self.remark})" if self.remark else ""
            with suppress(SpecError):  # a text that is almost a number with a unit
                if quantity := read_quantity(heading):
                    remark += f"; for a constant, give the number in SI units without its unit: {quantity[0]:.6g}"
            raise SpecError(f"{self.name} has no column '{shown(heading)}'{hint}{remark}", key=key)
        try:
            texts = [cells[place] for cells in self.cells]
            if not all(map(_is_plain, texts)):
                raise ValueError
            values = np.array([float(text) for text in texts])
        except (IndexError, TypeError, ValueError):  # there are gaps, or cells that are not numbers
            values = np.array([math.inf])
        if np.any(np.isinf(values)):
            cells = (cells[place] if place < len(cells) else None for cells in self.cells)
            values = np.array([self._number(cell, row, heading) for row, cell in enumerate(cells)])
        return values

    def _number(self, cell: Any, row: int, heading: str) -> float:
        if cell is None:
            return math.nan
        if isinstance(cell, str):
            text = cell.strip()
            if text.lower() in GAPS:
                return math.nan
            try:
                if not _is_plain(text):
                    raise ValueError
                cell = float(text)
            except ValueError:
                message = f"column '{shown(heading)}': {shown(text)!r} is not a number{self._hint(text, row)}"
                raise self.error(message, row=row) from None
        if math.isinf(cell):
            raise self.error(f"column '{shown(heading)}': {cell} is not a finite number", row=row)
        return float(cell)

    def _hint(self, text: str, row: int) -> str:
        """Return how to change a file with decimal commas, or with a row of units below the headings."""
        if _DECIMAL_COMMA.fullmatch(text):
            return "; decimal commas are not read, so replace them by points"
        if row == 0 and len(self) > 1 and self.lines and not any(map(_begins_like_number, self.cells[0])):
            return (
                "; if this row belongs to the headings, begin it with # (a comment) or delete it; a row of units, such "
                "as s, deg and mm, is read, but this one has none that is known"
            )
        return ""

    def times(self, heading: str, key: str, factor: float) -> np.ndarray:
        """Return the times in a column, (T,) [s].

        Parameters
        ----------
        factor
            Factor from the numbers of the column to seconds.

        Raises
        ------
        SpecError
            If there is no such column, a time is missing, or times do not increase.
        """
        if heading == "time" and heading not in self._place:  # some formats, such as .trc, write `Time`
            heading = next((name for name in self.headings if name.lower() == heading), heading)
        values = factor * self.column(heading, key)
        if not len(values):
            raise self.error("this table has no rows")
        missing = np.flatnonzero(np.isnan(values))
        if missing.size:
            raise self.error(f"column '{shown(heading)}': the time is missing", row=int(missing[0]))
        back = np.flatnonzero(np.diff(values) <= 0)
        if back.size:
            row = int(back[0]) + 1
            raise self.error(
                f"column '{shown(heading)}': times should increase, but {values[row]:.10g} s follows "
                f"{values[row - 1]:.10g} s",
                row=row,
            )
        return values


_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")


def _begins_like_number(cell: Any) -> bool:
    return not isinstance(cell, str) or bool(re.match(r"\s*[-+.]?\d", cell))


def _is_plain(cell: Any) -> bool:
    """Return whether `float` reads a cell as other programs do; false for ``1_0``, read as 10, and digits of other
    scripts.
    """
    return not isinstance(cell, str) or (cell.isascii() and "_" not in cell)


def read_table(path: Path, key: str) -> Table:
    """Read a table from a file in the format given by its suffix: .csv, .tsv, .txt, .mot, .sto, .trc or .c3d.

    Text files of Vicon Nexus and of Qualisys Track Manager are recognized by their first line.

    Raises
    ------
    SpecError
        If the file does not exist, is too large, or is not a table in one of these formats.
    ResourceError
        If the system refuses to read the file.
    """
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "there is no such file"
        raise SpecError(f"{what}: {shown(str(path))}", key=key)
    suffix = path.suffix.lower()
    try:
        size = path.stat().st_size
    except OSError as error:
        raise file_error(error.errno, f"this file cannot be read: {error.strerror or error}", file=path) from None
    if size > LARGEST_FILE:
        most = LARGEST_FILE >> 20
        message = f"this table has {size / 2**20:.0f} MiB, but at most {most} MiB are read"
        raise SpecError(f"{message}; keep the rows and columns that are used", file=path)
    if suffix == ".c3d":
        return _read_c3d(path)
    readers = dict.fromkeys((".csv", ".tsv", ".txt"), _read_csv) | {
        ".mot": _read_storage,
        ".sto": _read_storage,
        ".trc": _read_trc,
    }
    if suffix not in readers:
        raise SpecError(
            f"'{shown(path.name)}' does not have the suffix of a table; known suffixes: .csv, .tsv, .mot, "
            f".sto, .trc, .c3d, and .h5 of a run",
            key=key,
        )
    try:
        lines = path.read_text(encoding="utf-8-sig").split("\n")
    except UnicodeDecodeError:
        raise SpecError("this file is not valid UTF-8 text", file=path) from None
    except OSError as error:
        raise file_error(error.errno, f"this file cannot be read: {error.strerror or error}", file=path) from None
    return readers[suffix](str(path), lines)


def table_of(data: Mapping[str, Sequence[float | None]], key: str) -> Table:
    """Return a table with the given columns by heading; raise SpecError if the columns differ in length."""
    lengths = {heading: len(values) for heading, values in data.items()}
    if len(set(lengths.values())) > 1:
        raise SpecError(
            f"columns should be of equal length, not {listed(f'{name} {n}' for name, n in lengths.items())}", key=key
        )
    return Table("", list(data), list(zip(*data.values(), strict=True)))


def _read_csv(file: str, lines: list[str]) -> Table:
    """Read a table with a line of headings and possibly a line of units, or a file of a motion capture program; lines
    that begin with # are comments.
    """
    first = next((line for line in lines if _is_row(line)), None)
    if first is None:
        raise SpecError("this table is empty; its first line should hold the headings of the columns", file=file)
    if is_qualisys(first):
        return _of_program(file, read_qualisys(file, _rows_of(file, lines, "\t")))
    if is_vicon(first):
        delimiter = max(",;\t", key="\n".join(lines[:HEAD]).count)
        return _of_program(file, read_vicon(file, _rows_of(file, lines, delimiter)))
    rows = _rows_of(file, lines, max(",;\t", key=first.count))
    headings = [cell.strip() for cell in rows[0][1]]
    units = _units_in(headings, rows[1][1]) if len(rows) > 1 else {}
    data = rows[2 if units else 1 :]
    return _checked(Table(file, headings, [cells for _, cells in data], [number for number, _ in data], units=units))


def _rows_of(file: str, lines: list[str], delimiter: str) -> list[tuple[int, list[str]]]:
    return list(_within(file, _csv_rows(file, lines, delimiter)))


def _of_program(file: str, found: Columns) -> Table:
    """Return the table of a file of a motion capture program."""
    return Table(file, found.headings, found.cells, found.lines, units=found.units, remark=found.remark)


def _units_in(headings: Sequence[str], cells: Sequence[str]) -> dict[str, str]:
    """Return the units in a row below the headings, by heading; empty if it has numbers, or no unit that is known."""
    stated = {heading: cell.strip().strip("[]()") for heading, cell in zip(headings, cells, strict=False)}
    stated = {heading: text for heading, text in stated.items() if text}
    if any(map(_begins_like_number, stated.values())) or not any(map(_is_unit, stated.values())):
        return {}
    return stated


def _is_unit(text: str) -> bool:
    try:
        read_unit(text)
    except SpecError:
        return False
    return True


def _is_row(line: str) -> bool:
    """Return whether a line of a CSV file is neither empty nor a comment."""
    return bool(line.strip()) and not line.startswith("#")


def _csv_rows(file: str, lines: list[str], delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a CSV file with the number of the line where each begins; quoted cells may have line breaks."""
    begun = 0

    def of_row() -> Iterator[str]:
        nonlocal begun
        for number, line in enumerate(lines, 1):
            if begun or _is_row(line):
                begun = begun or number
                yield line + "\n"

    try:
        for cells in csv.reader(of_row(), delimiter=delimiter):
            yield begun, cells
            begun = 0
    except csv.Error as error:
        most = csv.field_size_limit()
        why = f"a cell of this row has more than {most} characters; is a quotation mark missing?"
        raise SpecError(
            why if "limit" in str(error) else f"this row cannot be read: {error}", file=file, line=begun
        ) from None


def _within(file: str, rows: Iterable[tuple[int, list[str]]]) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a table with their line numbers; raise SpecError if they have more than `MOST_CELLS` cells in
    total.
    """
    count = 0
    for line, cells in rows:
        count += len(cells)
        if count > MOST_CELLS:
            raise _too_many_cells(file)
        yield line, cells


def _too_many_cells(file: str) -> SpecError:
    message = f"this table has more than {MOST_CELLS} cells; keep the rows and columns that are used"
    return SpecError(message, file=file)


def _read_storage(file: str, lines: list[str]) -> Table:
    """Read an OpenSim storage file: a header up to ``endheader``, a line of headings, rows."""
    end = next((index for index, line in enumerate(lines) if line.strip().lower() == "endheader"), None)
    if end is None:
        raise SpecError("this file has no line `endheader`, as an OpenSim .mot or .sto file should", file=file)
    header = dict(re.split(r"\s*=\s*", line.strip(), maxsplit=1) for line in lines[:end] if "=" in line)
    kept = [(number, line) for number, line in enumerate(lines[end + 1 :], end + 2) if line.strip()]
    if not kept:
        raise SpecError("this table is empty: no headings follow `endheader`", file=file)
    split = _cells_of(kept[0][1])
    rows = [cells for _, cells in _within(file, ((number, split(line)) for number, line in kept))]
    in_degrees = header.get("inDegrees", "no").lower() == "yes"
    return _checked(Table(file, rows[0], rows[1:], [number for number, _ in kept[1:]], in_degrees=in_degrees))


def _cells_of(headings: str) -> Any:
    """Return the function that splits the lines of a table with these headings.

    Lines are split at tabs if the headings contain tabs, otherwise at blanks.
    """
    if "\t" in headings:
        return lambda line: [cell.strip() for cell in line.rstrip("\n").rstrip("\t").split("\t")]
    return str.split


def _read_trc(file: str, lines: list[str]) -> Table:
    """Read a .trc file of markers; the columns are called MARKER.x, MARKER.y and MARKER.z."""
    if len(lines) < 5 or not lines[0].startswith("PathFileType"):
        raise SpecError("this file does not begin with `PathFileType`, as a .trc file should", file=file)
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    names = [name.strip() for name in lines[3].split("\t")]
    markers = [name for name in names[2:] if name]
    headings = [*names[:2], *(f"{marker}.{axis}" for marker in markers for axis in "xyz")]
    kept = [(number, line) for number, line in enumerate(lines[5:], 6) if line.strip()]
    split = ((number, line.split("\t")[: len(headings)]) for number, line in kept)
    rows = [cells for _, cells in _within(file, split)]
    unit = header.get("Units", "m").strip() or "m"
    return _checked(
        Table(file, headings, rows, [number for number, _ in kept], units=dict.fromkeys(headings[2:], unit))
    )


def _read_c3d(path: Path) -> Table:
    """Read the markers and force plates of a C3D file; see `read_c3d`."""
    found = read_c3d(path, MOST_CELLS)
    if found is None:
        raise _too_many_cells(str(path))
    return Table(str(path), found.headings, found.values.tolist(), units=found.units, remark=found.remark)


def _checked(table: Table) -> Table:
    """Return the table; raise SpecError if a row has more cells than there are headings."""
    for row, cells in enumerate(table.cells):
        if len(cells) > len(table.headings) and any(str(cell).strip() for cell in cells[len(table.headings) :]):
            raise table.error(f"this row has {len(cells)} cells, but there are {len(table.headings)} headings", row=row)
    return table
