"""Markers of a model without data, and columns of the table of a motion that are not used."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from mbdkit.base.text import listed
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.inverse_dynamics.files.measured_table import MeasuredTable
from mbdkit_biomech.inverse_dynamics.motion.measured import Measured
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import TimeColumn
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec

NAMED = 6  #: Largest number of markers or columns that are named.

#: Headings, in lower case, of columns with the numbers of frames.
NUMBERS = ("frame", "frame#", "sub frame")


@dataclass(frozen=True)
class UnusedData:
    """What model and table do not have in common.

    Attributes
    ----------
    markers
        Markers of the model that are not observed.
    columns
        Columns of the table of the motion that are not used; a marker without any used coordinate counts as a single
        column with its name.
    misspelt
        Markers of the table that are not used and that the model probably has under another name, with that name.
    """

    markers: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    misspelt: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, spec: InverseSpec, names: QuantityNames, measured: Measured, table: MeasuredTable | None) -> UnusedData:
        """Return the unused data of a spec; nothing is unused if the motion is not a table."""
        if table is None:
            return cls()
        observed = {
            names.element(name)
            for name, quantity in zip(measured.names, measured.quantities.quantities, strict=True)
            if quantity.unscaled.marker is not None and name not in names.mechanism.coordinates
        }
        markers = tuple(name for name in names.mechanism.markers if name not in observed)
        used = table.resolved(_headings(spec, measured))
        misspelt = () if spec.motion.columns is not None else tuple(_misspelt(table, names))
        return cls(markers, tuple(_left(table.headings, used)), misspelt)

    @property
    def notes(self) -> dict[str, str]:
        """Lists for the provenance: markers of the model without data, and columns that are not used."""
        given = (
            ("unobserved_markers", "markers", self.markers, "model"),
            ("unused_columns", "columns", self.columns, "data"),
        )
        return {key: f"{what} {listed(names, 'and', NAMED)} of the {of}" for key, what, names, of in given if names}

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence on markers that are probably misspelt."""
        if not self.misspelt:
            return ()
        given, meant = (listed(names, "and") for names in zip(*self.misspelt, strict=True))
        told = f"markers {given} of the table are not used, because the model has no markers with these names"
        return (f"{told}: did you mean {meant}?",)


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


def _misspelt(table: MeasuredTable, names: QuantityNames) -> Iterator[tuple[str, str]]:
    """Yield markers of a table that the model does not have, and the markers without columns that they probably are.

    Their names differ only in letter case and in characters that are neither letters nor digits.
    """

    def plain(name: str) -> str:
        return "".join(filter(str.isalnum, name)).casefold()

    headings = set(table.headings)
    lacking = {plain(name): name for name in names.mechanism.markers if not headings & {f"{name}.x", f"{name}.y"}}
    found = {heading[:-2] for heading in headings if heading.endswith((".x", ".y")) and not names.knows(heading)}
    yield from ((name, lacking[plain(name)]) for name in sorted(found) if plain(name) in lacking)
