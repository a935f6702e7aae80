"""Worker processes of this machine, as an executor. A process that dies is replaced.

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
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from mbdkit.archive.part_file import checkpoint_path, part_path, remove_part
from mbdkit.base.errors import ResourceError
from mbdkit_studies.compute.tasks import Message

PROGRAM = "mbdkit_studies.compute.worker"  #: Module that carries out the tasks of studies.

#: Environment variables for the number of threads of linear algebra libraries. Several threads do not help with small
#: matrices, and the workers would compete for the cores.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


#: Exit statuses of Windows from here on are codes of errors, such as 0xc0000005 for an access violation.
_WINDOWS_ERROR = 0xC0000000


class ProcessDiedError(Exception):
    """A worker process died during a task; the message says how."""


class LocalProcesses(ThreadPoolExecutor):
    """Worker processes with one thread of linear algebra each; the threads of this executor wait for their answers.

    Parameters
    ----------
    size
        Maximum number of processes.
    program
        Module whose `main` carries out the tasks.
    notify
        Called with each message of the processes, in another thread.
    """

    def __init__(self, size: int, program: str, notify: Callable[[str], None]):
        super().__init__(size)
        self.size, self.program, self.notify = size, program, notify
        self._processes: list[_Process] = []
        self._idle: queue.SimpleQueue[_Process | None] = queue.SimpleQueue()  # None: the executor is shut down
        self._is_ending = False

    def submit(self, function: object, /, messages: Sequence[Message], *_: object) -> Future[Any]:  # type: ignore[override]
        """Let a process carry out a task; `function` is not used, because the processes know what to do.

        Raises
        ------
        ResourceError
            If the system refuses all processes.
        """
        if len(self._processes) < self.size:
            self._start()
        return super().submit(self._carry_out, *messages)

    def _start(self) -> None:
        try:
            process = _Process(self.program)
        except OSError as error:
            message = f"a worker process cannot be started: {error.strerror or error}"
            if not self._processes:
                raise ResourceError(message) from error
            self.size = len(self._processes)
            self.notify(message)
            return
        self._processes.append(process)
        self._idle.put(process)

    def _carry_out(self, message: Message) -> list[Message]:
        """Return the answer of a process, in a list; a process that dies is replaced, and its unfinished archive is
        removed, unless another call can continue it from a checkpoint because this executor has ended the process.
        """
        if (process := self._idle.get()) is None:
            raise CancelledError
        try:
            answer = process.answer(message, self.notify)
        except EOFError:
            self._processes.remove(process)
            how, part = process.end(), part_path(Path(message["path"]))
            if not (self._is_ending and checkpoint_path(part).is_file()):
                remove_part(part)
            if not self._is_ending:
                self._start()
            raise ProcessDiedError(how) from None
        self._idle.put(process)
        return [answer]

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes, also those that carry out tasks."""
        self._is_ending = True
        super().shutdown(wait=False, cancel_futures=True)
        for process in list(self._processes):
            process.process.kill()
        for _ in range(self._max_workers):
            self._idle.put(None)
        super().shutdown()
        for process in self._processes:
            process.end()


class _Process:
    """One process, which carries out one task at a time."""

    def __init__(self, program: str):
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

    def answer(self, message: Message, notify: Callable[[str], None]) -> Message:
        """Return the answer to a task, after passing on notes; raise EOFError if the process dies."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        with contextlib.suppress(OSError):  # BrokenPipeError, or EINVAL on Windows
            self.process.stdin.write(json.dumps(message) + "\n")
            self.process.stdin.flush()
        for line in iter(self.process.stdout.readline, ""):
            answer: Message = json.loads(line)
            if "note" not in answer:
                return answer
            notify(answer["note"])
        raise EOFError

    def end(self) -> str:
        """Kill the process, and return how it ended."""
        self.process.kill()
        code = self.process.wait()
        status = f"{code:#x}" if code >= _WINDOWS_ERROR else code
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit status {status}"
        self.errors.seek(0)
        said = self.errors.read().decode(errors="replace").strip().splitlines()
        for stream in (self.process.stdin, self.process.stdout, self.errors):
            assert stream is not None
            with contextlib.suppress(OSError):
                stream.close()
        return f"{how}{': ' + said[-1].strip().rstrip('.') if said else ''}"
