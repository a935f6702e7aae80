"""Markers of a model without data, and columns of the table of a motion that are not used."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from mbdkit.base.text import listed
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.inverse_dynamics.files.measured_table import MeasuredTable
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import TimeColumn
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec

NAMED = 6  #: Largest number of markers or columns that are named.

#: Headings, in lower case, of columns with the numbers of frames.
NUMBERS = ("frame", "frame#", "sub frame")


def unused_data(
    spec: InverseSpec, names: QuantityNames, measured: Measured, table: MeasuredTable | None
) -> dict[str, str]:
    """Return lists for the provenance: markers of the model without data, and columns of the table of the motion that
    are not used. A marker without any used coordinate counts as a single column with its name. If the motion is not a
    table, nothing is unused.
    """
    if table is None:
        return {}
    observed = {
        names.element(name)
        for name, quantity in zip(measured.names, measured.quantities.quantities, strict=True)
        if quantity.unscaled.marker is not None and name not in names.mechanism.coordinates
    }
    markers = [name for name in names.mechanism.markers if name not in observed]
    columns = [*_left(table.headings, table.resolved(_headings(spec, measured)))]
    lines = {}
    if markers:
        lines["unobserved_markers"] = f"markers {listed(markers, 'and', NAMED)} of the model"
    if columns:
        lines["unused_columns"] = f"columns {listed(columns, 'and', NAMED)} of the data"
    return lines


def _headings(spec: InverseSpec, measured: Measured) -> Iterator[str]:
    motion = spec.motion
    yield motion.time.column
    for name in measured.names:
        column = None if motion.columns is None else motion.columns[name]
        yield from (name,) if column is None else filter(None, (column.column, column.rate, column.acceleration))
    for load in spec.loads.values():
        if load.data is None and load.file in (None, motion.file):
            columns = (load.time or TimeColumn(), *(load.force or ()), *(load.point or ()), load.torque)
            yield from (one.column for one in columns if one is not None and not isinstance(one, float))


def _left(headings: Iterable[str], used: set[str]) -> Iterator[str]:
    """Yield the names of columns that are not used; the third coordinate of a marker in use is left out."""
    elements = {heading[:-2] for heading in used if heading.endswith((".x", ".y", ".z"))}
    told = set(NUMBERS)
    for heading in headings:
        element, axis = heading[:-2], heading[-2:]
        is_point = axis in (".x", ".y", ".z")
        if not heading or heading in used or (is_point and element in elements and axis == ".z"):
            continue
        name = element if is_point and element not in elements else heading
        if name.lower() not in told:
            told.add(name.lower())
            yield name
