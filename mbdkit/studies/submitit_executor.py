"""The jobs of submitit as a `concurrent.futures.Executor`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from typing import Any

JOBS = 100
"""Jobs into which the tasks of a study are divided, at most."""

INTERVAL = 0.5
"""Time between two looks at the jobs [s]."""

PATIENCE = 10.0
"""Time for cancelled jobs to end [s]."""


class SubmititExecutor(Executor):
    """Jobs of a scheduler such as Slurm.

    Parameters
    ----------
    begin
        Returns the executor of submitit; called when the first job is submitted.
    jobs
        Number of jobs into which tasks are divided, at most.
    """

    def __init__(self, begin: Callable[[], Any], jobs: int = JOBS):
        self.jobs = jobs
        self.has_lost = False  # whether a job has ended without a result
        self._begin = begin
        self._executor: Any = None
        self._jobs: dict[Future[Any], Any] = {}
        self._cancelled: list[Any] = []
        self._lock = threading.Lock()

    def submit_all(self, function: Callable[..., Any], values: Sequence[Any], *rest: Any) -> list[Future[Any]]:
        """Submit a job for each value, as one array of jobs; it calls ``function(value, *rest)``."""
        if self._executor is None:
            self._executor = self._begin()
        jobs = self._executor.map_array(function, values, *([one] * len(values) for one in rest))
        futures: list[Future[Any]] = [Future() for _ in jobs]
        with self._lock:
            is_watched = bool(self._jobs)
            self._jobs.update(zip(futures, jobs, strict=True))
            if not is_watched:
                threading.Thread(target=self._watch, daemon=True).start()
        return futures

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        """Submit one job; it calls ``function(*arguments)``."""
        if options:
            raise TypeError("jobs take no arguments by name")
        return self.submit_all(function, arguments[:1], *arguments[1:])[0]

    def _watch(self) -> None:
        """Pass the results of jobs to their futures until there are none."""
        while True:
            for future, job in list(self._jobs.items()):
                if future.cancelled():
                    job.cancel(check=False)
                    self._cancelled.append(job)
                elif not self._has_ended(future, job):
                    continue
                with self._lock:
                    del self._jobs[future]
            with self._lock:
                if not self._jobs:
                    return
            time.sleep(INTERVAL)

    def _has_ended(self, future: Future[Any], job: Any) -> bool:
        """Return whether a job has ended, and pass its result to its future if it has."""
        try:
            if not job.done():
                return False
            error = job.exception()
            result = job.result() if error is None else None
        except Exception as lost:  # such as a file of submitit that cannot be read
            error = lost
        self.has_lost |= error is not None
        if future.set_running_or_notify_cancel():
            if error is None:
                future.set_result(result)
            else:
                future.set_exception(error)
        return True

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let the jobs end, or cancel them; see `concurrent.futures.Executor.shutdown`."""
        for future in list(self._jobs) if cancel_futures else ():
            future.cancel()
        while wait and self._jobs:
            time.sleep(INTERVAL / 5)
        until = time.monotonic() + PATIENCE
        while wait and time.monotonic() < until and not all(job.done() for job in self._cancelled):
            time.sleep(INTERVAL / 5)
