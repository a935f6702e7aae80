"""A point of a study (a run with its entry in the index), the sequence of all points, and their descriptions.

A description is a text for readers, such as ``RK4, step 0.1 s``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import overload

from mbdkit.base.errors import MbdkitError
from mbdkit.spec.run_spec import RunSpec
from mbdkit_report import key_unit, key_words
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.points.planned_points import Label, PlannedPoint, PlannedPoints, point_label
from mbdkit_studies.store.study_index import Index, Row

KEPT = 1000  #: Number of points of a study that are kept in memory.


@dataclass(frozen=True)
class StudyPoint:
    """One run of a study with its entry in the index.

    Parameters
    ----------
    number
        Number of the point in the study, from 1; for a reference run, its number among the reference runs.
    planned
        The planned point from which the spec is built.
    folder
        Folder of the study.
    axes
        Label of the point's value on each axis, by dotted key; empty for a reference run.
    is_reference
        Whether this is a reference run, which is not a point of the study.
    """

    number: int
    row: Row
    planned: PlannedPoint
    folder: StudyFolder
    axes: Mapping[str, Label]
    is_reference: bool = False

    @property
    def path(self) -> Path | None:
        """Path of the archive; None if the run has none."""
        path = self.folder.archive(self.run_id)
        return path if self.run_id and self.status != "missing" and path.exists() else None

    @property
    def family(self) -> str:
        """Name of the family of the point; empty in a study without families, and for a reference run."""
        return self.row.family

    @property
    def run_id(self) -> str:
        """Identifier of the run."""
        return self.row.run_id

    @property
    def reference_id(self) -> str:
        """Identifier of the reference run against which errors are computed; empty if there is none."""
        return self.row.reference_id

    @property
    def status(self) -> str:
        """``complete``, ``failed``, ``missing``, or ``left-out`` if it needs a distribution that is not installed."""
        return self.row.status

    @property
    def reason(self) -> str:
        """Reason why the run is not complete, as a code and a sentence; empty if it is complete."""
        return self.row.status_reason

    @property
    def verdict(self) -> str:
        """Verdict on the run: ``good``, ``unknown``, ``doubtful`` or ``bad``; empty without an archive."""
        return self.row.verdict

    @property
    def verdict_reasons(self) -> str:
        """Reasons for the verdict, separated by two spaces; empty if there are none."""
        return self.row.verdict_reasons

    @property
    def values(self) -> Mapping[str, float]:
        """Measures, counters and timings by column; nan if not available."""
        return self.row.values

    @property
    def label(self) -> str:
        """The axis labels of the point as one line."""
        return point_label(self.axes)

    @property
    def spec(self) -> RunSpec:
        """The spec of the run."""
        spec = self.planned.reference if self.is_reference else self.planned.spec
        assert spec is not None
        return spec


class Points(Sequence[StudyPoint]):
    """Points of a study, each created on access; the first `KEPT` are kept, because their specs are read repeatedly.

    Parameters
    ----------
    planned, index, folder
        Planned points, index and folder of the whole study.
    places
        Indices of the points among those of the study; all by default.
    """

    def __init__(self, planned: PlannedPoints, index: Index, folder: StudyFolder, places: Sequence[int] | None = None):
        self._planned, self._index, self._folder = planned, index, folder
        self._places = range(len(planned)) if places is None else places
        self._kept: dict[int, StudyPoint] = {}

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, place: int) -> StudyPoint: ...

    @overload
    def __getitem__(self, place: slice) -> tuple[StudyPoint, ...]: ...

    def __getitem__(self, place: int | slice) -> StudyPoint | tuple[StudyPoint, ...]:
        if isinstance(place, slice):
            return tuple(self[index] for index in range(*place.indices(len(self))))
        place = self._places[place]
        if place in self._kept:
            return self._kept[place]
        planned, row = self._planned[place], self._index.row(place)
        point = StudyPoint(planned.number, replace(row, family=planned.family), planned, self._folder, planned.axes)
        if place < KEPT:
            self._kept[place] = point
        return point

    def at(self, places: Sequence[int]) -> Points:
        """Return the points with these indices in the study."""
        return Points(self._planned, self._index, self._folder, places)


def point_words(point: StudyPoint, units: Mapping[str, str] | None = None) -> str:
    """Return the values of a point on the axes in words, such as ``RK4, step 0.1 s``.

    Parameters
    ----------
    units
        Unit of each key, if the units are the same for all points; by default, the units are read from the spec of the
        point.
    """
    return ", ".join(value_words(key, point, None if units is None else units[key]) for key in point.axes)


def others_than(key: str, point: StudyPoint) -> list[str]:
    """Return the axes of a point without a key and the keys that vary together with it."""
    axes = [[name for name, _ in axis] for axis in point.planned.grid.axes]
    together = next((names for names in axes if key in names), [key])
    return [name for name in point.axes if name not in together]


def value_words(key: str, point: StudyPoint, unit: str | None = None) -> str:
    """Return the value of a point on an axis as text: a label unchanged, a number with the words and the unit of the
    key.
    """
    label = point.axes[key]
    if isinstance(label, str):
        return label
    return " ".join(filter(None, (key_words(key), f"{label:.6g}", axis_unit(key, [point]) if unit is None else unit)))


def axis_unit(key: str, points: Sequence[StudyPoint]) -> str:
    """Return the unit of an axis; empty if the axis has no unit, or if no spec of the points is valid here."""
    stated = points[0].planned.grid.stated_units.get(key, "") if points else ""
    return stated or key_unit(key, valid_specs(points))


def valid_specs(points: Iterable[StudyPoint]) -> Iterator[RunSpec]:
    """Yield the specs of the runs of points, without those that are not valid here."""
    for point in points:
        with suppress(MbdkitError):  # for example, a plugin that the spec needs is not installed
            yield point.spec
