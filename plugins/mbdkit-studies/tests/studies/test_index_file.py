"""The file of an index is whole, and what changed in it is found."""

from __future__ import annotations

from pathlib import Path

import h5py
import pytest

from mbdkit.archive.fingerprint import data_sha256
from mbdkit.base.errors import ArchiveError, MbdkitError
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.store import study_index
from mbdkit_studies.store.study_index import Index, Row
from tests.tiny_disk import tiny_disk

SPEC = load_study_spec({"mbdkit_study": 1, "base": "pendulum", "axes": [{"time.step": [0.01]}]})


def index(count: int) -> Index:
    return Index.of_rows([Row(f"run{number}", "missing") for number in range(count)], [], {})


def test_a_changed_value_is_found(tmp_path: Path) -> None:
    path = tmp_path / "index.h5"
    study_index.write(path, SPEC, index(3))
    assert len(study_index.read(path)) == 3
    with h5py.File(path, "r+") as file:
        file["runs/status"][1] = "complete"
    with pytest.raises(ArchiveError, match="data_sha256 does not match"):
        study_index.read(path)


def test_columns_of_different_lengths_are_damage(tmp_path: Path) -> None:
    path = tmp_path / "index.h5"
    study_index.write(path, SPEC, index(3))
    with h5py.File(path, "r+") as file:
        del file["runs/status"]
        file["runs"].create_dataset("status", data=["complete"], dtype=h5py.string_dtype())
        file.attrs["data_sha256"] = data_sha256(file)
    with pytest.raises(ArchiveError, match="this file is damaged"):
        study_index.read(path)


def test_a_full_disk_leaves_the_previous_index(tmp_path: Path) -> None:
    with tiny_disk(tmp_path / "disk", 300) as disk:
        path = disk / "index.h5"
        study_index.write(path, SPEC, index(1))
        with pytest.raises(MbdkitError, match="No space left"):
            study_index.write(path, SPEC, index(5000))
        assert len(study_index.read(path)) == 1
        assert [file.name for file in disk.iterdir()] == ["index.h5"]
