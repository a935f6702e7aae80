"""A disk of a few kilobytes, for tests of what happens when it is full."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


def mounted(folder: Path, kilobytes: int) -> bool:
    """Mount a file system in memory on a new folder, and return whether that was possible; it needs to be root."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def unmount(folder: Path) -> None:
    """Unmount it, even if a file is open."""
    subprocess.run(["umount", "-l", str(folder)], check=False)


@contextmanager
def tiny_disk(folder: Path, kilobytes: int) -> Iterator[Path]:
    """Yield `folder`, a disk of this size; skip the test if file systems cannot be mounted here."""
    if not mounted(folder, kilobytes):
        pytest.skip("needs to mount a small file system, which only root may do")
    try:
        yield folder
    finally:
        unmount(folder)
