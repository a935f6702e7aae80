"""Large runs, studies, mechanisms and tables: their time, memory and files stay within limits.

`SIZE` is the share of the full sizes, which the reduced campaign of the ordinary tests makes small.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from tests.browser import executable, launched

from .attack import Attack, Ending, wait_for
from .folder_attacks import INVERSE
from .specs import pendulum

SIZE = 1.0
"""Share of the sizes of the whole campaign."""

HOURS = 3600.0
"""Time for a large computation [s]."""

MIB = 1 << 20


def _mbdkit(folder: Path, *arguments: str) -> Ending:
    """Run a command in a process of its own; memory is that of this process alone, without its workers."""
    return _process(folder, "-m", "mbdkit", *arguments)


def _process(folder: Path, *arguments: str) -> Ending:
    start = time.monotonic()
    with (folder / ".err").open("wb") as errors:
        child = subprocess.Popen([sys.executable, *arguments], cwd=folder, stdout=errors, stderr=errors)
        status, memory, cpu = wait_for(child.pid, start + HOURS)
        child.returncode = -9 if status is None else status
    told = (folder / ".err").read_text(errors="replace")
    return Ending(status, time.monotonic() - start, memory, errors=told, cpu=cpu)


def _failed(ending: Ending, what: str, most: int) -> list[str]:
    """Return what did not hold: exit status 0, and a memory of at most `most` MiB."""
    if ending.exit_status != 0:
        return [f"{what} ended with {ending.exit_status}: {ending.errors[-300:]}"]
    if ending.memory > most * MIB:
        return [f"{what} took {ending.memory / MIB:.0f} MiB, more than {most}"]
    return []


def long_run(random: np.random.Generator, folder: Path) -> list[str]:
    """Make five million steps with 50,000 rows: memory is that of a run a hundredth as long."""
    memory = []
    for name, steps in (("short", 50_000 * SIZE), ("long", 5_000_000 * SIZE)):
        spec = pendulum() | {"time": {"steps": int(steps), "step": 1e-4}, "output": {"every": 100}}
        (folder / f"{name}.json").write_text(json.dumps(spec))
        ending = _mbdkit(folder, "run", f"{name}.json", "-o", f"{name}.h5", "--quiet")
        if found := _failed(ending, f"a run of {steps:.0f} steps", 1000):
            return found
        memory.append(ending.memory)
    if memory[1] > memory[0] + 32 * MIB:
        return [f"the long run took {memory[1] / MIB:.0f} MiB, the short one {memory[0] / MIB:.0f} MiB"]
    return []


MEMBERS = """\
import sys, json, numpy as np, mbdkit
count = int(sys.argv[1])
study = mbdkit.ensemble(json.loads(sys.argv[2]), {"model.length": np.linspace(1.0, 2.0, count)},
                        store="summary", out="out", workers=2)
assert study.status == "complete" and len(study.points) == count
"""


def members(random: np.random.Generator, folder: Path) -> list[str]:
    """Compute 20,000 members with two workers: the process that starts them stays below 400 MiB."""
    count = max(20, int(20_000 * SIZE))
    ending = _process(folder, "-c", MEMBERS, str(count), json.dumps(pendulum()))
    return _failed(ending, f"an ensemble of {count} members", 400)


def bodies(random: np.random.Generator, folder: Path) -> list[str]:
    """Report a run of 500 bodies: the page has less than 20 MB, and opens in 5 s."""
    count = max(10, int(500 * SIZE))
    spec = pendulum() | {"model": {"name": "n-pendulum", "n": count}, "title": "many"}
    (folder / "spec.json").write_text(json.dumps(spec | {"time": {"end": 0.2, "step": 0.001}}))
    found = _failed(_mbdkit(folder, "run", "spec.json", "-o", "run.h5", "--quiet"), f"a run of {count} bodies", 1000)
    if found:
        return found
    found = _failed(_mbdkit(folder, "report", "run.h5", "-o", "run.html"), f"the report of {count} bodies", 1000)
    if found:
        return found
    size = (folder / "run.html").stat().st_size
    if size > 20e6:
        found.append(f"the report of {count} bodies has {size / 1e6:.1f} MB")
    browser = executable()
    if browser is not None:
        with launched(browser) as opened:
            start = time.monotonic()
            opened.new_page().goto(f"file://{folder}/run.html")
            taken = time.monotonic() - start
        if taken > 5.0:
            found.append(f"the report of {count} bodies opens in {taken:.1f} s")
    return found


def columns(random: np.random.Generator, folder: Path) -> list[str]:
    """Read tables of a million columns and of a million rows: they are used, or refused, with a sentence."""
    count = max(1000, int(1_000_000 * SIZE))
    shapes = {"columns": (30, count // 10), "many columns": (6, count), "rows": (count, 3), "cells": (count // 2, 40)}
    name = list(shapes)[int(random.integers(len(shapes)))]
    rows, width = shapes[name]
    suffix = ("csv", "sto", "trc")[int(random.integers(3))]
    names = ["time", "angle", *(f"c{index}" for index in range(width - 2))]
    between = "," if suffix == "csv" else "\t"
    rest = (between + "0") * (width - 2)
    with (folder / f"motion.{suffix}").open("w") as file:
        if suffix == "sto":
            file.write("motion\nversion=1\nendheader\n")
        if suffix == "trc":
            markers = "\t".join(f"{one}\t\t" for one in names[1:])
            file.write(f"PathFileType\t4\nUnits\nm\nFrame#\tTime\t{markers}\n\n")
        else:
            file.write(between.join(names) + "\n")
        for row in range(rows):
            file.write(f"{0.001 * row:.3f}{between}{1e-3 * np.sin(0.01 * row):.9f}{rest}\n")
    motion = {**INVERSE["motion"], "file": f"motion.{suffix}"}
    (folder / "inverse.json").write_text(json.dumps({**INVERSE, "motion": motion}))
    ending = _mbdkit(folder, "inverse", "inverse.json", "-o", "out.h5")
    what = f"a .{suffix} with {rows} rows of {width} cells"
    if ending.exit_status == 2 and "Traceback" not in ending.errors and "bug in mbdkit" not in ending.errors:
        return [] if ending.memory < 3000 * MIB else [f"{what} took {ending.memory / MIB:.0f} MiB"]
    return _failed(ending, what, 3000)


ATTACKS = (
    Attack("long-run", "five million steps at constant memory", 1, long_run),
    Attack("members", "20,000 members: the process that starts the workers stays below 400 MiB", 1, members),
    Attack("bodies", "500 bodies: the report has less than 20 MB and opens in 5 s", 1, bodies),
    Attack("columns", "tables of a million columns or rows: used or refused within 3 GiB", 12, columns),
)
