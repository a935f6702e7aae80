"""Computes jobs of a design: in this process and, if they take long, in worker processes, or by an executor."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mbdkit.base.errors import ResourceError, RunError
from mbdkit.engine.native.levels import WIDTH
from mbdkit.spec.run_spec import RunSpec
from mbdkit_design.design_spec import DesignSpec
from mbdkit_design.evaluation import Job, Outcome, ScenarioRuns, in_this_process
from mbdkit_studies import Batches, Engine, Task

#: Computing time in this process [s] after which worker processes are started; starting one takes about two seconds.
PATIENCE = 5.0


class Computer:
    """Computes jobs of a design; a context manager that ends its processes.

    Parameters
    ----------
    spec
        The design.
    engine
        Worker processes, or an executor. Worker processes of this machine are used only after jobs in this process have
        taken `PATIENCE` seconds in total; an executor computes all jobs.
    notify
        Called with each message of the workers, unless it differs from an earlier one only in numbers.
    place
        Path of a file in a folder to which the workers of executors have access.
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
            If a resource, such as memory, is not available, or the system refuses to start processes.
        RunError
            If a worker fails for a reason other than a failed run.
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
        """Return the jobs of a scenario in groups; the jobs of a group are computed together."""
        own = [job for job in jobs if job.scenario == scenario]
        if not isinstance(self._spec.specs[scenario], RunSpec):
            size = 1
        elif self._engine.executor is not None:  # the number of processes of an executor is unknown
            size = WIDTH
        else:
            size = min(Batches.SIZE, math.ceil(len(own) * len(self._spec.specs) / self._engine.workers))
        return [tuple(own[first : first + size]) for first in range(0, len(own), max(1, size))]

    def _by_workers(self, pieces: Sequence[tuple[Job, ...]]) -> Iterator[tuple[Job, Outcome]]:
        if self._pool is None:
            self._pool = self._stack.enter_context(self._engine.pool(self._notify))
        tasks = [self._task(piece) for piece in pieces]
        while tasks:
            again: list[Task] = []
            for task, outcome in self._pool.work(tasks):
                is_death = outcome.reason.startswith("worker-died")
                if outcome.status == "complete":
                    yield from zip(task.key, map(outcome_of, outcome.results), strict=True)
                # the jobs are computed again one by one, to find the job that kills processes
                elif is_death and len(task.key) > 1:
                    again += [self._task((job,)) for job in task.key]
                elif is_death:
                    count = len(self._spec.goals) + len(self._spec.subject_to)
                    yield task.key[0], Outcome((math.nan,) * count, "failed", outcome.reason)
                else:
                    raise (ResourceError if outcome.status == "missing" else RunError)(outcome.reason)
            tasks = again

    def _task(self, jobs: tuple[Job, ...]) -> Task:
        """Return the task for a worker to compute some jobs of one scenario."""
        spec = self._spec.specs[jobs[0].scenario]
        assert spec._document is not None
        content = {
            "spec": spec._document.data,
            "folder": str(spec._document.folder.absolute()),
            "settings": [[[list(path), value] for path, value in job.settings] for job in jobs],
        }
        return Task(jobs, content, self._place, len(jobs), writes=False)

    def __enter__(self) -> Computer:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def plain_outcome(outcome: Outcome) -> dict[str, Any]:
    """Return an outcome as plain data; unknown numbers are None."""
    values, errors = (
        [value if math.isfinite(value) else None for value in some] for some in (outcome.values, outcome.errors)
    )
    plain: dict[str, Any] = {"values": values, "verdict": outcome.verdict, "reason": outcome.reason}
    return plain | ({"errors": errors} if errors else {})


def outcome_of(data: dict[str, Any]) -> Outcome:
    """Return the outcome from plain data."""
    values, errors = (
        tuple(math.nan if value is None else float(value) for value in some)
        for some in (data["values"], data.get("errors", ()))
    )
    return Outcome(values, str(data["verdict"]), str(data["reason"]), errors)
