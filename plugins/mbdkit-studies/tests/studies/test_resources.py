"""A resource that is refused costs a run until the next call, and no longer."""

from __future__ import annotations

import errno
import fcntl
import json
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.studies.stored_studies import index_hash
from typer.testing import CliRunner

import mbdkit
from mbdkit.base.errors import MbdkitError, ResourceError, SpecError, file_error
from mbdkit.cli import app
from mbdkit_studies.compute import executor_pool, pool, worker
from mbdkit_studies.compute.tasks import Outcome


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Hold a `.part` as another run does."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


@contextmanager
def replaced_by_a_folder(path: Path) -> Iterator[None]:
    """Put a folder where an archive belongs."""
    path.mkdir(parents=True)
    yield
    path.rmdir()


@pytest.fixture
def begun(small: dict[str, Any], tmp_path: Path) -> Path:
    """The folder of a study that has only its study.yaml."""
    from mbdkit_studies.folder.study_folder import StudyFolder
    from mbdkit_studies.spec.study_loading import load_study_spec

    folder = StudyFolder(tmp_path / "out")
    folder.prepare(load_study_spec(small))
    return folder.path


@pytest.mark.parametrize(
    ("obstacle", "suffix", "words"),
    [(held, ".h5.part", "is in use by another run"), (replaced_by_a_folder, ".h5", "this is a folder")],
)
def test_a_run_that_cannot_be_written_is_missing_and_computed_by_the_next_call(
    obstacle, suffix, words, finished, small, begun
):
    victim = finished.points[1].run_id
    with obstacle(begun / "runs" / (victim + suffix)):
        study = mbdkit.study(small, out=begun)
    assert [point.status for point in study.points] == ["complete", "missing", "complete", "complete"]
    assert study.status == "partial"
    assert study.points[1].reason.startswith("no-resources: ")
    assert words in study.points[1].reason
    assert study.unfinished == (study.points[1].reason,)
    again = mbdkit.study(small, out=begun)
    assert again.computed == 1
    assert (again.status, again.unfinished) == ("complete", ())
    assert index_hash(begun) == index_hash(finished.folder)


@pytest.mark.parametrize("kind", ["pipe", "holes"])
def test_what_cannot_be_hashed_is_not_waited_for(finished, small, begun, kind):
    study = mbdkit.study(small, out=begun)
    victim = study.points[1].path
    if kind == "holes":
        with victim.open("r+b") as file:
            file.truncate(1 << 42)  # hashing 4 TiB takes an hour
    else:
        victim.unlink()
        os.mkfifo(victim)
    again = mbdkit.study(small, out=begun)
    assert again.computed == 1
    assert again.points[1].status == ("complete" if kind == "holes" else "missing")


def test_the_command_ends_with_exit_status_3_and_says_why(finished, small, begun, monkeypatch):
    spec = begun.parent / "spec.json"
    spec.write_text(json.dumps(small))
    with held(begun / "runs" / f"{finished.points[1].run_id}.h5.part"):
        result = CliRunner().invoke(app, ["study", str(spec), "-o", str(begun), "--json"])
    assert result.exit_code == 3
    told = json.loads(result.stdout)
    assert (told["complete"], told["missing"], len(told["unfinished"])) == (3, 1, 1)
    assert "is in use by another run" in result.stderr
    assert CliRunner().invoke(app, ["study", str(spec), "-o", str(begun)]).exit_code == 0


@pytest.mark.usefixtures("processes")
def test_a_second_run_without_resources_is_made_by_the_next_call(small, tmp_path, monkeypatch):
    study = small | {"reference": "none", "measures": ["reversibility_defect"]}
    work = executor_pool.Pool.work

    def without_memory(self, tasks):
        for task, outcome in work(self, tasks):
            yield task, Outcome("missing", "no-resources: no memory.") if "second" in task.content else outcome

    monkeypatch.setattr(executor_pool.Pool, "work", without_memory)
    first = mbdkit.study(study, out=tmp_path / "out")
    assert [point.second_run for point in first.points] == [""] * 4
    assert len(first.unfinished) == 4
    monkeypatch.undo()
    second = mbdkit.study(study, out=tmp_path / "out")
    assert [point.second_run for point in second.points] == ["complete"] * 4


@pytest.mark.usefixtures("processes")
def test_a_study_whose_processes_are_refused_says_so_and_keeps_its_index(small, tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(24, os.strerror(24))

    monkeypatch.setattr(pool, "_Process", refuse)
    with pytest.raises(ResourceError, match="cannot be started: Too many open files"):
        mbdkit.study(small, out=tmp_path / "out")
    assert {point.status for point in mbdkit.load_study(tmp_path / "out").points} == {"missing"}


@pytest.mark.usefixtures("processes")
def test_one_process_is_enough_if_more_are_refused(finished, small, tmp_path, monkeypatch):
    real, started = pool._Process, []

    def only_one(*given: Any) -> Any:
        if started:
            raise OSError(11, os.strerror(11))
        started.append(real(*given))
        return started[0]

    monkeypatch.setattr(pool, "_Process", only_one)
    told: list[str] = []
    study = mbdkit.study(small, out=tmp_path / "out", workers=4, notify=told.append)
    assert study.status == "complete"
    assert any("cannot be started" in message for message in told)
    assert index_hash(tmp_path / "out") == index_hash(finished.folder)


@pytest.mark.parametrize(
    ("name", "kind"),
    [("ENOSPC", ResourceError), ("EACCES", ResourceError), ("EMFILE", ResourceError), ("EROFS", ResourceError),
     ("EIO", ResourceError), ("ENAMETOOLONG", SpecError), ("ENOENT", SpecError), ("ENOTDIR", SpecError)],
)  # fmt: skip
def test_the_error_of_a_file_says_whether_its_name_is_to_blame(name, kind):
    import errno

    error = file_error(getattr(errno, name), "refused", file="run.h5")
    assert type(error) is kind
    assert isinstance(error, MbdkitError)
    assert str(error) == "run.h5: refused"


def test_runs_that_a_disk_is_too_small_for_are_computed_when_there_is_space(finished, small, begun, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=1 << 10, total=1 << 10))
        study = mbdkit.study(small, out=begun, executor=ThreadPoolExecutor(1))
    assert {point.status for point in study.points} == {"missing"}
    assert all(reason.startswith("no-resources: the disk of ") for reason in study.unfinished)
    assert mbdkit.study(small, out=begun).status == "complete"
    assert index_hash(begun) == index_hash(finished.folder)


def test_an_error_of_the_disk_names_the_file_that_was_computed(begun, monkeypatch):
    def carry(task: dict[str, Any], notify: Any) -> dict[str, Any]:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    task = {"path": str(begun / "runs" / "abc.h5"), "command": [], "call": False}
    (answer,) = worker.compute([task], mbdkit.__version__, carry)
    assert answer["reason"] == f"no-resources: {task['path']}: Input/output error"
