"""What is computed, what is not computed again, and what becomes of runs that go wrong or are killed."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import h5py
import numpy as np
import pytest
from tests.studies.stored_studies import index_hash

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.archive.part_file import checkpoint_path
from mbdkit.base.errors import ArchiveError, SpecError
from mbdkit.spec import load_spec
from mbdkit_studies.compute import executor_pool, pool, worker
from mbdkit_studies.compute.batch import refusal
from mbdkit_studies.compute.run_files import RunFiles
from mbdkit_studies.folder.folder_lock import Shard
from mbdkit_studies.store import study_index
from tests.margins import assert_within
from tests.runs.resuming.killed_runs import killed

#: Two rods that can meet a point of the ground at a distance of 1.5 m, but not at 3 m.
CLOSED = {
    "name": "mechanism",
    "bodies": {
        "a": {"mass": 1, "inertia": 0.1, "position": [0.5, 0.0]},
        "b": {"mass": 1, "inertia": 0.1, "position": [1.4, 0.3]},
    },
    "joints": {
        "A": {"type": "revolute", "bodies": ["ground", "a"], "points": [[0, 0], [-0.5, 0]]},
        "B": {"type": "revolute", "bodies": ["a", "b"], "points": [[0.5, 0], [-0.5, 0]]},
        "C": {"type": "revolute", "bodies": ["ground", "b"], "points": [[1.5, 0], [0.5, 0]]},
    },
}


def written(folder: Path) -> dict[str, int]:
    """When each run file was last written."""
    return {path.name: path.stat().st_mtime_ns for path in (folder / "runs").iterdir()}


def test_every_run_has_a_sound_archive_and_nothing_else_is_left(finished):
    assert finished.status == "complete"
    assert finished.computed == 5
    assert sorted(os.listdir(finished.folder)) == ["index.h5", "runs", "study.yaml"]
    ids = {point.run_id for point in (*finished.points, *finished.references)}
    assert set(os.listdir(finished.folder / "runs")) == {f"{run_id}.h5" for run_id in ids}
    assert len(ids) == 5
    for point in finished.points:
        assert check(point.path) == []


def test_an_interrupt_while_the_index_is_written_waits_until_it_is_there(copied, small, monkeypatch):
    (copied / "index.h5").unlink()
    write = study_index.write

    def interrupted(*arguments):
        signal.raise_signal(signal.SIGINT)
        write(*arguments)

    monkeypatch.setattr(study_index, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        mbdkit.study(small, out=copied)
    assert mbdkit.load_study(copied).status == "complete"


def test_a_second_call_computes_nothing_and_writes_the_same_index(copied, small):
    before, index = written(copied), index_hash(copied)
    study = mbdkit.study(small, out=copied)
    assert study.computed == 0
    assert written(copied) == before
    assert index_hash(copied) == index


@pytest.mark.usefixtures("new_processes")
def test_two_workers_give_the_same_data_as_one(finished, small, tmp_path):
    study = mbdkit.study(small, out=tmp_path / "two", workers=2)
    assert study.computed == 5
    assert index_hash(tmp_path / "two") == index_hash(finished.folder)
    hashes = [[point.data_sha256 for point in which.points] for which in (study, finished)]
    assert hashes[0] == hashes[1]


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1000])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def change_a_number(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["trajectory/position"][3, 1, 0] += 1e-9


def interrupt(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs.modify("status", "interrupted")


@pytest.mark.parametrize("is_noticed_by_time", [True, False])
@pytest.mark.parametrize("damage", [truncate, empty, change_a_number, interrupt])
def test_a_damaged_or_unfinished_run_is_computed_again_alone(damage, is_noticed_by_time, copied, small, finished):
    index = index_hash(copied)
    path = copied / "runs" / finished.points[2].path.name
    before = path.stat()
    damage(path)
    if not is_noticed_by_time:
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    study = mbdkit.study(small, out=copied)
    assert study.computed == 1
    assert check(path) == []
    assert index_hash(copied) == index


@pytest.mark.parametrize("lost", [b"", b"no HDF5", None])
def test_a_lost_or_damaged_index_is_written_anew_from_the_runs(lost, copied, small):
    index = index_hash(copied)
    if lost is None:
        (copied / "index.h5").unlink()
    else:
        (copied / "index.h5").write_bytes(lost)
    assert mbdkit.study(small, out=copied).computed == 0
    assert index_hash(copied) == index


def test_who_opens_a_damaged_index_is_told_how_to_get_a_new_one(copied):
    (copied / "index.h5").write_bytes((copied / "index.h5").read_bytes()[:5000])
    with pytest.raises(ArchiveError, match=r"this index is truncated.*; run `mbdkit study` to write it again"):
        mbdkit.load_study(copied)


def test_a_folder_of_another_study_is_refused_and_left_as_it_is(copied, small):
    before, index = written(copied), (copied / "index.h5").read_bytes()
    with pytest.raises(SpecError, match="belongs to another study"):
        mbdkit.study(small | {"title": "Another"}, out=copied)
    assert written(copied) == before
    assert (copied / "index.h5").read_bytes() == index


def test_a_file_that_holds_another_run_than_its_name_says_is_refused_before_any_work(copied, small, finished):
    first, second = (copied / "runs" / point.path.name for point in finished.points[:2])
    third = copied / "runs" / finished.points[2].path.name
    first.write_bytes(second.read_bytes())
    third.unlink()
    with pytest.raises(SpecError, match="contains another run") as caught:
        mbdkit.study(small, out=copied)
    assert caught.value.file == str(first)
    assert not third.exists()


def test_runs_that_fail_are_results_with_their_reasons_and_are_not_tried_again(tmp_path):
    study = {
        "mbdkit_study": 1,
        "base": {"model": CLOSED, "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}},
        "axes": [{"model.joints.C.points[0]": [[1.5, 0], [3.0, 0]]}, {"limits.max_steps": [1000, 5]}],
        "reference": {"integrator": {"name": "gauss", "stages": 3}, "limits": {}},
    }
    done = mbdkit.study(study, out=tmp_path / "out")
    assert [point.status for point in done.points] == ["complete", "failed", "failed", "failed"]
    assert [point.status for point in done.references] == ["complete", "failed"]
    assert done.status == "complete"
    assert done.points[1].reason.startswith("max-steps: ")
    assert done.points[2].reason.startswith("wrong-input: ")
    assert "C" in done.points[2].reason
    assert done.run(done.points[1]).status == "failed"
    assert done.run(done.points[2]) is None
    assert done.reference(done.points[2]) is None
    assert len(done.failures) == 4
    errors = [point.values["end_error"] for point in done.points]
    assert_within(errors[0], 1e-6)
    assert np.isnan(errors[1:]).all()
    again = mbdkit.study(study, out=tmp_path / "out")
    assert again.computed == 0
    assert [point.reason for point in again.points] == [point.reason for point in done.points]


@pytest.mark.slow
@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize("count", [1, 2])
def test_a_run_whose_worker_dies_is_tried_once_more_in_the_same_call_and_in_later_ones(
    count, finished, small, tmp_path, monkeypatch
):
    victim, answer_of, deaths = finished.points[1].run_id, pool._Process.answer, []

    def deadly(worker, message, notify):
        if Path(message["path"]).stem == victim and len(deaths) < count:
            deaths.append(worker)
            worker.process.kill()
            worker.process.wait()
        return answer_of(worker, message, notify)

    monkeypatch.setattr(pool._Process, "answer", deadly)
    study = mbdkit.study(small, out=tmp_path / "out", workers=count)
    reason = "worker-died: two processes that computed it died; the second one was killed by SIGKILL."
    assert study.unfinished == (reason,) * (count - 1)
    assert len(deaths) == count
    assert deaths[0].process.stdout.closed
    assert not list((tmp_path / "out" / "runs").glob("*.part"))
    if count == 2:
        assert [point.status for point in study.points] == ["complete", "failed", "complete", "complete"]
        assert study.points[1].reason == reason
        assert mbdkit.study(small, out=tmp_path / "out").computed == 1
    assert index_hash(tmp_path / "out") == index_hash(finished.folder)


@pytest.mark.usefixtures("processes")
def test_an_interrupted_call_leaves_an_index_of_all_that_is_there(finished, small, tmp_path, monkeypatch):
    work = executor_pool.Pool.work

    def interrupted(self, tasks):
        for number, done in enumerate(work(self, tasks)):
            if number == 2:  # its archive is written, but nobody has heard of it
                raise KeyboardInterrupt
            yield done

    monkeypatch.setattr(executor_pool.Pool, "work", interrupted)
    with pytest.raises(KeyboardInterrupt):
        mbdkit.study(small, out=tmp_path / "out")
    monkeypatch.undo()
    study = mbdkit.load_study(tmp_path / "out")
    there = {path.stem for path in (tmp_path / "out" / "runs").glob("*.h5")}
    rows = (*study.points, *study.references)
    assert {point.run_id for point in rows if point.status == "complete"} == there
    assert {point.status for point in rows if point.run_id not in there} == {"missing"}
    assert len(there) >= 3
    assert mbdkit.study(small, out=tmp_path / "out").computed == 5 - len(there)
    assert index_hash(tmp_path / "out") == index_hash(finished.folder)


def test_equal_runs_are_computed_once(tmp_path):
    study = {
        "mbdkit_study": 1, "base": "pendulum", "overrides": {"time": {"end": 0.2, "step": 0.01}},
        "families": {
            "one": {"axes": [{"model.length": [1.0, 2.0]}]},
            "two": {"axes": [{"model.length": [2.0, 1.0, 1.0]}], "reference": {"time.step": 0.005}},
        },
    }  # fmt: skip
    done = mbdkit.study(study, out=tmp_path / "out")
    assert len(done.points) == 5
    assert done.computed == 4
    assert len(os.listdir(tmp_path / "out" / "runs")) == 4
    one, two = done.family("one"), done.family("two")
    assert [one[0].run_id, one[1].run_id] == [two[1].run_id, two[0].run_id]
    assert np.isnan(one[0].values["end_error"])
    assert two[1].values["end_error"] == two[2].values["end_error"] > 0
    assert mbdkit.study(study, out=tmp_path / "out").computed == 0


def test_the_parts_of_a_study_make_the_whole_and_say_what_they_lack(finished, small, tmp_path):
    out = tmp_path / "out"
    first = mbdkit.study(small, out=out, shard=Shard(1, 2))
    assert first.computed == 3
    assert first.status == "partial"
    missing = [point for point in first.points if point.status == "missing"]
    assert len(missing) == 2
    assert np.isnan(missing[0].values["misalignment_max"])
    assert first.run(missing[0]) is None
    second = mbdkit.study(small, out=out, shard=Shard(2, 2))
    assert second.computed == 2
    assert second.status == "complete"
    assert index_hash(out) == index_hash(finished.folder)


def test_repeated_timings_are_kept_with_their_quartiles_and_not_made_again(tmp_path):
    study = {
        "mbdkit_study": 1, "base": "pendulum", "overrides": {"time": {"end": 0.1, "step": 0.01}},
        "axes": [{"integrator": [{"name": "rk4"}, {"name": "rk-gill"}]}], "repeats": 5,
    }  # fmt: skip
    done = mbdkit.study(study, out=tmp_path / "out")
    for point in done.points:
        assert len(point.repeats) == 5
        expected = np.quantile(point.repeats, [0.0, 0.25, 0.5, 0.75])
        found = [point.values[f"wall_{name}_s"] for name in ("min", "q1", "median", "q3")]
        assert found == pytest.approx(expected)
        assert found[0] > 0
    again = mbdkit.study(study, out=tmp_path / "out")
    assert [point.repeats for point in again.points] == [point.repeats for point in done.points]


def test_progress_counts_runs_and_timings(small, tmp_path):
    told = []
    study = small | {"axes": [{"integrator": [{"name": "rk4"}]}], "repeats": 2}
    mbdkit.study(study, out=tmp_path / "out", progress=lambda *counts: told.append(counts))
    assert told == [(1, 4, 0), (2, 4, 0), (3, 4, 0), (4, 4, 0)]


def test_all_runs_are_timed_once_before_one_is_timed_again(tmp_path, monkeypatch):
    # a busy stretch of the machine then spreads the times of each run, and not those of some runs alone
    timed = []
    note = RunFiles.note
    monkeypatch.setattr(
        RunFiles, "note", lambda self, task, out: (timed.append((task.key, task.content)), note(self, task, out))
    )
    study = {
        "mbdkit_study": 1, "base": "pendulum", "overrides": {"time": {"end": 0.1, "step": 0.01}},
        "axes": [{"integrator": [{"name": "rk4"}, {"name": "rk-gill"}]}], "repeats": 3,
    }  # fmt: skip
    points = mbdkit.study(study, out=tmp_path / "out").points
    assert [key for key, content in timed if "timing" in content] == 3 * [point.run_id for point in points]


def test_reasons_of_runs_with_several_wrong_values_are_on_one_line() -> None:
    error = SpecError("should be greater than 0, not -1\n  also: model.b: is missing", key="model.a")
    wanted = "wrong-input: model.a: should be greater than 0, not -1; also: model.b: is missing"
    assert refusal(error).reason == wanted


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
