"""Studies on a Dask cluster and in jobs of submitit, whose workers, scheduler or machines fail while they compute."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from functools import cache
from pathlib import Path

import h5py
import numpy as np
from tests.studies.clusters import DaskCluster, LocalJobs, dask_cluster

import mbdkit

from .attack import Attack
from .specs import pendulum

PATIENCE = 240.0
"""Time for a study on a cluster to end [s]."""

ASLEEP = 4.0
"""Time that a hanging worker sleeps [s]."""

RUNS = 24

STUDY = {
    "mbdkit_study": 1,
    "base": pendulum(end=30.0, step=0.0005) | {"output": {"every": 100}},
    "store": "histories",
    "block": 2,
    "axes": [{"model.length": {"linspace": [1.0, 2.0, RUNS]}}],
}
"""Twelve blocks of some tenths of a second."""


@cache
def whole() -> str:
    """Return the hash of the index of the study that nobody disturbs."""
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        mbdkit.study(STUDY, out=Path(folder) / "out", workers=2)
        return index_hash(Path(folder) / "out")


def index_hash(folder: Path) -> str:
    """Return the hash of the index of a study without its times."""
    with h5py.File(folder / "index.h5") as file:
        return str(file.attrs["data_sha256"])


def start(folder: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start the study in a process of its own."""
    (folder / "study.json").write_text(json.dumps(STUDY))
    command = [sys.executable, "-m", "mbdkit", "study", "study.json", "-o", "out", "--quiet", *options]
    with (folder / "said").open("wb") as said:
        return subprocess.Popen(command, cwd=folder, stdout=said, stderr=said)


def wait_for_blocks(process: subprocess.Popen[bytes], folder: Path, count: int) -> None:
    """Wait until some blocks are there, or the study has ended."""
    until = time.monotonic() + PATIENCE
    while len(list((folder / "out" / "runs").glob("block-*.h5"))) < count and time.monotonic() < until:
        if process.poll() is not None:
            return
        time.sleep(0.01)


def problems(process: subprocess.Popen[bytes], folder: Path, what: str, statuses: tuple[int, ...]) -> list[str]:
    """Return what did not hold: the study ends, and with the call that follows it has the undisturbed index."""
    try:
        status = process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return [f"{what}: the study did not end in {PATIENCE:.0f} s"]
    said = (folder / "said").read_text(errors="replace")
    found = [f"{what}: it ended with {status}: {said[-300:]}"] if status not in statuses else []
    if "Traceback (most recent call last)" in said or "bug in mbdkit" in said:
        found.append(f"{what}: it ended with an exception of its own: {said[-300:]}")
    if found:
        return found
    if status:
        study = mbdkit.study(folder / "study.json", out=folder / "out", workers=2)
        found += [f"{what}: the next call left {study.unfinished}"] if study.unfinished else []
    if index_hash(folder / "out") != whole():
        found.append(f"{what}: the study differs from the undisturbed one")
    left = sorted(os.listdir(folder / "out" / "runs"))
    if left != [f"block-{number:06d}.h5" for number in range(RUNS // 2)]:
        found.append(f"{what}: it left {left}")
    return found


def hang(cluster: DaskCluster, random: np.random.Generator) -> None:
    """Stop a worker for some seconds."""
    worker = cluster.workers[int(random.integers(len(cluster.workers)))]
    worker.send_signal(signal.SIGSTOP)

    def go_on() -> None:
        time.sleep(ASLEEP)
        with contextlib.suppress(OSError):
            worker.send_signal(signal.SIGCONT)

    threading.Thread(target=go_on, daemon=True).start()


def dask(random: np.random.Generator, folder: Path) -> list[str]:
    """Kill a worker, all workers or the scheduler of a Dask cluster, or stop a worker for some seconds."""
    what = ("a worker is killed", "all workers are killed", "the scheduler is killed", "a worker hangs")[
        int(random.integers(4))
    ]
    whole()
    with dask_cluster(folder) as cluster:
        process = start(folder, *cluster.options)
        wait_for_blocks(process, folder, int(random.integers(1, 8)))
        time.sleep(random.uniform(0, 0.3))
        if what == "a worker is killed":
            cluster.kill_worker()
        elif what == "all workers are killed":
            for _ in range(len(cluster.workers)):
                cluster.kill_worker()
        elif what == "the scheduler is killed":
            cluster.scheduler.kill()
        else:
            hang(cluster, random)
        # without scheduler, the runs that are missing are reported, and the next call computes them
        return problems(process, folder, what, (0, 3) if what == "the scheduler is killed" else (0,))


def submitit(random: np.random.Generator, folder: Path) -> list[str]:
    """Kill jobs of submitit's local executor."""
    jobs = LocalJobs(folder, jobs=3)
    whole()
    process = start(folder, *jobs.options)
    wait_for_blocks(process, folder, int(random.integers(1, 8)))
    kills = int(random.integers(1, 3))
    for _ in range(kills):
        time.sleep(random.uniform(0, 0.3))
        jobs.kill_worker()
    return problems(process, folder, f"{kills} kills of jobs", (0, 3))


ATTACKS = (
    Attack("dask", "a Dask cluster loses workers or its scheduler, or a worker hangs: nothing is lost", 40, dask),
    Attack("submitit", "jobs of submitit's local executor are killed: nothing is lost", 20, submitit),
)
