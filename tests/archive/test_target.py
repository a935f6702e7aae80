"""No file is ever damaged: names, locks, renaming, full disks."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import h5py
import pytest

from mbdkit.archive import writer as archive_writer
from mbdkit.archive.archive_check import check
from mbdkit.archive.disk_space import check_room
from mbdkit.archive.part_file import check_target
from mbdkit.archive.reader import load
from mbdkit.archive.run_writer import Ending
from mbdkit.base.errors import MbdkitError, ResourceError, SpecError
from tests.forked_process import ForkedProcess

from .making import STATS, fill, largest, make, names, writer

HERE = Path(__file__).parent
as_root = pytest.mark.skipif(hasattr(os, "getuid") and os.getuid() == 0, reason="root may write everywhere")


def run_python(script: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a script that can import `making`, in a folder."""
    head = f"import sys; sys.path.insert(0, {str(HERE)!r}); import making; from pathlib import Path\n"
    return subprocess.run(
        [sys.executable, "-c", head + textwrap.dedent(script)],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize(
    ("free", "words"),
    [
        (0, "is full: 0 bytes are free, and the archive takes about 3.5 KiB"),
        (3 << 20, "10,000 rows of 360 bytes take 3.4 MiB, but only 3.0 MiB are free"),
        (2 << 30, "10,000,000 rows of 360 bytes take 3.3 GiB, but only 2.0 GiB are free"),
    ],
)
def test_sizes_are_told_in_units_that_suit_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: int, words: str
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=free, total=1 << 40))
    rows = 10 if free == 0 else 10_000 if free < 1 << 30 else 10_000_000
    with pytest.raises(ResourceError, match=words):
        check_room(tmp_path / "run.h5", rows, 360, None)


def test_an_archive_that_is_larger_than_the_whole_disk_may_be_written_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=1 << 16, total=1 << 16))
    with pytest.raises(ResourceError, match=r"is full: 64\.0 KiB are free, and the archive takes about 3\.4 MiB"):
        check_room(tmp_path / "run.h5", 10_000, 360, None)
    monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=1 << 30, total=1 << 30))
    with pytest.raises(ResourceError, match=r"output\.every: 10,000,000 rows"):
        check_room(tmp_path / "run.h5", 10_000_000, 360, 1)
    with pytest.raises(SpecError, match=r"output\.every: .* 1\.0 GiB are free"):
        check_room(tmp_path / "run.h5", 1 << 50, 360, 1)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("run", "ends in .h5: write run.h5"),
        ("run.hdf5", "ends in .h5: write run.h5"),
        ("missing/run.h5", "the folder missing does not exist"),
        ("file/run.h5", "the folder file is not a folder"),
        (".", "this is a folder"),
        ("folder.h5", "this is a folder"),
        ("there.h5", "exists already"),
        ("dangling.h5", "not a regular file"),
        ("n" * 300 + ".h5", "File name too long"),
    ],
)
def test_wrong_names_are_refused_and_nothing_is_left(in_tmp_path: Path, name: str, words: str) -> None:
    Path("file").touch()
    Path("folder.h5").mkdir()
    Path("there.h5").write_text("precious")
    Path("dangling.h5").symlink_to("nowhere")
    before = sorted(os.listdir())
    with pytest.raises(SpecError, match=words) as caught:
        writer(Path(name))
    assert caught.value.file == str(Path(name))
    assert sorted(os.listdir()) == before


@as_root
def test_folder_without_permission_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(ResourceError, match="cannot be written to"):
            check_target(tmp_path / "run.h5")
    finally:
        tmp_path.chmod(0o700)


def test_overwriting_replaces_only_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_text("precious")
    into = writer(path, overwrite=True)
    fill(into, 11)
    assert path.read_text() == "precious"
    into.finish(Ending("complete", "", STATS, largest(11, names())))
    assert check(path) == []
    assert os.listdir(tmp_path) == ["run.h5"]


