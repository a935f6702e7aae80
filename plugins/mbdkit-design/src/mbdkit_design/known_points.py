"""Points of a design, stored in memory and in a file from which the next call continues."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from zlib import crc32

import numpy as np
from pydantic import BeforeValidator

from mbdkit.base.errors import SpecError, file_error
from mbdkit.base.files import check_regular, replacing
from mbdkit.base.text import counted, shown
from mbdkit_design.computing import outcome_of, plain_outcome
from mbdkit_design.evaluation import Evaluator, Job, Outcome
from mbdkit_studies import PASSING

#: A number; stored results have null in place of nan.
Stored = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]

Notify = Callable[[str], None]  #: Function that receives a sentence for the user.


@dataclass(frozen=True)
class DesignPoint:
    """Values of the variables and the results for them.

    Attributes
    ----------
    variables
        Values of the variables by name.
    goals
        Goals by name, summed over the scenarios by their weights.
    measures
        Goals and limits by name, for each scenario. The name of the scenario is empty if there is only the base.
    """

    variables: dict[str, Stored]
    goals: dict[str, Stored]
    measures: dict[str, dict[str, Stored]]


def point_of(evaluator: Evaluator, x: np.ndarray) -> DesignPoint:
    """Return the point at these shares (n,) of the bounds."""
    values, goals = evaluator.values(x[None])[0], evaluator.totals(x)
    return DesignPoint(
        variables=evaluator.variables(x),
        goals=dict(zip(evaluator.spec.totals, goals.tolist(), strict=True)),
        measures={
            name: dict(zip(evaluator.names, row.tolist(), strict=True))
            for name, row in zip(evaluator.spec.situations, values, strict=True)
        },
    )


def read_versioned(text: str | bytes, name: str, path: Path) -> dict[str, Any]:
    """Return data that begin with a format version under this name; an empty mapping if the text contains something
    else.

    Raises
    ------
    SpecError
        If the version is later than 1.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    version = data.get(name) if isinstance(data, dict) else None
    if isinstance(version, int) and version > 1:
        message = f"this file has format version {version}, this mbdkit reads 1; install a later version of mbdkit"
        raise SpecError(message, file=path)
    return data if version == 1 else {}


#: Exceptions that occur if the data that are read are not those of a design.
NOT_READ = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)

VERSION = "mbdkit_points"  #: Name of the format version in the first line of the file.
FIRST = json.dumps({VERSION: 1}).encode()
#: Name of the check sum of a line. It is computed from the JSON text of the line without the check sum.
SUM = "crc32"

Compute = Callable[[Sequence[Job]], Iterator[tuple[Job, Outcome]]]


class PointFile:
    """A text file with a line of JSON for each evaluated scenario and point: ``points.jsonl``.

    The first line has the format version. Each further line has the ``scenario``, the ``settings`` of its keys, the
    ``values`` of goals and limits by name (null if the run failed), the ``verdict`` on the run, the ``reason`` if the
    run failed or is judged doubtful or bad, the ``errors`` of the values, in the same order, if they were estimated,
    and a check sum. Lines are appended, so that a killed process leaves at most one unfinished line. The next process
    removes unfinished and damaged lines, and computes their points again.

    Parameters
    ----------
    names
        Names of goals and limits, in order.
    notify
        Called with a sentence if lines are damaged.
    """

    def __init__(self, path: Path, names: Sequence[str], notify: Notify):
        self.path, self._names, self._notify = path, names, notify

    def read(self) -> dict[str, Outcome]:
        """Return the outcomes in the file by `Job.key`, after removing unfinished and damaged lines from the file.

        If there is no file, it is created.

        Raises
        ------
        SpecError
            If the file is not a list of points of this design, or was written by a later version of mbdkit.
        ResourceError
            If the system refuses to read or write the file.
        """
        try:
            if self.path.exists() and not self.path.is_dir():
                check_regular(self.path)
            text = self.path.read_bytes() if self.path.exists() else b""
        except OSError as error:
            raise _refused(error, self.path) from error
        first, *lines = text[: text.rfind(b"\n") + 1].split(b"\n")[:-1] or [FIRST]
        if not read_versioned(first, VERSION, self.path):
            hint = "replace the design in the folder with --overwrite"
            raise SpecError(f"this is not a list of evaluated points of this design; {hint}", file=self.path)
        known = {line: point for line in lines if (point := self._parsed(line)) is not None}
        if damaged := len(lines) - len(known):
            single, several = "is damaged and was removed; its run is", "are damaged and were removed; their runs are"
            which = single if damaged == 1 else several
            self._notify(f"{counted(damaged, 'line')} of {shown(self.path)} {which} made again")
        if (sound := b"".join(line + b"\n" for line in (first, *known))) != text:
            with replacing(self.path) as temporary:
                temporary.write_bytes(sound)
        return dict(known.values())

    def add(self, job: Job, outcome: Outcome) -> None:
        """Append a line; raise ResourceError if the system refuses to write it."""
        plain = plain_outcome(outcome)
        plain["values"] = dict(zip(self._names, plain["values"], strict=True))
        data = {"scenario": job.scenario, "settings": job.values, **plain}
        line = json.dumps(data | {SUM: crc32(json.dumps(data).encode())})
        try:
            with self.path.open("a", encoding="utf-8", newline="\n") as file:
                file.write(line + "\n")
        except OSError as error:
            raise _refused(error, self.path) from error

    def _parsed(self, line: bytes) -> tuple[str, Outcome] | None:
        """Return key and outcome of a line; None if it is damaged."""
        try:
            data: dict[str, Any] = json.loads(line)
            if data.pop(SUM) != crc32(json.dumps(data).encode()):
                return None
            values = [data["values"][name] for name in self._names]
            return json.dumps([data["scenario"], data["settings"]]), outcome_of(data | {"values": values})
        except NOT_READ:
            return None


class KnownPoints:
    """Source of outcomes of a design: known ones are looked up, others are computed and stored.

    Parameters
    ----------
    compute
        Function that computes jobs, and yields each when it is done.
    file
        File in which outcomes are stored; None if they are not stored.
    progress
        Called with the number of known outcomes, and the number of failures among them.
    """

    def __init__(
        self, compute: Compute, file: PointFile | None = None, progress: Callable[[int, int], None] | None = None
    ):
        self._compute, self._file, self._progress = compute, file, progress
        self._known = {} if file is None else file.read()
        self._failed = sum(outcome.verdict == "failed" for outcome in self._known.values())

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
            if self._file is not None and not outcome.reason.startswith(PASSING):
                self._file.add(job, outcome)
            if self._progress is not None:
                self._progress(self.count, self._failed)
        return [self._known[job.key] for job in jobs]


def _refused(error: OSError, path: Path) -> Exception:
    return file_error(error.errno, f"the points of the design cannot be stored: {error.strerror or error}", file=path)
