"""Rows of the index of a study, computed from the archives of its runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mbdkit.archive.layout import COUNTERS, TIMINGS
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.measures.take import with_error
from mbdkit.spec import RunSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit_studies.measures import MEASURES, OF_CHECKED_RUNS, SECOND, RunGroup, worst_joint
from mbdkit_studies.planned_points import PlannedPoint
from mbdkit_studies.study_index import BETWEEN_REASONS, Row, quartiles
from mbdkit_studies.study_spec import StudySpec
from mbdkit_studies.tasks import Outcome


@dataclass(frozen=True)
class ArchiveRows:
    """Creates the rows of the index of a study that stores an archive for each run.

    Parameters
    ----------
    measures
        Names of the built-in measures that are computed from archives.
    defined
        Measures that the study defines.
    again
        Names of the measures that need a second run.
    timed
        Whether runs are timed repeatedly.
    """

    measures: Sequence[str]
    defined: Sequence[DefinedMeasure]
    again: Sequence[str]
    timed: bool

    @classmethod
    def of(cls, spec: StudySpec, points: Sequence[PlannedPoint]) -> ArchiveRows:
        """Return an instance with the measures that the study requests for these points."""
        compared = any(point.grid.reference for point in points)
        wanted = tuple(MEASURES) if spec.built_in_measures is None else spec.built_in_measures
        return cls(
            [name for name in wanted if name in MEASURES and (compared or not MEASURES[name].needs)],
            spec.defined_measures(),
            [name for name in wanted if name in SECOND],
            any(point.grid.repeats > 1 for point in points),
        )

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the numeric columns that are computed from every archive; checked runs have further columns."""
        return *self.measures, *(measure.name for measure in self.defined), *COUNTERS, *TIMINGS

    @property
    def use_plugins(self) -> bool:
        """Whether a plugin computes one of the defined measures.

        Rows of the previous index are not reused in this case, because the plugin may have changed.
        """
        return any(measure.item is not None for measure in self.defined)

    def left_out(self, distribution: str) -> Row:
        """Return the row of a run that is left out because the required `distribution` is not installed."""
        reason = f"not-installed: the distribution {distribution} is not installed."
        return Row("", "left-out", reason, values=dict.fromkeys((*self.columns, *self.again), math.nan))

    def without_archive(self, run_id: str, outcome: Outcome) -> Row:
        """Return the row of a run that has no archive."""
        return Row(run_id, outcome.status, outcome.reason, values=dict.fromkeys(self.columns, math.nan))

    def row(self, archive: Path, reference: Path | None, spec: RunSpec) -> Row:
        """Return the row of a run, with values computed from its archive and from that of its reference run, if any.

        Raises
        ------
        SpecError, ResourceError
            If an archive cannot be read.
        """
        with load(archive) as run:
            if reference is None:
                values = self._values(run, None, spec)
            else:
                with load(reference) as compared:
                    values = self._values(run, compared, spec)
            return Row(
                run.run_id,
                run.status,
                run.status_reason,
                worst_joint=worst_joint(run),
                data_sha256=run.data_sha256,
                values=values,
                verdict=run.verdict,
                verdict_reasons=BETWEEN_REASONS.join(run.verdict_reasons),
            )

    def _values(self, run: Run, reference: Run | None, spec: RunSpec) -> dict[str, float]:
        group = RunGroup([run], reference)
        taken = {name: float(MEASURES[name].take(group)[0]) for name in self.measures}
        for measure in self.defined:
            taken |= with_error(measure, run, spec)
        if run.accuracy is not None:
            taken |= {name: float(measure.take(group)[0]) for name, measure in OF_CHECKED_RUNS.items()}
        return taken | {name: float(run.stats.get(name, math.nan)) for name in (*COUNTERS, *TIMINGS)}

    def with_second_run(self, row: Row, made: Outcome | None, before: Row | None) -> Row:
        """Return a row to which the measures that need a second run are added.

        The measures are taken from `made`, the outcome of the second run in this call. If this call has made no second
        run, or if the second run failed for an external reason, they are taken from `before`, the row of the run in the
        previous index.
        """
        if not self.again:
            return replace(row, second_run="")
        if made is not None and not made.is_passing:
            values, note = made.values, made.reason or made.status
        elif before is not None:
            values, note = before.values, before.second_run
        else:
            values, note = {}, ""
        second = {name: values.get(name, math.nan) for name in self.again}
        return replace(row, values={**row.values, **second}, second_run=note)

    def with_timings(self, row: Row, seconds: tuple[float, ...]) -> Row:
        """Return a row to which repeated timings [s] are added."""
        values = {**row.values, **quartiles(seconds)} if self.timed else row.values
        return replace(row, values=values, repeats=seconds)
