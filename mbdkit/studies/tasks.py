"""Tasks of a study as plain data (a run, or a block of runs), and their outcomes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

from mbdkit.spec import RunSpec
from mbdkit.studies.study_folder import StudyFolder

#: External reasons of failure: a resource that is not available, a process that died, a defect of mbdkit.
PASSING = ("no-resources", "worker-died", "error")


@dataclass(frozen=True)
class Task:
    """A task for a worker.

    Parameters
    ----------
    repeats
        If not 0, no archive is written, and the run is timed this many times in memory after one warm-up run.
    second
        If not empty, no archive is written, and these measures are taken from a second run in memory.
    tried
        Whether the first process that tried it died.
    measures
        Expressions of the measures of the study, see `mbdkit.runs.simulation.simulate`.
    """

    spec: RunSpec
    path: Path
    repeats: int = 0
    second: tuple[str, ...] = ()
    tried: bool = False
    measures: tuple[str, ...] = ()

    @property
    def writes(self) -> bool:
        """Whether the archive of the run is written."""
        return not self.repeats and not self.second

    def message(self) -> dict[str, Any]:
        """Return the message with which a worker can carry out the task."""
        spec = json.loads(self.spec.canonical_json())
        return {
            "spec": spec,
            "path": str(self.path.absolute()),
            "repeats": self.repeats,
            "second": self.second,
            "measures": self.measures,
        }

    def after_death(self, how: str) -> Task | None:
        """Return the task to try after a process died in this one, as described by `how`; None if it is not tried
        again.
        """
        return None if self.tried else replace(self, tried=True)


@dataclass(frozen=True)
class BlockTask:
    """A task for a worker: a block of a study.

    Parameters
    ----------
    deaths
        Numbers of processes that died at a run, by its number; 0 for those that died between runs.
    skip
        Reasons for which runs are recorded as failed without being computed, by their number.
    """

    folder: StudyFolder
    block: int
    deaths: Mapping[int, int] = field(default_factory=dict)
    skip: Mapping[int, str] = field(default_factory=dict)
    writes = True

    @property
    def path(self) -> Path:
        """File of the block."""
        return self.folder.block(self.block)

    def message(self) -> dict[str, Any]:
        """Return the message with which a worker can carry out the task."""
        place, skip = str(self.folder.path.absolute()), {str(run): reason for run, reason in self.skip.items()}
        return {"folder": place, "block": self.block, "skip": skip, "path": str(self.path.absolute())}

    def after_death(self, how: str) -> BlockTask | None:
        """Return the task to try after a process died in this one; the second time, the run in progress is left out."""
        run = self.folder.run_at_work(self.block) or 0
        deaths = {**self.deaths, run: self.deaths.get(run, 0) + 1}
        if sum(deaths.values()) > MOST_DEATHS or deaths.get(0, 0) > 1:
            return None
        skip = dict(self.skip)
        if run and deaths[run] > 1:
            skip[run] = died(how)
        return replace(self, deaths=deaths, skip=skip)


@dataclass(frozen=True)
class Outcome:
    """Result of a task: status of the run, its reason, wall times of repeats [s], and measures of a second run.

    `results` are plain data of tasks of other kinds, such as the points of a design.
    """

    status: str
    reason: str
    seconds: tuple[float, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    results: tuple[Any, ...] = ()

    @classmethod
    def of(cls, answer: Mapping[str, Any]) -> Outcome:
        """Return the outcome from the answer of a worker."""
        values = {name: math.nan if found is None else found for name, found in answer.get("values", {}).items()}
        results = tuple(answer.get("results", ()))
        return cls(answer["status"], answer["reason"], tuple(answer.get("seconds", ())), values, results)

    @property
    def is_passing(self) -> bool:
        """Whether the cause of a failure is external, so that the next call tries again."""
        return self.reason.startswith(PASSING)


class AnyTask(Protocol):
    """The interface of tasks for a pool."""

    @property
    def path(self) -> Path:
        """File that it writes, or a file in the folder that it belongs to."""

    @property
    def writes(self) -> bool:
        """Whether it writes this file."""

    def message(self) -> dict[str, Any]:
        """Return the message with which a worker can carry it out."""

    def after_death(self, how: str) -> Self | None:
        """Return the task to try after a process died in this one, as described by `how`; None if it is not tried
        again.
        """


Work = TypeVar("Work", bound=AnyTask)

MOST_DEATHS = 20
"""Number of processes that may die in one block before it is not tried again."""


def died(how: str) -> str:
    """Return the reason of failure of a run in which two processes died, the second one as described by `how`."""
    return f"worker-died: two processes that computed it died; the second one {how}."
