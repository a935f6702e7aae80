"""Ensembles of double pendulums with all that belongs to them: specs, measures, verdicts, hashes, blocks and the index.

``python -m tests.benchmarks.whole_ensembles --runs 100000`` prints wall time and processor time, memory and size on
disk of `mbdkit.ensemble` in two processes, and beside it what others take for the same number of runs: MuJoCo's
`rollout`, which keeps states only, a pool of processes that call `mbdkit.run`, and one that calls SciPy's `solve_ivp`.
Slow ones take a part of the runs. Their times are scaled to the number asked for.
"""

from __future__ import annotations

import argparse
import functools
import importlib.util
import resource
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit.archive.finished_run import ArrayHash, FinishedRun
from mbdkit.spec import RunSpec
from mbdkit_studies.compute.batch import simulate_batch

from .contenders import MUJOCO, G

WORKERS = 2
RUNS = 20_000
END, STEPS = 1.5, 150
BASE: dict[str, Any] = {
    "mbdkit": 1,
    "model": {"name": "double-pendulum", "angles": [0.0, 0.0]},
    "integrator": {"name": "rk4"},
    "time": {"end": END, "step": END / STEPS},
}
GAUSS: dict[str, Any] = {"integrator": {"name": "gauss", "stages": 2}, "time": {"end": 5.0, "step": 0.01}}
RADAU: dict[str, Any] = {"integrator": {"name": "radau-iia", "adaptive": True, "rtol": 1e-8}, "time": {"end": 5.0}}


def angles(runs: int) -> np.ndarray:
    """Return the initial angles of the rods, (N, 2) [rad]."""
    return np.random.default_rng(1).uniform(-1.0, 1.0, (runs, 2))


def by_ensemble(runs: int, store: Any, **sections: Any) -> float:
    """Run an ensemble, and return its size on disk [bytes a run]."""
    first, second = angles(runs).T
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "ensemble"
        variables = {"model.angles.0": first, "model.angles.1": second}
        study = mbdkit.ensemble(BASE | sections, variables, store=store, out=out, workers=WORKERS)
        assert not study.failures
        return sum(path.stat().st_size for path in out.rglob("*") if path.is_file()) / runs


def by_rollout(runs: int) -> float:
    """Run MuJoCo's RK4 in threads; it keeps states in memory and nothing else."""
    import mujoco
    from mujoco import rollout

    model = mujoco.MjModel.from_xml_string(MUJOCO.format(step=END / STEPS, inertia=1.0 / 12.0))
    data = [mujoco.MjData(model) for _ in range(WORKERS)]
    starts = np.zeros((runs, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    first, second = angles(runs).T
    starts[:, 1], starts[:, 2] = first, second - first
    rollout.rollout(model, data, starts, nstep=STEPS)
    return np.nan


def _single(pair: tuple[float, float]) -> float:
    return mbdkit.run(BASE | {"model": {"name": "double-pendulum", "angles": list(pair)}}).misalignment_max


def _rate(t: float, state: np.ndarray) -> list[float]:
    a, b, u, v = state
    coupling, sine = 0.5 * np.cos(a - b), 0.5 * np.sin(a - b)
    first = -1.5 * G * np.cos(a) - sine * v * v
    second = -0.5 * G * np.cos(b) + sine * u * u
    determinant = 4.0 / 9.0 - coupling * coupling
    return [
        u,
        v,
        (first / 3.0 - coupling * second) / determinant,
        (second * 4.0 / 3.0 - coupling * first) / determinant,
    ]


def _by_solve_ivp(pair: tuple[float, float]) -> float:
    from scipy.integrate import solve_ivp

    times = np.linspace(0.0, END, STEPS + 1)
    return float(solve_ivp(_rate, (0.0, END), [*pair, 0.0, 0.0], "DOP853", times, rtol=1e-8, atol=1e-8).y[0, -1])


def by_pool(runs: int, one: Callable[[tuple[float, float]], float]) -> float:
    """Call a function for each run in a pool of processes."""
    with ProcessPoolExecutor(WORKERS, get_context("spawn")) as pool:
        list(pool.map(one, map(tuple, angles(runs)), chunksize=50))
    return np.nan


def hashing(runs: int = 200) -> float:
    """Return the time [s] that the hash of the data takes for each run of the ensemble."""
    specs = [RunSpec(**BASE | {"model": {"name": "double-pendulum", "angles": list(pair)}}) for pair in angles(runs)]
    finished = [run for run in simulate_batch(specs) if isinstance(run, FinishedRun)]
    hashes = ArrayHash(finished[0].names, finished[0].layout)
    begin = time.process_time()
    assert [hashes.of(run.arrays) for run in finished] == [run.data_sha256 for run in finished]
    return (time.process_time() - begin) / runs


def _used() -> float:
    """Return the processor time of this process and of those that it has waited for [s]."""
    return sum(
        used.ru_utime + used.ru_stime
        for used in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def contenders(runs: int) -> dict[str, tuple[int, Callable[[], float]]]:
    """Return number of runs and function of each contender, by name."""
    few = max(1, runs // 20)
    found: dict[str, tuple[int, Callable[[], float]]] = {
        "rk4, store summary": (runs, functools.partial(by_ensemble, runs, "summary")),
        "rk4, store hashes": (runs, functools.partial(by_ensemble, runs, "hashes")),
        "rk4, store all": (4 * few, functools.partial(by_ensemble, 4 * few, "all")),
        "gauss 2, 500 steps, summary": (2 * few, functools.partial(by_ensemble, 2 * few, "summary", **GAUSS)),
        "radau-iia, adaptive, 5 s, summary": (2 * few, functools.partial(by_ensemble, 2 * few, "summary", **RADAU)),
        "pool of processes, mbdkit.run": (few, functools.partial(by_pool, few, _single)),
        "pool of processes, SciPy DOP853": (few, functools.partial(by_pool, few, _by_solve_ivp)),
    }
    if importlib.util.find_spec("mujoco"):
        found["MuJoCo rk4, rollout, states only"] = runs, functools.partial(by_rollout, runs)
    return found


def whole_ensembles(console: Console, runs: int = RUNS) -> None:
    """Print what ensembles cost, all included."""
    table = Table(title=f"{runs} runs of a double pendulum, {STEPS} steps of rk4, in {WORKERS} processes or threads")
    table.add_column("contender")
    for heading in ("runs", "ms of processor a run", f"s for {runs}", "largest process [MB]", "bytes a run"):
        table.add_column(heading, justify="right")
    by_ensemble(64, "summary")  # loads what is compiled
    share = hashing()
    for name, (count, contender) in contenders(runs).items():
        begin, used = time.perf_counter(), _used()
        size = contender()
        wall, spent = time.perf_counter() - begin, _used() - used
        largest = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        table.add_row(
            name, str(count), f"{1e3 * spent / count:.3f}", f"{wall * runs / count:.1f}", f"{largest / 1024:.0f}",
            "" if np.isnan(size) else f"{size:.0f}",
        )  # fmt: skip
    console.print(table)
    console.print(f"Hashing the data of a run of rk4 takes {1e3 * share:.3f} ms of these.")


def main() -> None:
    """Print the table for a number of runs."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.whole_ensembles", description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS)
    whole_ensembles(Console(width=160), parser.parse_args().runs)


if __name__ == "__main__":
    main()
