"""Archives under the rules of Windows for open files: written, replaced, refused and resumed."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import h5py
import pytest

import mbdkit
from mbdkit.archive import writer as archive_writer
from mbdkit.archive.archive_check import check
from mbdkit.archive.reader import load
from mbdkit.archive.run_writer import Ending
from mbdkit.base import files
from mbdkit.base.errors import MbdkitError, ResourceError
from mbdkit.runs import run_checkpoint
from tests.forked_process import ForkedProcess
from tests.windows_rules import obey_windows

from .making import STATS, fill, largest, names, writer


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "PATIENCE", 0.05)
    obey_windows(monkeypatch)


@pytest.fixture
def flushed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let HDF5 write rows before the end of a run."""
    monkeypatch.setattr(archive_writer, "FLUSH_INTERVAL", 0.0)


@pytest.mark.usefixtures("windows", "flushed")
def test_a_long_run_replaces_an_archive_at_its_end(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_text("precious")
    into = writer(path, overwrite=True)
    fill(into, 2000, piece=100, after=into.flush_if_due)
    assert path.read_text() == "precious"
    assert (tmp_path / "run.h5.part").stat().st_size > 0
    with pytest.raises(ResourceError, match="in use by another run"):
        writer(path, overwrite=True)
    with pytest.raises(ResourceError, match="a run is still writing this archive"):
        load(tmp_path / "run.h5.part")
    into.finish(Ending("complete", "", STATS, largest(2000, names())))
    assert check(path) == []
    assert os.listdir(tmp_path) == ["run.h5"]


@pytest.mark.usefixtures("windows", "flushed")
def test_a_run_whose_archive_cannot_be_replaced_keeps_its_part(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    into = writer(path)
    fill(into, 11)
    into.finish(Ending("complete", "", STATS, largest(11, names())))
    into = writer(path, overwrite=True)
    fill(into, 300, piece=100, after=into.flush_if_due)
    with (
        h5py.File(path),
        pytest.raises(ResourceError, match=r"run\.h5: this file is open .* Windows cannot replace it"),
    ):
        writer(path, overwrite=True)  # at the start of a run
    with h5py.File(path), pytest.raises(ResourceError, match=r"run\.h5\.part cannot be renamed.*run\.h5 is open in"):
        into.finish(Ending("complete", "", STATS, largest(300, names())))
    assert check(path) == []
    assert check(tmp_path / "run.h5.part") == []
    with mbdkit.resume(tmp_path / "run.h5.part", overwrite=True) as run:  # renames it
        assert len(run.time) == 300
    assert os.listdir(tmp_path) == ["run.h5"]


@pytest.mark.parametrize("limit", [14_000, 200_000, 1_200_000])
def test_a_full_disk_is_reported_and_harms_nothing(tmp_path: Path, limit: int) -> None:
    """There are no files in memory to which HDF5's repeated attempts to write could be redirected."""
    (tmp_path / "run.h5").write_text("precious")

    def write() -> None:
        obey_windows(pytest.MonkeyPatch())
        archive_writer.FLUSH_INTERVAL = 0.0
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        into = writer(Path("run.h5"), overwrite=True)
        try:
            fill(into, 2000, piece=100, after=into.flush_if_due)
            into.finish(Ending("complete", "", STATS, largest(2000, names())))
        except MbdkitError as error:
            print(error)
            into.abandon()

    process = ForkedProcess(write, tmp_path)
    said = "".join(process.communicate(60.0))
    process.kill()
    assert process.returncode == 0, said  # no crash in HDF5
    assert "run.h5 cannot be written: File too large" in said
    assert (tmp_path / "run.h5").read_text() == "precious"
    part = tmp_path / "run.h5.part"
    assert part.exists() == ("the data up to the last flush are in run.h5.part" in said) == (limit > 1_000_000)
    if part.exists():
        with load(part) as run:
            assert len(run.time) >= 100


@pytest.mark.usefixtures("windows")
def test_a_killed_run_that_another_program_has_open_is_resumed_once_it_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_checkpoint, "INTERVAL", 0.0)
    spec = {
        "mbdkit": 1,
        "model": {"name": "single-pendulum"},
        "integrator": {"name": "rk4"},
        "time": {"steps": 20_000, "step": 1e-4},
    }
    part = tmp_path / "run.h5.part"

    def kill(now: float, end: float) -> None:
        if now > 0.5 * end and not copies:
            copies.update({file.name: file.read_bytes() for file in tmp_path.iterdir()})

    copies: dict[str, bytes] = {}
    with mbdkit.run(spec, archive=tmp_path / "run.h5", progress=kill) as run:
        whole = run.data_sha256
    (tmp_path / "run.h5").unlink()
    for name, content in copies.items():
        (tmp_path / name).write_bytes(content)
    with part.open("rb"), pytest.raises(ResourceError, match=r"run\.h5\.part is open in this or another program"):
        mbdkit.resume(part)
    with mbdkit.resume(part) as run:
        assert run.data_sha256 == whole
    assert os.listdir(tmp_path) == ["run.h5"]
