"""Calls of the Windows API (kernel32) that the standard library of Python does not offer.

Each is described in Microsoft's documentation under its name. Files are opened here as `os.open` does it, except that
they may be renamed and removed while they are open. Windows otherwise refuses both.
"""

from __future__ import annotations

import ctypes
import errno
import os
from ctypes import wintypes
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

_windows: Any = ctypes  # on other systems, ctypes has neither `WinDLL` nor `get_last_error`

_DWORD = ctypes.c_uint32  # on other systems, where tests run, `wintypes.DWORD` has 64 bits

_GENERIC_READ, _GENERIC_WRITE, _DELETE = 0x80000000, 0x40000000, 0x00010000
_SHARE_ALL = 1 | 2 | 4  # FILE_SHARE_READ, FILE_SHARE_WRITE, FILE_SHARE_DELETE
_CREATE_NEW, _OPEN_EXISTING, _OPEN_ALWAYS = 1, 3, 4
_FILE_ATTRIBUTE_NORMAL = 0x80

_FILE_STANDARD_INFO = 1

_LOCKFILE_FAIL_IMMEDIATELY, _LOCKFILE_EXCLUSIVE_LOCK = 1, 2
_ERROR_SHARING_VIOLATION, _ERROR_LOCK_VIOLATION, _ERROR_IO_PENDING = 32, 33, 997

_PROCESS_QUERY_LIMITED_INFORMATION, _SYNCHRONIZE = 0x1000, 0x00100000
_WAIT_TIMEOUT = 258


class _Overlapped(ctypes.Structure):
    _fields_ = (
        ("Internal", ctypes.c_size_t),
        ("InternalHigh", ctypes.c_size_t),
        ("Offset", _DWORD),
        ("OffsetHigh", _DWORD),
        ("hEvent", wintypes.HANDLE),
    )


class _StandardInfo(ctypes.Structure):
    _fields_ = (
        ("AllocationSize", ctypes.c_int64),
        ("EndOfFile", ctypes.c_int64),
        ("NumberOfLinks", _DWORD),
        ("DeletePending", wintypes.BOOLEAN),
        ("Directory", wintypes.BOOLEAN),
    )


class _MemoryStatus(ctypes.Structure):
    _fields_ = (
        ("dwLength", _DWORD),
        ("dwMemoryLoad", _DWORD),
        ("ullTotalPhys", ctypes.c_uint64),
        ("ullAvailPhys", ctypes.c_uint64),
        ("ullTotalPageFile", ctypes.c_uint64),
        ("ullAvailPageFile", ctypes.c_uint64),
        ("ullTotalVirtual", ctypes.c_uint64),
        ("ullAvailVirtual", ctypes.c_uint64),
        ("ullAvailExtendedVirtual", ctypes.c_uint64),
    )


_POINTER = ctypes.c_void_p
#: Types of the result and of the arguments. Without them, ctypes would pass handles as integers of 32 bits.
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "CreateFileW": (wintypes.HANDLE, (wintypes.LPCWSTR, *(_DWORD,) * 2, _POINTER, *(_DWORD,) * 2, wintypes.HANDLE)),
    "LockFileEx": (wintypes.BOOL, (wintypes.HANDLE, *(_DWORD,) * 4, _POINTER)),
    "UnlockFileEx": (wintypes.BOOL, (wintypes.HANDLE, *(_DWORD,) * 3, _POINTER)),
    "GetFileInformationByHandleEx": (wintypes.BOOL, (wintypes.HANDLE, ctypes.c_int, _POINTER, _DWORD)),
    "OpenProcess": (wintypes.HANDLE, (_DWORD, wintypes.BOOL, _DWORD)),
    "WaitForSingleObject": (_DWORD, (wintypes.HANDLE, _DWORD)),
    "GetProcessTimes": (wintypes.BOOL, (wintypes.HANDLE, *(_POINTER,) * 4)),
    "CloseHandle": (wintypes.BOOL, (wintypes.HANDLE,)),
    "GlobalMemoryStatusEx": (wintypes.BOOL, (_POINTER,)),
}


@cache
def _kernel32() -> Any:
    library = _windows.WinDLL("kernel32", use_last_error=True)
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def _error(path: str | None = None) -> OSError:
    """Return the error of the last call, of the class that Python uses for it, such as PermissionError."""
    number = _windows.get_last_error()
    return OSError(0, _windows.FormatError(number).strip().rstrip("."), path, number)


def _opened(path: str, access: int, disposition: int) -> int:
    handle: int | None = _kernel32().CreateFileW(
        path, access, _SHARE_ALL, None, disposition, _FILE_ATTRIBUTE_NORMAL, None
    )
    if handle in (None, -1, wintypes.HANDLE(-1).value):  # INVALID_HANDLE_VALUE
        raise _error(path)
    assert handle is not None
    return handle