def test_abandoned_run_leaves_the_former_archive(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_text("precious")
    into = writer(path, overwrite=True)
    fill(into, 11)
    into.abandon()
    assert path.read_text() == "precious"
    assert os.listdir(tmp_path) == ["run.h5"]


def test_file_that_appears_meanwhile_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    into = writer(path)
    fill(into, 11)
    path.write_text("precious")
    with pytest.raises(MbdkitError, match=r"was created during the run.*run\.h5\.part"):
        into.finish(Ending("complete", "", STATS, largest(11, names())))
    assert path.read_text() == "precious"
    assert check(tmp_path / "run.h5.part") == []


def test_file_systems_without_hard_links_will_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    make(tmp_path / "run.h5")
    assert check(tmp_path / "run.h5") == []
    assert os.listdir(tmp_path) == ["run.h5"]
    into = writer(tmp_path / "next.h5")
    (tmp_path / "next.h5").write_text("precious")
    with pytest.raises(MbdkitError, match="was created during the run"):
        into.finish(Ending("complete", "", STATS, largest(0, names())))
    assert (tmp_path / "next.h5").read_text() == "precious"


@pytest.mark.parametrize("left", [b"", b"half an archive"])
def test_part_of_a_dead_run_is_replaced(tmp_path: Path, left: bytes) -> None:
    (tmp_path / "run.h5.part").write_bytes(left)
    make(tmp_path / "run.h5")
    assert os.listdir(tmp_path) == ["run.h5"]


def test_part_that_is_no_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run.h5.part").mkdir()
    with pytest.raises(SpecError, match="not a regular file"):
        writer(tmp_path / "run.h5")


@pytest.mark.parametrize("locking", ["BEST_EFFORT", "FALSE"])
def test_part_of_another_live_process_is_refused(tmp_path: Path, locking: str) -> None:
    script = """
        import os, subprocess
        into = making.writer(Path("run.h5"))
        if "second" not in os.environ:
            done = subprocess.run([sys.executable, *sys.orig_argv[1:]], env={**os.environ, "second": "yes"})
            making.fill(into, 11)
            into.finish(making.Ending("complete", "", making.STATS, making.largest(11, making.names())))
            sys.exit(0 if done.returncode == 1 else 3)
    """
    done = run_python(script, tmp_path, HDF5_USE_FILE_LOCKING=locking)
    assert done.returncode == 0, done.stderr
    assert "ResourceError: run.h5: run.h5.part is in use by another run" in done.stderr
    assert check(tmp_path / "run.h5") == []


def test_part_is_locked_until_it_has_its_final_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    link = os.link
    refused = []

    def late(source: Path, target: Path) -> None:
        with pytest.raises(ResourceError, match="in use by another run") as caught:
            writer(tmp_path / "run.h5")
        refused.append(caught.value)
        link(source, target)

    monkeypatch.setattr(os, "link", late)
    make(tmp_path / "run.h5")
    assert refused
    assert check(tmp_path / "run.h5") == []


def test_live_part_is_not_read(tmp_path: Path) -> None:
    into = writer(tmp_path / "run.h5")
    with pytest.raises(ResourceError, match=r"run\.h5\.part: a run is still writing this archive"):
        load(tmp_path / "run.h5.part")
    into.abandon()


def written_until_full(folder: Path, limit: int, interval: float) -> tuple[int, str]:
    """Write 2000 rows, which take more than a megabyte, in a process whose files may have `limit` bytes, which stands
    in for a full disk. Return the status of the process and what it says.

    Parameters
    ----------
    interval
        Time between flushes [s].
    """

    def write() -> None:
        archive_writer.FLUSH_INTERVAL = interval
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        try:
            into = writer(Path("run.h5"), overwrite=True)
            fill(into, 2000, piece=100, after=into.flush_if_due)
            into.finish(Ending("complete", "", STATS, largest(2000, names())))
        except MbdkitError as error:
            print(error)
            into.abandon()

    process = ForkedProcess(write, folder)
    said = "".join(process.communicate(120.0))
    process.kill()
    assert process.returncode is not None
    return process.returncode, said


@pytest.mark.parametrize("interval", [0.0, 1e9])
@pytest.mark.parametrize("limit", [1_000, 14_000, 200_000, 800_000, 1_200_000])
def test_full_disk_is_said_and_harms_nothing(tmp_path: Path, limit: int, interval: float) -> None:
    (tmp_path / "run.h5").write_text("precious")
    status, said = written_until_full(tmp_path, limit, interval)
    assert status == 0, said  # no crash in HDF5
    assert "run.h5 cannot be written: File too large" in said
    assert (tmp_path / "run.h5").read_text() == "precious"
    part = tmp_path / "run.h5.part"
    if part.exists():
        assert str(part.name) in said
        with load(part) as run:
            assert len(run.time) >= 100
            assert len(run.energy.total) == len(run.time)


def test_archive_is_flushed_to_its_exact_size(tmp_path: Path) -> None:
    make(tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5") as file:
        assert file.id.get_filesize() == (tmp_path / "run.h5").stat().st_size
