"""A block whose computation is interrupted goes on from the runs that have been saved, to the same bits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from tests.studies.stored_studies import BASE, GRID

import mbdkit
from mbdkit.archive.fingerprint import datasets
from mbdkit.archive.layout import TIMINGS
from mbdkit_studies.compute import compute_block as compute_block_module
from mbdkit_studies.compute import unfinished_block
from mbdkit_studies.compute.compute_block import compute_block
from mbdkit_studies.compute.unfinished_block import UnfinishedBlock, pieces_of
from mbdkit_studies.folder.folder_lock import Shard
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.spec.study_loading import load_study_spec

ONE_BLOCK = GRID | {"block": 15, "measures": ["misalignment_max", {"low": "min(rod2.y)"}]}
ONE_BLOCK["base"] = BASE | {"time": {"end": 0.1, "step": 0.01}, "limits": {"max_steps": 20}}
COMPUTED = 15
"""Runs of the grid. Some fail, because their steps are so small that `max_steps` ends them."""


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list of the numbers of runs that each later call computes; all of them save each vector of runs."""
    monkeypatch.setattr(unfinished_block, "INTERVAL", 0.0)
    monkeypatch.setattr(unfinished_block, "LARGEST_RATE", np.inf)
    simulate, counts = compute_block_module.simulate_in_any_order, []

    def counted(specs: Any, **options: Any) -> Any:
        counts.append(len(specs))
        return simulate(specs, **options)

    monkeypatch.setattr(compute_block_module, "simulate_in_any_order", counted)
    return counts


def begun(folder: Path, spec: Any = ONE_BLOCK) -> StudyFolder:
    """Return the folder of a study of one block of which nothing has been computed."""
    mbdkit.study(spec, out=folder, shard=Shard(2, 2))
    return StudyFolder(folder)


def interrupt(folder: StudyFolder, monkeypatch: pytest.MonkeyPatch, saves: int) -> None:
    """Compute the block until it has saved runs several times."""
    add = UnfinishedBlock.add

    def interrupted(self: UnfinishedBlock, runs: Any) -> None:
        add(self, runs)
        if len(pieces_of(folder.block(0))) >= saves:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(UnfinishedBlock, "add", interrupted)
        with pytest.raises(KeyboardInterrupt):
            compute_block(folder.path, 0)


def contents(block: Path) -> dict[str, Any]:
    """Return the arrays of a block except for times, as bytes."""
    with h5py.File(block) as file:
        return {
            item.name: item[()].tobytes() if item.dtype.kind != "O" else [str(one) for one in np.ravel(item[()])]
            for item in datasets(file)
            if item.name.rpartition("/")[2] not in (*TIMINGS, "elapsed_s")
        }


@pytest.mark.parametrize("store", ["hashes", "all"])
def test_an_interrupted_block_is_completed_to_the_same_bits(
    store: str, tmp_path: Path, computed: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, whole = (begun(tmp_path / name, ONE_BLOCK | {"store": store}) for name in ("interrupted", "whole"))
    compute_block(whole.path, 0)
    interrupt(folder, monkeypatch, 3)
    interrupt(folder, monkeypatch, 4)
    compute_block(folder.path, 0)
    assert computed[0] == computed[1] == COMPUTED > computed[2] > computed[3] > 0
    assert contents(folder.block(0)) == contents(whole.block(0))
    assert [path.name for path in folder.runs.iterdir()] == ["block-000000.h5"]


def test_runs_of_other_versions_and_truncated_files_are_computed_again(
    tmp_path: Path, computed: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = begun(tmp_path / "s")
    interrupt(folder, monkeypatch, 2)
    (first, second) = sorted(pieces_of(folder.block(0)))
    saved = [len(UnfinishedBlock(folder.block(0), heading(mbdkit_version)).saved()) for mbdkit_version in ("", "0.0.7")]
    assert saved[0] > saved[1] == 0
    for path in (first, second):
        path.write_bytes(path.read_bytes()[:-200])
    compute_block(folder.path, 0)
    assert computed == [COMPUTED, COMPUTED]


def heading(version: str) -> Any:
    study = load_study_spec(ONE_BLOCK)
    now = compute_block_module.surroundings()
    return compute_block_module.BlockHeading(study.sha256(), "all", now | ({"mbdkit": version} if version else {}), {})


def test_saved_runs_are_removed_with_the_study_and_when_their_block_is_complete(
    tmp_path: Path, computed: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = begun(tmp_path / "s")
    interrupt(folder, monkeypatch, 1)
    folder.clear()
    assert not list(folder.runs.iterdir())
    folder = begun(tmp_path / "t")
    compute_block(folder.path, 0)
    (folder.runs / ".block-000000.piece-7").touch()  # the process was killed before it could remove this file
    assert mbdkit.study(ONE_BLOCK, out=folder.path).computed == 0
    assert [path.name for path in folder.runs.iterdir()] == ["block-000000.h5"]
