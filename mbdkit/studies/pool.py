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
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from mbdkit.errors import ResourceError
from mbdkit.spec import RunSpec

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
    """

    spec: RunSpec
    path: Path
    repeats: int = 0
    second: tuple[str, ...] = ()


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


class Pool:
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
        self._workers: list[_Worker] = []
        self._said: set[str] = set()

    def work(self, tasks: Sequence[Task]) -> Iterator[tuple[Task, Outcome]]:
        """Start the tasks in order, and yield each with its outcome when it is finished.

        Raises
        ------
        ResourceError
            If the system refuses all processes.
        """
        waiting = deque(tasks)
        lines: queue.SimpleQueue[tuple[_Worker, str]] = queue.SimpleQueue()
        again: set[Path] = set()  # archives of tasks whose first process died
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
                is_first = task.path not in again
                if is_first:
                    again.add(task.path)
                    waiting.appendleft(task)
                if waiting and (added := self._started(lines)):
                    added.give(waiting.popleft())
                if is_first:
                    continue
                outcome = Outcome("failed", f"worker-died: two processes that computed it died; the second one {how}.")
            if waiting and worker in self._workers:
                worker.give(waiting.popleft())
            yield task, outcome

    def _started(self, lines: queue.SimpleQueue[tuple[_Worker, str]]) -> _Worker | None:
        """Start another process; return None if the system refuses it, but others are running."""
        try:
            worker = _Worker(lines)
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

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.end()


class _Worker:
    """One process, its task, and a thread that forwards its output."""

    def __init__(self, lines: queue.SimpleQueue[tuple[_Worker, str]]):
        self.task: Task | None = None
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

    def _listen(self, lines: queue.SimpleQueue[tuple[_Worker, str]]) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as output:  # closed here: closing it in another thread would wait for this one
            for line in output:
                lines.put((self, line))
        lines.put((self, ""))

    def give(self, task: Task) -> None:
        """Send a task to the process; if the process is dead, the end of its output reports that."""
        self.task = task
        spec = json.loads(task.spec.canonical_json())
        place = str(task.path.absolute())
        text = json.dumps({"spec": spec, "path": place, "repeats": task.repeats, "second": task.second})
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.write(text + "\n")
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