def open_file(path: str | os.PathLike[str], flags: int) -> int:
    """Open a file as `os.open` does, such that it may be renamed and removed while it is open.

    `flags`: ``os.O_RDONLY`` or ``os.O_RDWR``, with ``os.O_CREAT`` or both ``os.O_CREAT`` and ``os.O_EXCL`` to create
    it. Returns a file descriptor, for bytes. It is not inherited by child processes.
    """
    access = _GENERIC_READ | (_GENERIC_WRITE if flags & os.O_RDWR else 0)
    disposition = _OPEN_EXISTING if not flags & os.O_CREAT else _CREATE_NEW if flags & os.O_EXCL else _OPEN_ALWAYS
    handle = _opened(os.fspath(path), access, disposition)
    descriptor: int = import_module("msvcrt").open_osfhandle(handle, os.O_RDWR if flags & os.O_RDWR else os.O_RDONLY)
    return descriptor


def is_open_elsewhere(path: str | os.PathLike[str]) -> bool:
    """Return whether an existing file is open such that it can be neither renamed nor removed nor replaced."""
    try:
        handle = _opened(os.fspath(path), _DELETE, _OPEN_EXISTING)
    except OSError as error:
        return getattr(error, "winerror", None) == _ERROR_SHARING_VIOLATION
    _kernel32().CloseHandle(handle)
    return False


def _locked_byte() -> _Overlapped:
    """Return the position of the byte that locks cover, which is behind the end of any file.

    No other handle can read or write a locked byte, not even one of the same process, such as that of HDF5.
    """
    return _Overlapped(OffsetHigh=1 << 30)


def lock(descriptor: int, *, shared: bool) -> None:
    """Lock an open file; raise BlockingIOError if a lock of another handle prevents it, and OSError if the file system
    does not support locks.
    """
    handle = import_module("msvcrt").get_osfhandle(descriptor)
    flags = _LOCKFILE_FAIL_IMMEDIATELY | (0 if shared else _LOCKFILE_EXCLUSIVE_LOCK)
    if not _kernel32().LockFileEx(handle, flags, 0, 1, 0, ctypes.byref(_locked_byte())):
        if _windows.get_last_error() in (_ERROR_LOCK_VIOLATION, _ERROR_IO_PENDING):
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        raise _error()


def unlock(descriptor: int) -> None:
    """Unlock an open file. Windows also unlocks closed files, but does not promise to do so at once."""
    handle = import_module("msvcrt").get_osfhandle(descriptor)
    if not _kernel32().UnlockFileEx(handle, 0, 1, 0, ctypes.byref(_locked_byte())):
        raise _error()


def is_removed(descriptor: int) -> bool:
    """Return whether an open file has been removed; some file systems keep its name until it is closed."""
    handle, info = import_module("msvcrt").get_osfhandle(descriptor), _StandardInfo()
    size = ctypes.sizeof(info)
    if not _kernel32().GetFileInformationByHandleEx(handle, _FILE_STANDARD_INFO, ctypes.byref(info), size):
        raise _error()
    return bool(info.DeletePending) or info.NumberOfLinks == 0


def process_start(number: int) -> str:
    """Return when a process started, in units of 100 ns, as text; empty if it has ended or cannot be queried.

    `os.kill(number, 0)`, which checks this on other systems, ends the process on Windows.
    """
    library = _kernel32()
    if not (handle := library.OpenProcess(_PROCESS_QUERY_LIMITED_INFORMATION | _SYNCHRONIZE, False, number)):
        return ""
    try:
        begin, *others = (wintypes.FILETIME() for _ in range(4))
        is_running = library.WaitForSingleObject(handle, 0) == _WAIT_TIMEOUT
        times = (ctypes.byref(begin), *map(ctypes.byref, others))
        if not (is_running and library.GetProcessTimes(handle, *times)):
            return ""
        return str(begin.dwHighDateTime << 32 | begin.dwLowDateTime)
    finally:
        library.CloseHandle(handle)


class Memory(NamedTuple):
    """Memory of the machine [bytes]."""

    installed: int
    available: int


def memory() -> Memory:
    """Return the installed memory, and the part of it that is available without swapping."""
    status = _MemoryStatus(dwLength=ctypes.sizeof(_MemoryStatus))
    if not _kernel32().GlobalMemoryStatusEx(ctypes.byref(status)):
        raise _error()
    return Memory(int(status.ullTotalPhys), int(status.ullAvailPhys))
