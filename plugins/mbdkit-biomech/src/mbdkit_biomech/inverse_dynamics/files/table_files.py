"""Files with tables of measured data: CSV, Vicon, Qualisys, OpenSim .mot and .sto, .trc and C3D files."""

from __future__ import annotations

import codecs
import csv
import itertools
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.files_read import check_readable, read_data
from mbdkit.base.units import NUMBER, read_unit
from mbdkit_biomech.inverse_dynamics.files.c3d_file import read_c3d
from mbdkit_biomech.inverse_dynamics.files.measured_table import (
    CLOCK,
    DECIMAL_COMMA,
    MeasuredTable,
    begins_like_number,
    cited,
)
from mbdkit_biomech.inverse_dynamics.files.motion_capture_tables import (
    is_qualisys,
    is_vicon,
    read_qualisys,
    read_vicon,
    stripped,
)
from mbdkit_biomech.inverse_dynamics.signals.rounded_times import at_rate

LONGEST_PREAMBLE = 100  #: Number of lines in which the first row of numbers is searched.

COMMENTS = ("#", "%")  #: Beginnings of lines that are comments.

HEAD = 10  #: Number of lines in which the delimiter of a Vicon file is searched.

LARGEST_FILE = 128 * 2**20  #: Largest size of a file that is read [bytes].

MOST_CELLS = 10_000_000  #: Largest number of cells of a table; a cell takes about 70 bytes of memory.


def read_table(path: Path, key: str, separator: str | None = None, decimal: str | None = None) -> MeasuredTable:
    """Read a table from a file in the format given by its suffix: .csv, .tsv, .txt, .dat, .mot, .sto, .trc or .c3d.

    Text files of Vicon Nexus and of Qualisys Track Manager are recognized by their first line.

    Parameters
    ----------
    key
        Key of the spec that names the file, for messages.
    separator, decimal
        Separator of the cells, and decimal point or comma, of other text files; by default, both follow from the file.

    Raises
    ------
    SpecError
        If the file does not exist, is too large, or is not a table in one of these formats.
    ResourceError
        If the system refuses to read the file.
    """
    check_readable(path)
    if not os.path.exists(path) or os.path.isdir(path):
        what = "is a folder" if path.is_dir() else "there is no such file"
        raise SpecError(f"{what}: {cited(str(path))}", key=key)
    suffix = path.suffix.lower()
    content = read_data(path, LARGEST_FILE, "keep the rows and columns that are used")
    if suffix == ".c3d":
        if (c3d := read_c3d(path, MOST_CELLS)) is None:
            raise _too_many_cells(str(path))
        return c3d
    readers: dict[str, Callable[[str, list[str]], MeasuredTable]] = {
        **dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), partial(_read_csv, separator=separator, decimal=decimal)),
        **dict.fromkeys((".mot", ".sto"), _read_storage),
        ".trc": _read_trc,
    }
    if suffix not in readers:
        raise SpecError(
            f"'{cited(path.name)}' does not have the suffix of a table; known suffixes: .csv, .tsv, .txt, "
            ".dat, .mot, .sto, .trc, .c3d, and .h5 of a run where a run may be given",
            key=key,
        )
    if content.startswith(b"PK\3\4"):
        raise SpecError("this is a workbook or an archive, not a text; save the table as .csv", file=path)
    is_utf16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if is_utf16 else "utf-8-sig")
    except UnicodeError:
        raise SpecError("this file is not valid UTF-8 text; save it with the encoding UTF-8", file=path) from None
    return readers[suffix](str(path), text.replace("\r\n", "\n").replace("\r", "\n").split("\n"))


