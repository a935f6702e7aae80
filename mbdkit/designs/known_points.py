"""The points that a design has evaluated: kept in memory, and in a file from which the next call goes on."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from mbdkit.designs.computing import is_passing, plain_outcome, told
from mbdkit.designs.evaluation import Job, Outcome
from mbdkit.errors import SpecError, file_error

FORMAT = {"mbdkit_points": 1}
"""First line of the file."""

Compute = Callable[[Sequence[Job]], Iterator[tuple[Job, Outcome]]]


class PointFile:
    """A text file with a line of JSON for each evaluated scenario and point: ``points.jsonl``.

    A line has the ``scenario``, the ``settings`` of its keys, the ``values`` of goals and limits by name (null if the
    run failed), the ``verdict`` on the run, and the ``reason`` of a failure. Lines are added at the end, so that a
    killed process leaves one unfinished line at most, which is removed by the next one.

    Parameters
    ----------
    names
        Names of goals and limits, in order.
    """

    def __init__(self, path: Path, names: Sequence[str]):
        self.path, self._names = path, names

    def read(self) -> dict[str, Outcome]:
        """Return the outcomes in the file by the key of their job, and make the file ready for more.

        Raises
        ------
        SpecError
            If the file is not one of these.
        ResourceError
            If the system refuses to read or write it.
        """
        try:
            text = self.path.read_bytes() if self.path.exists() else b""
            whole = text[: text.rfind(b"\n") + 1]
            if not whole:
                self.path.write_text(json.dumps(FORMAT) + "\n", encoding="utf-8")
            elif len(whole) < len(text):
                with self.path.open("r+b") as file:
                    file.truncate(len(whole))
        except OSError as error:
            raise _refused(error, self.path) from error
        first, *lines = whole.splitlines() or [json.dumps(FORMAT).encode()]
        try:
            if json.loads(first) != FORMAT:
                raise ValueError
            return dict(map(self._parsed, lines))
        except (ValueError, KeyError, TypeError, AttributeError):
            message = "this is not a list of evaluated points of this design; start the folder anew with --overwrite"
            raise SpecError(message, file=self.path) from None

    def add(self, job: Job, outcome: Outcome) -> None:
        """Add a line; raise ResourceError if the system refuses it."""
        told_of = plain_outcome(outcome)
        told_of["values"] = dict(zip(self._names, told_of["values"], strict=True))
        line = json.dumps({"scenario": job.scenario, "settings": job.values, **told_of})
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
        except OSError as error:
            raise _refused(error, self.path) from error

    def _parsed(self, line: bytes) -> tuple[str, Outcome]:
        data: dict[str, Any] = json.loads(line)
        values = [data["values"][name] for name in self._names]
        return json.dumps([data["scenario"], data["settings"]]), told(data | {"values": values})


class KnownPoints:
    """The source of outcomes of a design: those that are known, and others, which become known.

    Parameters
    ----------
    compute
        Computes jobs, and yields each when it is done.
    file
        Where outcomes are kept; None if they are not.
    progress
        Called with the number of known outcomes, and of failures among them.
    """

    def __init__(
        self, compute: Compute, file: PointFile | None = None, progress: Callable[[int, int], None] | None = None
    ):
        self._compute, self._file, self._progress = compute, file, progress
        self._known = {} if file is None else file.read()
        self._failed = sum(one.verdict == "failed" for one in self._known.values())

    @property
    def count(self) -> int:
        """Number of known outcomes."""
        return len(self._known)

    def __call__(self, jobs: Sequence[Job]) -> list[Outcome]:
        """Return the outcome of each job."""
        missing = {job.key: job for job in jobs if job.key not in self._known}
        for job, outcome in self._compute(list(missing.values())):
            self._known[job.key] = outcome
            self._failed += outcome.verdict == "failed"
            if self._file is not None and not is_passing(outcome):
                self._file.add(job, outcome)
            if self._progress is not None:
                self._progress(self.count, self._failed)
        return [self._known[job.key] for job in jobs]


def _refused(error: OSError, path: Path) -> Exception:
    return file_error(error.errno, f"the points of the design cannot be kept: {error.strerror or error}", file=path)
