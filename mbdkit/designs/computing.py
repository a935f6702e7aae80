"""Computes jobs of a design: in this process and, if they take long, in worker processes or by an executor."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from mbdkit.base.errors import ResourceError, RunError
from mbdkit.designs.evaluation import Job, Outcome, ScenarioRuns, in_this_process
from mbdkit.engine.jit.lane_width import WIDTH
from mbdkit.runs.batch import CHUNK
from mbdkit.spec import DesignSpec, InverseSpec
from mbdkit.studies.executor_pool import Engine
from mbdkit.studies.tasks import PASSING
from mbdkit.studies.tasks import Outcome as TaskOutcome

PATIENCE = 5.0
"""Computing time in this process after which worker processes are started [s]; starting one takes about two seconds."""


@dataclass(frozen=True)
class JobTask:
    """A task for a worker: some jobs of one scenario.

    Parameters
    ----------
    scenario
        Description of the scenario for the worker.
    path
        File in the folder of the design, which the workers of executors must see.
    tried
        Whether the first process that tried it died.
    """

    scenario: dict[str, Any]
    jobs: tuple[Job, ...]
    path: Path
    tried: bool = False
    writes = False

    def message(self) -> dict[str, Any]:
        """Return the message with which a worker can carry out the task."""
        settings = [[[list(path), value] for path, value in job.settings] for job in self.jobs]
        return {**self.scenario, "settings": settings, "path": str(self.path.absolute())}

    def after_death(self, how: str) -> JobTask | None:
        """Return the task to try after a process has died in this one; None if it is not tried again."""
        return None if self.tried else replace(self, tried=True)


class Computer:
    """Computes jobs of a design; a context manager that ends its processes.

    Parameters
    ----------
    spec
        The design.
    engine
        Worker processes, or an executor. Processes of this machine are used when jobs have taken `PATIENCE` seconds.
    notify
        Called once with each distinct message of the workers.
    place
        A file in a folder that the workers of executors see.
    """

    def __init__(self, spec: DesignSpec, engine: Engine, notify: Callable[[str], None], place: Path):
        self._spec, self._engine, self._notify, self._place = spec, engine, notify, place
        self._here = in_this_process({name: ScenarioRuns(one) for name, one in spec.specs.items()})
        self._spent = 0.0
        self._pool: Any = None
        self._stack = ExitStack()

    def __call__(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Outcome]]:
        """Yield each job with its outcome when it is computed.

        Raises
        ------
        ResourceError
            If a resource is lacking, such as disk space, or the system refuses all processes.
        RunError
            If a worker fails for other reasons than those of a run.
        """
        waiting = [piece for name in self._spec.specs for piece in self._pieces(name, jobs)]
        while waiting and not self._uses_workers:
            piece = waiting.pop(0)
            begin = time.perf_counter()
            outcomes = self._here(piece)
            self._spent += time.perf_counter() - begin
            yield from zip(piece, outcomes, strict=True)
        if waiting:
            yield from self._by_workers(waiting)

    @property
    def _uses_workers(self) -> bool:
        engine = self._engine
        return engine.executor is not None or (engine.workers > 1 and self._spent >= PATIENCE)

    def _pieces(self, scenario: str, jobs: Sequence[Job]) -> list[tuple[Job, ...]]:
        """Return the jobs of a scenario in groups that are computed and stored together."""
        own = [job for job in jobs if job.scenario == scenario]
        if isinstance(self._spec.specs[scenario], InverseSpec):
            size = 1
        elif self._engine.executor is not None:  # for an unknown number of processes
            size = WIDTH
        else:
            size = min(CHUNK, math.ceil(len(own) * len(self._spec.specs) / self._engine.workers))
        return [tuple(own[first : first + size]) for first in range(0, len(own), max(1, size))]

    def _by_workers(self, pieces: Sequence[tuple[Job, ...]]) -> Iterator[tuple[Job, Outcome]]:
        if self._pool is None:
            self._pool = self._stack.enter_context(self._engine.pool(self._notify))
        tasks = [JobTask(self._scenario(piece[0].scenario), piece, self._place) for piece in pieces]
        while tasks:
            again: list[JobTask] = []
            for task, outcome in self._pool.work(tasks):
                if outcome.status == "complete":
                    yield from zip(task.jobs, map(told, outcome.results), strict=True)
                elif (
                    _is_death(outcome) and len(task.jobs) > 1
                ):  # one by one, to one by one, to find the job that kills processes
                    again += [replace(task, jobs=(job,), tried=False) for job in task.jobs]
                elif _is_death(outcome):
                    count = len(self._spec.goals) + len(self._spec.subject_to)
                    yield task.jobs[0], Outcome((math.nan,) * count, "failed", outcome.reason)
                else:
                    raise (ResourceError if outcome.status == "missing" else RunError)(outcome.reason)
            tasks = again

    def _scenario(self, name: str) -> dict[str, Any]:
        spec = self._spec.specs[name]
        assert spec._document is not None
        kind, folder = "inverse" if isinstance(spec, InverseSpec) else "run", spec._document.folder.absolute()
        return {"spec": spec._document.data, "kind": kind, "folder": str(folder)}

    def __enter__(self) -> Computer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()


def _is_death(outcome: TaskOutcome) -> bool:
    return outcome.reason.startswith("worker-died")


def is_passing(outcome: Outcome) -> bool:
    """Return whether the cause of a failure is external, so that the next call tries again."""
    return outcome.reason.startswith(PASSING)


def plain_outcome(outcome: Outcome) -> dict[str, Any]:
    """Return an outcome as plain data; unknown numbers are None."""
    values = [value if math.isfinite(value) else None for value in outcome.values]
    return {"values": values, "verdict": outcome.verdict, "reason": outcome.reason}


def told(data: dict[str, Any]) -> Outcome:
    """Return the outcome from plain data."""
    values = tuple(math.nan if value is None else float(value) for value in data["values"])
    return Outcome(values, str(data["verdict"]), str(data["reason"]))
