"""Several calls begin in one folder at the same time, and a folder is started anew."""

from __future__ import annotations

import contextlib
import errno
import gc
import json
import os
import shutil
import subprocess
import sys
import threading
import time
import warnings
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import mbdkit
from mbdkit.base.errors import MbdkitError, ResourceError, SpecError
from mbdkit_report import report
from mbdkit_studies.folder import folder_lock
from mbdkit_studies.folder.folder_lock import WHOLE, Owner, Shard
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.spec.study_loading import load_study_spec
from tests.windows_rules import obey_windows


def together(calls: list[Any]) -> list[MbdkitError | OSError]:
    """Call functions at the same time, and return the errors that they raise."""
    errors: list[MbdkitError | OSError] = []
    barrier = threading.Barrier(len(calls))

    def run(call: Any) -> None:
        barrier.wait()
        try:
            call()
        except (MbdkitError, OSError) as error:
            errors.append(error)

    threads = [threading.Thread(target=run, args=(call,)) for call in calls]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return errors


def begin(path: Path, spec: Any, shard: Shard) -> None:
    folder = StudyFolder(path)
    folder.check(spec)
    folder.prepare(spec)
    with folder.locked(shard):
        assert load_study_spec(folder.spec).sha256() == spec.sha256()


@pytest.mark.parametrize("attempt", range(3))
def test_parts_of_a_study_may_begin_at_the_same_time(attempt, small, tmp_path):
    parts = [(load_study_spec(small), Shard(number, 6)) for number in range(1, 7)]
    assert together([lambda part=part: begin(tmp_path / "out", *part) for part in parts]) == []
    assert sorted(os.listdir(tmp_path / "out")) == ["runs", "study.yaml"]


@pytest.mark.parametrize("attempt", range(3))
def test_of_two_studies_that_begin_in_one_folder_one_is_refused(attempt, small, tmp_path):
    parts = [(load_study_spec(small | {"title": title}), Shard(number, 2)) for number, title in ((1, "a"), (2, "b"))]
    errors = together([lambda part=part: begin(tmp_path / "out", *part) for part in parts])
    assert len(errors) == 1
    assert "belongs to another study" in str(errors[0])


@pytest.mark.parametrize(
    ("name", "is_folder", "words"),
    [("runs", False, "this is not a folder, but the study"), ("index.h5", True, "this is a folder, but the study")],
)
def test_what_has_the_name_of_something_else_in_the_folder_is_named(name, is_folder, words, small, tmp_path):
    spec, path = load_study_spec(small), tmp_path / "out"
    begin(path, spec, WHOLE)
    if name == "runs":
        (path / name).rmdir()
    (path / name).mkdir() if is_folder else (path / name).touch()
    with pytest.raises(SpecError, match=words) as caught:
        begin(path, spec, WHOLE)
    assert caught.value.file == str(path / name)


def test_what_a_killed_call_left_is_removed(small, tmp_path):
    folder, spec = StudyFolder(tmp_path / "out"), load_study_spec(small)
    folder.path.mkdir()
    (folder.path / ".study.yaml-0000").write_text("mbdkit_st")
    folder.check(spec)
    folder.prepare(spec)
    with folder.locked():
        assert sorted(os.listdir(folder.path)) == [".lock-1-of-1", "runs", "study.yaml"]
    assert sorted(os.listdir(folder.path)) == ["runs", "study.yaml"]


def test_overwriting_starts_a_folder_anew_and_keeps_the_files_of_others(copied: Path, small: dict[str, Any]) -> None:
    mine = {"notes.txt": "notes", "runs/mine.h5": "data", "report.html": "<p>my own report</p>"}
    for name, text in mine.items():
        (copied / name).write_text(text)
    before = {path.name for path in (copied / "runs").glob("*.h5")} - {"mine.h5"}
    changed = small | {"reference": "none", "axes": [{"integrator": [{"name": "rk4"}]}]}
    with pytest.raises(SpecError, match=r"replace its contents with --overwrite"):
        mbdkit.study(changed, out=copied)
    with pytest.raises(SpecError, match="unknown key"):
        mbdkit.study(changed | {"overrides": {"time.stp": 1}}, out=copied, overwrite=True)
    assert {path.name for path in (copied / "runs").glob("*.h5")} == before | {"mine.h5"}  # nothing was removed
    anew = mbdkit.study(changed, out=copied, overwrite=True)
    assert anew.computed == 1
    assert {path.name for path in (copied / "runs").glob("*.h5")} == {f"{anew.points[0].run_id}.h5", "mine.h5"}
    assert {name: (copied / name).read_text() for name in mine} == mine


