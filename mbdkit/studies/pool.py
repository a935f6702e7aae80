"""A pool of worker processes; if a process dies, its task is reported as failed."""

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

from mbdkit.spec import RunSpec

#: Thread counts of the linear algebra libraries: several threads do not pay for small matrices, and the workers would
#: compete for the cores.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


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
        """Start the tasks in order, and yield each with its outcome when it is finished."""
        waiting = deque(tasks)
        lines: queue.SimpleQueue[tuple[_Worker, str]] = queue.SimpleQueue()
        while waiting and len(self._workers) < min(self.size, len(tasks)):
            self._workers.append(_Worker(lines))
            self._workers[-1].give(waiting.popleft())
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
                outcome = Outcome("failed", f"worker-died: {worker.death()}")
                self._workers.remove(worker)
                worker.end()
                if waiting:
                    worker = _Worker(lines)
                    self._workers.append(worker)
            if waiting:
                worker.give(waiting.popleft())
            yield task, outcome

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
        threading.Thread(target=self._listen, args=(lines,), daemon=True).start()

    def _listen(self, lines: queue.SimpleQueue[tuple[_Worker, str]]) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
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
        """Return a sentence that says how the process ended."""
        code = self.process.wait()
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit status {code}"
        self.errors.seek(0)
        said = self.errors.read().decode(errors="replace").strip().splitlines()
        return f"the process that computed it {how}{': ' + said[-1].strip() if said else ''}."

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
