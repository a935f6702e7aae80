"""Markers of a motion capture file in metres, by name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import did_you_mean, listed, shown
from mbdkit_biomech.inverse_dynamics.files.measured_table import HEADINGS_SHOWN, MeasuredTable
from mbdkit_biomech.inverse_dynamics.motion.measured import si_values, times_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import ColumnOfTable, TimeColumn

LARGEST_LABORATORY = 1e4  #: Largest coordinate of a marker [m].


@dataclass(frozen=True)
class MarkerFile:
    """A table with markers, and its times (T,) [s]."""

    table: MeasuredTable
    time: np.ndarray

    @classmethod
    def of(cls, table: MeasuredTable, time: TimeColumn) -> MarkerFile:
        """Return a table of markers and its times."""
        return cls(table, times_of(table, time, "motion.time"))

    @property
    def names(self) -> list[str]:
        """Names of the markers."""
        headings = self.table.headings
        return [heading[:-2] for heading in headings if heading.endswith(".x") and not heading.startswith("plate")]

    def has(self, name: str) -> bool:
        """Return whether the file has a marker."""
        return len(self.table.resolved([f"{name}.{axis}" for axis in "xyz"])) == 3

    def vectors(self, name: str, unit: str, key: str) -> np.ndarray:
        """Return the vectors (T, 3) in the columns ``NAME.x``, ``NAME.y`` and ``NAME.z``."""
        columns = [si_values(ColumnOfTable(column=f"{name}.{axis}"), self.table, unit, key) for axis in "xyz"]
        return np.stack(columns, axis=1)

    def marker(self, name: str, key: str) -> np.ndarray:
        """Return the positions (T, 3) of a marker [m], nan where it was not seen; raise SpecError if there is none."""
        if not self.has(name):
            names = [shown(name) for name in self.names]
            some = listed(names[:HEADINGS_SHOWN]) + (", ..." if len(names) > HEADINGS_SHOWN else "")
            hint = did_you_mean(name, self.names) or f"; its markers: {some or 'none'}"
            raise SpecError(f"{self.table.name} has no marker '{shown(name)}'{hint}", key=key)
        values = self.vectors(name, "m", key)
        values[np.isnan(values).any(axis=1) | np.all(values == 0, axis=1)] = np.nan  # some programs write 0 for unseen
        if np.nanmax(np.abs(values), initial=0.0) > LARGEST_LABORATORY:
            raise SpecError(
                f"marker '{shown(name)}' of {self.table.name} is more than {LARGEST_LABORATORY:g} m from the origin; "
                "check the unit of length that the file states",
                key=key,
            )
        return values

    def markers(self, names: tuple[str, ...], key: str) -> np.ndarray:
        """Return the positions (T, N, 3) of markers [m]."""
        return np.stack([self.marker(name, key) for name in names], axis=1)
