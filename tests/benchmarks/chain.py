"""RK-Gill on the n-rod pendulum against the same in hand-written C, and how time and memory grow with n."""

from __future__ import annotations

import functools
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import mbdkit

from .timing import take_turns

STEPS = {1: 5000, 10: 2000, 30: 2000, 100: 1000, 300: 400, 1000: 200, 3000: 80}
REPEATS = 9
STAGES = 4
FLAGS = ["-O3", "-march=native"]


def spec(rods: int, steps: int, integrator: dict[str, Any]) -> dict[str, Any]:
    """Return the chain released from the horizontal; only its start and end are recorded."""
    model: dict[str, Any] = {"name": "n-pendulum", "n": rods}
    return {
        "mbdkit": 1,
        "model": model,
        "integrator": integrator,
        "time": {"steps": steps, "step": 0.001 if rods > 4 else 0.01},
        "output": {"every": steps, "quantities": []},
    }


def compiled(folder: Path) -> Path | None:
    """Return the compiled C program, or None where there is no gcc."""
    compiler = shutil.which("gcc")
    if compiler is None:
        return None
    program = folder / "chain_limit"
    source = Path(__file__).with_name("chain_limit.c")
    subprocess.run([compiler, *FLAGS, "-o", str(program), str(source), "-lm", "-D_GNU_SOURCE"], check=True)
    return program


def by_c(program: Path, rods: int, steps: int, seen: dict[str, float]) -> float:
    """Return the seconds that C took; leave the first rod's x in `seen`."""
    text = subprocess.run([program, str(rods), str(steps)], check=True, capture_output=True, text=True).stdout
    match = re.search(r"([\d.]+) ms .*y0 (\S+)\)", text)
    if match is None:
        raise RuntimeError(f"chain_limit printed something else: {text!r}")
    seen["C"] = float(match[2])
    return float(match[1]) / 1e3


def by_mbdkit(rods: int, steps: int, integrator: dict[str, Any], seen: dict[str, float]) -> float:
    """Return the seconds from the first step to the last; leave the first rod's x in `seen`."""
    run = mbdkit.run(spec(rods, steps, integrator))
    run.check()
    seen["mbdkit"] = float(run["rod1"].position[-1, 0])
    return float(run.stats["wall_s"])


def explicit(console: Console) -> None:
    """Print time per body and evaluation of RK-Gill beside hand-written C."""
    table = Table(
        title=f"RK-Gill on the n-rod pendulum, time per body and evaluation: medians of {REPEATS}, taking turns"
    )
    for heading in ("n", "steps", "C [ns]", "mbdkit [ns]", "ratio", "x of rod 1: C", "mbdkit"):
        table.add_column(heading, justify="right")
    cost: dict[int, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        program = compiled(Path(folder))
        for rods, steps in STEPS.items():
            seen: dict[str, float] = {}
            contenders: dict[str, Callable[[], float]] = {
                "mbdkit": functools.partial(by_mbdkit, rods, steps, {"name": "rk-gill"}, seen)
            }
            if program is not None:
                contenders["C"] = functools.partial(by_c, program, rods, steps, seen)
            timings = take_turns(contenders, REPEATS)
            unit = STAGES * steps * rods * 1e-9
            cost[rods] = timings["mbdkit"].median / unit
            row = [str(rods), str(steps), "no gcc", f"{cost[rods]:.1f}", "", "", f"{seen['mbdkit']:.6g}"]
            if program is not None:
                row[2] = f"{timings['C'].median / unit:.1f}"
                row[4] = f"{timings['mbdkit'].median / timings['C'].median:.2f}"
                row[5] = f"{seen['C']:.6g}"
            table.add_row(*row)
    table.caption = f"gcc {' '.join(FLAGS)}; per body, n = 3000 against n = 30: {cost[3000] / cost[30]:.2f}"
    console.print(table)


def implicit(console: Console) -> None:
    """Print time per body and step of gauss-2 and gauss-3 with Newton."""
    table = Table(
        title="Gauss collocation with Newton on the n-rod pendulum: time per body and step, iterations per step"
    )
    for heading in ("n", "steps", "gauss-2 [us]", "iterations", "gauss-3 [us]", "iterations"):
        table.add_column(heading, justify="right")
    for rods, steps in STEPS.items():
        steps = max(20, steps // 4)
        row = [str(rods), str(steps)]
        for stages in (2, 3):
            taken: list[float] = []
            for _ in range(4):
                run = mbdkit.run(spec(rods, steps, {"name": "gauss", "stages": stages}))
                run.check()
                taken.append(float(run.stats["wall_s"]))
            row += [f"{min(taken) / rods / steps * 1e6:.2f}", f"{run.stats['newton_iterations'] / steps:.2f}"]
        table.add_row(*row)
    table.caption = "least of 4 runs; h = 0.001 s (0.01 s at n = 1)"
    console.print(table)


# The resource usage of a child begins with what its parent had in memory; the kernel's own peak does not.
MEASURE = """
import pathlib, re, resource, sys, mbdkit
run = mbdkit.run({spec!r})
run.check()
status = pathlib.Path("/proc/self/status")
if status.exists():
    print(int(re.search(r"VmHWM:\\s+(\\d+) kB", status.read_text())[1]) / 1024)
else:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 1024))
"""


def memory(console: Console) -> None:
    """Print the largest resident memory of a process that runs a chain."""
    table = Table(title="Memory of a whole process [MiB] (largest resident set)")
    for heading in ("n", "rk-gill", "gauss-2", "gauss-3"):
        table.add_column(heading, justify="right")
    for rods in (1, 1000, 10000):
        row = [str(rods)]
        for integrator in ({"name": "rk-gill"}, {"name": "gauss", "stages": 2}, {"name": "gauss", "stages": 3}):
            code = MEASURE.format(spec=spec(rods, 5, integrator))
            done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
            row.append(f"{float(done.stdout):.0f}")
        table.add_row(*row)
    console.print(table)
