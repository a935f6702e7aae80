"""Workers of studies that are forks of the process that starts them, so that they begin to work at once."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import IO


class ForkedWorker:
    """What `mbdkit_studies.compute.pool` uses of ``subprocess.Popen``, for a worker that is a fork of this process.

    Parameters
    ----------
    command
        A command that ends with the module of the worker.
    """

    def __init__(self, command: Sequence[str], *, stderr: IO[bytes], **options: object):
        (tasks, given), (taken, answers) = os.pipe(), os.pipe()
        self.code: int | None = None
        self.pid = os.fork()
        if not self.pid:
            try:
                os.setsid()
                for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                    signal.signal(number, signal.SIG_DFL)
                signal.set_wakeup_fd(-1)  # the pipe of the process that starts it, closed below
                for place, end in enumerate((tasks, answers, stderr.fileno())):
                    os.dup2(end, place)
                os.closerange(3, os.sysconf("SC_OPEN_MAX"))  # locks, and the pipes of other workers
                sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
                import_module(command[-1]).main()
            finally:
                os._exit(1)
        os.close(tasks), os.close(answers)
        self.stdin = os.fdopen(given, "w", encoding="utf-8")
        self.stdout = os.fdopen(taken, encoding="utf-8")

    def kill(self) -> None:
        """See `subprocess.Popen.kill`."""
        if self.code is None:
            os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> int:
        """See `subprocess.Popen.wait`."""
        if self.code is None:
            self.code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.code
