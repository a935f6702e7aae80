"""Columns of numbers in CSV files that a spec names."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from mbdkit.base.errors import SpecError
from mbdkit.base.files_read import read_data
from mbdkit.base.text import did_you_mean, listed, shown

LARGEST_FILE = 16 * 2**20
"""Largest size of a file [bytes]."""


def read_columns(path: Path, columns: Sequence[str], *, has_gaps: bool = False) -> list[list[float]]:
    """Return the numbers in the columns of a CSV file with the given headings, in the order of `columns`.

    The file has a line of headings, and commas, semicolons or tabs between its cells; lines that begin with ``#`` are
    ignored. With `has_gaps`, empty cells are nan. Raises SpecError, with the file and line, if it has no such columns,
    or if a cell is not a number.
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
    rows = [next(csv.reader([line], delimiter=delimiter)) for _, line in numbered]
    headings = [heading.strip() for heading in rows[0]]
    for column in columns:
        if headings.count(column) != 1:
            known = did_you_mean(column, headings) or f"; columns: {listed([shown(one) for one in headings], 'and')}"
            raise SpecError(f"there should be one column '{column}'{known}", file=path, line=numbered[0][0])
    places = [headings.index(column) for column in columns]
    numbers: list[list[float]] = [[] for _ in columns]
    for (line, _), row in zip(numbered[1:], rows[1:], strict=True):
        try:
            for own, place in zip(numbers, places, strict=True):
                own.append(math.nan if has_gaps and not row[place].strip() else float(row[place]))
        except (ValueError, IndexError):
            names = listed([f"'{column}'" for column in columns], "and")
            raise SpecError(f"the columns {names} should have numbers here", file=path, line=line) from None
    return numbers
