"""The runs of a study: the table of their results, how they are read from its folder, and integrated again."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np

from mbdkit.archive.measured_values import MeasuredValues
from mbdkit.archive.run import Run
from mbdkit.base.called_functions import calls_allowed
from mbdkit.base.distributions import own_version
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.files_read import FileRead, only_known
from mbdkit.base.text import did_you_mean, listed
from mbdkit.runs.simulation import simulate
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.points.planned_points import Grid, Label, PlannedPoints
from mbdkit_studies.spec.measures import MEASURES, Description, numbers_of
from mbdkit_studies.spec.study_spec import StudySpec, expressions_of
from mbdkit_studies.store.storage import JoinedRuns, Storage
from mbdkit_studies.store.study_index import NUMBERS, TEXTS, Index
from mbdkit_studies.store.study_point import Points, StudyPoint
from mbdkit_studies.texts import ERROR

#: Columns of texts in the index that the tables of a study have at another place, or not at all.
_NOT_SHOWN = ("family", "data_sha256", "file_sha256")


class StudyRuns:
    """Base class of `Study`: its families of points, the table of its results, and the run of each point."""

    spec: StudySpec
    points: Points
    references: tuple[StudyPoint, ...]
    storage: Storage
    _files: StudyFolder
    _index: Index
    _planned: PlannedPoints

    @property
    def folder(self) -> Path:
        """Folder of the study."""
        return self._files.path

    @property
    def families(self) -> dict[str, str]:
        """Titles of the families by name; a study without families has a single one with an empty name."""
        return {name: family.title for name, family in self.spec.families.items()} or {"": self.spec.title}

    def family(self, name: str) -> tuple[StudyPoint, ...]:
        """Return the points of one family.

        Raises
        ------
        MbdkitError
            If there is no family with this name.
        """
        name = self._family(name)
        return tuple(point for point in self.points if point.family == name)

    def _family(self, name: str | None) -> str:
        """Return the name of a family; None stands for the only family."""
        if name is None and len(self.families) > 1:
            raise MbdkitError(f"the study has several families; name one: {listed(self.families)}")
        chosen = next(iter(self.families)) if name is None else name
        if chosen not in self.families:
            hint = did_you_mean(chosen, self.families)
            raise MbdkitError(f"the study has no family '{chosen}'{hint}; families: {listed(self.families)}")
        return chosen

    def axes(self, family: str | None = None) -> dict[str, list[Label]]:
        """Return the labels on each axis of a family by dotted key, in the order of the spec.

        Parameters
        ----------
        family
            Name of the family; optional if the study has only one.
        """
        grid = self.grid(family)
        return {key: [value.label for value in values] for axis in grid.axes for key, values in axis}

    def grid(self, family: str | None = None) -> Grid:
        """Return the plan of a family: its axes and the values of its sample.

        Parameters
        ----------
        family
            Name of the family; optional if the study has only one.
        """
        name = self._family(family)
        return next(grid for grid in self._planned.grids if grid.name == name)

    def described(self, name: str) -> tuple[str, str]:
        """Return the units and the description of a numeric column of the index, such as a measure.

        Raises
        ------
        KeyError
            If there is no such column.
        """
        column = self._index.described.get(name) or NUMBERS[name]
        return column.units, column.long_name

    @property
    def units(self) -> dict[str, str]:
        """Unit of each numeric column of `columns` that is not an axis, by name."""
        return {name: column.units for name, column in self._index.described.items()}

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns of `to_frame` by name, each with one value for each point."""
        return self._table()

    def _columns(self, places: Sequence[int] | slice) -> dict[str, np.ndarray]:
        """Return the columns of the index for the points with these indices, without families and axes."""
        texts = [name for name in TEXTS if name in self._index.runs and name not in _NOT_SHOWN]
        names = dict.fromkeys((*texts, *self._index.described, "data_sha256"))
        return {name: self._index.runs[name][places] for name in names}

    def _places(self, family: str) -> list[int]:
        """Return the indices of the points of a family."""
        return np.flatnonzero(self._planned.families() == self._family(family)).tolist()

    def _table(self, family: str | None = None) -> dict[str, np.ndarray]:
        """Return the columns of a table of the points of one family, or of all."""
        where = {"number": np.arange(1, len(self.points) + 1), "family": self._planned.families()}
        if family is None:
            return where | self._planned.labels() | self._columns(slice(None))
        places = self._places(family)
        labels = self.grid(family).labels()
        return {name: column[places] for name, column in where.items()} | labels | self._columns(places)

    def run(self, point: StudyPoint | int | None = None, *, number: int | None = None) -> Run | None:
        """Return the run of a point with the arrays that the study stores, or None if it has no results.

        Close the run, or use it in a `with` block.

        Parameters
        ----------
        point
            A point, or its index among the points, counted from 0 as in `points` and in the table of `to_frame`.
        number
            Number of the run instead, counted from 1 as in answers, reports, messages and the column ``number``.

        Raises
        ------
        SpecError
            If the file contains another run, of this or of another study, or if its data differ from those in the
            index.
        MbdkitError
            If there is no such run, or not exactly one of `point` and `number` is given.
        """
        chosen = self._point(point, number)
        if (run := self.storage.open(chosen)) is not None:
            try:
                _check_stored(run, chosen, self.storage.path(chosen))
            except BaseException:
                run.close()
                raise
            self._add_measures(run, chosen)
        return run

    def _add_measures(self, run: Run, point: StudyPoint) -> None:
        """Add to a run the measures that the study defines and that the spec of the run does not define."""
        known, values = run.measures, point.values
        if own := [one.name for one in self.spec.defined_measures() if not one.of_base and one.name in values]:
            run.measures = MeasuredValues(
                {**known, **{name: values[name] for name in own}},
                {**known.units, **{name: self.measures[name].units for name in own}},
                known.reasons,
                {**known.errors, **{name: values.get(name + ERROR, np.nan) for name in own}},
                known.remarks,
            )

    def remake(
        self,
        point: StudyPoint | int | None = None,
        *,
        number: int | None = None,
        files: bool = False,
        call: bool = False,
    ) -> Run:
        """Integrate the run of a point again, and return it with all of its arrays, in memory.

        Parameters
        ----------
        point, number
            See `run`.
        files
            Whether files that the spec names may be read, such as a model of another program; they must have the
            SHA-256 with which the run was computed.
        call
            Whether the Python functions that controllers of the spec name may be called.

        Raises
        ------
        MbdkitError
            If there is no such run, if it has no results, if its spec names files that may not be read, if its file
            contains another run, or if its data, measures, counters and verdict are not bitwise identical to those in
            the index. Timings and measures of second runs are not compared.
        """
        chosen = self._point(point, number)
        if not chosen.data_sha256:
            message = f"run {chosen.number} has no results, so that it cannot be computed again"
            raise MbdkitError(f"{message}: {chosen.status}")
        (written, read), now = self._written_by(chosen), own_version()
        why = f"; mbdkit {written} wrote it, this is {now}" if written not in (now, "unknown") else ""
        with self.reference(chosen) or nullcontext() as reference, only_known(read, allowed=files), calls_allowed(call):
            run = _remake(self.spec, chosen, reference, why)
        self._add_measures(run, chosen)
        return run

    def _point(self, point: StudyPoint | int | None, number: int | None) -> StudyPoint:
        if (point is None) == (number is None):
            message = "give a run by its index from 0, as in study.run(4), or by its number, study.run(number=5)"
            raise MbdkitError(message)
        if isinstance(point, StudyPoint):
            return point
        count = len(self.points)
        if point is None:
            assert number is not None
            if not 1 <= operator.index(number) <= count:
                raise MbdkitError(f"the study has no run number {number}; its runs have the numbers 1 to {count}")
            return self.points[operator.index(number) - 1]
        if not -count <= operator.index(point) < count:
            hint = f"; study.run(number={count}) is the last run" if point == count else ""
            raise MbdkitError(f"the study has no run with index {point}; indices are 0 to {count - 1}{hint}")
        return self.points[operator.index(point)]

    def _written_by(self, point: StudyPoint) -> tuple[str, Sequence[FileRead] | None]:
        """Return the version of mbdkit that computed the run of a point, after checking its file, and the files that
        were read for the run; "unknown" and None without a file.
        """
        path = self.storage.path(point)
        run = self.run(point) if path is not None and path.exists() else None
        if run is None:
            return "unknown", None
        with run:
            return str(run.provenance.get("mbdkit", "unknown")), run.files

    def reference(self, point: StudyPoint) -> Run | None:
        """Open the archive of the reference run of a point, or return None if it has none."""
        return next((self.run(other) for other in self.references if other.run_id == point.reference_id), None)

    def runs(self, family: str | None = None) -> Iterator[tuple[StudyPoint, Run | None]]:
        """Yield each point of one family, or of the whole study, with its run, or None if it has no results.

        Close each run, or use it in a `with` block.
        """
        yield from ((point, self.run(point)) for point in (self.points if family is None else self.family(family)))

    @property
    def measures(self) -> dict[str, Description]:
        """Units and descriptions, by column, of the measures that the study defines by expressions or plugins."""
        return {measure.name: self._index.described[measure.name] for measure in self.spec.defined_measures()}

    def rows_of_runs(self) -> JoinedRuns:
        """Yield runs that join the rows of one or more runs of the study.

        Each item is a joined run, the numbers of its runs in the study, and the number of rows of each of its runs. A
        joined run has the histories of all of its runs, but only the spec and the name of the first one.
        """
        return self.storage.joined_runs(self.runs())


