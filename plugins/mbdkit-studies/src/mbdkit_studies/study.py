"""The `Study` object: the spec of a study, its points, their runs and measures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.html_view import HtmlView
from mbdkit_report import data_frame
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.points.planned_points import Label, PlannedPoints
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_studies.statistics.quantile_bands import QUANTILES, QuantileBands, quantiles
from mbdkit_studies.statistics.sample_statistics import CONFIDENCE, MeasureStatistics, statistics
from mbdkit_studies.statistics.selection import select_rows
from mbdkit_studies.statistics.sobol_indices import RESAMPLES, Sensitivity, sensitivity
from mbdkit_studies.store import study_index
from mbdkit_studies.store.storage import storage_of
from mbdkit_studies.store.study_point import Points, StudyPoint
from mbdkit_studies.store.study_runs import StudyRuns

if TYPE_CHECKING:
    import pandas
    import xarray


class Study(StudyRuns, HtmlView):
    """A study in a folder: its spec, its runs and their measures.

    Parameters
    ----------
    computed
        Number of runs that were computed by the call that returns this object.
    unfinished
        External reasons why that call did not finish runs or timings; the next call tries again.
    keep
        An object that deletes the folder when it is deleted itself, if the folder is temporary.

    Raises
    ------
    SpecError
        If the folder contains no study with an index, or the index does not match the study.
    """

    def __init__(self, folder: str | Path, *, computed: int = 0, unfinished: Sequence[str] = (), keep: object = None):
        self.computed = computed
        self.unfinished = tuple(unfinished)
        self._files = StudyFolder(Path(folder))
        self._keep = keep
        if not self._files.spec.is_file():
            raise SpecError("this folder contains no study: there is no study.yaml", file=folder)
        self.spec: StudySpec = load_study_spec(self._files.spec)
        self._index = index = study_index.read(self._files.index)
        self._planned = planned = PlannedPoints(self.spec)
        if index.study_sha256 != self.spec.sha256() or len(index) != len(planned):
            raise SpecError("the index does not match study.yaml; run `mbdkit study` to renew it", file=self.folder)
        self.storage = storage_of(self.spec, self._files, planned)
        self.points: Points = Points(planned, index, self._files)
        compared = {point.reference_id: point.planned for point in self.points} if len(index.references) else {}
        rows = [index.row(place, of_references=True) for place in range(len(index.references.get("run_id", ())))]
        self.references: tuple[StudyPoint, ...] = tuple(
            StudyPoint(**vars(row), number=number, planned=compared[row.run_id], folder=self._files, is_reference=True)
            for number, row in enumerate(rows, start=1)
        )

    @property
    def status(self) -> str:
        """``complete`` if no run or reference run is missing; ``partial`` otherwise.

        Failed runs, and runs that are left out because a distribution is not installed, do not count as missing.
        """
        statuses = (*self.statuses(), *(reference.status for reference in self.references))
        return "partial" if "missing" in statuses else "complete"

    def statuses(self) -> Sequence[str]:
        """Return the status of the run of each point."""
        return list(self._index.runs["status"])

    def verdicts(self) -> Sequence[str]:
        """Return the verdict on the run of each point; empty where there is none."""
        return list(self._index.runs["verdict"])

    @property
    def failures(self) -> Sequence[StudyPoint]:
        """The points whose runs failed, and the reference runs that failed."""
        failed = self.points.at(np.flatnonzero(self._index.runs["status"] == "failed").tolist())
        references = [reference for reference in self.references if reference.status == "failed"]
        return (*failed, *references) if references else failed

    def select(self, condition: str) -> pandas.DataFrame:
        """Return the rows of `to_frame` that satisfy a condition on its columns.

        Parameters
        ----------
        condition
            Comparisons of columns, numbers and quoted text, such as ``misalignment_max < 1e-6 and status == 'failed'``;
            with ``and``, ``or``, ``not``, ``in [...]``, ``+ - * / **``, abs, sqrt, log10 and isnan. It is not evaluated
            as Python.

        Raises
        ------
        SpecError
            If the condition cannot be parsed, or refers to an unknown column.
        MbdkitError
            If pandas is not installed.
        """
        frame = self.to_frame()
        rows = select_rows(condition, {str(name): frame[name].to_numpy() for name in frame.columns})
        selected = frame[rows]
        selected.attrs = frame.attrs
        return selected

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
        frame = data_frame(self._table(family))
        frame.attrs["units"] = self.units
        return frame

    def statistics(
        self, measure: str, *, where: Mapping[str, Label] | None = None, confidence: float = CONFIDENCE
    ) -> MeasureStatistics:
        """Return mean, standard deviation and quantiles of a measure over the sample, with confidence intervals.

        Runs that failed or are rated bad are left out. The intervals contain only the error of a finite sample, not
        those of its runs. They treat members as independent; for samples that are not `random`, they are therefore
        usually too wide.

        Parameters
        ----------
        measure
            Name of a numeric column, such as a measure or a counter.
        where
            Labels that select one sample, as in `sensitivity`.
        confidence
            Probability of each interval.

        Raises
        ------
        MbdkitError
            If the study has no sample and no table of members, if there is no such measure, if too few runs have a
            value of it, if one sample must be selected by `where`, or if the confidence is not valid.
        """
        return statistics(self, measure, where=where, confidence=confidence)

    def sensitivity(
        self,
        measure: str,
        *,
        where: Mapping[str, Label] | None = None,
        confidence: float = CONFIDENCE,
        members: int | None = None,
        resamples: int = RESAMPLES,
    ) -> Sensitivity:
        """Return the Sobol indices of a measure with respect to the variables of the sample.

        The indices are the estimates (b) and (f) in table 2 of [1]_, as in `scipy.stats.sobol_indices`. Confidence
        intervals are quantiles of a bootstrap over the members. Members with a run that failed or is rated bad are left
        out. An index is nan if its interval covers 0 to 1, or if the values of the measure differ by less than their
        estimated errors.

        Parameters
        ----------
        measure
            Name of a numeric column, such as a measure or a counter.
        where
            Labels on the axes by dotted key, and the name of the family under the key ``family``. They select one
            sample, if the sample is repeated for several labels or families.
        confidence
            Probability of the intervals.
        members
            Number of members to use, beginning with the first, to see how the indices converge; by default all.
        resamples
            Number of bootstrap samples.

        Raises
        ------
        SpecError
            If the study has no sample with ``design: saltelli``.
        MbdkitError
            If there is no such measure, if too few members have a value of it, if one sample must be selected by
            `where`, or if another argument is not valid.

        References
        ----------
        .. [1] A. Saltelli et al., Computer Physics Communications 181 (2010) 259-270.
        """
        return sensitivity(self, measure, where=where, confidence=confidence, members=members, resamples=resamples)

    def quantiles(
        self,
        quantity: str,
        q: float | Sequence[float] = QUANTILES,
        *,
        where: Mapping[str, Label] | None = None,
        times: Sequence[float] | np.ndarray | None = None,
    ) -> QuantileBands:
        """Return quantiles of a quantity over the runs, at each time.

        Parameters
        ----------
        quantity
            Expression of recorded quantities, as in expressions of measures: ``rod.angle``, ``abs(joints.B.force)``.
        q
            Probabilities.
        where
            Labels on the axes by dotted key, and the name of the family under the key ``family``; only runs with these
            labels are used. Required if the sample is repeated for several labels or families.
        times
            (K,) times [s], at which recorded rows are interpolated by cubic polynomials. By default, at most 501 of the
            recorded times if they are the same in all runs, otherwise 201 equally spaced times.

        Returns
        -------
        QuantileBands
            Quantiles over the runs that reach each time; a failed run counts up to its end. Runs that are rated bad
            are left out. Its `error` estimates what interpolation does: runs of adaptive methods have rows of their own
            unless `output.interval` is given.

        Raises
        ------
        SpecError
            If the expression is not valid.
        MbdkitError
            If a probability, a time or a label is not valid, if one sample must be selected by `where`, if no run has
            results, or if the study does not store the quantity.
        """
        return quantiles(self, quantity, q, where=where, times=times)

    def to_xarray(self, family: str | None = None) -> xarray.Dataset:
        """Return the points of one family as a dataset with one dimension per axis.

        In a study with a sample or a table of members, the runs for each combination of axis values have the dimension
        `row`.

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
        places = self._places(self._family(family))
        grid = self.grid(family)
        axes = grid.axes
        dims = [axis[0][0] for axis in axes]
        shape = [len(axis[0][1]) for axis in axes]
        coordinates: dict[str, tuple[str, object]] = {
            key: (dim, [value.label for value in values])
            for dim, axis in zip(dims, axes, strict=True)
            for key, values in axis
        }
        if grid.table:
            dims, shape = [*dims, "row"], [*shape, grid.rows]
            coordinates |= {key: ("row", column) for key, column in grid.table.items()}
        columns = {"number": np.array(places) + 1, **self._columns(places)}
        variables = {}
        for name, values in columns.items():
            told = self._index.described.get(name)
            attributes = {} if told is None else {"units": told.units, "long_name": told.long_name}
            variables[name] = (dims, values.reshape(shape), attributes)
        return xarray.Dataset(variables, coordinates, {"title": self.spec.title, "status": self.status})

    def __repr__(self) -> str:
        return f"<Study of {len(self.points)} runs, {self.status}, {self.folder}>"
