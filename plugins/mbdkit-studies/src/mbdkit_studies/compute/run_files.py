"""The runs of a study that stores one archive per run."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from mbdkit.archive.layout import COUNTERS, SOME_COUNTERS, TIMINGS
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.untrusted_file import is_sparse
from mbdkit.base.errors import ArchiveError, ResourceError, SpecError
from mbdkit.base.text import counted
from mbdkit.runs.integrals import functionals_of
from mbdkit.spec.run_spec import RunSpec
from mbdkit_studies.compute.run_store import MISSING, Round, RunStore
from mbdkit_studies.compute.tasks import Outcome, Task
from mbdkit_studies.folder.folder_lock import Shard
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.spec.measures import SECOND, numbers_of, worst_joint
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_studies.store.study_index import BETWEEN_REASONS, Index, Row, quartiles


class RunFiles(RunStore[str]):
    """Stores an archive for each run; the results of second runs and repeated timings are stored in the index.

    Second runs and timings are computed after the missing runs, and only by calls for the whole study, not for a shard.
    Timings are made one after another in a separate process of this machine.
    """

    def __init__(self, spec: StudySpec, folder: StudyFolder):
        super().__init__(spec, folder)
        self._planned = [point for point in self.plan.points if not point.lacking]
        references = {point.reference_id: point.reference for point in self._planned if point.reference is not None}
        #: Specs of the distinct runs by run id, references first.
        self._runs = references | {point.run_id: point.spec for point in self._planned}
        self.count = len(self._runs)
        self._defined = spec.defined_measures()
        self._is_timed = any(grid.repeats > 1 for grid in self.plan.points.grids)
        self._of_second_runs = [name for name in spec.built_in_measures or () if name in SECOND]
        #: Names of the numeric columns that are computed from every archive; checked runs have further columns.
        self._columns = (*self.plan.built_in, *(measure.name for measure in self._defined))
        self._columns += (*COUNTERS, *SOME_COUNTERS, *TIMINGS)
        self._hashes: dict[str, str] = {}
        #: The open reference run, by its id; runs of a family follow each other, and to open an archive takes long.
        self._compared: dict[str, Run] = {}

    def begin(self, shard: Shard | None, notify: Callable[[str], None]) -> int:
        """See `RunStore.begin`."""
        for name, count in Counter(point.lacking for point in self.plan.points if point.lacking).items():
            notify(f"{counted(count, 'run')} left out: the distribution {name} is not installed")
        before = self.index_before()
        rows = [] if before is None else before.rows()
        self._by_run = {row.run_id: row for row in rows}
        self._measured = {(row.run_id, row.reference_id): row for row in rows}
        self._timings = {row.run_id: row.repeats for row in rows}
        #: Results of second runs, of this call or for archives that have not changed since an earlier one.
        self._second = {
            row.run_id: Outcome("complete", row.second_run, values=row.values)
            for row in rows
            if row.second_run and self._is_unchanged(row.run_id)
        }
        missing = set(self.missing(self._runs))
        run_ids = [run_id for index, run_id in enumerate(self._runs) if shard is None or shard.has(index)]
        self._missing = [run_id for run_id in run_ids if run_id in missing]
        #: Runs that still need a second run; reference runs never do.
        self._again: list[str] = []
        self._turns: list[tuple[int, str]] = []
        if shard is None:
            wanted = dict.fromkeys(point.run_id for point in self._planned if self.spec.second_run_measures)
            self._again = [run_id for run_id in wanted if run_id not in self._second]
            # All runs are timed once before one is timed again: other work on the machine that lasts for many runs then
            # spreads the times of each run, and does not pass for a difference between runs.
            timings = dict.fromkeys(
                (turn, point.run_id)
                for point in self._planned
                if point.grid.repeats > 1
                for turn in range(len(self._timings.get(point.run_id, ())), point.grid.repeats)
            )
            self._turns = sorted(timings, key=lambda timing: timing[0])
        return len(self._missing) + len(self._again) + len(self._turns)

    def rounds(self) -> Iterator[Round]:
        """Yield the missing runs, then the second runs and the timings of complete runs."""
        runs = [self._task(run_id, measures=self.plan.expressions) for run_id in self._missing]
        yield Round(runs, len(runs))
        second = self.spec.second_run_measures
        again = [self._task(run_id, second=second) for run_id in self._again if self._is_complete(run_id)]
        yield Round(again, len(self._again))
        timings = [self._task(run_id, timing=turn) for turn, run_id in self._turns if self._is_complete(run_id)]
        yield Round(timings, len(self._turns), one_by_one=True)

    def _task(self, run_id: str, **content: object) -> Task:
        """Return the task that computes a run, with or without writing its archive."""
        spec = self._runs[run_id].canonical_json()
        return Task(run_id, {"spec": spec, **content}, self.folder.archive(run_id), writes="measures" in content)

    def _is_complete(self, run_id: str) -> bool:
        return self.outcome(run_id).status == "complete"

    def note(self, task: Task, outcome: Outcome) -> None:
        """See `RunStore.note`."""
        self.unfinished += [outcome.reason] if outcome.is_passing else []
        if "second" in task.content:
            self._second |= {} if outcome.is_passing else {task.key: outcome}
        elif "timing" in task.content:
            self._timings[task.key] = (*self._timings.get(task.key, ()), *outcome.seconds)
        else:
            self._second.pop(task.key, None)
            self.note_file(task.key, outcome)
            self.computed += 1
            self.failed += int(outcome.status == "failed" or outcome.is_passing)

    def index(self) -> Index:
        """Return the index of the archives that exist; rows of unchanged archives are copied from the previous
        index.
        """
        known: dict[tuple[str, str], Row] = {}
        rows = []
        for point in self.plan.points:
            if point.lacking:
                reason = f"not-installed: the distribution {point.lacking} is not installed."
                values = dict.fromkeys((*self._columns, *self._of_second_runs), math.nan)
                row = Row("", "left-out", reason, values=values)
            else:
                key = point.run_id, point.reference_id
                if key not in known:
                    known[key] = self._row(*key)
                row = known[key]
            rows.append(replace(row, family=point.family, axes=point.axes))
        self._close()
        references = dict.fromkeys(reference_id for _, reference_id in known if reference_id)
        return Index.of_rows(rows, [self._row(run_id, "") for run_id in references], self.plan.defined)

    def _row(self, run_id: str, reference_id: str) -> Row:
        """Return the row of a run, without its family and axes."""
        path, outcome = self.folder.archive(run_id), self.outcome(run_id)
        # A plugin that computes a measure may have changed since the previous index.
        use_plugins = any(measure.item is not None for measure in self._defined)
        row = self._measured.get((run_id, reference_id))
        is_unchanged = all(self._is_unchanged(name) for name in (run_id, reference_id) if name)
        if row is not None and (use_plugins or not row.verdict or not is_unchanged):
            row = None
        if row is None and outcome.status != "missing" and path.exists():
            is_compared = bool(reference_id) and self._is_complete(reference_id)
            sha256 = self._file_sha256(run_id)
            try:
                reference = self._opened(reference_id) if is_compared else None
                row = replace(self._row_of(path, reference, self._runs[run_id]), file_sha256=sha256)
            except (SpecError, ArchiveError, ResourceError) as error:  # the archive was damaged after it was computed
                outcome = Outcome("missing", f"error: {error}")
        row = row or Row(run_id, outcome.status, outcome.reason, values=dict.fromkeys(self._columns, math.nan))
        second, seconds = self._second.get(run_id, Outcome("", "")), self._timings.get(run_id, ())
        values = {**row.values, **{name: second.values.get(name, math.nan) for name in self._of_second_runs}}
        values |= quartiles(seconds) if self._is_timed else {}
        note = second.reason or second.status
        return replace(row, values=values, repeats=seconds, reference_id=reference_id, second_run=note)

    def _opened(self, run_id: str) -> Run:
        """Return an open reference run, after closing another one."""
        if run_id not in self._compared:
            self._close()
            self._compared[run_id] = load(self.folder.archive(run_id))
        return self._compared[run_id]

    def _close(self) -> None:
        for run in self._compared.values():
            run.close()
        self._compared.clear()

    def _row_of(self, archive: Path, reference: Run | None, spec: RunSpec) -> Row:
        """Return the row of a run, with values computed from its archive and from its reference run, if any.

        Raises
        ------
        SpecError, ResourceError
            If an archive cannot be read.
        """
        with load(archive) as run:
            values = numbers_of(run, reference, spec, self.plan.built_in, self._defined)
            values |= {name: float(run.stats.get(name, math.nan)) for name in TIMINGS}
            values |= {name: float(run.stats.get(name, 0)) for name in SOME_COUNTERS}
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

    def _is_unchanged(self, run_id: str) -> bool:
        """Return whether the archive of a run has the same bytes as when it was indexed."""
        row = self._by_run.get(run_id)
        return row is not None and bool(row.file_sha256) and row.file_sha256 == self._file_sha256(run_id)

    def _file_sha256(self, run_id: str) -> str:
        """Return the SHA-256 of the bytes of the archive of a run; empty if it is missing, sparse or unreadable."""
        if run_id not in self._hashes:
            path = self.folder.archive(run_id)
            try:
                if not path.is_file() or is_sparse(path):
                    return ""
                with path.open("rb") as file:
                    self._hashes[run_id] = hashlib.file_digest(file, "sha256").hexdigest()
            except OSError:
                return ""
        return self._hashes[run_id]

    def forget(self, key: str) -> None:
        """See `RunStore.forget`."""
        super().forget(key)
        self._hashes.pop(key, None)

    def read(self, key: str) -> Outcome:
        """See `RunStore.read`."""
        row, path = self._by_run.get(key), self.folder.archive(key)
        if row is not None:
            is_refused = row.status_reason.startswith("wrong-input")  # invalid input leaves no archive
            if self._is_unchanged(key) or (is_refused and not path.exists()):
                return Outcome(row.status, row.status_reason)
        try:
            run = load(path)
        except (SpecError, ArchiveError, ResourceError) as error:
            if isinstance(error, ArchiveError) and error.is_other_version:
                raise
            return MISSING
        with run:
            if run.run_id != key or run.spec_sha256 != self._runs[key].sha256():
                message = "this archive contains another run than its name says; move it to another folder"
                raise SpecError(message, file=path)
            try:
                sound = bool(run.file)  # all arrays are verified
            except ArchiveError:
                sound = False
            needed = {integral.text for integral in functionals_of(self._runs[key], self.plan.expressions)}
            ended = run.status in ("complete", "failed") and needed <= run.integrals.keys()
            return Outcome(run.status, run.status_reason) if sound and ended else MISSING