def _read_csv(file: str, lines: list[str], separator: str | None = None, decimal: str | None = None) -> MeasuredTable:
    """Read a table with a line of headings and possibly a line of units, or a file of a motion capture program; lines
    that begin with # or % are comments, of which the last one has the headings if the table has no others.
    """
    if (first := next((line for line in lines if _is_row(line)), None)) is None:
        raise _empty(file)
    if is_qualisys(first):
        return read_qualisys(file, _rows_of(file, lines, "\t"))
    if is_vicon(first):
        delimiter = max(",;\t", key="\n".join(lines[:HEAD]).count)
        return read_vicon(file, _rows_of(file, lines, delimiter))
    delimiter, begin = _data_in(lines, separator or ";\t, ") or (separator or max(",;\t", key=first.count), 0)
    rows = [(number, cells) for number, cells in _rows_of(file, lines, delimiter) if stripped(cells)]
    if not rows:
        raise _empty(file)
    begin = next((index for index, (number, _) in enumerate(rows) if number > begin), 0)
    if begin == 0 and _is_data(rows[0][1], delimiter):
        rows.insert(0, _commented_headings(file, lines, rows[0], delimiter))
    rows = rows[_headings_above(rows, begin) :]
    headings = [cell.replace("\u00a0", " ").strip() for cell in rows[0][1]]
    units = _units_in(headings, rows[1][1]) if len(rows) > 1 else {}
    data = rows[2 if units else 1 :]
    names, in_headings = _without_units(headings)
    cells = _with_points([cells for _, cells in data], delimiter, decimal)
    if delimiter == " " and len(cells[0]) != len(headings):
        raise SpecError(
            f"the cells of this table are separated by blanks, but there are {len(headings)} headings and "
            f"{len(cells[0])} columns of numbers; separate the cells by commas",
            file=file,
            line=rows[0][0],
        )
    units = {names[headings.index(heading)]: unit for heading, unit in units.items()}
    return _checked(
        MeasuredTable(
            file, names, cells, [number for number, _ in data], units=in_headings | units, full_headings=headings,
        )
    )  # fmt: skip


def _commented_headings(
    file: str, lines: list[str], data: tuple[int, list[str]], delimiter: str
) -> tuple[int, list[str]]:
    """Return the headings in the last comment above the first row of data, with as many cells as this has."""
    number, cells = data
    message = "this table has no headings: its first line has numbers"
    for index in range(number - 2, -1, -1):
        line = lines[index].lstrip("#% ")
        headings = line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])
        if lines[index].startswith(COMMENTS) and not _is_data(headings, delimiter):
            if len(headings) == len(cells):
                return index + 1, headings
            if len(headings) == len(cells) + 1:
                message = (
                    f"this row has {len(cells)} cells, but line {index + 1} has {len(headings)}: remove the heading"
                )
                message += " that has no column"
    raise SpecError(message, file=file, line=number)


def _data_in(lines: list[str], delimiters: str) -> tuple[str, int] | None:
    """Return the delimiter of a table, and the index of the line with its first row of numbers; None if the first lines
    have no row of numbers.
    """
    for index, line in enumerate(lines[:LONGEST_PREAMBLE]):
        for delimiter in delimiters:
            cells = line.split() if delimiter == " " else line.split(delimiter)
            if _is_row(line) and _is_data(cells, delimiter):
                return delimiter, index
    return None


def _is_data(cells: Sequence[str], delimiter: str) -> bool:
    """Return whether the first two cells of a row that are not empty are numbers."""
    given = [text for cell in cells if (text := cell.strip().strip('"'))][:2]
    if delimiter not in ", ":
        given = [text.replace(",", ".") if DECIMAL_COMMA.fullmatch(text) else text for text in given]
    return len(given) == 2 and all(re.fullmatch(NUMBER, text) or CLOCK.fullmatch(text) for text in given)


def _headings_above(rows: list[tuple[int, list[str]]], begin: int) -> int:
    """Return the index of the row with the headings of a table whose numbers begin with the row `begin`.

    It is the first row unless this row has fewer cells than the numbers, as a title or the settings of a device. In
    that case, the headings are in the last row, or the last but one above a row of units.
    """
    width = len(stripped(rows[begin][1]))
    if len(stripped(rows[0][1])) >= width:
        return 0
    for index in (begin - 1, begin - 2):
        cells = stripped(rows[index][1]) if index > 0 else []
        if len(cells) < 2 or any(map(begins_like_number, cells)):
            break
        if index == begin - 2 or not _units_in(cells, cells):
            return index
    return 0


