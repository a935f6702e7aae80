"""Interruption of runs and commands by Ctrl-C and by the signals SIGTERM and SIGHUP, which have the same effect.

On Windows, SIGBREAK (Ctrl-Break) has it too; no program can send SIGTERM there, because `os.kill` ends a process.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from types import FrameType

#: Signals within this time [s] count as one: `timeout` sends SIGTERM twice, and a closing terminal sends several
#: signals.
TOGETHER = 1.0

#: Exit status of an interrupted command.
INTERRUPTED = 130

_STOPPING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))

_last = -TOGETHER


def stop_as_by_ctrl_c() -> None:
    """Make SIGTERM and SIGHUP raise KeyboardInterrupt, and a second SIGTERM end the process; call it in the main thread
    only.

    A signal that is ignored, such as SIGHUP under `nohup`, remains ignored.
    """
    for number in _STOPPING:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _raise_interrupt)
    _watch_second_sigterm()


@contextmanager
def interrupts_noted(note: Callable[[], None]) -> Iterator[None]:
    """Call `note` on Ctrl-C, SIGTERM and SIGHUP instead of ending the block; has no effect outside the main thread.

    After the block, a SIGTERM or SIGHUP that was noted is raised again, so that its default action, or the handler of
    the program that called mbdkit, takes effect. It is not raised again if `stop_as_by_ctrl_c` had set its handler.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    taken: set[int] = set()

    def take(number: int, frame: FrameType | None) -> None:
        taken.add(number)
        note()

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *_STOPPING)}
    before = {
        number: handler
        for number, handler in before.items()
        if handler is not None and (number == signal.SIGINT or handler is not signal.SIG_IGN)
    }
    for number in before:
        signal.signal(number, take)
    close = _watch_second_sigterm()
    try:
        yield
    finally:
        close()
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in _STOPPING:
            if number in taken and before[number] is not _raise_interrupt:
                signal.raise_signal(number)


def is_interrupt(error: BaseException) -> bool:
    """Return whether an exception is a KeyboardInterrupt that a signal has raised, not code of a plugin by ``raise``.

    Python calls handlers of signals between two instructions, which a `raise` is not.
    """
    import dis

    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if not isinstance(error, KeyboardInterrupt) or trace is None:
        return isinstance(error, KeyboardInterrupt)
    code = trace.tb_frame.f_code
    handlers = [getattr(signal.getsignal(number), "__code__", None) for number in (signal.SIGINT, *_STOPPING)]
    return code in handlers or code.co_code[trace.tb_lasti] != dis.opmap["RAISE_VARARGS"]


def _raise_interrupt(number: int, frame: FrameType | None) -> None:
    global _last
    now = time.monotonic()
    if now - _last >= TOGETHER:
        _last = now
        raise KeyboardInterrupt


def _watch_second_sigterm() -> Callable[[], None]:
    """Let a second SIGTERM end the process, by a thread that all calls share; return a function that stops watching.

    Python calls its signal handlers between two instructions of the main thread. While compiled code runs, such as a
    force law with an endless loop, there is no next instruction. Compiled code releases the interpreter lock, so this
    thread runs nevertheless.
    """
    if sys.platform == "win32":
        return lambda: None
    writing = _watched_pipe(os.getpid())
    before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    if before != -1:  # this process is watched already, or the calling program has its own
        signal.set_wakeup_fd(before, warn_on_full_buffer=False)
        return lambda: None

    def close() -> None:
        signal.set_wakeup_fd(-1)
        os.write(writing, b"\0")  # signals until now do not count in later calls

    return close


@lru_cache(maxsize=1)
def _watched_pipe(process: int) -> int:
    """Return the end of a pipe to which Python writes the numbers of signals; a thread of this process reads them."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    # `threading.Thread.start` waits until the thread runs, which takes milliseconds on a busy machine.
    _thread.start_new_thread(_end_by_second_sigterm, (reading,))
    return writing


def _end_by_second_sigterm(source: int) -> None:
    first: float | None = None
    while number := os.read(source, 1):
        if number[0] == 0:
            first = None
        elif number[0] == signal.SIGTERM:
            if first is None:
                first = time.monotonic()
            elif time.monotonic() - first >= TOGETHER:
                os._exit(INTERRUPTED)
