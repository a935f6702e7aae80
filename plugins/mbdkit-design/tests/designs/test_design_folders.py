"""The folder of a design: going on after an interruption, processes, locks, and what is refused."""

from __future__ import annotations

import json
import os
import shutil
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.designs.design_command import command
from tests.designs.oscillator import STIFFNESS, tuned

import mbdkit
from mbdkit import ArchiveError, ResourceError, SpecError
from mbdkit.spec.spec_kinds import kind_named
from mbdkit.spec.yaml_reader import write_yaml
from mbdkit_design import computing
from mbdkit_design.computing import Computer
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.evaluation import Job
from mbdkit_design.known_points import KnownPoints, PointFile
from mbdkit_design.solve_design import WORKER
from mbdkit_design.store import DesignFolder
from mbdkit_studies.compute import pool
from mbdkit_studies.compute.executor_pool import Engine


def lines(folder: Path) -> list[str]:
    return (folder / "points.jsonl").read_text("utf-8").splitlines()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A design that nothing disturbed."""
    folder = tmp_path_factory.mktemp("designs") / "whole"
    mbdkit.design(tuned(), out=folder)
    return folder


def test_the_result_of_a_folder_is_that_of_the_design(whole: Path) -> None:
    found = mbdkit.load_design(whole)
    written = json.loads((whole / "design.json").read_text("utf-8"))
    assert written.pop("mbdkit_result") == 1
    assert written.pop("sha256")
    assert found.to_dict() == mbdkit.design(tuned()).to_dict() == written
    assert sorted(path.name for path in whole.iterdir()) == [
        "best.h5", "design.json", "design.yaml", "points.jsonl", "start.h5"]  # fmt: skip
    with mbdkit.load(whole / "best.h5") as run:
        assert run.measures["goal"] == found.best.goals["goal"]
        assert run.verdict == found.trust.verdict
        assert run.accuracy is not None


def test_a_killed_design_goes_on_from_its_points(whole: Path, tmp_path: Path) -> None:
    # as kill -9 leaves it: some points, the last one half written, and the lock of a process that is gone
    folder, points = tmp_path / "killed", lines(whole)
    folder.mkdir()
    shutil.copy(whole / "design.yaml", folder)
    half = len(points) // 2
    (folder / "points.jsonl").write_text("\n".join(points[:half]) + "\n" + points[half][:40], encoding="utf-8")
    mbdkit.design(tuned(), out=folder)
    assert lines(folder) == points
    for name in ("design.json", "design.yaml"):
        assert (folder / name).read_bytes() == (whole / name).read_bytes()


def test_ctrl_c_keeps_the_points_and_says_how_to_go_on(whole: Path, tmp_path: Path) -> None:
    folder, told = tmp_path / "interrupted", []  # type: Path, list[str]

    def interrupt(done: int, failed: int) -> None:
        if done == 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mbdkit.design(tuned(), out=folder, progress=interrupt, notify=told.append)
    assert told[-1] == f"8 runs are kept in {folder / 'points.jsonl'}; the same call continues from there"
    assert lines(folder) == lines(whole)[:9]
    with pytest.raises(SpecError, match="has no result yet; `mbdkit design` with the same spec and this folder"):
        mbdkit.load_design(folder)
    seen: list[int] = []
    mbdkit.design(tuned(), out=folder, progress=lambda done, failed: seen.append(done))
    assert seen[0] == 9
    assert (folder / "design.json").read_bytes() == (whole / "design.json").read_bytes()


def test_ctrl_c_while_archives_are_written_leaves_no_result(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(time: float, end: float) -> None:
        raise KeyboardInterrupt

    def simulate(spec: Any, *, path: Path, overwrite: bool) -> mbdkit.Run:
        long = {"time": {"end": 1000.0, "step": 0.001}}
        return mbdkit.run("double-pendulum", archive=path, overwrite=overwrite, progress=interrupt, **long)

    differentiate = kind_named("run").differentiate
    kind = SimpleNamespace(compute=lambda: simulate, differentiate=differentiate, is_integrated=True)
    monkeypatch.setattr(mbdkit.spec.RunSpec, "spec_kind", kind)
    folder = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        mbdkit.design(tuned(), out=folder)
    assert sorted(path.name for path in folder.iterdir()) == ["design.yaml", "points.jsonl"]
    monkeypatch.undo()
    mbdkit.design(tuned(), out=folder)
    assert (folder / "design.json").read_bytes() == (whole / "design.json").read_bytes()


def test_a_complete_design_is_read_and_not_computed_again(whole: Path) -> None:
    seen: list[int] = []
    found = mbdkit.design(tuned(), out=whole, progress=lambda done, failed: seen.append(done))
    assert not seen
    assert found.to_dict() == mbdkit.load_design(whole).to_dict()


@pytest.mark.usefixtures("processes")
def test_processes_compute_the_same_points(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(computing, "PATIENCE", 0.0)
    started: list[Any] = []
    real = pool._Process
    monkeypatch.setattr(pool, "_Process", lambda *given: started.append(real(*given)) or started[-1])
    mbdkit.design(tuned(), out=tmp_path / "out", workers=2)
    assert len(started) == 2  # for all searches together
    assert sorted(lines(tmp_path / "out")) == sorted(lines(whole))
    assert (tmp_path / "out" / "design.json").read_bytes() == (whole / "design.json").read_bytes()


def test_an_executor_computes_the_same_points(whole: Path, tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as executor:
        mbdkit.design(tuned(), out=tmp_path / "out", executor=executor)
    assert lines(tmp_path / "out") == lines(whole)
    assert (tmp_path / "out" / "design.json").read_bytes() == (whole / "design.json").read_bytes()


@pytest.mark.usefixtures("processes")
def test_a_point_that_kills_its_process_twice_fails_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer_of = pool._Process.answer
    path = ("model", "forces", "spring", "stiffness")

    def deadly(worker: Any, message: Any, notify: Any) -> Any:
        if any([list(path), 3.0] in settings for settings in message["settings"]):
            worker.process.kill()
            worker.process.wait()
        return answer_of(worker, message, notify)

    monkeypatch.setattr(pool._Process, "answer", deadly)
    spec, jobs = load_design_spec(tuned()), [Job("", [(path, stiffness)]) for stiffness in (2.0, 3.0)]
    engine = Engine(1, None, WORKER)
    with Computer(spec, engine, print, tmp_path / "points.jsonl") as computer:
        monkeypatch.setattr(Computer, "_uses_workers", True)
        known = KnownPoints(computer, PointFile(tmp_path / "points.jsonl", ["goal"], print))
        good, bad = known(jobs)
    assert good.values == pytest.approx([np.cos(np.sqrt(2.0)) ** 2], rel=1e-8)
    assert bad.verdict == "failed"
    assert bad.reason.startswith("worker-died: two processes that computed it died")
    assert [json.loads(line)["settings"] for line in lines(tmp_path)[1:]] == [
        jobs[0].values
    ]  # the next call tries again


def test_a_folder_is_used_by_one_call_at_a_time(whole: Path) -> None:
    with (
        DesignFolder(whole).locked(),
        pytest.raises(ResourceError, match=f"another `mbdkit design` is running in this folder.*{os.getpid()}"),
    ):
        mbdkit.design(tuned(), out=whole)
    assert not list(whole.glob(".lock*"))


def test_the_folder_of_another_design_is_refused_and_started_anew_on_demand(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(whole, folder)
    own = {"notes.txt", "best-of-all.h5", "report.html"}  # which mbdkit has not written
    for name in own:
        (folder / name).write_text("mine")
    with pytest.raises(SpecError, match="belongs to another design"):
        mbdkit.design(tuned(minimize="final(wheel.angle)**2 + 1"), out=folder)
    assert (folder / "design.json").read_bytes() == (whole / "design.json").read_bytes()
    other = mbdkit.design(tuned(minimize="final(wheel.angle)**2 + 1"), out=folder, overwrite=True)
    assert mbdkit.load_design(folder).to_dict() == other.to_dict() != mbdkit.load_design(whole).to_dict()
    assert all((folder / name).read_text() == "mine" for name in own)


def test_starting_anew_removes_nothing_outside_the_folder(whole: Path, tmp_path: Path) -> None:
    folder, outside = tmp_path / "copy", tmp_path / "start-b.h5"
    shutil.copytree(whole, folder)
    (folder / "start-a").mkdir()
    outside.write_text("mine")
    spec = (folder / "design.yaml").read_text("utf-8")
    (folder / "design.yaml").write_text(f"{spec}\nscenarios: {{a/../../start-b: {{}}}}\n")
    DesignFolder(folder).clear()
    assert outside.read_text() == "mine"
    assert not (folder / "design.yaml").exists()


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(SpecError, match=r"contains other files and no design\.yaml"):
        mbdkit.design(tuned(), out=tmp_path)
    with pytest.raises(SpecError, match=r"contains no design \(no design\.yaml\)"):
        mbdkit.load_design(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_wrong_design_writes_nothing(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="nowhere"):
        mbdkit.design(tuned(minimize="final(nowhere.angle)"), out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def begun(whole: Path, folder: Path, points: str) -> Path:
    """Return the folder of a design that was interrupted, with these points."""
    folder.mkdir()
    shutil.copy(whole / "design.yaml", folder)
    (folder / "points.jsonl").write_text(points, "utf-8")
    return folder


@pytest.mark.parametrize("text", ["[]\n", '{"mbdkit_points": "a"}\n', "points\n"])
def test_points_that_are_none_are_told(whole: Path, tmp_path: Path, text: str) -> None:
    folder = begun(whole, tmp_path / "copy", text)
    with pytest.raises(SpecError, match=r"points\.jsonl: this is not a list of evaluated points of this design"):
        mbdkit.design(tuned(), out=folder)
    assert (folder / "points.jsonl").read_text() == text


def test_files_of_a_later_version_are_refused(whole: Path, tmp_path: Path) -> None:
    later = '{"mbdkit_points": 2}\n{"more": 1}\n'
    folder = begun(whole, tmp_path / "copy", later)
    words = "this file has format version 2, this mbdkit reads 1; install a later version of mbdkit"
    done = command("design", str(folder / "design.yaml"), "-o", str(folder))
    assert done.exit_code == 2
    assert f"points.jsonl: {words}" in done.stderr
    assert (folder / "points.jsonl").read_text() == later
    (folder / "design.json").write_text('{"mbdkit_result": 2}')
    with pytest.raises(SpecError, match=rf"design\.json: {words}"):
        mbdkit.load_design(folder)


def with_sum(data: dict[str, Any]) -> str:
    return json.dumps(data | {"crc32": zlib.crc32(json.dumps(data).encode())})


@pytest.mark.parametrize("damage", ["flip", "cut", "zeros", "other", "deep", "large"])
def test_damaged_points_are_computed_again(whole: Path, tmp_path: Path, damage: str) -> None:
    points, told = lines(whole), []  # type: list[str], list[str]
    line = points[3]
    digit = line.index("0.") + 5
    harmed = {
        "flip": line[:digit] + str((int(line[digit]) + 1) % 10) + line[digit + 1 :],
        "cut": line[: len(line) // 2],
        "zeros": "\0" * 40,
        "other": '{"scenario": ""}',
        "deep": "[" * 1_000_000,
        "large": with_sum({"scenario": "", "settings": {}, "values": {"goal": 10**400}, "verdict": "", "reason": ""}),
    }[damage]
    folder = begun(whole, tmp_path / "copy", "\n".join([*points[:3], harmed, *points[4:]]) + "\n")
    seen: list[int] = []
    mbdkit.design(tuned(), out=folder, notify=told.append, progress=lambda done, failed: seen.append(done))
    assert told[0] == f"1 line of {folder / 'points.jsonl'} is damaged and was removed; its run is made again"
    assert len(seen) == 1
    assert sorted(lines(folder)) == sorted(points)
    assert (folder / "design.json").read_bytes() == (whole / "design.json").read_bytes()


def test_the_report_of_a_folder_needs_no_spec_and_no_new_runs_the_second_time(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(whole, folder)
    done = command("report", str(folder))
    assert done.exit_code == 0, done.stderr
    page, points = (folder / "report.html").read_text("utf-8"), lines(folder)
    assert len(points) > len(lines(whole))
    assert "stiffness of spring" in page.lower()
    assert command("report", str(folder)).exit_code == 2
    assert command("report", str(folder), "--overwrite").exit_code == 0
    assert lines(folder) == points


def test_files_that_are_no_files_of_a_design_are_refused_in_a_sentence(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "copy")
    (tmp_path / "copy" / "design.json").write_text("[" * 1_000_000)
    with pytest.raises(SpecError, match=r"this is not the result of the design\.yaml beside it"):
        mbdkit.load_design(tmp_path / "copy")
    changed = (whole / "design.json").read_text().replace('"verdict": "', '"verdict": "x', 1)
    (tmp_path / "copy" / "design.json").write_text(changed)
    with pytest.raises(ArchiveError, match=r"design\.json.* has changed since it was written"):
        mbdkit.load_design(tmp_path / "copy")
    folder = begun(whole, tmp_path / "begun", "")
    (folder / "points.jsonl").unlink()
    os.mkfifo(folder / "points.jsonl")
    with pytest.raises(SpecError, match="this is not a regular file but a pipe"):
        mbdkit.design(tuned(), out=folder)


def test_the_report_of_a_design_without_a_result_says_how_to_get_one(whole: Path, tmp_path: Path) -> None:
    shutil.copy(whole / "design.yaml", tmp_path)
    done = command("report", str(tmp_path))
    assert done.exit_code == 2
    assert "has no result yet" in done.stderr


def test_units_of_variables_and_limits_are_kept_in_the_folder(tmp_path: Path) -> None:
    for number, variable in enumerate(
        ({"bounds": ["1 N m/rad", "4 N m/rad"], "start": 1.5}, {"bounds": [1, 4], "start": "1500 N mm/rad"})
    ):
        limit = {"half": {"value": "abs(final(wheel.angle))", "max": "90 deg"}}
        first = load_design_spec(tuned(variables={STIFFNESS: variable}, subject_to=limit))
        folder = DesignFolder(tmp_path / str(number))
        folder.path.mkdir()
        folder.spec.write_text(write_yaml(folder.plain_spec(first)), encoding="utf-8")
        assert folder.is_same(first)
        again = load_design_spec(folder.spec)
        assert again.variables[STIFFNESS].written == first.variables[STIFFNESS].written == "1.5 N m/rad"
        assert again.subject_to["half"].measure == {"value": "abs(final(wheel.angle))", "unit": "rad"}
