"""Makes the index of a study out of its archives."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import TYPE_CHECKING

from mbdkit.archive.layout import COUNTERS, TIMINGS
from mbdkit.archive.reader import load
from mbdkit.spec.study_spec import ERRORS, StudySpec
from mbdkit.studies.index import Index, Row, quartiles
from mbdkit.studies.ledger import Ledger
from mbdkit.studies.measures import MEASURES, worst_joint
from mbdkit.studies.plan import PlannedPoint

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


def collect(
    spec: StudySpec,
    points: Sequence[PlannedPoint],
    ledger: Ledger,
    repeats: Mapping[str, Sequence[float]],
) -> Index:
    """Return the index of what is in the folder now.

    Parameters
    ----------
    spec
        The study.
    points
        All of its points.
    ledger
        What is known of their runs; rows are taken from it where the files have not changed.
    repeats
        New serial timings by run id, s.
    """
    compared = any(point.reference for point in points)
    wanted = MEASURES if spec.measures == "all" else spec.measures
    collector = _Collector(
        ledger,
        [name for name in wanted if compared or name not in ERRORS],
        repeats,
        any(point.grid.repeats > 1 for point in points),
    )
    rows: dict[tuple[str, str], Row] = {}
    for point in points:
        key = point.run_id, point.reference_id
        if key not in rows:
            rows[key] = collector.row(*key)
    references = dict.fromkeys(point.reference_id for point in points if point.reference_id)
    return Index(
        spec.canonical_json(),
        spec.sha256(),
        version("mbdkit"),
        tuple(replace(rows[p.run_id, p.reference_id], family=p.family, axes=p.axes) for p in points),
        tuple(collector.row(run_id, "") for run_id in references),
    )


class _Collector:
    def __init__(self, ledger: Ledger, measures: Sequence[str], repeats: Mapping[str, Sequence[float]], timed: bool):
        self.ledger, self.measures, self.repeats, self.timed = ledger, measures, repeats, timed

    def row(self, run_id: str, reference_id: str) -> Row:
        """Return the row of a run, its family and axes left out."""
        path = self.ledger.folder.archive(run_id)
        outcome = self.ledger.outcome(run_id)
        known = self.ledger.measured(run_id, reference_id)
        if known is not None:
            row = known
        elif outcome.status == "missing" or not path.exists():
            columns = (*self.measures, *COUNTERS, *TIMINGS)
            row = Row(run_id, outcome.status, outcome.reason, values=dict.fromkeys(columns, math.nan))
        else:
            row = replace(self.measured(run_id, reference_id), modified=path.stat().st_mtime)
        seconds = tuple(self.repeats.get(run_id) or self.ledger.repeats(run_id))
        values = {**row.values, **quartiles(seconds)} if self.timed else row.values
        return replace(row, reference_id=reference_id, values=values, repeats=seconds)

    def measured(self, run_id: str, reference_id: str) -> Row:
        """Return the row of an archive."""
        folder = self.ledger.folder
        with load(folder.archive(run_id)) as run:
            if reference_id and self.ledger.outcome(reference_id).status == "complete":
                with load(folder.archive(reference_id)) as reference:
                    values = self.values(run, reference)
            else:
                values = self.values(run, None)
            return Row(
                run_id,
                run.status,
                run.status_reason,
                worst_joint=worst_joint(run),
                data_sha256=run.data_sha256,
                values=values,
            )

    def values(self, run: Run, reference: Run | None) -> dict[str, float]:
        taken = {name: MEASURES[name].take(run, reference) for name in self.measures}
        return taken | {name: float(run.stats.get(name, math.nan)) for name in (*COUNTERS, *TIMINGS)}
