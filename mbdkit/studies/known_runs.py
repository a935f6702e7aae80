"""What is known of the files with the runs of a study: from the index of an earlier call, from the files, and from the
workers.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from contextlib import suppress
from importlib.metadata import version
from typing import Generic, TypeVar

from mbdkit.archive.fingerprint import data_sha256
from mbdkit.archive.hdf5_errors import DAMAGE
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.untrusted_file import is_sparse
from mbdkit.base.errors import ResourceError, SpecError
from mbdkit.runs.integrals import functionals_of
from mbdkit.spec import RunSpec
from mbdkit.spec.study_measures import expressions_of
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies import study_index
from mbdkit.studies.study_folder import StudyFolder
from mbdkit.studies.study_index import Index, Row
from mbdkit.studies.tasks import Outcome

MISSING = Outcome("missing", "")

Key = TypeVar("Key", str, int)


class KnownFiles(ABC, Generic[Key]):
    """Outcomes of the files with the runs of a study, which are read unless they are the ones that were indexed.

    The key of a file is the run id in an archive, and the number of a block.
    """

    def __init__(self, spec: StudySpec, folder: StudyFolder):
        self.spec, self.folder = spec, folder
        self._outcomes: dict[Key, Outcome] = {}
        self._before: Index | None = None
        with suppress(SpecError, ResourceError):  # without a valid index, the files are read instead
            before = study_index.read(folder.index)
            if before.study_sha256 == spec.sha256() and before.version == version("mbdkit"):
                self._before = before

    def missing(self, keys: Iterable[Key]) -> list[Key]:
        """Return the keys of the files that are to be computed.

        They are looked at again for the index, because another shard, or a worker of an interrupted call, may still
        write them.

        Raises
        ------
        SpecError
            If a file contains other runs.
        """
        missing = [key for key in keys if not self.outcome(key).is_final]
        for key in missing:
            self.forget(key)
        return missing

    def outcome(self, key: Key) -> Outcome:
        """Return the outcome of a file; ``missing`` if it is not there, or has to be computed again.

        Raises
        ------
        SpecError
            If it contains other runs.
        """
        if key not in self._outcomes:
            self._outcomes[key] = self.indexed(key) or self.read(key)
        return self._outcomes[key]

    def note(self, key: Key, outcome: Outcome) -> None:
        """Record the outcome of a file that was computed just now."""
        self.forget(key)
        self._outcomes[key] = outcome if outcome.status in ("complete", "failed", "missing") else MISSING

    def forget(self, key: Key) -> None:
        """Discard what was read of a file."""
        self._outcomes.pop(key, None)

    @abstractmethod
    def indexed(self, key: Key) -> Outcome | None:
        """Return the outcome of a file that has not changed since it was indexed; None for others."""

    @abstractmethod
    def read(self, key: Key) -> Outcome:
        """Return the outcome from a file; ``missing`` if it is damaged, or its runs have not ended."""


class KnownRuns(KnownFiles[str]):
    """Outcomes of the archives of a study.

    Parameters
    ----------
    runs
        Specs of all its runs by run id.
    """

    def __init__(self, spec: StudySpec, folder: StudyFolder, runs: Mapping[str, RunSpec]):
        super().__init__(spec, folder)
        self.runs = runs
        self._measures = expressions_of(spec.defined_measures())
        self._hashes: dict[str, str] = {}
        rows: list[Row] = []
        if (before := self._before) is not None:
            rows = [before.row(index, of_references=True) for index in range(len(before.references["status"]))]
            rows += [before.row(index) for index in range(len(before))]
        self._by_run: Mapping[str, Row] = {row.run_id: row for row in rows}
        self._measured: Mapping[tuple[str, str], Row] = {(row.run_id, row.reference_id): row for row in rows}

    def is_unchanged(self, run_id: str) -> bool:
        """Return whether the archive of a run has the same bytes as when it was indexed."""
        row = self._by_run.get(run_id)
        return row is not None and bool(row.file_sha256) and row.file_sha256 == self.file_sha256(run_id)

    def file_sha256(self, run_id: str) -> str:
        """Return the SHA-256 of the bytes of the archive of a run; empty if it cannot be read."""
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

    def repeats(self, run_id: str) -> tuple[float, ...]:
        """Return the serial timings of a run from earlier calls [s]."""
        return self._by_run[run_id].repeats if run_id in self._by_run else ()

    def run_twice(self, run_id: str) -> Row | None:
        """Return the row of a run with a second run, if its archive is unchanged since then; else None."""
        return self._by_run[run_id] if self.is_unchanged(run_id) and self._by_run[run_id].second_run else None

    def measured(self, run_id: str, reference_id: str) -> Row | None:
        """Return the indexed row of a run if its archive and that of its reference are unchanged; else None.

        Rows of the index formats before 1.2, which have no verdict, are not used.
        """
        row = self._measured.get((run_id, reference_id))
        unchanged = all(self.is_unchanged(name) for name in (run_id, reference_id) if name)
        return row if unchanged and row is not None and row.verdict else None

    def forget(self, key: str) -> None:
        """See `KnownFiles.forget`."""
        super().forget(key)
        self._hashes.pop(key, None)

    def indexed(self, key: str) -> Outcome | None:
        """See `KnownFiles.indexed`."""
        row = self._by_run.get(key)
        if row is None:
            return None
        is_refused = row.status_reason.startswith("wrong-input")  # invalid input leaves no archive
        is_known = self.is_unchanged(key) or (is_refused and not self.folder.archive(key).exists())
        return Outcome(row.status, row.status_reason) if is_known else None

    def read(self, key: str) -> Outcome:
        """See `KnownFiles.read`."""
        path = self.folder.archive(key)
        try:
            run = load(path)
        except (SpecError, ResourceError):
            return MISSING
        with run:
            if run.run_id != key or run.spec_sha256 != self.runs[key].sha256():
                raise SpecError(
                    "this archive contains another run than its name says; move it to another folder", file=path
                )
            try:
                sound = data_sha256(run.file) == run.data_sha256
            except DAMAGE:
                sound = False
            ended = run.status in ("complete", "failed") and self._has_integrals(run)
            return Outcome(run.status, run.status_reason) if sound and ended else MISSING

    def _has_integrals(self, run: Run) -> bool:
        """Return whether a run has the time integrals that the measures of the study need."""
        needed = {one.text for one in functionals_of(self.runs[run.run_id], self._measures)}
        return needed <= run.integrals.keys()
