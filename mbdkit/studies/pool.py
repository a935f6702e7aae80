"""A pool of worker processes; if a process dies, another one tries its task, once."""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, TypeVar

from mbdkit.errors import ResourceError
from mbdkit.spec import RunSpec
from mbdkit.studies.study_folder import StudyFolder

#: Thread counts of the linear algebra libraries: several threads do not pay for small matrices, and the workers would
#: compete for the cores.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


#: Reasons of failure that are outside the study: a resource that was refused, a process that died, a defect of mbdkit.
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
    """

    spec: RunSpec
    path: Path
    repeats: int = 0
    second: tuple[str, ...] = ()
    tried: bool = False

    def message(self) -> dict[str, Any]:
        """Return what a worker needs to carry out the task."""
        spec = json.loads(self.spec.canonical_json())
        return {"spec": spec, "path": str(self.path.absolute()), "repeats": self.repeats, "second": self.second}

    def after_death(self, how: str) -> Task | None:
        """Return the task to try after a process died of this one, as `how` says; None if it is given up."""
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

    @property
    def path(self) -> Path:
        """File of the block."""
        return self.folder.block(self.block)

    def message(self) -> dict[str, Any]:
        """Return what a worker needs to carry out the task."""
        place, skip = str(self.folder.path.absolute()), {str(run): reason for run, reason in self.skip.items()}
        return {"folder": place, "block": self.block, "skip": skip, "path": str(self.path.absolute())}

    def after_death(self, how: str) -> BlockTask | None:
        """Return the task to try after a process died of this one; the second time, the run at work is left out."""
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
    """Result of a task: status of the run, its reason, wall times of repeats [s], and measures of a second run."""

    status: str
    reason: str
    seconds: tuple[float, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_passing(self) -> bool:
        """Whether the cause of a failure is outside the study, so that the next call tries again."""
        return self.reason.startswith(PASSING)


Work = TypeVar("Work", Task, BlockTask)

MOST_DEATHS = 20
"""Processes that may die in one block before it is given up."""


def died(how: str) -> str:
    """Return the reason of failure of a run of which two processes died, the second one as `how` says."""
    return f"worker-died: two processes that computed it died; the second one {how}."


class Pool(Generic[Work]):
    """Worker processes with one linear algebra thread each, for use in a `with` block, which ends them.

    Parameters
    ----------
    size
        Maximum number of processes.
    notify
        Called once with each distinct message of the workers.
    """

    def __init__(self, size: int, notify: Callable[[str], None]):
        self.size = size
        self.notify = notify
        self._workers: list[_Worker[Work]] = []
        self._said: set[str] = set()

    def work(self, tasks: Sequence[Work]) -> Iterator[tuple[Work, Outcome]]:
        """Start the tasks in order, and yield each with its outcome when it is finished.

        Raises
        ------
        ResourceError
            If the system refuses all processes.
        """
        waiting = deque(tasks)
        lines: queue.SimpleQueue[tuple[_Worker[Work], str]] = queue.SimpleQueue()
        while waiting and len(self._workers) < min(self.size, len(tasks)) and (added := self._started(lines)):
            added.give(waiting.popleft())
        while any(worker.task for worker in self._workers):
            worker, line = lines.get()
            task = worker.task
            if task is None:  # it died while it was idle
                self._workers.remove(worker)
                worker.end()
                continue
            if line:
                answer: dict[str, Any] = json.loads(line)
                if "note" in answer:
                    self._say(answer["note"])
                    continue
                values = {
                    name: math.nan if found is None else found for name, found in answer.get("values", {}).items()
                }
                outcome = Outcome(answer["status"], answer["reason"], tuple(answer.get("seconds", ())), values)
                worker.task = None
            else:
                how = worker.death()
                self._workers.remove(worker)
                worker.end()
                following = task.after_death(how)
                if following is not None:
                    waiting.appendleft(following)
                if waiting and (added := self._started(lines)):
                    added.give(waiting.popleft())
                if following is not None:
                    continue
                outcome = Outcome("failed", died(how))
            if waiting and worker in self._workers:
                worker.give(waiting.popleft())
            yield task, outcome

    def _started(self, lines: queue.SimpleQueue[tuple[_Worker[Work], str]]) -> _Worker[Work] | None:
        """Start another process; return None if the system refuses it, but others are running."""
        try:
            worker: _Worker[Work] = _Worker(lines)
        except OSError as error:
            message = f"a process of the study cannot be started: {error.strerror or error}"
            if not self._workers:
                raise ResourceError(message) from error
            self._say(message)
            return None
        self._workers.append(worker)
        return worker

    def _say(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self.notify(text)

    def __enter__(self) -> Pool[Work]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.end()


class _Worker(Generic[Work]):
    """One process, its task, and a thread that forwards its output."""

    def __init__(self, lines: queue.SimpleQueue[tuple[_Worker[Work], str]]):
        self.task: Work | None = None
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115
        environment = os.environ | dict.fromkeys(ONE_THREAD, "1")
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
        # In a session of its own, so that Ctrl-C interrupts only the parent process, which then ends its workers.
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "mbdkit.studies.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self.errors,
                env=environment,
                start_new_session=True,
                text=True,
                encoding="utf-8",
            )
        except OSError:
            self.errors.close()
            raise
        threading.Thread(target=self._listen, args=(lines,), daemon=True).start()

    def _listen(self, lines: queue.SimpleQueue[tuple[_Worker[Work], str]]) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as output:  # closed here: closing it in another thread would wait for this one
            for line in output:
                lines.put((self, line))
        lines.put((self, ""))

    def give(self, task: Work) -> None:
        """Send a task to the process; if the process is dead, the end of its output reports that."""
        self.task = task
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.write(json.dumps(task.message()) + "\n")
            self.process.stdin.flush()

    def death(self) -> str:
        """Return words that say how the process ended."""
        code = self.process.wait()
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit status {code}"
        self.errors.seek(0)
        said = self.errors.read().decode(errors="replace").strip().splitlines()
        return f"{how}{': ' + said[-1].strip().rstrip('.') if said else ''}"

    def end(self) -> None:
        """Kill the process and remove the unfinished archive of its task."""
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.errors):
            assert stream is not None
            with contextlib.suppress(BrokenPipeError):
                stream.close()
        if self.task is not None:
            self.task.path.with_name(self.task.path.name + ".part").unlink(missing_ok=True)
