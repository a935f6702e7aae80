"""A task for a worker as plain data (a run, a block of runs, points of a design), and its outcome."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

from mbdkit.base.called_functions import may_call
from mbdkit.base.terminal import command_words

Message: TypeAlias = dict[str, Any]  #: A task for a worker, or its answer, as plain data that JSON can contain.

#: External reasons of failure: a resource was not available, a process died or was stopped, or mbdkit has a defect.
PASSING = ("no-resources", "worker-died", "interrupted", "error")

#: Status of a block in which a run that was computed twice has different results, which ends the study.
DIFFERS = "differs"

#: Reasons of failure after which a run is computed again, because a second attempt may succeed.
TRIED_AGAIN = ("plugin-error", *PASSING)

#: Largest number of processes that may die in one task; after more deaths, the task is not tried again.
MOST_DEATHS = 20


@dataclass(frozen=True)
class Task:
    """A task for a worker.

    Parameters
    ----------
    key
        What the task computes: a run id, the number of a block, or the jobs of a design.
    content
        The message from which a worker can carry out the task, except for `path` and `skip`, which `message` adds.
    path
        File that the task writes, or another file in the same folder. The workers of executors must have access to this
        folder.
    runs
        Number of runs.
    writes
        Whether the task writes the file.
    deaths
        Number of processes that died while they computed a run of a block, by number of the run. The key 0 counts
        processes that died at other times or in other tasks.
    skip
        Reasons for which runs of a block are recorded as failed without being computed, by number of the run.
    """

    key: Any
    content: Mapping[str, Any]
    path: Path
    runs: int = 1
    writes: bool = True
    deaths: Mapping[int, int] = field(default_factory=dict)
    skip: Mapping[int, str] = field(default_factory=dict)

    def message(self) -> Message:
        """Return the message from which a worker can carry out the task, with the command line of this process, and
        whether functions that specs name may be called.
        """
        skip = {str(run): reason for run, reason in self.skip.items()}
        own = {"path": str(self.path.absolute()), "skip": skip, "command": command_words(), "call": may_call()}
        return {**self.content, **own}

    def after_death(self, how: str) -> Task | None:
        """Return the task to try after a process died in this task; None if it is not tried again.

        `how` describes how the process died. A run of a block in which two processes died is left out of the new task.
        """
        run = run_at_work(self.path) or 0
        deaths = {**self.deaths, run: self.deaths.get(run, 0) + 1}
        if sum(deaths.values()) > MOST_DEATHS or deaths.get(0, 0) > 1:
            return None
        skip = {**self.skip, run: died(how)} if run and deaths[run] > 1 else self.skip
        return replace(self, deaths=deaths, skip=skip)


def mark_of(block: Path) -> Path:
    """Return the path of the file that contains the number of the run in progress while a block is computed."""
    return block.with_name(f".{block.stem}.at")


def run_at_work(block: Path) -> int | None:
    """Return the number of the run that a process was computing when it died in a block; None if there is none."""
    try:
        return int(mark_of(block).read_bytes()[:8])
    except (OSError, ValueError):
        return None


def forget_run_at_work(block: Path) -> None:
    """Empty the file with the number of the run in progress; it is not removed, because a process may hold a lock on
    it.
    """
    with contextlib.suppress(OSError):
        os.truncate(mark_of(block), 0)


@dataclass(frozen=True)
class Outcome:
    """Result of a task: status of the run with the reason, wall times of repetitions [s], and measures of a second run.

    `results` are plain data of tasks of other kinds, such as the points of a design.
    """

    status: str
    reason: str
    seconds: tuple[float, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    results: tuple[Any, ...] = ()

    @classmethod
    def of(cls, answer: Message) -> Outcome:
        """Return the outcome from the answer of a worker."""
        values = {name: math.nan if value is None else value for name, value in answer.get("values", {}).items()}
        results = tuple(answer.get("results", ()))
        return cls(answer["status"], answer["reason"], tuple(answer.get("seconds", ())), values, results)

    @property
    def is_passing(self) -> bool:
        """Whether the cause of a failure is external, so that the next call tries again."""
        return self.reason.startswith(PASSING)

    @property
    def is_final(self) -> bool:
        """Whether the task is not to be tried again, because a second attempt would have the same result."""
        has_failed_for_good = self.status == "failed" and not self.reason.startswith(TRIED_AGAIN)
        return self.status in ("complete", "left-out") or has_failed_for_good


def died(how: str) -> str:
    """Return the reason of failure of a run in which two processes died; `how` describes the second death."""
    return f"worker-died: two processes that computed it died; the second one {how}."
