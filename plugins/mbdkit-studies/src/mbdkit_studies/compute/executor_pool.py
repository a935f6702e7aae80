"""Computes the tasks of a study by an executor: processes of this machine, a Dask cluster, jobs of a scheduler."""

from __future__ import annotations

import math
import os
import queue
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from mbdkit.base.distributions import own_version
from mbdkit.base.errors import ResourceError, SpecError
from mbdkit.base.plain_data import value_text
from mbdkit.base.text import one_line
from mbdkit_studies.compute.executors import SubmititExecutor
from mbdkit_studies.compute.pool import PROGRAM, LocalProcesses, ProcessDiedError
from mbdkit_studies.compute.tasks import Message, Outcome, Task, died
from mbdkit_studies.texts import without_numbers

LOOK = 1.0  #: Interval between checks whether the client of a Dask cluster is closed [s].


@dataclass(frozen=True)
class Engine:
    """Settings for computing the tasks of a study.

    Parameters
    ----------
    workers
        Number of worker processes of this machine.
    executor
        Executor that computes the tasks instead. If it breaks, worker processes compute the remaining tasks.
    program
        Module that carries out the tasks, with the functions `main` and `compute` of `mbdkit_studies.compute.worker`.
    """

    workers: int = 1
    executor: Executor | None = None
    program: str = PROGRAM

    @classmethod
    def of(cls, workers: int, executor: object, program: str = PROGRAM) -> Engine:
        """Return the engine with an executor passed by the user, which may be one of submitit, or None.

        Raises
        ------
        SpecError
            If the object is not an executor.
        """
        if executor is None or isinstance(executor, Executor):
            return cls(workers, executor, program)
        if hasattr(executor, "map_array"):
            return cls(workers, SubmititExecutor(lambda: executor), program)
        message = f"needs a concurrent.futures.Executor, or one of submitit, not {value_text(executor)}"
        raise SpecError(message, key="executor")

    def pool(self, notify: Callable[[str], None]) -> Pool:
        """Return the pool that computes tasks, for use in a `with` block.

        Parameters
        ----------
        notify
            Called with each message of the workers, unless it differs from an earlier one only in numbers.
        """
        return Pool(self, notify)


