"""A pool of worker processes. If a process dies, another process tries its task again (see `Task.after_death`).

`concurrent.futures.ProcessPoolExecutor` and loky do not suffice for studies. When a process dies in one of these pools,
all pending tasks fail, and the error tells neither which task killed the process nor what the process printed last
(loky names the signal). If the parent process is killed, the workers of these pools continue to run. Workers of
`ProcessPoolExecutor` also import the script of the user again, and receive the Ctrl-C that is meant for the parent
process.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence

from mbdkit.archive.part_file import checkpoint_path, part_path, remove_part
from mbdkit.base.errors import ResourceError
from mbdkit_studies.compute.tasks import Message, Outcome, Task, died
from mbdkit_studies.texts import without_numbers

PROGRAM = "mbdkit_studies.compute.worker"  #: Module that carries out the tasks of studies.

#: Environment variables for the number of threads of linear algebra libraries. Several threads do not help with small
#: matrices, and the workers would compete for the cores.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


#: Exit statuses of Windows from here on are codes of errors, such as 0xc0000005 for an access violation.
_WINDOWS_ERROR = 0xC0000000


class Pool:
    """Worker processes with one thread of linear algebra each. The pool is used in a `with` block, which ends them.

    Parameters
    ----------
    size
        Maximum number of processes.
    notify
        Called with each message of the workers, unless it differs from an earlier one only in numbers.
    program
        Module whose `main` carries out the tasks.
    """

    def __init__(self, size: int, notify: Callable[[str], None], program: str = PROGRAM):
        self.size = size
        self.notify = notify
        self.program = program
        self._workers: list[_Worker] = []
        self._lines: queue.SimpleQueue[tuple[_Worker, str]] = queue.SimpleQueue()
        self._said: set[str] = set()

    def work(self, tasks: Sequence[Task]) -> Iterator[tuple[Task, Outcome]]:
        """Start the tasks in order, and yield each with its outcome when it is finished.

        Processes of earlier tasks are reused.

        Raises
        ------
        ResourceError
            If the system refuses all processes.
        """
        waiting = deque(tasks)
        for worker in self._workers[: len(waiting)]:
            worker.give(waiting.popleft())
        while waiting and len(self._workers) < min(self.size, len(tasks)) and (added := self._started()):
            added.give(waiting.popleft())
        while any(worker.task for worker in self._workers):
            worker, line = self._lines.get()
            task = worker.task
            if task is None:  # the process died while it was idle
                self._workers.remove(worker)
                worker.end()
                continue
            if line:
                answer: Message = json.loads(line)
                if "note" in answer:
                    self.say(answer["note"])
                    continue
                outcome = Outcome.of(answer)
                worker.task = None
            else:
                how = worker.death()
                self._workers.remove(worker)
                worker.end()
                following = task.after_death(how)
                if following is not None:
                    waiting.appendleft(following)
                if waiting and (added := self._started()):
                    added.give(waiting.popleft())
                if following is not None:
                    continue
                outcome = Outcome("failed", died(how))
            if waiting and worker in self._workers:
                worker.give(waiting.popleft())
            yield task, outcome

    def _started(self) -> _Worker | None:
        """Start another process; return None if the system refuses it but other processes are running."""
        try:
            worker: _Worker = _Worker(self._lines, self.program)
        except OSError as error:
            message = f"a worker process cannot be started: {error.strerror or error}"
            if not self._workers:
                raise ResourceError(message) from error
            self.say(message)
            return None
        self._workers.append(worker)
        return worker

    def say(self, text: str) -> None:
        """Pass a message to the user, unless it differs from an earlier one only in numbers."""
        kind = without_numbers(text)
        if kind not in self._said:
            self._said.add(kind)
            self.notify(text)

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end(keep_checkpoint=True)


class _Worker:
    """One process, its task, and a thread that forwards its output."""

    def __init__(self, lines: queue.SimpleQueue[tuple[_Worker, str]], program: str):
        self.task: Task | None = None
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115
        environment = os.environ | dict.fromkeys(ONE_THREAD, "1")
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
        # The process has its own session, on Windows its own process group, so that Ctrl-C interrupts only the parent
        # process, which then ends its workers.
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self.errors,
                env=environment,
                start_new_session=True,
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
                text=True,
                encoding="utf-8",
            )
        except OSError:
            self.errors.close()
            raise
        threading.Thread(target=self._listen, args=(lines,), daemon=True).start()

    def _listen(self, lines: queue.SimpleQueue[tuple[_Worker, str]]) -> None:
        assert self.process.stdout is not None
        # closed here, because closing it in another thread would wait for this thread
        with self.process.stdout as output:
            for line in output:
                lines.put((self, line))
        lines.put((self, ""))

    def give(self, task: Task) -> None:
        """Send a task to the process; if the process is dead, `_listen` reports the end of its output."""
        self.task = task
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):  # BrokenPipeError, or EINVAL on Windows
            self.process.stdin.write(json.dumps(task.message()) + "\n")
            self.process.stdin.flush()

    def death(self) -> str:
        """Return a description of how the process ended."""
        code = self.process.wait()
        status = f"{code:#x}" if code >= _WINDOWS_ERROR else code
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit status {status}"
        self.errors.seek(0)
        said = self.errors.read().decode(errors="replace").strip().splitlines()
        return f"{how}{': ' + said[-1].strip().rstrip('.') if said else ''}"

    def end(self, *, keep_checkpoint: bool = False) -> None:
        """Kill the process and remove the unfinished archive of its task; it is kept if another call can continue it
        from a checkpoint and `keep_checkpoint` is true.
        """
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.errors):
            assert stream is not None
            with contextlib.suppress(OSError):
                stream.close()
        if self.task is not None:
            part = part_path(self.task.path)
            if not (keep_checkpoint and checkpoint_path(part).is_file()):
                remove_part(part)
