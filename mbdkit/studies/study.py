"""The study as Python sees it: its spec, its points, their runs and what was measured."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbdkit.archive.missing_plugins import advised
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.errors import MbdkitError, SpecError
from mbdkit.spec import RunSpec
from mbdkit.spec.study_loading import load_study_spec
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies import study_index
from mbdkit.studies.execute import Execution, Progress, Shard
from mbdkit.studies.planned_points import Label, PlannedPoint, plan_points, point_label
from mbdkit.studies.study_folder import StudyFolder
from mbdkit.studies.study_index import Row
from mbdkit.terminal import say
from mbdkit.text import did_you_mean, listed

if TYPE_CHECKING:
    import pandas
    import xarray


@dataclass(frozen=True)
class StudyPoint:
    """One run of a study and what the index says of it.

    Parameters
    ----------
    number
        From 1, over the whole study; over the references for a reference.
    row
        Its row in the index.
    planned
        What makes its spec.
    path
        Its archive; None where there is none.
    axes
        The label of its value on every axis, by dotted key; empty for a reference.
    is_reference
        Whether it is a run that others are compared with, and no point of the study.
    """

    number: int
    row: Row
    planned: PlannedPoint
    path: Path | None
    axes: Mapping[str, Label]
    is_reference: bool = False

    @property
    def family(self) -> str:
        """The name of its family; empty in a study without families, and for a reference."""
        return self.row.family

    @property
    def run_id(self) -> str:
        """The name of its run."""
        return self.row.run_id

    @property
    def reference_id(self) -> str:
        """The name of the run that its errors are taken against; empty without one."""
        return self.row.reference_id

    @property
    def status(self) -> str:
        """``complete``, ``failed``, ``missing``, or ``left-out`` where it needs what is not installed."""
        return self.row.status

    @property
    def reason(self) -> str:
        """Why it is not complete: a code and a sentence."""
        return self.row.reason

    @property
    def values(self) -> Mapping[str, float]:
        """Measures, counters and timings by column; nan where there is none."""
        return self.row.values

    @property
    def label(self) -> str:
        """Its values on the axes in one line."""
        return point_label(self.axes)

    @property
    def spec(self) -> RunSpec:
        """The spec of its run."""
        spec = self.planned.reference if self.is_reference else self.planned.spec
        assert spec is not None
        return spec


class Study:
    """A study in its folder: what was asked, what was run, what was measured.

    Parameters
    ----------
    folder
        Where it lies.
    computed
        How many runs the call computed that gives the study; 0 if it was only opened.
    keep
        What keeps a temporary folder alive as long as the study is.

    Raises
    ------
    SpecError
        If there is no study with an index there.
    """

    def __init__(self, folder: str | Path, *, computed: int = 0, keep: tempfile.TemporaryDirectory[str] | None = None):
        self.computed = computed
        self._files = StudyFolder(Path(folder))
        self._keep = keep
        if not self._files.spec.is_file():
            raise SpecError("there is no study here: no study.yaml", file=folder)
        self.spec: StudySpec = load_study_spec(self._files.spec)
        index = study_index.read(self._files.index)
        planned = plan_points(self.spec)
        if index.study_sha256 != self.spec.sha256() or len(index.runs) != len(planned):
            raise SpecError("the index is of another study than study.yaml; `mbdkit study` renews it", file=folder)
        self.points: tuple[StudyPoint, ...] = tuple(
            StudyPoint(point.number, row, point, self._archive(row), point.axes)
            for point, row in zip(planned, index.runs, strict=True)
        )
        compared = {row.reference_id: point for point, row in zip(planned, index.runs, strict=True)}
        self.references: tuple[StudyPoint, ...] = tuple(
            StudyPoint(number, row, compared[row.run_id], self._archive(row), {}, is_reference=True)
            for number, row in enumerate(index.references, start=1)
        )

    def _archive(self, row: Row) -> Path | None:
        path = self._files.archive(row.run_id)
        return path if row.run_id and row.status != "missing" and path.exists() else None

    @property
    def folder(self) -> Path:
        """Where the study lies."""
        return self._files.path

    @property
    def status(self) -> str:
        """``complete`` if every run was computed, failed ones included; ``partial`` if some are missing.

        Runs that are left out, because they need what is not installed, are not missing.
        """
        rows = (*self.points, *self.references)
        return "partial" if any(point.status == "missing" for point in rows) else "complete"

    @property
    def failures(self) -> tuple[StudyPoint, ...]:
        """The points and references whose runs failed."""
        return tuple(point for point in (*self.points, *self.references) if point.status == "failed")

    @property
    def families(self) -> dict[str, str]:
        """The titles of the families by name; one without a name where the study has none."""
        return {name: family.title for name, family in self.spec.families.items()} or {"": self.spec.title}

    def family(self, name: str) -> tuple[StudyPoint, ...]:
        """Return the points of one family.

        Raises
        ------
        MbdkitError
            If there is none of this name.
        """
        if name not in self.families:
            hint = did_you_mean(name, self.families)
            raise MbdkitError(f"the study has no family '{name}'{hint}; families: {listed(self.families)}")
        return tuple(point for point in self.points if point.family == name)

    def axes(self, family: str | None = None) -> dict[str, list[Label]]:
        """Return the labels on each axis of a family by dotted key, in the order of the spec.

        Parameters
        ----------
        family
            Its name; may be left out where there is but one.
        """
        grid = self._one_family(family)[0].planned.grid
        return {key: [value.label for value in values] for axis in grid.axes for key, values in axis}

    def run(self, point: StudyPoint) -> Run | None:
        """Open the archive of a point; None where it has none. Close it, or use it in a `with` block."""
        return None if point.path is None else load(point.path)

    def reference(self, point: StudyPoint) -> Run | None:
        """Open the archive of the run that a point's errors are taken against; None where there is none."""
        path = self._files.archive(point.reference_id)
        return load(path) if point.reference_id and path.exists() else None

    def runs(self, family: str | None = None) -> Iterator[tuple[StudyPoint, Run | None]]:
        """Yield each point, of one family or of all, with its archive opened."""
        for point in self.points if family is None else self.family(family):
            yield point, self.run(point)

    def _one_family(self, name: str | None) -> tuple[StudyPoint, ...]:
        if name is None and len(self.families) > 1:
            raise MbdkitError(f"the study has several families; name one: {listed(self.families)}")
        return self.family(next(iter(self.families)) if name is None else name)

    def _columns(self, points: Sequence[StudyPoint]) -> dict[str, list[Any]]:
        """Return the index by column, those of the axes apart."""
        names = dict.fromkeys(name for point in points for name in point.values)
        return {
            "run_id": [point.run_id for point in points],
            "reference_id": [point.reference_id for point in points],
            "status": [point.status for point in points],
            "status_reason": [point.reason for point in points],
            "second_run": [point.row.second_run for point in points],
            "worst_joint": [point.row.worst_joint for point in points],
            **{name: [point.values.get(name, float("nan")) for point in points] for name in names},
            "data_sha256": [point.row.data_sha256 for point in points],
        }

    def to_frame(self, family: str | None = None) -> pandas.DataFrame:
        """Return one row a point: number, family, axes, run, status, measures, counters, timings.

        Parameters
        ----------
        family
            The points of one family only.

        Raises
        ------
        MbdkitError
            If pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise MbdkitError("to_frame needs the package pandas: pip install pandas") from error
        points = self.points if family is None else self.family(family)
        keys = dict.fromkeys(key for point in points for key in point.axes)
        axes = {key: [point.axes.get(key) for point in points] for key in keys}
        place = {"number": [point.number for point in points], "family": [point.family for point in points]}
        return pandas.DataFrame({**place, **axes, **self._columns(points)})

    def to_xarray(self, family: str | None = None) -> xarray.Dataset:
        """Return one dimension an axis: the grid of one family.

        Parameters
        ----------
        family
            Its name; may be left out where there is but one.

        Raises
        ------
        MbdkitError
            If xarray is not installed, or the study has several families and none is named.
        """
        try:
            import xarray
        except ImportError as error:
            raise MbdkitError("to_xarray needs the package xarray: pip install xarray") from error
        import numpy as np

        points = self._one_family(family)
        axes = points[0].planned.grid.axes
        dims = [axis[0][0] for axis in axes]
        shape = [len(axis[0][1]) for axis in axes]
        coordinates = {
            key: (dim, [value.label for value in values])
            for dim, axis in zip(dims, axes, strict=True)
            for key, values in axis
        }
        columns = {"number": [point.number for point in points], **self._columns(points)}
        variables = {}
        for name, values in columns.items():
            dtype = object if isinstance(values[0], str) else None
            attributes = {}
            if name in points[0].values:
                attributes = dict(zip(("units", "long_name"), study_index.described(name), strict=True))
            variables[name] = (dims, np.array(values, dtype).reshape(shape), attributes)
        return xarray.Dataset(variables, coordinates, {"title": self.spec.title, "status": self.status})

    def __repr__(self) -> str:
        return f"<Study of {len(self.points)} runs, {self.status}, {self.folder}>"


def load_study(folder: str | Path) -> Study:
    """Open the folder of a study; runs nothing.

    Parameters
    ----------
    folder
        Where `study` or ``mbdkit study`` put it.

    Raises
    ------
    SpecError
        If there is no study with an index there.
    """
    return Study(folder)


def study(
    source: Any,
    *,
    out: str | Path | None = None,
    workers: int = 1,
    shard: Shard | None = None,
    progress: Progress | None = None,
    notify: Callable[[str], None] = say,
) -> Study:
    """Run a study: what is missing of it in its folder.

    Parameters
    ----------
    source
        The name of a packaged study, a file, a mapping or a `StudySpec`.
    out
        The folder; left out, a temporary one that lives as long as the study that is returned.
    workers
        How many processes compute at a time.
    shard
        The part of the study to compute; left out, all of it.
    progress
        Called with (pieces of work done, pieces in all, runs that failed) after each.
    notify
        Told what takes long.

    Returns
    -------
    Study
        With its index. Runs that failed are results like others.

    Raises
    ------
    SpecError
        If the study or one of its runs is wrong, or the folder is another study's; nothing has been done then.
    """
    spec = load_study_spec(source)
    keep = None
    if out is None:
        keep = tempfile.TemporaryDirectory(prefix="mbdkit-study-")
        out = keep.name
    folder = StudyFolder(Path(out))
    try:
        execution = Execution(spec, folder, shard=shard, progress=progress, notify=notify)
        execution.run(workers)
    except SpecError as error:
        raise advised(error, sorted(folder.path.glob("runs/*.h5"))) from None
    return Study(folder.path, computed=execution.computed, keep=keep)
