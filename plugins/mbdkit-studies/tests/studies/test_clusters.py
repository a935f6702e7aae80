"""Studies on a real Dask cluster and in jobs of submitit: the index of local processes, also if workers are killed."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.studies.clusters import Cluster, LocalJobs, dask_cluster, disturbed
from tests.studies.stored_studies import index_hash
from tests.studies.study_of_executors import BASE

import mbdkit

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")]

PART = ["--shard", "1/20", "--quiet"]
"""A twentieth of the packaged study, 24 runs or so; `python -m tests.benchmarks executors` takes all of it."""


@pytest.fixture(params=["dask", "submitit"])
def cluster(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Cluster]:
    pytest.importorskip("distributed" if request.param == "dask" else "submitit", reason="an extra of mbdkit")
    if request.param == "submitit":
        yield LocalJobs(tmp_path)
    else:
        with dask_cluster(tmp_path) as there:
            yield there


def test_a_packaged_study_has_the_index_of_local_processes(cluster: Cluster, tmp_path: Path) -> None:
    for options, folder in ((["--workers", "2"], "local"), (cluster.options, "there")):
        command = [sys.executable, "-m", "mbdkit", "study", "paper", "-o", str(tmp_path / folder), *PART, *options]
        subprocess.run(command, check=True)
    assert index_hash(tmp_path / "there") == index_hash(tmp_path / "local")
    assert sorted(path.name for path in (tmp_path / "there").iterdir()) == ["index.h5", "runs", "study.yaml"]


def test_killed_workers_cost_nothing(cluster: Cluster, tmp_path: Path) -> None:
    out = tmp_path / "there"

    def compute(**options: object) -> mbdkit.Study:
        angles = {"model.angles.0": np.linspace(-1.0, 1.0, 240)}
        return mbdkit.ensemble(BASE, angles, block=20, measures=["energy_balance_max"], **options)

    local = compute(out=tmp_path / "local", workers=2)
    with cluster.executor() as executor:
        study, killed = disturbed(cluster, out / "runs", lambda: compute(out=out, executor=executor))
    assert killed == 2
    assert (study.status, study.unfinished) == ("complete", ())
    assert index_hash(out) == index_hash(local.folder)
    assert sorted(path.name for path in (out / "runs").iterdir()) == [f"block-{number:06d}.h5" for number in range(12)]
