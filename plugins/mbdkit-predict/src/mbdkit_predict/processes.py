"""Solutions in processes of their own, as many at once as there are cores, which can be ended at any time.

The optimizer asks whether to stop after each iteration only. The factorization of a large matrix takes up to a minute,
in which it answers nobody. The process inherits the problem, whose functions cannot be sent to another one. Where
processes cannot inherit, on Windows and macOS, solutions are found one after another in the process itself.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Generic, TypeVar

import numpy as np

from mbdkit.base.errors import RunError

GRACE = 0.25  #: Time after which a process that should stop is ended [s].
LOOK = 0.05  #: Time between two looks at whether to stop [s].

T = TypeVar("T")
#: A function that returns a result; its argument is a function that takes intermediate results.
Task = Callable[[Callable[[T], None]], T]


@dataclass
class Stop:
    """Says when an optimization stops early: on Ctrl-C, or after a limit of wall time."""

    end: float = np.inf  #: Time at which it stops, as returned by `time.perf_counter` [s].
    interrupted: bool = False  #: Whether the user interrupted it.

    @property
    def now(self) -> bool:
        """Whether to stop."""
        return self.interrupted or time.perf_counter() > self.end

    def interrupt(self) -> None:
        """Note that the user interrupts the optimization."""
        self.interrupted = True


@dataclass
class _Child(Generic[T]):
    process: BaseProcess
    connection: Connection
    found: list[T] = field(default_factory=list)
    """The last result, if there is one."""
    is_running: bool = True

    def receive(self) -> None:
        """Take what the process sends, or note that it has ended."""
        try:
            kind, result = self.connection.recv()
        except (EOFError, OSError):
            self.is_running = False
            return
        if isinstance(result, Exception):
            raise result
        self.found = [result]
        self.is_running = kind == "intermediate"

    def end(self) -> None:
        if self.process.is_alive():
            os.kill(int(self.process.pid or 0), signal.SIGKILL)
        self.process.join()
        self.connection.close()


def results_of(tasks: Sequence[Task[T]], stop: Stop, meanwhile: Callable[[], object] = lambda: None) -> list[T | None]:
    """Return the results of tasks; if `stop` says to stop, the last intermediate results, or None without any.

    `meanwhile`: what this process does while others work; it is called repeatedly.

    Raises
    ------
    RunError
        If a process ends without a result.
    """
    if sys.platform != "linux":
        return [task(lambda result: None) for task in tasks]
    children, waiting = list[_Child[T]](), list(tasks)
    try:
        while True:
            running = [child for child in children if child.is_running]
            while waiting and len(running) < (os.cpu_count() or 1) and not (stop.now and children):
                children.append(_started(waiting.pop(0)))
                running.append(children[-1])
            meanwhile()
            if not running or stop.interrupted or time.perf_counter() > stop.end + GRACE:
                break
            ready = wait([child.connection for child in running], LOOK)
            for child in running:
                if child.connection in ready:
                    child.receive()
    finally:
        for child in children:
            child.end()
    for child in children:
        if not child.found and not stop.now:
            raise RunError("the process of the optimizer ended without a result: the memory may be too small")
    return [child.found[0] if child.found else None for child in children] + [None] * len(waiting)


def _started(task: Task[T]) -> _Child[T]:
    context = get_context("fork")
    receiving, sending = context.Pipe(duplex=False)

    def execute() -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        receiving.close()
        # keep memory that is freed: the linear solver asks for large blocks in each iteration, which the system clears
        library = ctypes.CDLL(None)
        if hasattr(library, "mallopt"):  # the C library of GNU
            library.mallopt(-1, 2**31 - 1)  # M_TRIM_THRESHOLD
            library.mallopt(-4, 0)  # M_MMAP_MAX
        try:
            sending.send(("last", task(lambda result: sending.send(("intermediate", result)))))
        except Exception as error:
            sending.send(("last", error))
        finally:
            sending.close()

    process = context.Process(target=execute, daemon=True)
    process.start()
    sending.close()
    return _Child(process, receiving)
