"""Several calls begin in one folder at the same time, and a folder is started anew."""

from __future__ import annotations

import gc
import os
import threading
import warnings
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import mbdkit
from mbdkit.errors import MbdkitError, ResourceError, SpecError
from mbdkit.report.report import report
from mbdkit.spec import load_study_spec
from mbdkit.studies.execute import Shard
from mbdkit.studies.study_folder import StudyFolder


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


def begin(path: Path, spec: Any) -> None:
    folder = StudyFolder(path)
    folder.check(spec)
    folder.prepare(spec)
    with folder.locked(shared=True):
        assert load_study_spec(folder.spec).sha256() == spec.sha256()


@pytest.mark.parametrize("attempt", range(20))
def test_parts_of_a_study_may_begin_at_the_same_time(attempt, small, tmp_path):
    specs = [load_study_spec(small) for _ in range(6)]
    assert together([lambda spec=spec: begin(tmp_path / "out", spec) for spec in specs]) == []
    assert sorted(os.listdir(tmp_path / "out")) == ["runs", "study.yaml"]


@pytest.mark.parametrize("attempt", range(10))
def test_of_two_studies_that_begin_in_one_folder_one_is_refused(attempt, small, tmp_path):
    specs = [load_study_spec(small | {"title": title}) for title in ("one", "two")]
    errors = together([lambda spec=spec: begin(tmp_path / "out", spec) for spec in specs])
    assert len(errors) == 1
    assert "belongs to another study" in str(errors[0])


@pytest.mark.parametrize(
    ("name", "is_folder", "words"),
    [
        ("runs", False, "this is not a folder, as the runs of the study need"),
        ("index.h5", True, "this is a folder, where the study writes a file"),
    ],
)
def test_what_has_the_name_of_something_else_in_the_folder_is_named(name, is_folder, words, small, tmp_path):
    spec, path = load_study_spec(small), tmp_path / "out"
    begin(path, spec)
    if name == "runs":
        (path / name).rmdir()
    (path / name).mkdir() if is_folder else (path / name).touch()
    with pytest.raises(SpecError, match=words) as caught:
        begin(path, spec)
    assert caught.value.file == str(path / name)


def test_what_a_killed_call_left_is_removed(small, tmp_path):
    folder, spec = StudyFolder(tmp_path / "out"), load_study_spec(small)
    folder.path.mkdir()
    (folder.path / ".study.yaml-0000").write_text("mbdkit_st")
    folder.check(spec)
    folder.prepare(spec)
    with folder.locked():
        assert sorted(os.listdir(folder.path)) == ["runs", "study.yaml"]


def test_overwriting_starts_a_folder_anew_and_keeps_the_files_of_others(copied: Path, small: dict[str, Any]) -> None:
    mine = {"notes.txt": "notes", "runs/mine.h5": "data", "report.html": "<p>my own report</p>"}
    for name, text in mine.items():
        (copied / name).write_text(text)
    before = {path.name for path in (copied / "runs").glob("*.h5")} - {"mine.h5"}
    changed = small | {"reference": "none", "axes": [{"integrator": [{"name": "rk4"}]}]}
    with pytest.raises(SpecError, match=r"start it anew with --overwrite"):
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
