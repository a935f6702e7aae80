"""Columns of numbers in CSV files that a spec names."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from mbdkit.base.errors import SpecError
from mbdkit.base.files_read import read_data
from mbdkit.base.text import counted, did_you_mean, listed, shortened, shown
from mbdkit.base.units import NUMBER

LARGEST_FILE = 16 * 2**20  #: Largest size of a file [bytes].


def read_columns(path: Path, columns: Sequence[str], *, has_gaps: bool = False) -> list[list[float]]:
    """Return the numbers in the columns of a CSV file with the given headings, in the order of `columns`.

    The file has a line of headings, and commas, semicolons or tabs between its cells; lines that begin with ``#`` are
    ignored. With `has_gaps`, empty cells and ``nan`` are nan. Raises SpecError, with the file and line, if it has no
    such columns, if a cell is not a finite number in ASCII digits, or if a row has another number of cells than the
    headings.
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
            is_gap = has_gaps and cell.lower() in ("", "nan")
            if not is_gap and not (re.fullmatch(NUMBER, cell) and math.isfinite(float(cell))):
                message = f"the column '{column}' should have a number here, not '{shortened(shown(cell))}'"
                raise SpecError(message, file=path, line=line)
            own.append(math.nan if is_gap else float(cell))
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
