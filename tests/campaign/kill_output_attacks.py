"""Kills of every command that writes a file or folder: old files stay, and the same command then succeeds."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np

from .attack import Attack, wait_for
from .folder_attacks import COMMANDS, unsound, whole, work_here, write_specs
from .kill_attacks import PATIENCE, finish, said, start_command

REPLACING = {"run", "inverse", "report", "report.md", "plot", "animate", "equilibrium", "rerun"}
"""The commands that write one file, and here replace an old one."""


def _words(name: str) -> list[str]:
    words = [word.replace("OUT", "place") for word in COMMANDS[name]]
    return [*words, "--overwrite"] if name in REPLACING else words


def start_here(folder: Path, *arguments: str) -> int:
    """Start a command that computes studies and designs without worker processes; return the id of its process."""
    return start_command(folder, *arguments, prepare=work_here)


@cache
def _seconds(name: str) -> float:
    """Return the time that a command takes if nobody disturbs it [s]."""
    whole()
    with tempfile.TemporaryDirectory(prefix="campaign-") as path:
        folder = Path(path)
        write_specs(folder)
        (folder / "place").mkdir()
        start = time.monotonic()
        assert not (found := finish(folder, *_words(name), start=start_here)), found
        return time.monotonic() - start


def kill(random: np.random.Generator, folder: Path) -> list[str]:
    """Kill a command, and call it again."""
    name = list(COMMANDS)[int(random.integers(len(COMMANDS)))]
    words, seconds = _words(name), _seconds(name)
    write_specs(folder)
    place = folder / "place"
    place.mkdir()
    target = place / Path(next(word for word in words if word.startswith("place/"))).name
    if name in REPLACING:
        target.write_text("precious")
    child = start_here(folder, *words)
    time.sleep(random.uniform(0, seconds))
    os.kill(child, signal.SIGKILL)
    status, *_ = wait_for(child, time.monotonic() + PATIENCE)
    if status not in (-signal.SIGKILL, 0):
        return [f"{name} ended with {status}: {said(folder)}"]
    found = []
    if name in REPLACING and (not target.is_file() or (status and target.stat().st_size < 8)):
        found.append(f"{name} was killed, and its old file is gone or cut")
    elif name in ("run", "inverse", "rerun") and target.read_bytes() != b"precious":
        found += unsound(place, name)
    left = [path.name for path in place.iterdir() if path != target and not _is_temporary(path.name, target.name)]
    if left:
        found.append(f"{name} was killed, and left {', '.join(left)}")
    if name == "export" and target.is_dir() and "--overwrite" not in words:
        words = [*words, "--overwrite"]
    found += finish(folder, *words, start=start_here)
    left = [path.name for path in place.iterdir() if path != target]
    if left and not found:
        found.append(f"the second call of {name} left {', '.join(left)}")
    return found or unsound(place, name)


def _is_temporary(name: str, target: str) -> bool:
    return name.startswith((".", f"{target}.part"))


ATTACKS = (
    Attack("kill-output", "SIGKILL to a command that writes: old files stay, and the next call succeeds", 300, kill),
)
