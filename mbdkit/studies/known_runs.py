"""State of the runs of a study, from the index of an earlier call, from their archives, and from the workers."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from importlib.metadata import version

from mbdkit.archive.fingerprint import data_sha256
from mbdkit.archive.hdf5_errors import DAMAGE
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.base.errors import ResourceError, SpecError
from mbdkit.runs.integrals import integrands_of
from mbdkit.spec import RunSpec
from mbdkit.spec.study_measures import expressions_of
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies import study_index
from mbdkit.studies.study_folder import StudyFolder
from mbdkit.studies.study_index import Row
from mbdkit.studies.tasks import PASSING, Outcome

#: Reasons of failure after which a run is computed again, because a second attempt may succeed.
TRIED_AGAIN = ("interrupted", "plugin-error", *PASSING)

MISSING = Outcome("missing", "")


class KnownRuns:
    """State of the runs in the folder of a study.

    Parameters
    ----------
    runs
        Specs of all its runs by run id.
    """

    def __init__(self, spec: StudySpec, folder: StudyFolder, runs: Mapping[str, RunSpec]):
        self.folder, self.runs = folder, runs
        self._measures = expressions_of(spec.defined_measures())
        self._outcomes: dict[str, Outcome] = {}
        self._hashes: dict[str, str] = {}
        rows: list[Row] = []
        try:
            before = study_index.read(folder.index)
        except (SpecError, ResourceError):
            pass  # without a valid index, the archives are read instead
        else:
            if before.study_sha256 == spec.sha256() and before.version == version("mbdkit"):
                count = len(before.references["status"])
                rows = [before.row(index, of_references=True) for index in range(count)]
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
            try:
                with self.folder.archive(run_id).open("rb") as file:
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

    def is_done(self, run_id: str) -> bool:
        """Return whether a run is complete, or has failed for a reason that would recur.

        Raises
        ------
        SpecError
            If its archive contains another run.
        """
        outcome = self.outcome(run_id)
        return outcome.status == "complete" or (
            outcome.status == "failed" and not outcome.reason.startswith(TRIED_AGAIN)
        )

    def outcome(self, run_id: str) -> Outcome:
        """Return the outcome of a run; ``missing`` if it has not ended.

        Raises
        ------
        SpecError
            If its archive contains another run.
        """
        if run_id not in self._outcomes:
            self._outcomes[run_id] = self._found(run_id)
        return self._outcomes[run_id]

    def note(self, run_id: str, outcome: Outcome | None) -> None:
        """Record the outcome of a run that was computed just now; None discards the recorded outcome."""
        self._hashes.pop(run_id, None)
        if outcome is None:
            self._outcomes.pop(run_id, None)
        else:
            self._outcomes[run_id] = outcome if outcome.status in ("complete", "failed", "missing") else MISSING

    def _found(self, run_id: str) -> Outcome:
        row = self._by_run.get(run_id)
        if self.folder.archive(run_id).exists():
            if row is None or not self.is_unchanged(run_id):
                return self._read(run_id)
        elif row is None or not row.status_reason.startswith("wrong-input"):  # invalid input leaves no archive
            return MISSING
        return Outcome(row.status, row.status_reason)

    def _read(self, run_id: str) -> Outcome:
        """Return the outcome from an archive; ``missing`` if the file is damaged or the run was interrupted."""
        path = self.folder.archive(run_id)
        try:
            run = load(path)
        except (SpecError, ResourceError):
            return MISSING
        with run:
            if run.run_id != run_id or run.spec_sha256 != self.runs[run_id].sha256():
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
        needed = {one.text for one in integrands_of(self.runs[run.run_id], self._measures)}
        return needed <= run.integrals.keys()
