"""The packaged study `paper` and an ensemble of 20,000 runs on a Dask cluster and in jobs, while workers are killed."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from rich.console import Console
from rich.table import Table
from tests.studies.clusters import Cluster, LocalJobs, dask_cluster, disturbed

import mbdkit

RUNS = 20_000

PENDULUM = {
    "mbdkit": 1,
    "model": {"name": "double-pendulum"},
    "integrator": {"name": "rk4"},
    "time": {"steps": 150, "step": 0.01},
}


def _paper(**options: Any) -> mbdkit.Study:
    return mbdkit.study("paper", notify=lambda text: None, **options)


def _ensemble(**options: Any) -> mbdkit.Study:
    angles = np.random.default_rng(1).uniform(-1.0, 1.0, RUNS)
    return mbdkit.ensemble(PENDULUM, {"model.angles.0": angles}, **options)


def _hash(folder: Path) -> str:
    """Return the hash of an index without its times."""
    with h5py.File(folder / "index.h5") as file:
        return str(file.attrs["data_sha256"])


@contextlib.contextmanager
def _clusters(folder: Path) -> Iterator[dict[str, Cluster]]:
    with dask_cluster(folder) as dask:
        yield {"dask": dask, "submitit": LocalJobs(folder, jobs=8)}


def executors(console: Console) -> None:
    """Print whether executors give the index of local processes, and their times; two workers of each are killed."""
    table = Table("study", "executor", "runs", "seconds", "workers killed", "unfinished", "index as of local processes")
    with tempfile.TemporaryDirectory(prefix="executors-") as name, _clusters(Path(name)) as clusters:
        for study in (_ensemble, _paper):
            start = time.perf_counter()
            what = study.__name__.strip("_")
            local = study(out=Path(name) / f"{what}-local", workers=2)
            table.add_row(what, "local", f"{len(local.points)}", f"{time.perf_counter() - start:.0f}", "0", "", "")
            for engine, cluster in clusters.items():
                out = Path(name) / f"{what}-{engine}"
                start = time.perf_counter()
                with cluster.executor() as executor:
                    found, killed = disturbed(
                        cluster,
                        out / "runs",
                        lambda study=study, out=out, executor=executor: study(out=out, executor=executor),
                    )
                seconds = f"{time.perf_counter() - start:.0f}"
                same = "the same" if _hash(out) == _hash(local.folder) else "different"
                table.add_row(
                    what, engine, f"{len(found.points)}", seconds, f"{killed}", f"{len(found.unfinished)}", same
                )
    console.print(table)