def test_a_report_of_mbdkit_is_removed_with_its_study(copied: Path) -> None:
    (copied / "report.html").write_text('<html>\n<meta name="generator" content="mbdkit 1.0">')
    StudyFolder(copied).clear()
    assert sorted(path.name for path in copied.rglob("*")) == ["runs"]


@pytest.mark.usefixtures("pictures")
def test_the_figures_of_a_report_are_removed_with_it_and_other_images_are_kept(copied: Path) -> None:
    report(copied, overwrite=True)
    drawn = {path.name for path in (copied / "figures").iterdir()}
    assert {".png", ".svg"} == {Path(name).suffix for name in drawn}
    Figure().savefig(copied / "figures" / "mine.png")
    (copied / "figures" / "mine.svg").write_text("<svg/>")
    StudyFolder(copied).clear()
    assert sorted(path.name for path in (copied / "figures").iterdir()) == ["mine.png", "mine.svg"]
    (copied / "study.yaml").write_text("mbdkit_study: 1\n")
    for path in list((copied / "figures").iterdir()):
        path.unlink()
    StudyFolder(copied).clear()
    assert not (copied / "figures").exists()


def test_a_folder_that_is_not_that_of_a_study_is_not_overwritten(tmp_path: Path, small: dict[str, Any]) -> None:
    (tmp_path / "study.yaml").write_text("sweep: true\n")
    (tmp_path / "index.h5").write_text("data")
    with pytest.raises(SpecError, match="not the spec of a study, so its folder is not overwritten"):
        mbdkit.study(small, out=tmp_path, overwrite=True)
    assert (tmp_path / "index.h5").read_text() == "data"
    with pytest.raises(SpecError, match=r"--overwrite cannot be combined with --shard"):
        mbdkit.study(small, out=tmp_path / "s", overwrite=True, shard=Shard(1, 2))


def test_a_study_in_use_is_not_overwritten(copied: Path) -> None:
    folder = StudyFolder(copied)
    with folder.locked(), pytest.raises(ResourceError, match="another `mbdkit study` is running"):
        StudyFolder(copied).clear()
    assert folder.index.exists()


def held_by(folder: Path, **changes: Any) -> Path:
    """Write the lock of another call into the folder of a study."""
    lock = folder / ".lock-1-of-1"
    lock.write_text(json.dumps(asdict(Owner.this_process()) | changes))
    return lock


@pytest.mark.parametrize("changes", [{"started": "1"}, {"boot": "before"}, {"pid": 2**22 + 1}], ids=str)
def test_the_lock_of_a_dead_process_is_taken_over(changes: dict[str, Any], copied: Path, small: dict[str, Any]) -> None:
    lock = held_by(copied, **changes)
    assert mbdkit.study(small, out=copied).computed == 0
    assert not lock.exists()


