"""Locks on open files: `flock`, and on Windows `LockFileEx`.

A lock ends when its file is closed, also by the end of its process. It excludes locks of other processes and of other
handles of the same process, but no reading and writing.

The packages filelock and portalocker do not suffice: filelock locks files of its own only. On Windows, portalocker
locks the content of a file, which neither HDF5 nor another process can then read, and needs pywin32 for shared locks.

Objects that one thread may use at a time, such as simulations, refuse meanwhile the calls of other threads.
A lock for which they wait would not help: where threads share a simulation, its time and inputs after a call are not
those that the thread left.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from functools import wraps
from types import ModuleType
from typing import Any, Concatenate, ParamSpec, TypeVar

from mbdkit.base.errors import SpecError

IS_WINDOWS = sys.platform == "win32"

#: Flags with which `open_file` refuses symbolic links, and does not wait for a writer to a pipe.
NO_LINKS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

_PAUSE = 0.02  #: Time between two attempts to lock a file on Windows [s].


def _windows() -> ModuleType:
    """Return the calls of Windows, which other systems need not import; this takes a few milliseconds."""
    from mbdkit.base import windows_calls

    return windows_calls


def open_file(path: str | os.PathLike[str], flags: int) -> int:
    """Open a file as `os.open` does; also on Windows, it may be renamed and removed while it is open.

    `flags`: ``os.O_RDONLY`` or ``os.O_RDWR``; ``os.O_CREAT``, ``os.O_EXCL`` and `NO_LINKS` may be added.
    """
    return int(_windows().open_file(path, flags)) if IS_WINDOWS else os.open(path, flags, 0o666)


def lock(handle: int, *, shared: bool = False, wait: bool = False) -> None:
    """Lock an open file.

    `handle`: descriptor of a file that `open_file` has opened. `shared`: whether other shared locks are allowed.
    `wait`: whether to wait until other locks end. Raises BlockingIOError if there is another lock, and `wait` is not
    set. Raises OSError if the file system does not support locks.
    """
    if not IS_WINDOWS:
        import fcntl

        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))
        return
    while True:
        try:
            _windows().lock(handle, shared=shared)
        except BlockingIOError:
            if not wait:
                raise
            time.sleep(_PAUSE)  # `LockFileEx` can wait too, but Ctrl-C does not end it
        else:
            return


def has_name(handle: int, path: str | os.PathLike[str]) -> bool:
    """Return whether an open file still has the name `path`; False if it has been removed, renamed or replaced."""
    if IS_WINDOWS and _windows().is_removed(handle):
        return False
    try:
        return os.path.samestat(os.fstat(handle), os.lstat(path))
    except FileNotFoundError:
        return False


def is_locked(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is locked, except for shared locks; False if the file cannot be opened or locked at all."""
    try:
        handle = open_file(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        lock(handle, shared=True)  # exclusive locks need write access on some file systems
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(handle)
    return False


def is_kept_by_a_program(path: str | os.PathLike[str]) -> bool:
    """Return whether an existing file cannot be replaced because a program has it open; always False on POSIX."""
    return IS_WINDOWS and bool(_windows().is_open_elsewhere(path))


def unlock(handle: int) -> None:
    """Unlock an open file."""
    if IS_WINDOWS:
        _windows().unlock(handle)
    else:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_UN)


P = ParamSpec("P")
R = TypeVar("R")


class UseLock:
    """Held by the thread that uses an object; copies are locks of their own.

    `refusal`: the sentence for other threads.
    """

    def __init__(self, refusal: str):
        self.refusal = refusal
        lock = threading.RLock()
        self.acquire, self.release = lock.acquire, lock.release

    def __reduce__(self) -> tuple[type[UseLock], tuple[str]]:
        return UseLock, (self.refusal,)


def one_thread_at_a_time(method: Callable[Concatenate[Any, P], R]) -> Callable[Concatenate[Any, P], R]:
    """Let a method of an object with the `UseLock` `in_use` raise SpecError while another thread is in one of them."""

    @wraps(method)
    def exclusive(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> R:
        lock: UseLock = self.in_use
        if not lock.acquire(blocking=False):
            raise SpecError(lock.refusal)
        try:
            return method(self, *args, **kwargs)
        finally:
            lock.release()

    return exclusive