def _without_units(headings: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Return headings without the units at their ends, and these units by heading: ``hip [deg]`` is ``hip`` in deg.

    Headings that would then be equal to others keep their units.
    """
    parts = [_HEADING_WITH_UNIT.fullmatch(heading) for heading in headings]
    given = [_usual(part[2]) if part and part[2] != "1" else "" for part in parts]
    stated = [unit if _is_unit(unit) else "" for unit in given]
    short = [part[1] if part and unit else one for part, unit, one in zip(parts, stated, headings, strict=True)]
    names = [name if short.count(name) == 1 else heading for name, heading in zip(short, headings, strict=True)]
    return names, {name: unit for name, unit in zip(names, stated, strict=True) if unit}


def _usual(unit: str) -> str:
    """Return a unit as mbdkit writes it: deg for the sign of degrees, and N m for Nm."""
    return re.sub(r"\bN[.*\u00b7]?(m?m)\b", r"N \1", unit.strip().replace("\u00b0", "deg"))


def _with_points(rows: list[list[str]], delimiter: str, decimal: str | None) -> list[list[str]]:
    """Return the rows of a table with decimal points, if it has decimal commas throughout."""
    if decimal is None and delimiter not in ", ":
        flat = itertools.chain.from_iterable
        has_points = any("." in cell and begins_like_number(cell) and ":" not in cell for cell in flat(rows))
        decimal = "," if any(map(DECIMAL_COMMA.fullmatch, flat(rows))) and not has_points else None
    if decimal != ",":
        return rows
    return [[cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells] for cells in rows]


_HEADING_WITH_UNIT = re.compile(r"(.*\S)\s*[\[(]([^\[\]()]+)[\])]")


def _rows_of(file: str, lines: list[str], delimiter: str) -> list[tuple[int, list[str]]]:
    split = ((number, line.split()) for number, line in enumerate(lines, 1) if _is_row(line))
    return list(_within(file, split if delimiter == " " else _csv_rows(file, lines, delimiter)))


def _units_in(headings: Sequence[str], cells: Sequence[str]) -> dict[str, str]:
    """Return the units in a row below the headings, by heading; empty if it has numbers, or no unit that is known."""
    stated = {heading: _usual(cell.strip().strip("[]()")) for heading, cell in zip(headings, cells, strict=False)}
    stated = {heading: text for heading, text in stated.items() if text}
    if any(map(begins_like_number, stated.values())) or not any(map(_is_unit, stated.values())):
        return {}
    return stated


def _is_unit(text: str) -> bool:
    try:
        read_unit(text)
    except SpecError:
        return False
    return True


def _is_row(line: str) -> bool:
    return bool(line.strip()) and not line.startswith(COMMENTS)


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


def _empty(file: str) -> SpecError:
    return SpecError("this table is empty; its first line should hold the headings of the columns", file=file)


def _too_many_cells(file: str) -> SpecError:
    message = f"this table has more than {MOST_CELLS} cells; keep the rows and columns that are used"
    return SpecError(message, file=file)


def _read_storage(file: str, lines: list[str]) -> MeasuredTable:
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
    lines_of = [number for number, _ in kept[1:]]
    _check_count(file, header, "nRows", len(rows) - 1)
    table = _checked(MeasuredTable(file, rows[0], rows[1:], lines_of, in_degrees=_is_in_degrees(file, header)))
    if split is str.split:  # a missing cell would move the others
        for row, cells in enumerate(table.cells):
            if len(cells) < len(table.headings):
                few = f"this row has {len(cells)} cells, but there are {len(table.headings)} headings"
                raise table.error(f"{few}; write nan for a missing value", row=row)
    return table


def _check_count(file: str, header: Mapping[str, str], key: str, count: int) -> None:
    """Raise SpecError if the header gives a number of rows that is none, or if the table ends before it."""
    given = header.get(key, "0")
    if not given.isdecimal() or int(given[:10]) > count:
        raise SpecError(f"the header has `{cited(f'{key}={given}')}`, but there are {count} rows; is the end missing?",
                        file=file)  # fmt: skip


def _is_in_degrees(file: str, header: Mapping[str, str]) -> bool:
    """Return whether the header of an OpenSim storage file says that rotations are in degrees.

    Files without `inDegrees` and without a version are motion files of SIMM, in degrees, as OpenSim reads them.
    """
    if (key := next((key for key in header if key.lower() == "indegrees"), None)) is None:
        return "version" not in header
    if key != "inDegrees" or header[key].lower() not in ("yes", "no"):
        given = cited(f"{key}={header[key]}")
        raise SpecError(f"the header has `{given}`; write `inDegrees=yes` or `inDegrees=no`", file=file)
    return header[key].lower() == "yes"


def _cells_of(headings: str) -> Callable[[str], list[str]]:
    """Return the function that splits the lines of a table with these headings.

    Lines are split at tabs if the headings contain tabs, otherwise at blanks.
    """
    if "\t" in headings:
        return lambda line: [cell.strip() for cell in line.rstrip("\n").rstrip("\t").split("\t")]
    return str.split


def _read_trc(file: str, lines: list[str]) -> MeasuredTable:
    """Read a .trc file of markers; the columns are called MARKER.x, MARKER.y and MARKER.z."""
    if len(lines) < 5 or not lines[0].startswith("PathFileType"):
        raise SpecError("this file does not begin with `PathFileType`, as a .trc file should", file=file)
    keys, values, names, axes = ([cell.strip() for cell in line.split("\t")] for line in lines[1:5])
    if len(stated := list(filter(None, values))) == len(named := list(filter(None, keys))):
        keys, values = named, stated  # some files have two tabs between values, and one between their names
    header = {key.lower(): value for key, value in zip(keys, values, strict=False)}
    markers = _markers_of_trc(file, names[2:], header.get("nummarkers", ""))
    given = [axis[:1] for axis in axes if axis]
    if given[: 3 * len(markers)] != ["X", "Y", "Z"] * len(markers):
        raise SpecError("this row should be X1, Y1, Z1, X2 and so on, three for each marker", file=file, line=5)
    rate = header.get("datarate") or "1"
    if not re.fullmatch(NUMBER, rate) or not 0.0 < float(rate) < math.inf:
        raise SpecError(f"DataRate should be a rate in Hz, not '{cited(rate)}'", file=file, line=3)
    if not header.get("units"):
        raise SpecError("this file states no unit; write, for example, mm below `Units`", file=file, line=3)
    headings = [*names[:2], *(f"{marker}.{axis}" if marker else "" for marker in markers for axis in "xyz")]
    kept = [(number, line) for number, line in enumerate(lines[5:], 6) if line.strip()]
    rows = [cells for _, cells in _within(file, ((number, line.split("\t")) for number, line in kept))]
    _check_count(file, {"NumFrames": header.get("numframes") or "0"}, "NumFrames", len(rows))
    units = dict.fromkeys(headings[2:], header["units"])
    rows = _at_rate(rows, float(rate))
    return _checked(MeasuredTable(file, headings, rows, [number for number, _ in kept], units=units))


def _at_rate(rows: list[list[str]], rate: float) -> list[list[str]]:
    """Return the rows of a .trc file, whose second cells are times, with the digits that rounding removed from these:
    many files have three decimals, which do not resolve rates such as 60 Hz.
    """
    if not rows or not all(len(cells) > 1 and re.fullmatch(NUMBER, cells[1].strip()) for cells in rows):
        return rows
    time = np.array([float(cells[1]) for cells in rows])
    if not np.all(np.isfinite(time)) or (exact := at_rate(time, rate)) is time:
        return rows
    return [[cells[0], repr(t), *cells[2:]] for cells, t in zip(rows, exact.tolist(), strict=True)]


def _markers_of_trc(file: str, names: Sequence[str], count: str) -> list[str]:
    """Return the names of the markers of a .trc file, empty where a marker has none.

    Each name is followed by two empty cells. In some files, these are left out.

    Parameters
    ----------
    names
        Cells above the coordinates.
    count
        Number of markers in the header.
    """
    given = [name for name in names if name]
    markers = [*names[::3]] if any(names) and not any(name for at, name in enumerate(names) if at % 3) else given
    while markers and not markers[-1] and str(len(markers)) != count:
        markers.pop()
    if count != str(len(markers)):
        have = f"NumMarkers is {cited(count)}, but this row has the names of {len(markers)} markers"
        raise SpecError(f"{have}; each name is followed by two empty cells", file=file, line=4)
    return markers


def _checked(table: MeasuredTable) -> MeasuredTable:
    for row, cells in enumerate(table.cells):
        if len(cells) > len(table.headings) and any(str(cell).strip() for cell in cells[len(table.headings) :]):
            raise table.error(f"this row has {len(cells)} cells, but there are {len(table.headings)} headings", row=row)
    return table
