"""Segments of a person whose thigh and shank were measured."""

from __future__ import annotations

from dataclasses import dataclass, replace

from mbdkit_biomech.models._segments import BodySegments, SegmentTable


@dataclass(frozen=True)
class MeasuredPerson(BodySegments):
    """The segments of a person, with measured lengths of thigh and shank.

    Parameters
    ----------
    measured_thigh, measured_shank
        Lengths [m]; None for those of the table.
    """

    measured_thigh: float | None = None
    measured_shank: float | None = None

    @property
    def fractions(self) -> SegmentTable:
        """The table of proportions, with the measured lengths."""
        table = super().fractions
        thigh, shank = (
            own if length is None else replace(own, length=length / self.height)
            for own, length in ((table.thigh, self.measured_thigh), (table.shank, self.measured_shank))
        )
        return replace(table, thigh=thigh, shank=shank)
