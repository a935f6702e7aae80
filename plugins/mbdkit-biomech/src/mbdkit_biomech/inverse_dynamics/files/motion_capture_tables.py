"""Text files of motion capture programs, whose headings take several lines: Vicon Nexus CSV and Qualisys TSV.

Sources: exports of Nexus 2 (sections that begin with their name and rate, then names, components, units and frames);
the description of motion data files in the manual of Qualisys Track Manager.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeGuard, TypeVar

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit_biomech.inverse_dynamics.files.measured_table import Cell, MeasuredTable, cited

Rows = Sequence[tuple[int, list[str]]]  #: Rows of cells with the numbers of their lines, without empty lines.

#: Sections of Vicon files that are read; all but the last have one row for each frame of the cameras.
SECTIONS = ("Trajectories", "Model Outputs", "Joints", "Segments", "Devices")

_DEVICES = "Devices"
#: First words of files of Qualisys Track Manager.
_QUALISYS = ("NO_OF_FRAMES", "FILE_VERSION", "NO_OF_SAMPLES", "TOT_NO_OF_CHAN")


def is_qualisys(first_line: str) -> bool:
    """Return whether a file with this first line is one of Qualisys Track Manager."""
    return first_line.split("\t")[0].strip() in _QUALISYS


def is_vicon(first_line: str) -> bool:
    """Return whether a file with this first line is one of Vicon Nexus."""
    return first_line.strip().strip(",;\t") in SECTIONS


def read_qualisys(file: str, rows: Rows) -> MeasuredTable:
    """Read the markers of a motion data file of Qualisys Track Manager; coordinates are in mm.

    The columns are called MARKER.x, MARKER.y and MARKER.z. Without a column of times, they follow from the frequency;
    the first frame is at time 0. Markers that were not seen are empty cells or exactly zero in all coordinates.

    Raises
    ------
    SpecError
        If the file does not contain 3D markers, or if its rows do not have the columns of its markers.
    """
    header: dict[str, list[str]] = {}
    place = 0
    while place < len(rows) and (key := rows[place][1][0].strip()).isupper() and len(rows[place][1]) > 1:
        header[key] = [cell.strip() for cell in rows[place][1][1:]]
        place += 1
    kind, markers = header.get("DATA_INCLUDED", ["3D"])[0], [name for name in header.get("MARKER_NAMES", []) if name]
    if kind != "3D" or not markers:
        raise SpecError(
            f"this file of Qualisys Track Manager has {'data of the kind ' + cited(kind) if kind != '3D' else 'no row'}"
            f"{'' if kind != '3D' else ' MARKER_NAMES'}; 3D motion data with their header are read, and forces from "
            "C3D files",
            file=file,
        )
    has_heads = place < len(rows) and not _is_number(_first(rows[place][1]))
    data = rows[place + has_heads :]
    headings = [f"{marker}.{axis}" for marker in markers for axis in "xyz"]
    width = max((len(stripped(cells)) for _, cells in data), default=0)
    has_time = width > len(headings) or (has_heads and _first(rows[place][1]).lower() == "frame")
    lead = 2 if has_time else 0
    cells: list[list[Cell]] = []
    lines: list[int] = []
    for row, (line, given) in enumerate(data):
        values: list[Cell] = [cell.strip() for cell in given]
        if len(stripped(values)) > lead + len(headings):
            raise SpecError(
                f"this row has {len(values)} cells, but {len(markers)} markers need {lead + len(headings)}",
                file=file,
                line=line,
            )
        values += [None] * (lead + len(headings) - len(values))
        for first in range(lead, lead + len(headings), 3):
            if all(_is_number(x) and float(x) == 0 for x in values[first : first + 3]):
                values[first : first + 3] = [None] * 3
        time = values[1] if has_time else row / _rate(header.get("FREQUENCY", [""])[0], file, None)
        cells.append([time, *values[lead : lead + len(headings)]])
        lines.append(line)
    return MeasuredTable(file, ["time", *headings], cells, lines, units=dict.fromkeys(headings, "mm"))


class _Section(NamedTuple):
    """A section of a Vicon file: its rate [Hz], headings and units of its columns, and cells and line by frame and
    sub-frame.
    """

    rate: float
    headings: list[str]
    units: list[str]
    rows: dict[tuple[int, int], tuple[int, list[Cell]]]


def read_vicon(file: str, rows: Rows) -> MeasuredTable:
    """Read a file of Vicon Nexus. Columns are called NAME.x, NAME.y and NAME.z, or NAME.Fx with other components.

    Frame 1 is at time 0. If the file has frames of the cameras, samples of devices are those at the frames.

    Raises
    ------
    SpecError
        If a section does not have the rows of a Vicon file.
    """
    found: dict[str, _Section] = {}
    other: list[str] = []
    begins = [place for place in range(len(rows) - 1) if _begins_section(rows, place)]
    if not begins or begins[0]:
        raise SpecError("this Vicon file has no section with a rate in its second line", file=file)
    for begin, end in zip(begins, [*begins[1:], len(rows)], strict=True):
        if (name := rows[begin][1][0].strip()) in SECTIONS:
            found[name] = _section(file, name, rows[begin:end])
        else:
            other.append(cited(name))
    devices = found.get(_DEVICES)
    of_cameras = [section for name, section in found.items() if name != _DEVICES]
    main = of_cameras[0] if of_cameras else next(iter(found.values()))
    per_frame = 1 + max(sub for _, sub in main.rows) if main is devices else 1
    keys = sorted(main.rows)
    headings, units = ["time"], dict[str, str]()
    cells: list[list[Cell]] = [[(frame - 1 + sub / per_frame) / (main.rate / per_frame)] for frame, sub in keys]
    for section in found.values():
        headings += section.headings
        units |= {heading: unit for heading, unit in zip(section.headings, section.units, strict=True) if unit}
        nothing = 0, [None] * len(section.headings)
        for row, key in zip(cells, keys, strict=True):
            row.extend(section.rows.get(key, nothing)[1])
    remark = f"its sections {listed(other, 'and')} are not read" if other else ""
    return MeasuredTable(file, headings, cells, [main.rows[key][0] for key in keys], units=units, remark=remark)


def _begins_section(rows: Rows, place: int) -> bool:
    """Return whether a row has nothing but a name, and the next one nothing but a number."""
    name, rate = (stripped(cells) for _, cells in rows[place : place + 2])
    return len(name) == len(rate) == 1 and not _is_number(name[0]) and _is_number(rate[0])


def _section(file: str, name: str, rows: Rows) -> _Section:
    if len(rows) < 6:
        raise SpecError(f"the section '{name}' has no frames", file=file, line=rows[0][0])
    rate = _rate(rows[1][1][0], file, rows[1][0])
    names, components, units = ([cell.strip() for cell in cells] for _, cells in rows[2:5])
    if [cell.lower() for cell in components[:2]] != ["frame", "sub frame"]:
        raise SpecError(
            "this row should hold the components of the columns, beginning with Frame and Sub Frame, as in files of "
            "Vicon Nexus",
            file=file,
            line=rows[3][0],
        )
    headings: list[str] = []
    of_column, count = "", len(components)
    for column in range(2, count):
        of_column = (names[column] if column < len(names) else "") or of_column
        component = components[column].lower() if components[column] in ("X", "Y", "Z") else components[column]
        headings.append(f"{of_column}.{component}" if of_column and component else "")
    found: dict[tuple[int, int], tuple[int, list[Cell]]] = {}
    for line, cells in rows[5:]:
        if not stripped(cells):
            continue
        if len(stripped(cells)) > count:
            raise SpecError(f"this row has {len(cells)} cells, but there are {count} columns", file=file, line=line)
        frame, sub = (_whole(cell, file, line) for cell in cells[:2])
        found[frame, sub] = line, [*cells[2:count], *[None] * (count - max(2, len(cells)))]
    if not found:
        raise SpecError(f"the section '{name}' has no frames", file=file, line=rows[0][0])
    # Nexus writes N.mm, and degree signs in some versions
    readable = [unit.replace(".", " ").replace("\u00b0", "deg") for unit in (*units, *[""] * count)]
    return _Section(rate, headings, readable[2:count], found)


C = TypeVar("C", bound=Cell)


def _whole(cell: str, file: str, line: int) -> int:
    if not _is_number(cell) or float(cell) != int(float(cell)):
        raise SpecError(f"'{cited(cell.strip())}' is not the number of a frame", file=file, line=line)
    return int(float(cell))


def _rate(text: str, file: str, line: int | None) -> float:
    """Return a rate [Hz]; raise SpecError if the text is not one."""
    if not _is_number(text) or float(text) <= 0:
        raise SpecError(f"'{cited(text.strip())}' is not a rate in Hz, from which times follow", file=file, line=line)
    return float(text)


def _is_number(cell: Cell) -> TypeGuard[str | float]:
    try:
        return cell is not None and math.isfinite(float(cell))
    except ValueError:
        return False


def _first(cells: Sequence[str]) -> str:
    return cells[0].strip() if cells else ""


def stripped(cells: Sequence[C]) -> list[C]:
    """Return cells without empty cells at their end."""
    last = (at for at, cell in enumerate(cells, 1) if cell is not None and str(cell).strip())
    return list(cells[: max(last, default=0)])
