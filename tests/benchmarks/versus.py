"""Speed of this checkout against another one, in turns within one run: stepping, small runs, cold compilation.

``python -m tests.benchmarks.versus OTHER`` starts one process per checkout, lets both take the same runs in turns, and
prints the ratio of the times, this checkout over the other: the median over all pairs, with its quartiles. Only the
public interface is used, so that OTHER may be an older version. ``--cold`` adds compilation into an empty cache.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

METHODS: dict[str, dict[str, Any]] = {
    "rk-gill": {"name": "rk-gill"},
    "gauss 2": {"name": "gauss", "stages": 2},
    "gauss 3": {"name": "gauss", "stages": 3},
    "radau-iia 3": {"name": "radau-iia", "stages": 3},
    "dop853 adaptive": {"name": "dop853", "adaptive": True, "rtol": 1e-9},
}

STEPS = {1: 100_000, 2: 100_000, 100: 1000, 3000: 20}
"""Steps of one run by number of rods; implicit methods take a quarter of them, adaptive ones as long a time."""

SMALL = {
    "mbdkit": 1,
    "model": {"name": "double-pendulum"},
    "integrator": {"name": "rk-gill"},
    "time": {"steps": 100, "step": 0.01},
}

WORKER = """
import json, sys, time
import mbdkit
for line in sys.stdin:
    spec = json.loads(line)
    begin = time.perf_counter()
    with mbdkit.run(spec) as run:
        run.check()
        wall = run.stats["wall_s"]
    print(json.dumps({"stepping": float(wall), "whole": time.perf_counter() - begin}), flush=True)
"""


class Worker:
    """A process that runs specs with one checkout."""

    def __init__(self, checkout: Path):
        environment = {**os.environ, "PYTHONPATH": str(checkout)}
        self.process = subprocess.Popen(
            [sys.executable, "-c", WORKER], cwd=checkout, env=environment, stdin=-1, stdout=-1, text=True
        )

    def run(self, spec: dict[str, Any]) -> dict[str, float]:
        """Run a spec; return its times [s]."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(spec) + "\n")
        self.process.stdin.flush()
        answer: dict[str, float] = json.loads(self.process.stdout.readline())
        return answer


def chain(n: int, method: str) -> dict[str, Any]:
    """Return the spec of a chain of `n` rods released 40 degrees below the horizontal."""
    steps = STEPS[n] if method == "rk-gill" else max(3, STEPS[n] // 4)
    return {
        "mbdkit": 1,
        "model": {"name": "n-pendulum", "n": n, "length": 20.0, "angle": -0.6981317007977318},
        "integrator": METHODS[method],
        "time": {"end": steps * 0.01, "step": 0.01},
        "output": {"every": 10**7},
    }


def ratios(here: Worker, there: Worker, spec: dict[str, Any], key: str, pairs: int) -> list[float]:
    """Return the ratios of times of `pairs` pairs, in alternating order, after one run of each."""
    here.run(spec)
    there.run(spec)
    found = []
    for i in range(pairs):
        first, second = (here, there) if i % 2 == 0 else (there, here)
        times = {id(first): first.run(spec)[key], id(second): second.run(spec)[key]}
        found.append(times[id(here)] / times[id(there)])
    return found


def cold(checkout: Path) -> float:
    """Return the CPU time [s] of a first run with an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "PYTHONPATH": str(checkout), "MBDKIT_CACHE_DIR": cache}
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        code = f"import mbdkit; mbdkit.run({SMALL!r}).check()"
        subprocess.run(
            [sys.executable, "-c", code], cwd=checkout, env=environment, check=True, stderr=subprocess.DEVNULL
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print the table of ratios."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.versus", description=__doc__)
    parser.add_argument("other", type=Path, help="another checkout of mbdkit")
    parser.add_argument("--pairs", type=int, default=5, help="pairs of runs per pair of processes")
    parser.add_argument("--processes", type=int, default=5, help="pairs of processes; where arrays lie differs in each")
    parser.add_argument("--only", default="", help="a part of the names of the rows to measure")
    parser.add_argument("--cold", action="store_true", help="also compile into an empty cache, three times each")
    asked = parser.parse_args()
    root, other = Path(__file__).resolve().parents[2], asked.other.resolve()
    rows = [(f"n = {n}, {method}", chain(n, method), "stepping") for n in STEPS for method in METHODS]
    rows.append(("small warm run", SMALL, "whole"))
    rows = [row for row in rows if asked.only in row[0]]
    found: dict[str, list[float]] = {name: [] for name, _, _ in rows}
    for _ in range(asked.processes):
        here, there = Worker(root), Worker(other)
        for name, spec, key in rows:
            found[name] += ratios(here, there, spec, key, asked.pairs)
        here.process.stdin.close()
        there.process.stdin.close()
    for name, values in found.items():
        low, middle, high = statistics.quantiles(values, n=4)
        print(f"{name:28s} {middle:6.3f}   ({low:.3f} to {high:.3f})", flush=True)
    if asked.cold:
        times = [(cold(root), cold(other)) for _ in range(3)]
        ratio = statistics.median(a / b for a, b in times)
        print(f"{'cold compilation':28s} {ratio:6.3f}   {times[0][0]:.1f} s of CPU against {times[0][1]:.1f} s")


if __name__ == "__main__":
    main()
