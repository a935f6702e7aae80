"""Runs what is missing of a study, and writes its index."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import TYPE_CHECKING

from mbdkit.archive.check import check
from mbdkit.archive.layout import COUNTERS, TIMINGS
from mbdkit.archive.reader import load
from mbdkit.errors import SpecError
from mbdkit.spec import RunSpec
from mbdkit.spec.study_spec import ERRORS, StudySpec
from mbdkit.studies import index as table
from mbdkit.studies.folder import StudyFolder
from mbdkit.studies.index import Index, Row
from mbdkit.studies.measures import MEASURES, worst_joint
from mbdkit.studies.plan import outline
from mbdkit.studies.pool import Outcome, Pool, Task

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

#: Called with (runs done, runs to do, runs that failed).
Progress = Callable[[int, int, int], None]

#: Reasons that a second attempt may do away with.
PASSING = ("interrupted", "plugin-error", "worker-died", "error")


@dataclass(frozen=True)
class Shard:
    """One of several equal parts of a study.

    Parameters
    ----------
    number, count
        Which part, from 1, of how many: every run belongs to one of them, by its place in the list of all runs.
    """

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Return the part that was typed as ``2/3``.

        Raises
        ------
        SpecError
            If it is none.
        """
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise SpecError(f"a part of a study is written number/count, such as 1/2 and 2/2, not {text!r}")
        return cls(int(found[1]), int(found[2]))

    def has(self, place: int) -> bool:
        """Tell whether the run at this place, from 0, belongs to the part."""
        return place % self.count == self.number - 1


