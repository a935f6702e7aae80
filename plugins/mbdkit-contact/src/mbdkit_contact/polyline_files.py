"""Polylines of contacts that are given by tables in files, which are read when a spec is loaded.

The loaded spec has the points, so that neither archives nor studies need the files.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from pathlib import Path

from pydantic import ValidationError

from mbdkit.plugin import SpecError, did_you_mean, listed, quoted, read_data, read_unit, shown
from mbdkit.plugin.seams import element_files
from mbdkit.plugin.specs import spec_error
from mbdkit_contact.contact import PolylineFile

LARGEST_FILE = 16 * 2**20
"""Largest size of a file with points [bytes]."""


@element_files
def read_polylines(contacts: Mapping[str, object], folder: Path) -> None:
    """Replace polylines that name a file by the points in the file.

    Parameters
    ----------
    contacts
        Plain data of contacts by name.
    folder
        Folder of the spec.

    Raises
    ------
    SpecError
        If a file is not a table with the named columns, with the file and line or the key.
    """
    for key, shape in _shapes(contacts):
        if isinstance(polyline := shape.get("polyline"), Mapping):
            try:
                shape["polyline"] = _points(polyline, folder)
            except SpecError as error:
                raise error if error.file else error.located(prefix=f"{key}.polyline") from None


def _shapes(contacts: Mapping[str, object]) -> Iterator[tuple[str, dict[str, object]]]:
    for name, contact in contacts.items():
        shapes = contact.get("shapes") if isinstance(contact, Mapping) else None
        key = f"model.contacts.{quoted(name)}.shapes"
        if isinstance(shapes, Mapping):
            places = [(f"{key}.{quoted(body)}", shape) for body, shape in shapes.items()]
        else:
            places = [(f"{key}[{i}]", shape) for i, shape in enumerate(shapes if isinstance(shapes, list) else ())]
        yield from ((place, shape) for place, shape in places if isinstance(shape, dict))


def _points(given: Mapping[str, object], folder: Path) -> list[list[float]]:
    try:
        table = PolylineFile.model_validate(given)
    except ValidationError as error:
        raise spec_error(error, PolylineFile) from None
    try:
        unit = read_unit(table.unit)
        if not unit.fits(read_unit("m")):
            raise SpecError(f"should be a unit of length such as mm, not {unit}")
    except SpecError as error:
        raise error.located(prefix="unit") from None
    path = folder / table.file
    content = read_data(path, LARGEST_FILE, "keep the rows and columns that are used")
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise SpecError("this file is not valid UTF-8 text", file=path) from None
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not numbered:
        raise SpecError("this file is empty; it should have a line of headings, and a point in each further line",
                        file=path)  # fmt: skip
    delimiter = max(",;\t", key=numbered[0][1].count)
    rows = [next(csv.reader([line], delimiter=delimiter)) for _, line in numbered]
    headings = [heading.strip() for heading in rows[0]]
    for column in (table.x, table.y):
        if headings.count(column) != 1:
            known = did_you_mean(column, headings) or f"; columns: {listed([shown(one) for one in headings], 'and')}"
            raise SpecError(f"there should be one column '{column}'{known}", file=path, line=numbered[0][0])
    places = [headings.index(column) for column in (table.x, table.y)]
    points = []
    for (line, _), row in zip(numbered[1:], rows[1:], strict=True):
        try:
            points.append([unit.factor * float(row[i]) for i in places])
        except (ValueError, IndexError):
            message = f"the columns '{table.x}' and '{table.y}' should have numbers here"
            raise SpecError(message, file=path, line=line) from None
    return points
