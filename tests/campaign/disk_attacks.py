"""Full disks under every command that writes."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np

from tests.tiny_disk import mounted, unmount

from .archive_attacks import command_in_child, small_archive
from .attack import Attack, command
from .specs import pendulum

WRITERS: dict[str, tuple[str, ...]] = {
    "run": ("run", "spec.json", "-o", "DISK/old.h5", "--overwrite"),
    "equilibrium": ("equilibrium", "spec.json", "--write", "DISK/old.yaml", "--overwrite"),
    "kinematics": ("kinematics", "driven.json", "-o", "DISK/old.csv", "--overwrite"),
    "modes": ("modes", "spec.json", "-o", "DISK/old.png", "--overwrite"),
    "plot": ("plot", "run.h5", "-o", "DISK/old.png", "--overwrite"),
    "plot.svg": ("plot", "run.h5", "-o", "DISK/old.svg", "--overwrite"),
    "plot.pdf": ("plot", "run.h5", "-o", "DISK/old.pdf", "--overwrite"),
    "animate.gif": ("animate", "run.h5", "-o", "DISK/old.gif", "--overwrite"),
    "animate.html": ("animate", "run.h5", "-o", "DISK/old.html", "--overwrite"),
    "report": ("report", "run.h5", "-o", "DISK/old.html", "--overwrite"),
    "report --figures": ("report", "run.h5", "-o", "page.html", "--figures", "DISK/old", "--overwrite"),
    "rerun": ("rerun", "run.h5", "-o", "DISK/old.h5", "--overwrite"),
    "examples copy": ("examples", "copy", "knee", "-o", "DISK/new.yaml"),
    "study": ("study", "study.json", "-o", "DISK/study", "--workers", "1"),
    "plugins new": ("plugins", "new", "DISK/rocket", "--kind", "model"),
}
"""The commands that write a file; every one but the last three replaces a file that is there."""

IN_PROCESSES = {"study"}  # starts processes of its own


def full_disk(random: np.random.Generator, folder: Path) -> list[str]:
    """Write onto a disk with little space left."""
    name = list(WRITERS)[int(random.integers(len(WRITERS)))]
    return fill(name, int(random.integers(0, 80)), folder)


def fill(name: str, free: int, folder: Path) -> list[str]:
    """Return what did not hold when a command wrote onto a disk with `free` kilobytes left."""
    driven = {
        "mbdkit": 1,
        "model": {
            "name": "mechanism",
            "bodies": {"crank": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}},
            "joints": {
                "A": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0, 0], [-0.5, 0]]},
                "D": {"type": "driver", "bodies": ["ground", "crank"], "coordinate": "angle", "motion": "t"},
            },
        },
        "integrator": {"name": "rk4"},
        "time": {"end": 1.0, "step": 0.001},
    }
    (folder / "spec.json").write_text(json.dumps(pendulum(end=2.0, step=0.001)))
    (folder / "driven.json").write_text(json.dumps(driven))
    study = {"mbdkit_study": 1, "base": pendulum(), "axes": {"time.step": [0.01, 0.02, 0.04]}}
    (folder / "study.json").write_text(json.dumps(study))
    (folder / "run.h5").write_bytes(small_archive())
    disk = folder / "disk"
    if not mounted(disk, 400):
        return ["no file system can be mounted here: run this attack as root"]
    try:
        for suffix in (".h5", ".yaml", ".csv", ".png", ".svg", ".pdf", ".gif", ".html"):
            (disk / f"old{suffix}").write_text("precious")
        (disk / "old").mkdir()
        space = shutil.disk_usage(disk).free - 1024 * free
        (disk / "ballast").write_bytes(bytes(max(0, space)))
        before = {path.name for path in disk.iterdir()}
        words = [word.replace("DISK", str(disk)) for word in WRITERS[name]]
        if name in IN_PROCESSES:
            ending = command(*words, folder=folder, seconds=60)
        else:
            ending = command_in_child(*words, folder=folder, seconds=30)
        what = f"{name} onto a disk with {free} kB"
        # slow is not wrong here: the work itself takes time
        found = [text for text in ending.problems(what=what) if " took " not in text or "MiB" in text]
        if ending.exit_status not in (0, None):
            found += _harmed(disk, before, name, what)
        found += [f"{what} left {path.name}" for path in disk.iterdir() if path.name.startswith(".")]
        return found
    finally:
        unmount(disk)


def _harmed(disk: Path, before: set[str], name: str, what: str) -> list[str]:
    """Return what a failed command has harmed or left; the .part of a run may hold its first rows."""
    found = [
        f"{what} failed, and changed {path.name}"
        for path in disk.glob("old.*")
        if path.suffix != ".part" and path.read_text(errors="replace") != "precious"
    ]
    left = {path.name for path in disk.iterdir()} - before - {"old.h5.part", "old.h5.part.checkpoint", "study"}
    found += [f"{what} failed, and left {entry}" for entry in sorted(left)]
    if name == "study":
        for path in (disk / "study").rglob("*"):
            if path.is_file() and path.suffix != ".part" and os.path.getsize(path) == 0:
                found.append(f"{what} left an empty {path.name}")
    return found


ATTACKS = (
    Attack("disks", "a full disk under each writing command: a sentence, and every old file as it was", 200, full_disk),
)
