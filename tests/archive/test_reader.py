"""What is no archive is refused with a sentence; what a crashed run left is read."""

from __future__ import annotations

from pathlib import Path

import h5py
import pytest

from mbdkit.archive.archive_check import check
from mbdkit.archive.fingerprint import seal
from mbdkit.archive.reader import load
from mbdkit.base.errors import ArchiveError, SpecError

from .making import fill, writer


def refusal(path: Path) -> str:
    """Return the sentence with which `load` refuses a path, checked to carry its name."""
    with pytest.raises((SpecError, ArchiveError)) as caught:
        load(path)
    assert caught.value.file == str(path)
    return caught.value.message


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    assert "folder" in refusal(tmp_path)
    assert refusal(tmp_path / "run.h5") == "there is no such file"
    (tmp_path / "run.h5.part").touch()
    assert "run.h5.part holds the data of an unfinished run" in refusal(tmp_path / "run.h5")


@pytest.mark.parametrize("content", [b"", b"time,angle\n0,1\n", b"\x89PNG\r\n"])
def test_file_of_another_kind_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "run.h5").write_bytes(content)
    assert refusal(tmp_path / "run.h5") == "this is not an HDF5 file, so not a run archive"
    assert check(tmp_path / "run.h5") == ["this is not an HDF5 file, so not a run archive"]


@pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
def test_truncated_archive_is_refused(archive: Path, share: float) -> None:
    whole = archive.read_bytes()
    archive.write_bytes(whole[: int(share * len(whole))])
    assert "truncated" in refusal(archive)
    (problem,) = check(archive)
    assert "truncated" in problem


def test_hdf5_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = [1, 2]
    assert refusal(tmp_path / "other.h5") == "this is not a run archive but an HDF5 file of another kind"
    with h5py.File(tmp_path / "other.h5", "a") as file:
        file.attrs["format"] = "mbdkit-study"
    assert refusal(tmp_path / "other.h5") == "this is not a run archive but of the format 'mbdkit-study'"


@pytest.mark.parametrize("version", ["2.0", "10.0", "0.9", "one", ""])
def test_other_major_version_is_refused(archive: Path, version: str) -> None:
    with h5py.File(archive, "r+") as file:
        file.attrs["format_version"] = version
    assert f"format version {version}, this mbdkit reads 1.x" in refusal(archive)


def test_later_minor_version_is_read(archive: Path) -> None:
    with h5py.File(archive, "r+") as file:
        file.attrs["format_version"] = "1.7"
        file["trajectory/more"] = [1.0]
        file["stats"].attrs["more"] = "words"
        seal(file)
    assert check(archive) == []
    with load(archive) as run:
        assert run.format_version == "1.7"
        assert len(run.time) == 11
        assert run.to_xarray()["trajectory/more"].dims == ("more_0",)


def test_part_that_was_not_begun_says_so(tmp_path: Path) -> None:
    into = writer(tmp_path / "run.h5")
    fill(into, 11)
    assert into._target is not None
    into._target.close()  # as a crash before the first flush
    assert "the run was killed before it wrote any rows" in refusal(tmp_path / "run.h5.part")


def test_part_without_a_row_is_read_as_empty(tmp_path: Path) -> None:
    into = writer(tmp_path / "run.h5")
    into._write_more()
    assert into._target is not None
    into._target.close()  # as a crash during the first flush
    (problem,) = check(tmp_path / "run.h5.part")
    assert problem.startswith("the run did not end")
    with load(tmp_path / "run.h5.part") as run:
        assert run.status == "running"
        assert run.time.shape == (0,)
        assert run["rod1"].position.shape == (0, 2)
        assert run.joints["J2"].reaction_force.shape == (0, 2)
        assert run.energy.total.shape == (0,)
        assert run.steps.size.shape == (0,)
        assert run.misalignment_max == 0.0
        assert "no row recorded" in run.summary()
        assert not run.records("constraints/method_multiplier")
