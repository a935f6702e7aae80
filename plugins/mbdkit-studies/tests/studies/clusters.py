"""A Dask cluster on this machine, and jobs of submitit's local executor, whose workers can be killed."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Protocol

PATIENCE = 120.0
"""Time for processes to begin or to end [s]."""


class Cluster(Protocol):
    """Something that computes studies in processes of its own.

    Attributes
    ----------
    options
        The options of `mbdkit study` that choose it.
    """

    options: list[str]

    def executor(self) -> contextlib.AbstractContextManager[Any]:
        """Return what is passed to `mbdkit.study`."""
        ...

    def kill_worker(self) -> bool:
        """Kill a process that computes; return whether there was one."""
        ...


class DaskCluster:
    """A scheduler and workers with one thread each, as separate processes; a killed worker is replaced."""

    def __init__(self, folder: Path):
        self.folder, self.file = folder, folder / "scheduler.json"
        self.options = ["--executor", "dask", "--scheduler", str(self.file)]
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", "0")
        self.workers: list[subprocess.Popen[bytes]] = []

    def _start(self, what: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", "--scheduler-file", str(self.file)]
        with (self.folder / f"{what}.log").open("ab") as log:
            return subprocess.Popen([*command, "--no-dashboard", *options], stdout=log, stderr=log)

    def add_worker(self) -> None:
        """Start another worker."""
        self.workers.append(self._start("worker", "--nthreads", "1", "--no-nanny"))

    @contextlib.contextmanager
    def executor(self) -> Iterator[Executor]:
        """Yield the executor of a client of the cluster."""
        from distributed import Client

        with Client(scheduler_file=str(self.file), timeout=PATIENCE, set_as_default=False) as client:
            yield client.get_executor(pure=False)

    def kill_worker(self) -> bool:
        """Kill a worker, and start another one."""
        victim = self.workers.pop(random.randrange(len(self.workers)))
        victim.kill()
        victim.wait()
        self.add_worker()
        return True

    def end(self) -> None:
        """End all processes."""
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


class LocalJobs:
    """Jobs of submitit that are processes of this machine."""

    def __init__(self, folder: Path, jobs: int = 4):
        self.folder, self.jobs = folder, jobs
        self.options = ["--executor", "submitit", "--scheduler", "local", "--workers", str(jobs)]

    @contextlib.contextmanager
    def executor(self) -> Iterator[Executor]:
        """Yield an executor that divides tasks into few jobs."""
        import submitit

        from mbdkit_studies.compute.executors import SubmititExecutor

        executor = submitit.AutoExecutor(folder=self.folder / "logs", cluster="local")
        executor.update_parameters(timeout_min=60)
        yield SubmititExecutor(lambda: executor, self.jobs)

    def kill_worker(self) -> bool:
        """Kill the process of a job whose files are in the folder."""
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                command = (process / "cmdline").read_bytes().decode(errors="replace")
                if "submitit.core._submit" in command and str(self.folder) in command:
                    found.append(int(process.name))
        with contextlib.suppress(OSError):
            if found:
                os.kill(random.choice(found), signal.SIGKILL)
                return True
        return False


@contextlib.contextmanager
def dask_cluster(folder: Path, workers: int = 2) -> Iterator[DaskCluster]:
    """Yield a Dask cluster whose scheduler has begun."""
    cluster = DaskCluster(folder)
    try:
        until = time.monotonic() + PATIENCE
        while not cluster.file.exists() and time.monotonic() < until:
            time.sleep(0.05)
        for _ in range(workers):
            cluster.add_worker()
        yield cluster
    finally:
        cluster.end()


def disturbed(cluster: Cluster, runs: Path, compute: Callable[[], Any], kills: int = 2) -> tuple[Any, int]:
    """Compute a study while workers are killed, and return what `compute` returns and the number of kills.

    Parameters
    ----------
    runs
        Folder for the files of the runs; a worker is killed whenever some more files are there.
    """
    has_ended, killed = threading.Event(), 0

    def kill() -> None:
        nonlocal killed
        files = 0
        while killed < kills and not has_ended.wait(0.01):
            now = len(list(runs.glob("*.h5")))
            if now > files and not has_ended.wait(random.uniform(0.0, 0.2)) and cluster.kill_worker():
                killed += 1
                files = now

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        value = compute()
    finally:
        has_ended.set()
        killer.join()
    return value, killed