def test_the_lock_of_a_killed_process_whose_parent_has_not_noticed_is_taken_over(copied: Path) -> None:
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(100)"])
    try:
        held_by(copied, pid=child.pid, started=folder_lock._started(child.pid))
        with pytest.raises(ResourceError, match=f"process {child.pid} on .*; wait until it ends$"):
            StudyFolder(copied).locked().__enter__()
        child.kill()
        while Path(f"/proc/{child.pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z":
            time.sleep(0.01)
        with StudyFolder(copied).locked():
            pass
    finally:
        child.kill()
        child.wait()


@pytest.mark.skipif(shutil.which("ps") is None, reason="needs the command ps")
def test_the_start_of_a_process_is_known_without_proc(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on macOS, where `ps` prints it in the language and the time zone of the call."""
    monkeypatch.setattr(folder_lock, "_BOOT", Path("/nowhere"))
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(100)"])
    try:
        starts = set()
        for zone in ("UTC", "Asia/Tokyo"):
            monkeypatch.setenv("TZ", zone)
            starts.add(folder_lock._started(child.pid))
        (start,) = starts
        assert datetime.strptime(start, "%a %b %d %H:%M:%S %Y").year >= 2024
        child.kill()
        os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)
        assert folder_lock._started(child.pid) == ""  # although its parent has not noticed
    finally:
        child.kill()
        child.wait()


def test_a_folder_is_locked_by_the_rules_of_windows(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    obey_windows(monkeypatch)
    with StudyFolder(copied).locked():
        held = copied / ".lock-1-of-1"
        owner = Owner.of(held)
        assert owner is not None
        assert not owner.is_dead
        with pytest.raises(ResourceError, match=f"process {os.getpid()} on .*; wait until it ends"):
            StudyFolder(copied).locked().__enter__()
    assert not held.exists()
    held_by(copied, started="1")  # of a process that has ended
    with StudyFolder(copied).locked(Shard(1, 2)), StudyFolder(copied).locked(Shard(2, 2)):
        assert len(list(copied.glob(".lock*"))) == 2
    assert not list(copied.glob(".lock*"))


def test_the_lock_of_a_living_process_in_another_container_is_kept(copied: Path) -> None:
    """In another PID namespace on one machine, processes have other numbers, so that each seems to be dead."""
    hold = "import sys; from mbdkit_studies.folder.study_folder import StudyFolder; from pathlib import Path\n"
    hold += "with StudyFolder(Path(sys.argv[1])).locked(): print('held', flush=True); sys.stdin.read()"
    command = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount-proc", sys.executable, "-c", hold]
    other = subprocess.Popen([*command, str(copied)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert other.stdin is not None
    assert other.stdout is not None
    try:
        if other.stdout.readline() != "held\n":
            pytest.skip("this machine creates no PID namespaces")
        owner = Owner.of(copied / ".lock-1-of-1")
        assert owner is not None
        assert owner.is_dead  # as far as its number tells
        with pytest.raises(ResourceError, match="another `mbdkit study` is running in this folder"):
            StudyFolder(copied).locked().__enter__()
        assert Owner.of(copied / ".lock-1-of-1") == owner
    finally:
        other.stdin.close()
        other.stdout.close()
        other.wait()
    with StudyFolder(copied).locked():
        pass


def test_a_lock_of_another_machine_is_kept_and_the_message_names_it(copied: Path) -> None:
    lock = held_by(copied, host="node7")
    with pytest.raises(ResourceError, match=r"on node7, since .* or remove .*\.lock-1-of-1 if it no longer runs"):
        mbdkit.study(copied / "study.yaml", out=copied)
    assert lock.exists()
    lock.write_text("what is this")
    with pytest.raises(ResourceError, match=r"if none is, remove .*\.lock-1-of-1"):
        mbdkit.study(copied / "study.yaml", out=copied)


@pytest.mark.skipif(sys.platform == "win32", reason="imitates flock")
def test_a_study_ends_where_exclusive_locks_need_files_open_for_writing(copied: Path, monkeypatch: Any) -> None:
    """NFS emulates `flock` by record locks; flock(2) names the error EBADF."""
    import fcntl

    flock = fcntl.flock

    def of_nfs(handle: int, operation: int) -> None:
        if operation & fcntl.LOCK_EX and fcntl.fcntl(handle, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "Bad file descriptor")
        flock(handle, operation)

    monkeypatch.setattr("fcntl.flock", of_nfs)
    (copied / "index.h5").unlink()
    mbdkit.study(copied / "study.yaml", out=copied)
    assert (copied / "index.h5").exists()


@pytest.mark.parametrize(
    ("held", "asked", "is_free"),
    [("1/2", "2/2", True), ("1/2", "1/2", False), ("1/2", "2/4", True), ("1/2", "3/4", False), ("1/2", "1/3", False)],
)
def test_parts_with_runs_in_common_are_kept_apart(held: str, asked: str, is_free: bool, copied: Path) -> None:
    folder = StudyFolder(copied)
    with folder.locked(Shard.parse(held)):
        with contextlib.nullcontext() if is_free else pytest.raises(ResourceError), folder.locked(Shard.parse(asked)):
            pass
        with pytest.raises(ResourceError, match="running in this folder"), folder.locked():
            pass
    assert not list(copied.glob(".lock*"))


def test_the_temporary_folder_of_a_study_is_deleted_with_it_without_a_warning() -> None:
    study = mbdkit.ensemble(
        {"mbdkit": 1, "model": {"name": "double-pendulum"}, "integrator": {"name": "rk4"},
         "time": {"end": 0.02, "step": 0.01}},
        {"model.angles.0": [0.0]},
    )  # fmt: skip
    folder = study.folder
    assert folder.is_dir()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        del study
        gc.collect()
    assert not folder.exists()


def test_a_file_system_without_locks_is_refused_where_a_lock_is_needed(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", refuse)
    with folder_lock.alone(tmp_path, is_needed=False):
        pass
    with pytest.raises(ResourceError, match="cannot be locked: Operation not supported"), folder_lock.alone(tmp_path):
        pass
