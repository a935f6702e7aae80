"""Build the index of a study from its archives."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mbdkit.archive.layout import COUNTERS, TIMINGS
from mbdkit.archive.reader import load
from mbdkit.base.errors import ResourceError, SpecError
from mbdkit.measures.take import with_error
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies.known_runs import KnownRuns
from mbdkit.studies.measures import MEASURES, OF_CHECKED_RUNS, SECOND, RunGroup, worst_joint
from mbdkit.studies.study_index import Index, Row, quartiles
from mbdkit.studies.study_plan import StudyPlan
from mbdkit.studies.tasks import Outcome

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


def collect(
    spec: StudySpec,
    plan: StudyPlan,
    known_runs: KnownRuns,
    repeats: Mapping[str, Sequence[float]],
    second: Mapping[str, Outcome],
) -> Index:
    """Return the index of the current content of the folder.

    Parameters
    ----------
    plan
        All of its points, and what the measures are that it defines.
    known_runs
        State of the runs; rows of unchanged archives are taken from it.
    repeats
        New serial timings by run id, s.
    second
        Outcomes of new second runs by run id.
    """
    points = plan.points
    compared = any(point.grid.reference for point in points)
    wanted = tuple(MEASURES) if spec.built_in_measures is None else spec.built_in_measures
    collector = _Collector(
        known_runs,
        [name for name in wanted if name in MEASURES and (compared or not MEASURES[name].needs)],
        spec.defined_measures(),
        [name for name in wanted if name in SECOND],
        repeats,
        second,
        any(point.grid.repeats > 1 for point in points),
    )
    known: dict[tuple[str, str], Row] = {}
    rows = []
    for point in points:
        if point.lacking:
            row = collector.left_out(point.lacking)
        else:
            key = point.run_id, point.reference_id
            if key not in known:
                known[key] = collector.row(*key)
            row = known[key]
        rows.append(replace(row, family=point.family, axes=point.axes))
    references = dict.fromkeys(reference_id for _, reference_id in known if reference_id)
    return Index.of_rows(rows, [collector.row(run_id, "") for run_id in references], plan.defined)


@dataclass(frozen=True)
class _Collector:
    known_runs: KnownRuns
    measures: Sequence[str]
    defined: Sequence[DefinedMeasure]
    again: Sequence[str]
    repeats: Mapping[str, Sequence[float]]
    second: Mapping[str, Outcome]
    timed: bool

    @property
    def taken(self) -> tuple[str, ...]:
        """Names of the measures that are taken from archives."""
        return *self.measures, *(measure.name for measure in self.defined)

    @property
    def uses_plugins(self) -> bool:
        """Whether a measure is that of a plugin, which may have changed since the study was indexed."""
        return any(measure.item is not None for measure in self.defined)

    def left_out(self, distribution: str) -> Row:
        """Return the row of a run that is left out because a distribution is not installed."""
        columns = (*self.taken, *self.again, *COUNTERS, *TIMINGS)
        reason = f"not-installed: the distribution {distribution} is not installed."
        return Row("", "left-out", reason, values=dict.fromkeys(columns, math.nan))

    def row(self, run_id: str, reference_id: str) -> Row:
        """Return the row of a run without its family and axes."""
        path = self.known_runs.folder.archive(run_id)
        outcome = self.known_runs.outcome(run_id)
        known = None if self.uses_plugins else self.known_runs.measured(run_id, reference_id)
        if known is not None:
            row = known
        elif outcome.status == "missing" or not path.exists():
            row = self.without_archive(run_id, outcome)
        else:
            row = self.read(run_id, reference_id)
        seconds = tuple(self.repeats.get(run_id) or self.known_runs.repeats(run_id))
        values, second_run = self.with_second_run(run_id, row)
        values = {**values, **quartiles(seconds)} if self.timed else values
        return replace(row, reference_id=reference_id, values=values, repeats=seconds, second_run=second_run)

    def with_second_run(self, run_id: str, row: Row) -> tuple[Mapping[str, float], str]:
        """Return the values of a row with the measures of its second run, and the outcome of that run."""
        if not self.again:
            return row.values, ""
        made, before = self.second.get(run_id), self.known_runs.run_twice(run_id)
        values: Mapping[str, float] = {}
        note = ""
        if made is not None and not made.is_passing:
            values, note = made.values, made.reason or made.status
        elif before is not None:
            values, note = before.values, before.second_run
        return {**row.values, **{name: values.get(name, math.nan) for name in self.again}}, note

    def read(self, run_id: str, reference_id: str) -> Row:
        """Return the row of a run from its archive; `missing` if the archive was damaged after it was computed."""
        sha256 = self.known_runs.file_sha256(run_id)
        try:
            return replace(self.measured(run_id, reference_id), file_sha256=sha256)
        except (SpecError, ResourceError) as error:
            return self.without_archive(run_id, Outcome("missing", f"error: {error}"))

    def without_archive(self, run_id: str, outcome: Outcome) -> Row:
        """Return the row of a run that has no archive."""
        columns = (*self.taken, *COUNTERS, *TIMINGS)
        return Row(run_id, outcome.status, outcome.reason, values=dict.fromkeys(columns, math.nan))

    def measured(self, run_id: str, reference_id: str) -> Row:
        """Return the row of a run with values computed from its archive."""
        folder = self.known_runs.folder
        with load(folder.archive(run_id)) as run:
            if reference_id and self.known_runs.outcome(reference_id).status == "complete":
                with load(folder.archive(reference_id)) as reference:
                    values = self.values(run, reference, run_id)
            else:
                values = self.values(run, None, run_id)
            return Row(
                run_id,
                run.status,
                run.status_reason,
                worst_joint=worst_joint(run),
                data_sha256=run.data_sha256,
                values=values,
                verdict=run.verdict,
                verdict_reasons=" ".join(run.verdict_reasons),
            )

    def values(self, run: Run, reference: Run | None, run_id: str) -> dict[str, float]:
        group = RunGroup([run], reference)
        taken = {name: float(MEASURES[name].take(group)[0]) for name in self.measures}
        for measure in self.defined:
            taken |= with_error(measure, run, self.known_runs.runs[run_id])
        if run.accuracy is not None:
            taken |= {name: float(measure.take(group)[0]) for name, measure in OF_CHECKED_RUNS.items()}
        return taken | {name: float(run.stats.get(name, math.nan)) for name in (*COUNTERS, *TIMINGS)}
