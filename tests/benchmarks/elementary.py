"""Errors and times of the elementary functions of the machine code.

``python -m tests.benchmarks.elementary --count 1e8`` compares with MPFR on as many arguments of each function, in
several processes; with names, of these functions alone. The section of `python -m tests.benchmarks` takes 10^6.
"""

from __future__ import annotations

import argparse
import ctypes
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from tests.builder.elementary_cases import CASES, largest_error
from tests.builder.elementary_code import C_LIBRARY, LANES, NUMBERS, built, evaluate

from mbdkit.engine.kernels.elementary import FUNCTIONS
from mbdkit.engine.native.levels import Level, chosen_level
from tests.benchmarks.timing import take_turns

CHUNK = 200_000
TIMED, REPEATS = 4096, 200


def _error(folder: Path, level: Level, task: tuple[str, int]) -> tuple[float, tuple[float, float]]:
    """Return the largest error of a function on a chunk of arguments."""
    name, seed = task
    x, y = CASES[name].arguments(CHUNK, seed)
    return largest_error(CASES[name], x, y, evaluate(*built(folder, level), NUMBERS, name)(x, y))


def _nanoseconds(code: ctypes.CDLL, name: str) -> list[float]:
    """Return the times of one call of the C library, of ours, and of one number in lanes."""
    x, y = np.random.default_rng(0).uniform(0.01, 1.0, (2, TIMED))
    x = 1.0 + x if name == "acosh" else 10.0 * x if name in ("cos", "sin", "tan") else x

    def timed(kind: str) -> float:
        start = time.perf_counter()
        evaluate(code, kind, name)(x, y)
        return time.perf_counter() - start

    found = take_turns({kind: partial(timed, kind) for kind in (C_LIBRARY, NUMBERS, LANES)}, REPEATS)
    return [1e9 * timing.least / TIMED for timing in found.values()]


def elementary(console: Console, names: Sequence[str] = tuple(FUNCTIONS), count: float = 1e6) -> None:
    """Print the largest errors of functions, where they occur, and times per call."""
    level = chosen_level()
    table = Table("function", "error [ulp]", "at", "C library [ns]", f"{level.name} [ns]", "in lanes [ns]")
    with tempfile.TemporaryDirectory() as work, ProcessPoolExecutor() as pool:
        (code,) = built(Path(work), level)
        for name in names:
            tasks = [(name, seed) for seed in range(max(1, round(count / CHUNK)))]
            error, (x, y) = max(pool.map(partial(_error, Path(work), level), tasks))
            at = f"{x!r}, {y!r}" if CASES[name].second else f"{x!r}"
            table.add_row(name, f"{error:.3f}", at, *(f"{one:.1f}" for one in _nanoseconds(code, name)))
    console.print(table)


def main() -> None:
    """Print the table of the functions and the number of arguments that are asked for."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.elementary")
    parser.add_argument("names", nargs="*", default=tuple(FUNCTIONS), help="functions, all by default")
    parser.add_argument("--count", type=float, default=1e6, help="number of arguments of each function")
    given = parser.parse_args()
    elementary(Console(width=140), given.names, given.count)


if __name__ == "__main__":
    main()
