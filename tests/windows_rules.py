"""The rules of Windows for open files, their locks and their names, as far as Linux can imitate them.

They are taken from Microsoft's documentation of `CreateFileW` (sharing), `LockFileEx`, `MoveFileExW` and `DeleteFileW`.
A file can be renamed or removed only if all who have it open share deletion, which C libraries such as that of HDF5 do
not. A file that is open cannot be replaced at all. Renaming without replacing fails if the new name exists. Folders
cannot be opened. Functions of POSIX are missing.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from mbdkit.base import file_locks, windows_calls

ACCESS_DENIED, SHARING_VIOLATION, LOCK_VIOLATION, FILE_EXISTS, INVALID_PARAMETER = 5, 32, 33, 80, 87

MISSING = ("memfd_create", "O_NOFOLLOW", "O_NONBLOCK", "mkfifo", "sysconf")


def refusal(number: int, path: object) -> OSError:
    """Return the exception that Python raises on Windows for an error of the system."""
    error: OSError = FileExistsError(17, "exists") if number == FILE_EXISTS else PermissionError(13, "refused")
    error.winerror = number  # type: ignore[attr-defined]
    error.filename = str(path)
    return error


class Kernel32:
    """Functions of kernel32 that call those of Linux."""

    def __init__(self) -> None:
        self.last_error = 0
        self.sharing: dict[int, tuple[int, int]] = {}  # identity of the file by descriptor opened here
        self.locks: dict[tuple[int, int], dict[int, bool]] = {}  # by file: whether shared, by descriptor
        self.positions: set[tuple[int, int]] = set()
        for name in [name for name in vars(type(self)) if name[0].isupper()]:
            setattr(self, name, partial(getattr(self, name)))  # methods cannot have the attributes that ctypes needs

    def _failed(self, number: int) -> int:
        self.last_error = number
        return 0

    def CreateFileW(
        self, name: str, access: int, share: int, security: None, disposition: int, flags: int, template: None
    ) -> int:
        if access == 0x10000:  # DELETE
            return self._failed(SHARING_VIOLATION) - 1 if self.is_open(name, also_shared=False) else 0
        mode = os.O_RDWR if access & 0x40000000 else os.O_RDONLY
        mode |= {1: os.O_CREAT | os.O_EXCL, 3: 0, 4: os.O_CREAT}[disposition]
        try:
            if disposition == 1 and os.path.lexists(name):
                raise FileExistsError
            handle = os.open(name, mode, 0o666)
        except FileExistsError:
            return self._failed(FILE_EXISTS) - 1
        except FileNotFoundError:
            return self._failed(2) - 1
        except OSError:
            return self._failed(ACCESS_DENIED) - 1
        for locks in self.locks.values():
            locks.pop(handle, None)  # of a closed file with this descriptor
        if share == 7:
            self.sharing[handle] = identity(handle)
        return handle

    def is_open(self, path: Any, *, also_shared: bool) -> bool:
        """Return whether this process has a file open; unless `also_shared`, such that it may not be removed."""
        try:
            status = os.stat(path, follow_symlinks=False)
        except OSError:
            return False
        for handle in map(int, os.listdir("/proc/self/fd")):
            with contextlib.suppress(OSError):
                file = identity(handle)
                if file == (status.st_dev, status.st_ino) and (also_shared or self.sharing.get(handle) != file):
                    return True
        return False

    def _others(self, handle: int) -> dict[int, bool]:
        """Return the locks on a file by descriptors that are still open, except `handle`."""
        locks = self.locks.setdefault(identity(handle), {})
        for other in list(locks):
            with contextlib.suppress(OSError):
                if identity(other) == identity(handle):
                    continue
            del locks[other]
        return {other: shared for other, shared in locks.items() if other != handle}

    def LockFileEx(self, handle: int, flags: int, zero: int, low: int, high: int, position: Any) -> int:
        self.positions.add((position._obj.Offset, position._obj.OffsetHigh))
        others = self._others(handle)
        shared = not flags & 2
        if others and not (shared and all(others.values())):
            assert flags & 1, "waits forever"
            return self._failed(LOCK_VIOLATION)
        self.locks[identity(handle)][handle] = shared
        return 1

    def UnlockFileEx(self, handle: int, zero: int, low: int, high: int, position: Any) -> int:
        return 1 if self.locks.get(identity(handle), {}).pop(handle, None) is not None else self._failed(158)

    def GetFileInformationByHandleEx(self, handle: int, kind: int, info: Any, size: int) -> int:
        assert (kind, size) == (1, 24)
        info._obj.NumberOfLinks = os.fstat(handle).st_nlink
        return 1

    def GlobalMemoryStatusEx(self, status: Any) -> int:
        if status._obj.dwLength != 64:
            return self._failed(INVALID_PARAMETER)
        status._obj.ullTotalPhys, status._obj.ullAvailPhys = 16 << 30, 5 << 30
        return 1

    def OpenProcess(self, access: int, inherit: bool, number: int) -> int:
        return number if os.path.exists(f"/proc/{number}") else self._failed(INVALID_PARAMETER)

    def WaitForSingleObject(self, handle: int, milliseconds: int) -> int:
        return 258

    def GetProcessTimes(self, handle: int, begin: Any, *rest: Any) -> int:
        begin._obj.dwLowDateTime, begin._obj.dwHighDateTime = handle, 1
        return 1

    def CloseHandle(self, handle: int) -> int:
        return 1


def identity(handle: int) -> tuple[int, int]:
    status = os.fstat(handle)
    return status.st_dev, status.st_ino


class Names:
    """Renaming and removal of files by the rules of Windows."""

    def __init__(self, kernel: Kernel32):
        self.kernel = kernel
        self.link, self.rename, self.remove, self.open = os.link, os.rename, os.unlink, os.open

    def renamed(self, source: Any, target: Any) -> None:
        if self.kernel.is_open(source, also_shared=False):
            raise refusal(SHARING_VIOLATION, source)
        try:
            self.link(source, target)  # unlike renaming, it never replaces a file
        except FileExistsError:
            raise refusal(FILE_EXISTS, target) from None
        self.remove(source)

    def replaced(self, source: Any, target: Any) -> None:
        if self.kernel.is_open(source, also_shared=False):
            raise refusal(SHARING_VIOLATION, source)
        if self.kernel.is_open(target, also_shared=True):
            raise refusal(ACCESS_DENIED, target)
        self.rename(source, target)

    def removed(self, path: Any, **options: Any) -> None:
        if not options and self.kernel.is_open(path, also_shared=False):
            raise refusal(SHARING_VIOLATION, path)
        self.remove(path, **options)

    def opened(self, path: Any, *arguments: Any, **options: Any) -> int:
        if not options and os.path.isdir(path) and not str(path).startswith("/proc"):
            raise refusal(ACCESS_DENIED, path)
        return self.open(path, *arguments, **options)


def obey_windows(monkeypatch: pytest.MonkeyPatch) -> Kernel32:
    """Make this process obey the rules of Windows until the end of a test."""
    kernel = Kernel32()
    names = Names(kernel)
    for name in MISSING:
        monkeypatch.delattr(os, name, raising=False)
    monkeypatch.setitem(sys.modules, "fcntl", None)
    identical = lambda handle, *_: handle  # noqa: E731
    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(open_osfhandle=identical, get_osfhandle=identical))
    monkeypatch.setattr(ctypes, "WinDLL", lambda *_, **__: kernel, raising=False)
    monkeypatch.setattr(ctypes, "get_last_error", lambda: kernel.last_error, raising=False)
    monkeypatch.setattr(ctypes, "FormatError", lambda number: f"error {number}", raising=False)
    monkeypatch.setattr(
        windows_calls,
        "_error",
        lambda path=None: (
            FileNotFoundError(2, "error 2", path) if kernel.last_error == 2 else refusal(kernel.last_error, path)
        ),
    )  # `OSError` takes errors of Windows on Windows only
    monkeypatch.setattr(file_locks, "IS_WINDOWS", True)
    monkeypatch.setattr(file_locks, "NO_LINKS", 0)
    monkeypatch.setattr(os, "rename", names.renamed)
    monkeypatch.setattr(os, "replace", names.replaced)
    for name in ("unlink", "remove"):
        monkeypatch.setattr(os, name, names.removed)
    monkeypatch.setattr(os, "open", names.opened)
    windows_calls._kernel32.cache_clear()
    return kernel
