"""How much memory this machine has to spare, and sizes in words."""

from __future__ import annotations

import os
from pathlib import Path

_MEMINFO = Path("/proc/meminfo")


def available_memory() -> int | None:
    """Return the memory [bytes] that a process can have without swapping; None where the system does not say.

    That is what Linux counts as available, elsewhere all that is installed.
    """
    try:
        for line in _MEMINFO.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # as on Windows
        return None


def in_gib(size: int) -> str:
    """Return a number of bytes in words, such as ``1.5 GiB``."""
    tenths = size * 10 // 2**30
    return f"{tenths // 10:,}.{tenths % 10} GiB" if tenths < 1000 else f"{tenths // 10:,} GiB"