class Execution:
    """One call for a study in a folder.

    Parameters
    ----------
    spec
        The study.
    folder
        Where it goes; it may hold what earlier calls have done.

    Raises
    ------
    SpecError
        If a run of the study is wrong, or the folder is another study's; nothing has been done then.
    """

    def __init__(self, spec: StudySpec, folder: StudyFolder):
        self.spec, self.folder = spec, folder
        self.points = outline(spec)
        self.references: dict[str, RunSpec] = {}
        self.runs: dict[str, RunSpec] = {}
        self.reference_of: dict[int, str] = {}
        for point in self.points:
            run, reference = point.spec, point.reference
            self.runs[run.run_id()] = run
            if reference is not None:
                self.reference_of[point.number] = reference.run_id()
                self.references[reference.run_id()] = reference
        folder.check(spec)
        self.known = self._known_rows()
        self.computed = 0
        self.failures: dict[str, Outcome] = {}

    @property
    def every_run(self) -> dict[str, RunSpec]:
        """All different runs by id, references first: the errors of the others wait for them."""
        return self.references | self.runs

    def _known_rows(self) -> dict[str, Row]:
        """Return what an earlier call put in the index, by run id, if this version can rely on it."""
        try:
            before = table.read(self.folder.index)
        except SpecError:
            return {}
        if before.study_sha256 != self.spec.sha256() or before.version != version("mbdkit"):
            return {}
        return {row.run_id: row for row in (*before.references, *before.runs)}

    def is_unchanged(self, run_id: str) -> bool:
        """Tell whether the index knows the file of a run as it is now."""
        path = self.folder.archive(run_id)
        return run_id in self.known and path.exists() and path.stat().st_mtime == self.known[run_id].modified

    def is_done(self, run_id: str, spec: RunSpec) -> bool:
        """Tell whether a run need not be computed: it is complete, or failed for a reason that would come again.

        Raises
        ------
        SpecError
            If its file holds another run.
        """
        path = self.folder.archive(run_id)
        row = self.known.get(run_id)
        if not path.exists():
            return row is not None and row.reason.startswith("wrong-input")
        if row is not None and self.is_unchanged(run_id):
            return row.status == "complete" or not row.reason.startswith(PASSING)
        if check(path):
            return False
        with load(path) as run:
            if run.run_id != run_id or run.spec_sha256 != spec.sha256():
                raise SpecError("this archive holds another run than its name says; move it away", file=path)
            return run.status == "complete" or (run.status == "failed" and not run.status_reason.startswith(PASSING))

    def run(
        self, workers: int, progress: Progress | None, notify: Callable[[str], None], shard: Shard | None = None
    ) -> None:
        """Compute what is missing, time what is to be timed, write the index; on Ctrl-C write what there is."""
        self.folder.prepare(self.spec)
        with self.folder.locked(shared=shard is not None):
            mine = {
                run_id: spec
                for number, (run_id, spec) in enumerate(self.every_run.items())
                if shard is None or shard.has(number)
            }
            missing = {run_id: spec for run_id, spec in mine.items() if not self.is_done(run_id, spec)}
            repeats: dict[str, tuple[float, ...]] = {}
            try:
                self.compute(missing, workers, progress, notify)
                if shard is None:
                    self.time(repeats, notify)
            finally:
                with self.folder.indexing():
                    table.write(self.folder.index, self.collect(repeats))

    def compute(
        self,
        missing: Mapping[str, RunSpec],
        workers: int,
        progress: Progress | None,
        notify: Callable[[str], None],
    ) -> None:
        """Compute runs, several at a time."""
        names = {self.folder.archive(run_id): run_id for run_id in missing}
        tasks = [Task(spec, self.folder.archive(run_id)) for run_id, spec in missing.items()]
        with Pool(workers, notify) as pool:
            for task, outcome in pool.work(tasks):
                self.computed += 1
                if outcome.status == "failed":
                    self.failures[names[task.path]] = outcome
                if progress is not None:
                    progress(self.computed, len(tasks), len(self.failures))

    def time(self, repeats: dict[str, tuple[float, ...]], notify: Callable[[str], None]) -> None:
        """Time the complete runs of families that ask for it, one after the other."""
        wanted: dict[str, int] = {}
        for point in self.points:
            run_id, count = point.spec.run_id(), point.grid.repeats
            done = len(self.known[run_id].repeats) if run_id in self.known else 0
            if count > max(1, done) and self.status(run_id).status == "complete":
                wanted[run_id] = max(count, wanted.get(run_id, 0))
        names = {self.folder.archive(run_id): run_id for run_id in wanted}
        tasks = [Task(self.runs[run_id], self.folder.archive(run_id), count) for run_id, count in wanted.items()]
        with Pool(1, notify) as pool:
            for task, outcome in pool.work(tasks):
                repeats[names[task.path]] = outcome.seconds

    def status(self, run_id: str) -> Outcome:
        """Return how a run ended, by its file or by what the worker said; ``missing`` if it was not computed."""
        path = self.folder.archive(run_id)
        if run_id in self.failures and not path.exists():
            return self.failures[run_id]
        row = self.known.get(run_id)
        if not path.exists():
            return Outcome("failed", row.reason) if row and row.reason.startswith("wrong-input") else MISSING
        if row is not None and self.is_unchanged(run_id):
            return Outcome(row.status, row.reason)
        with load(path) as run:
            return Outcome(run.status, run.status_reason) if run.status in ("complete", "failed") else MISSING

    def collect(self, repeats: Mapping[str, tuple[float, ...]]) -> Index:
        """Return the index of what is in the folder now."""
        measured: dict[tuple[str, str], Row] = {}
        rows = []
        for point in self.points:
            run_id, reference_id = point.spec.run_id(), self.reference_of.get(point.number, "")
            if (run_id, reference_id) not in measured:
                measured[run_id, reference_id] = self.row(run_id, reference_id, repeats)
            row = measured[run_id, reference_id]
            rows.append(replace(row, family=point.family, axes=point.axes, reference_id=reference_id))
        references = [self.row(run_id, "", repeats) for run_id in self.references]
        return Index(self.spec.canonical_json(), self.spec.sha256(), version("mbdkit"), tuple(rows), tuple(references))

    def row(self, run_id: str, reference_id: str, repeats: Mapping[str, tuple[float, ...]]) -> Row:
        """Return the row of a run, from the index before where its files have not changed since."""
        outcome = self.status(run_id)
        path = self.folder.archive(run_id)
        before = self.known.get(run_id)
        timed = repeats.get(run_id) or (before.repeats if before else ())
        names = self.measures(bool(reference_id))
        if outcome.status == "missing" or not path.exists():
            columns = (*names, *COUNTERS, *TIMINGS)
            row = Row(run_id, outcome.status, outcome.reason, values=dict.fromkeys(columns, math.nan))
        elif (
            before is not None
            and before.reference_id == reference_id
            and self.is_unchanged(run_id)
            and (not reference_id or self.is_unchanged(reference_id))
        ):
            row = before
        else:
            has_reference = reference_id and self.folder.archive(reference_id).exists()
            with load(path) as run:
                if has_reference:
                    with load(self.folder.archive(reference_id)) as reference:
                        row = self.measure(run, reference, names)
                else:
                    row = self.measure(run, None, names)
            row = replace(row, modified=path.stat().st_mtime)
        if any(point.grid.repeats > 1 for point in self.points):
            row = replace(row, values={**row.values, **table.quartiles(timed)})
        return replace(row, repeats=timed)

    def measures(self, with_reference: bool) -> list[str]:
        """Return which measures are taken."""
        wanted = list(MEASURES) if self.spec.measures == "all" else list(self.spec.measures)
        return [name for name in wanted if name not in ERRORS or self.references]

    def measure(self, run: Run, reference: Run | None, names: Iterable[str]) -> Row:
        """Return the row of an archive."""
        values = {name: MEASURES[name].take(run, reference) for name in names}
        stats = {name: float(run.stats.get(name, math.nan)) for name in (*COUNTERS, *TIMINGS)}
        return Row(
            run.run_id,
            run.status,
            run.status_reason,
            worst_joint=worst_joint(run),
            data_sha256=run.data_sha256,
            values=values | stats,
        )


MISSING = Outcome("missing", "")
