"""Polylines of contacts that are given by tables in files, which are read when a spec is loaded.

The loaded spec has the points, so that neither archives nor studies need the files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from pydantic import ValidationError

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.units import read_unit
from mbdkit.mechanism.element_kinds import element_files
from mbdkit.mechanism.validation_errors import spec_error
from mbdkit.spec.input_tables import read_columns
from mbdkit_contact.contact import PolylineFile


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


def _points(values: Mapping[str, object], folder: Path) -> list[list[float]]:
    try:
        table = PolylineFile.model_validate(values)
    except ValidationError as error:
        raise spec_error(error, PolylineFile) from None
    try:
        unit = read_unit(table.unit)
        if not unit.fits(read_unit("m")):
            raise SpecError(f"should be a unit of length such as mm, not {unit}")
    except SpecError as error:
        raise error.located(prefix="unit") from None
    columns = read_columns(folder / table.file, (table.x, table.y))
    return [[unit.factor * value for value in point] for point in zip(*columns, strict=True)]
