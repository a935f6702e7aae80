"""Processes that are forks of this one: they have imported everything, and begin to work at once."""

from __future__ import annotations

import gc
import importlib
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import IO

from mbdkit.archive import writer
from mbdkit.base import progress_bars
from mbdkit.cli import main

FLUSH = 0.02
"""Time between two flushes of archives [s], so that tests need not wait for the first one."""


class ForkedProcess:
    """A function in a fork of this process, with the methods of `subprocess.Popen` that tests use.

    Parameters
    ----------
    function
        What the process does; its standard streams are files.
    folder
        The folder in which it works.
    stderr
        Descriptor of its standard error, if this is no file.
    """

    def __init__(self, function: Callable[[], object], folder: Path, stderr: int | None = None):
        self.returncode: int | None = None
        self._files: tuple[IO[bytes], IO[bytes]] = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115
        self.pid = os.fork()
        if not self.pid:
            status = 1
            gc.freeze()  # a fork that closes an archive of its parent, as garbage of an earlier test, ends itself
            try:
                _begin(folder, self._files[0].fileno(), self._files[1].fileno() if stderr is None else stderr)
                function()
                status = 0
            except SystemExit as end:
                status = end.code if isinstance(end.code, int) else 1
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(status)

    def poll(self) -> int | None:
        """See `subprocess.Popen.poll`."""
        if self.returncode is None:
            done, status = os.waitpid(self.pid, os.WNOHANG)
            if done:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float) -> int:
        """See `subprocess.Popen.wait`."""
        until = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > until:
                raise subprocess.TimeoutExpired("a fork", timeout)
            time.sleep(0.005)
        assert self.returncode is not None
        return self.returncode

    def communicate(self, timeout: float) -> tuple[str, str]:
        """See `subprocess.Popen.communicate`."""
        self.wait(timeout)
        said = []
        for file in self._files:
            file.seek(0)
            said.append(file.read().decode())
        return said[0], said[1]

    def send_signal(self, number: int) -> None:
        """See `subprocess.Popen.send_signal`."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill the process, if it has not ended, and close its files."""
        self.send_signal(signal.SIGKILL)
        self.wait(60.0)
        for file in self._files:
            file.close()


def forked_command(*arguments: str, folder: Path, stderr: int | None = None) -> ForkedProcess:
    """Start ``mbdkit ARGUMENTS`` in a fork of this process."""

    def command() -> None:
        sys.argv = ["mbdkit", *arguments]
        main()

    return ForkedProcess(command, folder, stderr)


def _begin(folder: Path, stdout: int, stderr: int) -> None:
    """Let a fork begin as a new process does."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL if number == signal.SIGTERM else signal.default_int_handler)
    os.chdir(folder)
    os.dup2(stdout, 1)
    os.dup2(stderr, 2)
    sys.stdout, sys.stderr = (open(place, "w", encoding="utf-8", closefd=False) for place in (1, 2))  # noqa: SIM115
    importlib.reload(warnings)  # pytest records warnings instead of showing them
    writer.FLUSH_INTERVAL, progress_bars.PATIENCE = FLUSH, 0.0
