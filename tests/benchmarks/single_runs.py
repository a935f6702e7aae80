"""Times of small runs in a process that has run before: in memory, with an archive, and prepared, and their parts.

``python -m tests.benchmarks.single_runs`` prints processor times, the least of many runs, ten of each kind by
turns, because other processes slow runs down. Parts are measured in further runs and contain their own measurement.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit.archive.run import Run
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.engine import consistent_start
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.runs import finish, preparation, run_record, simulated_run, simulation
from mbdkit.runs.recorder import Recorder
from mbdkit.spec.model_spec import ModelSpec

SPEC: dict[str, Any] = {
    "mbdkit": 1,
    "model": {"name": "double-pendulum", "lengths": [1.0, 1.0]},
    "integrator": {"name": "rk4"},
    "time": {"end": 1.5, "step": 0.01},
}
PARTS: dict[str, list[tuple[Any, str]]] = {
    "validation of the spec": [(simulation, "load_spec")],
    "building the model": [(ModelSpec, "_build")],
    "warnings about the spec": [(simulation, "findings")],
    "compilation to arrays": [(consistent_start, "compile_mechanism")],
    "assembly": [(consistent_start, "search_for"), (consistent_start, "assemble")],
    "working arrays": [(consistent_start, "Workspace")],
    "redundancy": [(preparation, "require_unique_start")],
    "start of the method": [(preparation, "start_method")],
    "steps": [(CompiledStepper, "advance")],
    "recording, with accelerations and reactions": [(run_record, "Recorder"), (Recorder, "record")],
    "evidence and verdict": [(simulated_run, "conclude")],
    "provenance": [(finish, "provenance"), (run_record, "provenance")],
    "archive: begun": [(run_record, "ArchiveWriter")],
    "archive: finished": [(ArchiveWriter, "finish")],
}


def kinds(folder: Path) -> dict[str, Callable[[float], Run]]:
    """Return functions that run a double pendulum with a mass, by name."""
    prepared = mbdkit.prepare(SPEC)

    def spec(mass: float) -> dict[str, Any]:
        return SPEC | {"model": SPEC["model"] | {"masses": [1.0, mass]}}

    return {
        "in memory": lambda mass: mbdkit.run(spec(mass)),
        "with an event": lambda mass: mbdkit.run(spec(mass) | {"events": {"low": {"when": "rod1.angle + pi/2"}}}),
        "with an archive": lambda mass: mbdkit.run(spec(mass), archive=folder / "run.h5", overwrite=True),
        "prepared": lambda mass: prepared.run({"model.masses.1": mass}),
    }


def least_times(runs: dict[str, Callable[[float], Run]], repeats: int) -> dict[str, tuple[float, float]]:
    """Return the least processor times of a whole run and of its steps, by kind [s]."""
    found = dict.fromkeys(runs, (float("inf"), float("inf")))
    for _, (name, run), number in itertools.product(range(repeats // 10), runs.items(), range(10)):
        begin = time.process_time()
        with run(1.0 + 0.001 * number) as made:
            whole, steps = time.process_time() - begin, float(made.stats["cpu_s"])
        found[name] = min(found[name][0], whole), min(found[name][1], steps)
    return found


@contextmanager
def timed(spent: dict[str, float]) -> Iterator[None]:
    """Add the wall time of each part to `spent`, without that of parts within it."""
    within: list[float] = []

    def wrapped(part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any, **named: Any) -> Any:
            within.append(0.0)
            begin = time.perf_counter()
            try:
                return function(*given, **named)
            finally:
                took = time.perf_counter() - begin
                spent[part] += took - within.pop()
                if within:
                    within[-1] += took

        return call

    with ExitStack() as stack:
        for part, places in PARTS.items():
            for owner, name in places:
                stack.enter_context(patch.object(owner, name, _as_method(owner, wrapped(part, getattr(owner, name)))))
        yield


def _as_method(owner: Any, call: Callable[..., Any]) -> Any:
    return (lambda self, *given, **named: call(self, *given, **named)) if isinstance(owner, type) else call


def least_parts(run: Callable[[float], Run], repeats: int) -> dict[str, float]:
    """Return the least time of each part of a run [s]."""
    least: dict[str, float] = defaultdict(lambda: float("inf"))
    for number in range(repeats):
        spent: dict[str, float] = defaultdict(float)
        with timed(spent):
            run(1.0 + 0.001 * number).close()
        for part, took in spent.items():
            least[part] = min(least[part], took)
    return least


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=100)
    repeats, console = parser.parse_args().repeats, Console()
    with tempfile.TemporaryDirectory() as folder:
        runs = kinds(Path(folder))
        table = Table("a run of 150 steps of rk4", "ms", "without the steps and their recording, ms")
        found = least_times(runs, repeats)
        steps = found["in memory"][1]  # those of prepared runs are counted for eight runs, of which seven are empty
        for name, (whole, _) in found.items():
            table.add_row(name, f"{1e3 * whole:.2f}", f"{1e3 * (whole - steps):.2f}")
        console.print(table)
        parts = {name: least_parts(runs[name], repeats) for name in ("in memory", "with an archive")}
    table = Table("part", *(f"{name}, ms" for name in parts))
    for part in PARTS:
        if any(part in one for one in parts.values()):
            table.add_row(part, *(f"{1e3 * one[part]:.2f}" if part in one else "" for one in parts.values()))
    console.print(table)


if __name__ == "__main__":
    main()
