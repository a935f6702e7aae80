"""The `Study` object: the spec of a study, its points, their runs and measures."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbdkit.archive.missing_plugins import advised
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.errors import MbdkitError, SpecError
from mbdkit.html_view import HtmlView
from mbdkit.logs import logger_of
from mbdkit.measures.take import Description
from mbdkit.progress_bars import count_bar, in_notebook
from mbdkit.spec import RunSpec
from mbdkit.spec.run_source import StudySource
from mbdkit.spec.study_loading import load_study_spec
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies import study_index
from mbdkit.studies.execute import Execution, Progress, Shard
from mbdkit.studies.planned_points import Label, PlannedPoint, plan_points, point_label
from mbdkit.studies.study_folder import StudyFolder
from mbdkit.studies.study_index import Row
from mbdkit.terminal import say
from mbdkit.text import counted, did_you_mean, listed, shown

if TYPE_CHECKING:
    import pandas
    import xarray

_LOG = logger_of(__name__)


@dataclass(frozen=True)
class StudyPoint:
    """One run of a study with its entry in the index.

    Parameters
    ----------
    number
        Number from 1, counted over the points of the study, or over its references for a reference.
    planned
        The planned point from which its spec is built.
    path
        Path of its archive; None if it does not exist.
    axes
        Label of its value on each axis, by dotted key; empty for a reference.
    is_reference
        Whether it is a reference run, which is not itself a point of the study.
    """

    number: int
    row: Row
    planned: PlannedPoint
    path: Path | None
    axes: Mapping[str, Label]
    is_reference: bool = False

    @property
    def family(self) -> str:
        """Name of its family; empty in a study without families, and for a reference."""
        return self.row.family

    @property
    def run_id(self) -> str:
        """Identifier of its run."""
        return self.row.run_id

    @property
    def reference_id(self) -> str:
        """Identifier of the reference run for its errors; empty if it has none."""
        return self.row.reference_id

    @property
    def status(self) -> str:
        """``complete``, ``failed``, ``missing``, or ``left-out`` if it needs a distribution that is not installed."""
        return self.row.status

    @property
    def reason(self) -> str:
        """Why the run is not complete, as a code and a sentence; empty if it is."""
        return self.row.reason

    @property
    def verdict(self) -> str:
        """Verdict on the run: ``good``, ``unknown``, ``doubtful`` or ``bad``; empty without an archive."""
        return self.row.verdict

    @property
    def verdict_reasons(self) -> str:
        """Reasons for the verdict, joined by spaces; empty if there are none."""
        return self.row.verdict_reasons

    @property
    def values(self) -> Mapping[str, float]:
        """Measures, counters and timings by column; nan if not available."""
        return self.row.values

    @property
    def label(self) -> str:
        """Its axis labels as one line."""
        return point_label(self.axes)

    @property
    def spec(self) -> RunSpec:
        """The spec of its run."""
        spec = self.planned.reference if self.is_reference else self.planned.spec
        assert spec is not None
        return spec


class Study(HtmlView):
    """A study in a folder: its spec, its runs and their measures.

    Parameters
    ----------
    computed
        Number of runs that were computed before the study was opened in the same call.
    unfinished
        Reasons outside the study why runs or timings were not finished in the same call; the next call tries again.
    keep
        Temporary folder to delete when the study is deleted.

    Raises
    ------
    SpecError
        If the folder contains no study with an index.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        computed: int = 0,
        unfinished: Sequence[str] = (),
        keep: tempfile.TemporaryDirectory[str] | None = None,
    ):
        self.computed = computed
        self.unfinished = tuple(unfinished)
        self._files = StudyFolder(Path(folder))
        self._keep = keep
        if not self._files.spec.is_file():
            raise SpecError("this folder contains no study: there is no study.yaml", file=folder)
        self.spec: StudySpec = load_study_spec(self._files.spec)
        index = study_index.read(self._files.index)
        planned = plan_points(self.spec)
        if index.study_sha256 != self.spec.sha256() or len(index.runs) != len(planned):
            raise SpecError("the index does not match study.yaml; run `mbdkit study` to renew it", file=folder)
        self._index = index
        self.points: tuple[StudyPoint, ...] = tuple(
            StudyPoint(point.number, row, point, self._archive(row), point.axes)
            for point, row in zip(planned, index.runs, strict=True)
        )
        compared = {row.reference_id: point for point, row in zip(planned, index.runs, strict=True)}
        self.references: tuple[StudyPoint, ...] = tuple(
            StudyPoint(number, row, compared[row.run_id], self._archive(row), {}, is_reference=True)
            for number, row in enumerate(index.references, start=1)
        )

    def described(self, name: str) -> tuple[str, str]:
        """Return the units and the description of a numeric column of the index, such as a measure.

        Raises
        ------
        KeyError
            If there is no such column.
        """
        found = self._index.described(name)
        return found.units, found.long_name

    def _archive(self, row: Row) -> Path | None:
        path = self._files.archive(row.run_id)
        return path if row.run_id and row.status != "missing" and path.exists() else None

    @property
    def folder(self) -> Path:
        """Folder of the study."""
        return self._files.path

    @property
    def status(self) -> str:
        """``complete`` if every run was computed, including failed ones; ``partial`` if some are missing.

        Runs that are left out because a distribution is not installed do not count as missing.
        """
        rows = (*self.points, *self.references)
        return "partial" if any(point.status == "missing" for point in rows) else "complete"

    @property
    def failures(self) -> tuple[StudyPoint, ...]:
        """The points and references whose runs failed."""
        return tuple(point for point in (*self.points, *self.references) if point.status == "failed")

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
        if name not in self.families:
            hint = did_you_mean(name, self.families)
            raise MbdkitError(f"the study has no family '{name}'{hint}; families: {listed(self.families)}")
        return tuple(point for point in self.points if point.family == name)

    def axes(self, family: str | None = None) -> dict[str, list[Label]]:
        """Return the labels on each axis of a family by dotted key, in the order of the spec.

        Parameters
        ----------
        family
            Name of the family; optional if the study has only one.
        """
        grid = self._one_family(family)[0].planned.grid
        return {key: [value.label for value in values] for axis in grid.axes for key, values in axis}

    def run(self, point: StudyPoint) -> Run | None:
        """Open the archive of a point, or return None if it has none. Close the run, or use it in a `with` block."""
        return None if point.path is None else load(point.path)

    def reference(self, point: StudyPoint) -> Run | None:
        """Open the archive of the reference run of a point, or return None if it has none."""
        path = self._files.archive(point.reference_id)
        return load(path) if point.reference_id and path.exists() else None

    def runs(self, family: str | None = None) -> Iterator[tuple[StudyPoint, Run | None]]:
        """Yield each point of one family, or of the whole study, with its open archive."""
        for point in self.points if family is None else self.family(family):
            yield point, self.run(point)

    def _one_family(self, name: str | None) -> tuple[StudyPoint, ...]:
        if name is None and len(self.families) > 1:
            raise MbdkitError(f"the study has several families; name one: {listed(self.families)}")
        return self.family(next(iter(self.families)) if name is None else name)

    @property
    def measures(self) -> dict[str, Description]:
        """Units and descriptions, by column, of the measures that the study defines by expressions or plugins."""
        return {measure.name: self._index.described(measure.name) for measure in self.spec.defined_measures()}

    def _columns(self, points: Sequence[StudyPoint]) -> dict[str, list[Any]]:
        """Return the columns of the index without those of the axes."""
        names = dict.fromkeys((*self.measures, *(name for point in points for name in point.values)))
        return {
            "run_id": [point.run_id for point in points],
            "reference_id": [point.reference_id for point in points],
            "status": [point.status for point in points],
            "status_reason": [point.reason for point in points],
            "verdict": [point.verdict for point in points],
            "verdict_reasons": [point.verdict_reasons for point in points],
            "second_run": [point.row.second_run for point in points],
            "worst_joint": [point.row.worst_joint for point in points],
            **{name: [point.values.get(name, float("nan")) for point in points] for name in names},
            "data_sha256": [point.row.data_sha256 for point in points],
        }

    def to_frame(self, family: str | None = None) -> pandas.DataFrame:
        """Return a table with one row per point: number, family, axes, run, status, verdict, measures, counters, times.

        Its attribute ``attrs["units"]`` has the unit of each numeric column.

        Parameters
        ----------
        family
            Name of a family to which to restrict the table; all families by default.

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
        frame = pandas.DataFrame({**place, **axes, **self._columns(points)})
        frame.attrs["units"] = {name: self._index.described(name).units for name in points[0].values}
        return frame

    def to_xarray(self, family: str | None = None) -> xarray.Dataset:
        """Return the grid of one family as a dataset with one dimension per axis.

        Parameters
        ----------
        family
            Name of the family; optional if the study has only one.

        Raises
        ------
        MbdkitError
            If xarray is not installed, or if the study has several families and `family` is None.
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
                attributes = asdict(self._index.described(name))
            variables[name] = (dims, np.array(values, dtype).reshape(shape), attributes)
        return xarray.Dataset(variables, coordinates, {"title": self.spec.title, "status": self.status})

    def __repr__(self) -> str:
        return f"<Study of {len(self.points)} runs, {self.status}, {self.folder}>"


