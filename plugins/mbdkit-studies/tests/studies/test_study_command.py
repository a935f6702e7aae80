"""The command `mbdkit study`: what it says, and that Ctrl-C costs only what was under way."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.studies.stored_studies import index_hash

from mbdkit import load, load_study
from mbdkit import study as study_in_this_process
from mbdkit.archive.archive_check import check
from mbdkit.base import progress_bars
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.spec.study_loading import load_study_spec

SWEEP = """\
mbdkit_study: 1
title: A sweep
base: pendulum
overrides:
  time: {end: 0.2, step: 0.01}
axes:
  - model.length: [1.0, 2.0]
  - limits.max_steps: [100, 3]
"""

#: Runs of some tenths of a second each.
SLOW = """\
mbdkit_study: 1
base: double-pendulum
overrides:
  integrator: {name: rk4}
  time: {steps: 400000, step: 1.5e-5}
  output.every: 4000
axes:
  - model.masses[0]: [1.0, 2.0, 3.0, 4.0]
"""


def test_the_summary_counts_runs_and_names_what_failed(mbdkit, in_tmp_path, monkeypatch):
    (in_tmp_path / "sweep.yaml").write_text(SWEEP)
    result = mbdkit("study", "sweep.yaml")
    assert result.exit_code == 0
    assert result.stderr == ""
    assert sorted(os.listdir(in_tmp_path)) == ["sweep", "sweep.yaml"]
    lines = result.stdout.splitlines()
    assert lines[:5] == [
        "study      A sweep", "runs       4: 2 complete, 2 failed; numbered from 1, as in study.run(number=1)",
        "verdicts   2 unknown, 2 bad (failed runs are rated bad)", "computed   4 now", "folder     sweep",
    ]  # fmt: skip
    assert lines[5].startswith("failed     2 runs (2, 4); max-steps: stopped after limits.max_steps = 3 steps")
    assert lines[5].endswith(" (run 2: model.length 1, limits.max_steps 3)")
    assert lines[6:] == ["all runs   mbdkit archive export sweep --to csv"]
    monkeypatch.setitem(sys.modules, "pandas", None)  # as if it were not installed
    assert mbdkit(*lines[6].partition("mbdkit ")[2].split()).exit_code == 0
    with (in_tmp_path / "sweep-csv" / "runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["number"] for row in rows if row["status"] == "failed"] == ["2", "4"]
    assert "max-steps: stopped after" in rows[1]["status_reason"]


def test_json_is_one_object(mbdkit, in_tmp_path):
    (in_tmp_path / "sweep.yaml").write_text(SWEEP)
    found = json.loads(mbdkit("study", "sweep.yaml", "-o", "out", "--json", "--workers", "2").stdout)
    failures, notes = found.pop("failures"), found.pop("notes")
    assert [note["about"] for note in notes] == ["failed", "all runs"]
    assert found == {
        "path": "out", "title": "A sweep", "status": "complete", "runs": 4, "references": 0, "computed": 4,
        "complete": 2, "failed": 2, "missing": 0, "unfinished": [], "left_out": 0, "verdicts": {"unknown": 2, "bad": 2},
        "answers": [],
    }  # fmt: skip
    assert [failure["number"] for failure in failures] == [2, 4]
    assert failures[0]["axes"] == {"model.length": 1.0, "limits.max_steps": 3}
    assert failures[0]["status_reason"].startswith("max-steps: ")
    again = json.loads(mbdkit("study", "sweep.yaml", "-o", "out", "--json", "--executor", "local").stdout)
    assert (again["computed"], again["failed"]) == (0, 2)


def start(folder: Path, out: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "mbdkit", "study", "slow.yaml", "-o", out], cwd=folder, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.mark.end_to_end
@pytest.mark.parametrize("stop", ["SIGINT", pytest.param("SIGTERM", marks=pytest.mark.slow)])
def test_ctrl_c_keeps_what_is_finished_and_the_next_call_comes_to_the_same_index(stop, tmp_path):
    (tmp_path / "slow.yaml").write_text(SLOW)
    process = start(tmp_path, "cut")
    runs = tmp_path / "cut" / "runs"
    deadline = time.monotonic() + 300  # a first run may compile for a minute before
    while time.monotonic() < deadline and process.poll() is None:
        if runs.is_dir() and list(runs.glob("*.h5")) and list(runs.glob("*.h5.part")):
            break
        time.sleep(0.01)
    process.send_signal(getattr(signal, stop))
    told, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert told == ""
    assert errors.endswith("continues others from their last checkpoint\ninterrupted\n")
    assert not list(runs.glob("*.part"))
    study = load_study(tmp_path / "cut")
    assert study.status == "partial"
    statuses = {path: load(path).status for path in runs.glob("*.h5")}
    assert set(statuses.values()) <= {"complete", "interrupted"}
    kept = {path: path.stat().st_mtime_ns for path, status in statuses.items() if status == "complete"}
    assert len(kept) == sum(point.status == "complete" for point in study.points)
    assert 0 < len(kept) < 4
    assert all(check(path) == [] for path in statuses)
    assert {load(path).provenance["command"] for path in kept} == {"mbdkit study slow.yaml --output cut"}

    for out in ("cut", "whole"):
        study_in_this_process(tmp_path / "slow.yaml", out=tmp_path / out)
    assert all(path.stat().st_mtime_ns == before for path, before in kept.items())
    assert index_hash(tmp_path / "cut") == index_hash(tmp_path / "whole")


@pytest.mark.end_to_end
@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal")
def test_workers_do_not_outlive_a_study_that_is_killed(tmp_path):
    (tmp_path / "slow.yaml").write_text(
        SLOW.replace("400000", "1000000000").replace("output", "limits.max_steps: 1e12\n  output")
    )
    process = start(tmp_path, "cut")
    runs = tmp_path / "cut" / "runs"
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline and process.poll() is None:
        if runs.is_dir() and list(runs.glob("*.h5.part")):
            break
        time.sleep(0.01)
    process.kill()
    process.communicate(timeout=60)
    part = next(runs.glob("*.h5.part"))
    while time.monotonic() < deadline and is_locked(part):
        time.sleep(0.05)
    assert not is_locked(part)


def is_locked(path: Path) -> bool:
    """Whether somebody still writes an archive."""
    import fcntl

    with path.open("rb") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def test_a_terminal_sees_how_many_are_done_and_how_many_failed(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress_bars.count_bar("study") as advance:
        advance(3, 7, 0)
        advance(4, 7, 2)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "4/7" in captured.err
    assert "2 failed" in captured.err


@pytest.mark.parametrize(
    ("bar", "counts"), [(progress_bars.count_bar, (4, 8, 1)), (progress_bars.tally_bar, (4, 1, "4 stages"))]
)
def test_without_a_terminal_there_is_at_most_one_line_in_ten_seconds(bar, counts, monkeypatch, capsys):
    clock = iter([0.0, 1.0, 9.9, 10.1, 15.0, 20.2])
    monkeypatch.setattr(progress_bars.time, "perf_counter", lambda: next(clock))
    with bar("study") as advance:
        for _ in range(4):
            advance(*counts)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("study: 4")
    assert "1 failed after" in lines[0]


def test_a_folder_is_watched_while_it_is_computed_and_afterwards(mbdkit, in_tmp_path):
    (in_tmp_path / "sweep.yaml").write_text(SWEEP)
    assert mbdkit("study", "sweep.yaml", "--quiet").exit_code == 0
    told = mbdkit("watch", "sweep").output
    assert re.fullmatch(r"(\d+) of \1 runs; complete\n", told)
    (in_tmp_path / "sweep" / "index.h5").unlink()
    next((in_tmp_path / "sweep" / "runs").glob("*.h5")).unlink()
    assert "no process is computing it; the same command continues it" in mbdkit("watch", "sweep").output
    with StudyFolder(in_tmp_path / "sweep").locked():
        assert f"computed by process {os.getpid()} on " in mbdkit("watch", "sweep", "--once").output
    assert "contains no study" in mbdkit("watch", ".").output


def test_a_key_is_set_in_the_base_of_every_run(mbdkit, in_tmp_path):
    (in_tmp_path / "sweep.yaml").write_text(SWEEP)
    done = mbdkit("study", "sweep.yaml", "--set", "time.end=0.1", "--set", "model.mass=3", "--workers", "1", "--quiet")
    assert done.exit_code == 0
    study = load_study("sweep")
    assert {point.spec.time.end for point in study.points} == {0.1}
    assert {point.spec.model.mass for point in study.points} == {3.0}
    again = mbdkit("study", "sweep.yaml")
    assert again.exit_code == 2
    assert "belongs to another study" in again.stderr


@pytest.mark.parametrize(
    ("assignment", "expected"),
    [
        ("model.length=3", "--set model.length=3: an axis of the study sets model.length"),
        ("time.ende=3", "--set time.ende=3: overrides.\"time.ende\": unknown key (did you mean 'end'?)"),
        ("time.end", "should have the form KEY=VALUE"),
    ],
)
def test_a_wrong_assignment_is_refused(mbdkit, in_tmp_path, assignment, expected):
    (in_tmp_path / "sweep.yaml").write_text(SWEEP)
    for command in ("study", "validate"):
        result = mbdkit(command, "sweep.yaml", "--set", assignment)
        assert result.exit_code == 2
        assert expected in result.stderr
    assert os.listdir() == ["sweep.yaml"]


def test_an_assignment_comes_after_the_overrides_of_families():
    base = {"model": {"name": "double-pendulum"}, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}}
    axes = [{"model.masses": [[1.0, 2.0]]}]
    families = {"a": {"axes": axes, "overrides": {"time.end": 2.0, "time.step": 0.5}}, "b": {"axes": axes}}
    given = {"mbdkit_study": 1, "base": base, "families": families}
    spec = load_study_spec(given, ["time.end=3"])
    times = [(point.spec.time.end, point.spec.time.step) for point in PlannedPoints(spec)]
    assert times == [(3.0, 0.5), (3.0, 0.1)]


def test_validate_warns_of_an_unused_variable_as_study_does(mbdkit, in_tmp_path):
    (in_tmp_path / "sweep.yaml").write_text(
        "mbdkit_study: 1\nbase:\n  parameters: {k: 1.0, kk: 1.0}\n  model: {name: single-pendulum, mass: k}\n"
        "  integrator: {name: rk4}\n  time: {end: 0.02, step: 0.01}\naxes:\n  - parameters.kk: [1.0, 2.0]\n"
    )
    result = mbdkit("validate", "sweep.yaml")
    assert result.exit_code == 0
    told = "warning: the parameter at parameters.kk is not used (did you mean 'k'?)"
    assert result.stderr.count(told) == 1
    assert told in mbdkit("study", "sweep.yaml", "--workers", "1").stderr


@pytest.mark.parametrize("runs", ["axes:\n  - parameters.ref: [0.5, 0.6]\n",
                                  "sample: {variables: {parameters.ref: {uniform: [0.5, 0.6]}}, n: 2}\n"])  # fmt: skip
def test_a_parameter_that_only_a_measure_of_a_study_uses_is_used(mbdkit, in_tmp_path, runs):
    (in_tmp_path / "sweep.yaml").write_text(
        "mbdkit_study: 1\nbase:\n  parameters: {ref: 0.5}\n  model: {name: single-pendulum}\n"
        "  integrator: {name: rk4}\n  time: {end: 0.02, step: 0.01}\n"
        f'measures: {{miss: "max(rod1.x) - ref"}}\n{runs}'
    )
    assert "not used" not in mbdkit("validate", "sweep.yaml").stderr
    assert "not used" not in mbdkit("study", "sweep.yaml", "--workers", "1").stderr
    assert not any("not used" in warning for warning in load_study("sweep").run(0).warnings)


def test_a_distribution_of_an_angle_in_degrees_is_told(mbdkit, in_tmp_path):
    (in_tmp_path / "angles.yaml").write_text(
        "mbdkit_study: 1\nbase:\n  parameters: {a: 1.0, b: 1.0}\n  model: {name: double-pendulum, angles: [a, b]}\n"
        "  integrator: {name: rk4}\n  time: {end: 0.02, step: 0.01}\n"
        "sample: {variables: {parameters.a: {uniform: [10, 40]}, parameters.b: {normal: [0.1, 0.2]}}, n: 2}\n"
    )
    told = 'sample.variables."parameters.a": with 10, the angle of 10 rad at model.angles[0] (from parameters.a)'
    for words in (["validate", "angles.yaml"], ["study", "angles.yaml", "--workers", "1"]):
        result = mbdkit(*words)
        assert result.exit_code == 0
        assert result.stderr.count("warning: ") == 1
        assert told in result.stderr


def test_validate_takes_a_study(mbdkit, in_tmp_path):
    text = SWEEP + 'measures: {far: "max(abs(rod1.position))", turn: {value: final(rod1.angle), unit: deg}}\n'
    (in_tmp_path / "sweep.yaml").write_text(text)
    for arguments, stdin in ((("sweep.yaml",), None), (("-",), text)):
        result = mbdkit("validate", *arguments, stdin=stdin)
        assert result.exit_code == 0, result.stderr
        assert result.stdout.splitlines() == [
            f"{arguments[0]}: this study is valid", "study      A sweep", "runs       4",
            "axis       model.length: 2 values: 1.0, 2.0", "axis       limits.max_steps: 2 values: 100, 3",
            "measure    far [m]: max(abs(rod1.position))", "measure    turn [deg]: final(rod1.angle)",
        ]  # fmt: skip
    assert os.listdir() == ["sweep.yaml"]
    assert mbdkit("validate", "no-drift").exit_code == 0
