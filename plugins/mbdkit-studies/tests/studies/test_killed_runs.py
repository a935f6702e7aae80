"""A study continues a run that was killed, or repeats it if its checkpoint is damaged."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

import mbdkit
from mbdkit.archive.part_file import checkpoint_path
from mbdkit.spec import load_spec
from mbdkit_studies.compute import worker
from tests.runs.resuming.killed_runs import killed


@pytest.mark.parametrize("is_damaged", [False, True], ids=["whole", "damaged checkpoint"])
def test_a_study_continues_its_killed_run(tmp_path: Path, is_damaged: bool) -> None:
    part = tmp_path / "run.h5.part"
    spec = load_spec("double-pendulum", integrator={"name": "rk4"}, time={"steps": 20_000, "step": 1e-4}, events={})
    assert killed(json.loads(spec.canonical_json()), part, checkpoints=3, delay=0.0)
    if is_damaged:
        checkpoint_path(part).write_bytes(b"damaged")
    path = part.with_suffix("")
    answer = worker._work({"spec": spec.canonical_json(), "path": str(path), "measures": []}, print)
    assert answer == {"status": "complete", "reason": ""}
    with mbdkit.load(path) as run:
        assert run.provenance.get("resumed", 0) == (0 if is_damaged else 1)
        assert run.data_sha256 == mbdkit.run(spec).data_sha256
    assert os.listdir(tmp_path) == ["run.h5"]