class Pool:
    """Tasks that the processes of this machine or another executor compute. The pool is used in a `with` block.

    Workers receive texts, numbers and paths of files; all workers must have access to these files. A worker writes the
    archive or the block of its task. A task whose worker is lost is submitted again (see `Task.after_death`).
    """

    def __init__(self, engine: Engine, notify: Callable[[str], None]):
        self.engine, self.notify = engine, notify
        self._said: set[str] = set()
        self._begun: dict[Future[list[Message]], _Batch] = {}
        self._ended: queue.SimpleQueue[Future[list[Message]] | str] = queue.SimpleQueue()  # or messages of processes
        self.executor = engine.executor or LocalProcesses(engine.workers, engine.program, self._ended.put)

    def work(self, tasks: Sequence[Task]) -> Iterator[tuple[Task, Outcome]]:
        """Submit the tasks in order, and yield each with its outcome when it is finished.

        Raises
        ------
        ResourceError
            If the system refuses all processes.
        """
        batches = self._batches(tasks)
        while batches or self._begun:
            try:
                if batches:
                    for task in self._refused(batches):
                        yield task, Outcome("missing", f"no-resources: {self._refusal}")
                    batches = []
                    continue
                if (ended := self._next_ended()) is None:
                    outcome = Outcome("missing", "no-resources: the connection to the Dask scheduler is lost.")
                    yield from ((task, outcome) for batch in self._begun.values() for task in batch.tasks)
                    self._begun.clear()
                    return
                future = ended
                batch = self._begun[future].tasks
                answers = future.result()
            except ResourceError:
                raise
            except BrokenExecutor as error:
                yield from self._without_executor(batches, error)
                return
            except (CancelledError, ImportError) as error:
                why = f"a worker of the executor cannot begin: {_told(error)}."
                if isinstance(error, CancelledError):  # by Dask, which cancels all tasks when it loses its scheduler
                    why = "the executor cancelled tasks; is its scheduler running?"
                outcome = Outcome("missing", f"no-resources: {why}")
                yield from ((task, outcome) for task in self._begun.pop(future).tasks)
            except Exception as error:
                how = str(error) if isinstance(error, ProcessDiedError) else f"was lost by the executor: {_told(error)}"
                suspects, innocent = self._begun.pop(future).divided()
                for task in suspects:
                    if (following := task.after_death(how)) is None:
                        yield task, Outcome("failed", died(how))
                    else:
                        batches.append([following])
                batches += [innocent] if innocent else []
            else:
                del self._begun[future]
                yield from ((task, self._outcome(task, answer)) for task, answer in zip(batch, answers, strict=True))

    def _next_ended(self) -> Future[list[Message]] | None:
        """Return a future that has ended, after waiting for it; None if none will end.

        The futures of a Dask client that lost its scheduler, and was therefore closed, never end.
        """
        while True:
            try:
                ended = self._ended.get(timeout=LOOK)
            except queue.Empty:
                if getattr(getattr(self.executor, "_client", None), "status", "") == "closed":
                    return None
                continue
            if not isinstance(ended, str):
                return ended
            self.say(ended)

    def say(self, text: str) -> None:
        """Pass a message to the user, unless it differs from an earlier one only in numbers."""
        if (kind := without_numbers(text)) not in self._said:
            self._said.add(kind)
            self.notify(text)

    def _batches(self, tasks: Sequence[Task]) -> list[list[Task]]:
        """Return the tasks in lists that are submitted together: lists of one task or, for submitit, one list for each
        job.
        """
        jobs = self.executor.jobs if isinstance(self.executor, SubmititExecutor) else len(tasks)
        size = math.ceil(len(tasks) / max(1, jobs))
        return [list(tasks[first : first + size]) for first in range(0, len(tasks), max(1, size))]

    def _refused(self, batches: list[list[Task]]) -> list[Task]:
        """Submit batches, and return the tasks that the executor refuses."""
        messages = [[task.message() for task in batch] for batch in batches]
        compute: Callable[..., Any] = import_module(self.engine.program).compute
        submitted = 0
        futures: Iterator[Future[list[Message]]]
        try:
            if isinstance(self.executor, SubmititExecutor):
                futures = iter(self.executor.submit_all(compute, messages, own_version()))
            else:
                futures = (self.executor.submit(compute, part, own_version()) for part in messages)
            for batch, future in zip(batches, futures, strict=True):
                self._begun[future] = _Batch(batch)
                submitted += 1
                future.add_done_callback(self._ended.put)
        except (BrokenExecutor, ResourceError):
            del batches[:submitted]
            raise
        except Exception as error:
            self._refusal = f"the executor refuses tasks: {_told(error)}."
        return [task for batch in batches[submitted:] for task in batch]

    def _without_executor(self, batches: list[list[Task]], error: BrokenExecutor) -> Iterator[tuple[Task, Outcome]]:
        """Compute the remaining tasks of a broken executor by local processes."""
        self.executor.shutdown()  # wait until its last processes have ended
        self.say(f"the executor failed, and processes on this machine compute the rest ({_told(error)})")
        left = [task for batch in (*(begun.tasks for begun in self._begun.values()), *batches) for task in batch]
        self._begun.clear()
        with replace(self.engine, executor=None).pool(self.say) as pool:
            yield from pool.work(left)

    def _outcome(self, task: Task, answer: Message) -> Outcome:
        """Return the outcome reported by a worker; ``missing`` if this process cannot see the file of the worker."""
        for note in answer.pop("notes", ()):
            self.say(note)
        outcome = Outcome.of(answer)
        if outcome.status != "complete" or not task.writes or task.path.exists():
            return outcome
        os.listdir(task.path.parent)  # makes network file systems refresh their listing
        if task.path.exists():
            return outcome
        why = f"{answer['host']} has written {task.path.name}, which is not in the folder of the study here"
        return Outcome("missing", f"no-resources: {why}; the folder must be on a file system that all workers share.")

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        for future in self._begun:
            future.cancel()  # running tasks of an executor are not cancelled; they end by themselves
        is_ours = self.executor is not self.engine.executor
        if is_ours or (self._begun and isinstance(self.executor, SubmititExecutor)):  # cancels jobs
            self.executor.shutdown(cancel_futures=True)


class _Batch:
    """Tasks that one call of a worker computes, in order."""

    def __init__(self, tasks: list[Task]):
        self.tasks: list[Task] = tasks
        self._before = [_written(task.path) for task in tasks]

    def divided(self) -> tuple[list[Task], list[Task]]:
        """Return the tasks that may have killed a lost worker, and the remaining tasks.

        Tasks are computed in order. If all of them write files, the worker died during the first task whose file it has
        not written, or after the last one. If some tasks write no files, every task may have killed the worker.
        """
        if not all(task.writes for task in self.tasks):
            return self.tasks, []
        done = [_written(task.path) != before for task, before in zip(self.tasks, self._before, strict=True)]
        index = done.index(False) if False in done else len(done) - 1
        return self.tasks[index : index + 1], self.tasks[:index] + self.tasks[index + 1 :]


def _written(path: Path) -> int:
    """Return the time at which a file was written [ns]; 0 if it does not exist."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _told(error: BaseException) -> str:
    """Return an exception as a clause."""
    return one_line(error).rstrip(".")