def _check_stored(run: Run, point: StudyPoint, path: Path | None) -> None:
    """Check that a stored run is the one that the study plans, and that its data are those in the index.

    Parameters
    ----------
    path
        File of the run, which may have been replaced since the study was indexed.

    Raises
    ------
    SpecError
        If the spec of the run is not that of the point, or if its identifier or data differ from those in the index.
    """
    which = f"the reference run {point.run_id}" if point.is_reference else f"run {point.number}"
    another = run.run_id != point.run_id
    # The plugin of the model may not be installed, and files that the spec names are not read.
    with suppress(MbdkitError), only_known((), allowed=False):
        another = another or run.run_spec.sha256() != point.spec.sha256()
    if another:
        message = f"this file contains another run in place of {which} of the study"
        raise SpecError(f"{message}; move it to another folder, and run `mbdkit study` again", file=path)
    if run.data_sha256 != point.data_sha256:
        message = f"the data of {which} are not those that the study has indexed: data_sha256 differs"
        raise SpecError(f"{message}; run `mbdkit study` again to index what is in the folder", file=path)


def _remake(study: StudySpec, point: StudyPoint, reference: Run | None, why: str) -> Run:
    """Integrate the run of a point again, and compare it with its row in the index.

    Parameters
    ----------
    reference
        Stored reference run against which errors are computed, if there is one.
    why
        Explanation of possible differences, which is appended to messages.

    Raises
    ------
    MbdkitError
        If data, measures, counters or verdict differ from those in the index.
    """
    run = simulate(point.spec, measures=expressions_of(study.defined_measures()))
    if run.data_sha256 != point.data_sha256:
        raise MbdkitError(f"run {point.number}, computed again, has other data than the stored run{why}")
    known = point.values
    names = [name for name, one in MEASURES.items() if name in known and (reference is not None or not one.needs)]
    numbers = numbers_of(run, reference, run.run_spec, names, study.defined_measures())
    differing = [
        name
        for name, value in numbers.items()
        if name in known and not (value == known[name] or (math.isnan(value) and math.isnan(known[name])))
    ]
    if run.verdict != (point.verdict or run.verdict):
        differing.append("verdict")
    if differing:
        message = f"run {point.number}, computed again, has the same data, but the index has other values of"
        raise MbdkitError(f"{message} {listed(differing)}{why}")
    return run
