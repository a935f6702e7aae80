"""A point of a study (a run with its entry in the index), the sequence of all points, and their descriptions.

A description is a text for readers, such as ``RK4, step 0.1 s``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from mbdkit.base.errors import MbdkitError
from mbdkit.spec.run_spec import RunSpec
from mbdkit_report import key_unit, key_words
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.points.planned_points import PlannedPoint, PlannedPoints, point_label
from mbdkit_studies.spec.made_items import MadeItems
from mbdkit_studies.store.study_index import Index, Row

KEPT = 1000  #: Number of points of a study that are kept in memory.


@dataclass(frozen=True, kw_only=True)
class StudyPoint(Row):
    """One run of a study: its entry in the index with its family and the values on the axes, and how to build its spec.

    Parameters
    ----------
    number
        Number of the point in the study, from 1; for a reference run, its number among the reference runs.
    planned
        The planned point from which the spec is built.
    folder
        Folder of the study.
    is_reference
        Whether this is a reference run, which is not a point of the study, and has no family and no axes.
    """

    number: int
    planned: PlannedPoint = field(compare=False)
    folder: StudyFolder = field(compare=False)
    is_reference: bool = False

    @property
    def path(self) -> Path | None:
        """Path of the archive; None if the run has none."""
        path = self.folder.archive(self.run_id)
        return path if self.run_id and self.status != "missing" and path.exists() else None

    @property
    def reason(self) -> str:
        """Reason why the run is not complete, as a code and a sentence; empty if it is complete."""
        return self.status_reason

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


class Points(MadeItems[StudyPoint]):
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
        super().__init__(len(self._places), self._point, KEPT)

    def _point(self, number: int) -> StudyPoint:
        place = self._places[number]
        planned = self._planned[place]
        row = replace(self._index.row(place), family=planned.family, axes=planned.axes)
        return StudyPoint(**vars(row), number=planned.number, planned=planned, folder=self._folder)

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
    if isinstance(label := point.axes[key], str):
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
