"""Damage to the cache of compiled kernels: a run is right whatever the cache contains, and the damage is repaired."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tests.engine.few_kernels import ACCELERATION

from .attack import Attack

PROGRAM = ACCELERATION + "print(json.dumps(acceleration()))"
EXPECTED = -2.0


def run(folder: Path, program: str = PROGRAM, **more: Any) -> subprocess.CompletedProcess[str]:
    """Run a program with its cache in a folder; `more` goes to `subprocess.run`."""
    environment = os.environ | {"MBDKIT_CACHE_DIR": str(folder)} | more.pop("env", {})
    return subprocess.run(
        [sys.executable, "-c", program],
        env={name: value for name, value in environment.items() if value},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
        **more,
    )


@cache
def _warm() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="campaign-cache-"))
    assert run(folder).returncode == 0
    return folder


def warm_copy(folder: Path) -> Path:
    """Return a copy of a warm cache in a folder."""
    return Path(shutil.copytree(_warm(), folder / "cache"))


def _problems(done: subprocess.CompletedProcess[str], what: str) -> list[str]:
    if done.returncode != 0 or "Traceback" in done.stderr:
        return [f"{what} ended with exit status {done.returncode}: {done.stderr[-300:]}"]
    if abs(json.loads(done.stdout) - EXPECTED) > 1e-12:
        return [f"{what} computed {done.stdout}"]
    return []


def _no_writing() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))


def damage(random: np.random.Generator, file: Path) -> str:
    """Damage a file, and return what was done."""
    content = bytearray(file.read_bytes())
    match random.integers(7):
        case 0 if content:
            content[random.integers(len(content))] ^= 1 << int(random.integers(8))
            file.write_bytes(content)
            return f"a flipped bit in {file.name}"
        case 1:
            file.write_bytes(content[: random.integers(len(content) + 1)])
            return f"truncation of {file.name}"
        case 2:
            file.unlink()
            return f"deletion of {file.name}"
        case 3:
            file.write_bytes(random.bytes(int(random.integers(1, 5000))))
            return f"garbage in {file.name}"
        case 4:
            file.unlink()
            file.mkdir()
            return f"a folder in place of {file.name}"
        case 5:
            file.write_bytes(bytes(len(content)))
            return f"zeros in {file.name}"
    others = [other for other in file.parent.iterdir() if other.is_file() and other != file]
    other = others[random.integers(len(others))]
    file.write_bytes(other.read_bytes())
    return f"{other.name} in place of {file.name}"


def _damaged(random: np.random.Generator, folder: Path) -> list[str]:
    copy = warm_copy(folder)
    files = sorted(path for path in copy.rglob("*") if path.is_file())
    what = ", ".join(damage(random, files[place]) for place in random.permutation(len(files))[: random.integers(1, 4)])
    found = _problems(run(copy), f"the first run after {what}")
    again = run(copy)
    found += _problems(again, f"the second run after {what}")
    if "damaged" in again.stderr:
        found.append(f"{what} is not repaired")
    return found


def _full(random: np.random.Generator, folder: Path) -> list[str]:
    empty = folder / "cache"
    if random.random() < 0.5:  # a part of the kernels is there
        empty = warm_copy(folder)
        for path in sorted(empty.rglob("*.code"))[:: int(random.integers(1, 4))]:
            path.unlink()
    done = run(empty, preexec_fn=_no_writing)
    found = _problems(done, "a run that cannot write its cache")
    if done.stderr.count("warning") > 2:
        found.append(f"it says so {done.stderr.count('warning')} times")
    left = [path.name for path in empty.rglob(".*") if path.is_file()]
    return [*found, *(f"it leaves {name}" for name in left)]


ATTACKS = (
    Attack("cache", "damaged files of the cache are found, replaced and never executed", 280, _damaged),
    Attack("full-cache", "a run goes on if its cache cannot be written", 10, _full),
)
