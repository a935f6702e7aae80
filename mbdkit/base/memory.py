"""Available memory of the machine."""

from __future__ import annotations

import os
from pathlib import Path

from mbdkit.base import file_locks
from mbdkit.base.text import counted

_MEMINFO = Path("/proc/meminfo")


def available_memory() -> int | None:
    """Return the memory available without swapping [bytes]; None if unknown.

    On macOS, this is the installed memory.
    """
    if file_locks.IS_WINDOWS:
        from mbdkit.base import windows_calls

        return windows_calls.memory().available
    try:
        for line in _MEMINFO.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass
    return installed_memory()


def installed_memory() -> int | None:
    """Return the installed memory [bytes]; None if unknown."""
    if file_locks.IS_WINDOWS:
        from mbdkit.base import windows_calls

        return windows_calls.memory().installed
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return None


def in_bytes(size: int) -> str:
    """Format a number of bytes as ``1.5 GiB``, or in a smaller unit."""
    for power, unit in ((30, "GiB"), (20, "MiB"), (10, "KiB")):
        tenths = size * 10 >> power
        if tenths >= 10:
            return f"{tenths // 10:,}.{tenths % 10} {unit}" if tenths < 1000 else f"{tenths // 10:,} {unit}"
    return counted(size, "byte")