def load_study(folder: str | Path) -> Study:
    """Open the folder of a study without computing anything.

    Parameters
    ----------
    folder
        Folder that was written by `study` or ``mbdkit study``.

    Raises
    ------
    SpecError
        If the folder contains no study with an index.

    Examples
    --------
    >>> import mbdkit
    >>> study = mbdkit.study(
    ...     {"mbdkit_study": 1, "base": "pendulum", "axes": [{"time.step": [0.02, 0.01]}]}, out="steps"
    ... )
    >>> len(mbdkit.load_study("steps").points)
    2
    """
    return Study(folder)


def study(
    source: StudySource,
    *,
    out: str | Path | None = None,
    workers: int = 1,
    shard: Shard | None = None,
    progress: Progress | None = None,
    notify: Callable[[str], None] = say,
    assignments: Sequence[str] = (),
    overwrite: bool = False,
) -> Study:
    """Run a study: compute the runs that are missing in its folder.

    Parameters
    ----------
    source
        Name of a packaged study, path of a file, mapping, or `StudySpec`.
    out
        Folder of the study; by default a temporary one that is deleted with the returned study.
    workers
        Number of processes that compute in parallel.
    shard
        Part of the study to compute; by default all of it.
    progress
        Called with (tasks done, tasks in all, failed runs) after each task. By default, notebooks show a progress
        bar.
    notify
        Called with a message before an operation that takes long.
    assignments
        Assignments such as ``"time.end=5"`` that are set in the base of every run.
    overwrite
        Whether to start the folder anew: its study.yaml, index, archives of runs and report are removed first, once the
        new study has proved valid. Other files in it are kept.

    Returns
    -------
    Study
        The study with its index. Failed runs do not raise an error; they are part of the results. A run for which a
        resource is lacking, such as disk space, is missing; `Study.unfinished` has the reasons.

    Raises
    ------
    SpecError
        If the study or one of its runs is invalid, or the folder belongs to another study. Nothing is written in this
        case.
    ResourceError
        If the folder cannot be written to, is in use by another call, or no process can be started.

    Examples
    --------
    >>> import mbdkit
    >>> study = mbdkit.study(
    ...     {
    ...         "mbdkit_study": 1,
    ...         "base": "pendulum",
    ...         "overrides": {"time": {"end": 1.0, "step": 0.01}},
    ...         "axes": [{"integrator": [{"name": "rk4"}, {"name": "gauss"}]}, {"time.step": [0.02, 0.01]}],
    ...     },
    ...     out="methods",
    ... )
    >>> [point.status for point in study.points]
    ['complete', 'complete', 'complete', 'complete']
    """
    spec = load_study_spec(source, assignments)
    keep = None
    if out is None:
        keep = tempfile.TemporaryDirectory(prefix="mbdkit-study-")
        out = keep.name
    folder = StudyFolder(Path(out))
    try:
        is_shown = progress is None and in_notebook()
        with count_bar(spec.title or folder.path.name, quiet=not is_shown) as bar:
            execution = Execution(
                spec, folder, shard=shard, progress=progress or bar, notify=notify, overwrite=overwrite
            )
            _LOG.info("study in %s begins: %s", shown(folder.path), counted(len(execution.runs), "run"))
            execution.run(workers)
            _LOG.info(
                "study in %s ends: %d computed, %d failed", shown(folder.path), execution.computed, execution.failed
            )
    except SpecError as error:
        raise advised(error, sorted(folder.path.glob("runs/*.h5"))) from None
    return Study(folder.path, computed=execution.computed, unfinished=execution.unfinished, keep=keep)
