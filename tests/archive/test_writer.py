"""What is appended is what is in the file, in bounded memory and few bytes, whatever ends the run."""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mbdkit.archive import growing_array
from mbdkit.archive.archive_check import check
from mbdkit.archive.layout import every_array
from mbdkit.archive.reader import load
from mbdkit.archive.run_writer import Ending

from .making import SPEC, STATS, fill, largest, make, names, rows, steps, writer


def assert_holds(path: Path, count: int, named: object = None) -> None:
    """The archive at `path` holds the first `count` made-up rows."""
    expected = rows(count, names())
    with h5py.File(path) as file:
        for array in every_array():
            if array.dims[0] == "time" and not array.optional:
                np.testing.assert_array_equal(file[array.path][:], expected[array.key], err_msg=array.path)
        for name, values in steps(count - 1).items():
            np.testing.assert_array_equal(file[f"steps/{name}"][:], values)
        np.testing.assert_array_equal(file["steps/interval"][:], np.arange(1, count))


@pytest.mark.parametrize("piece", [1, 4, 11])
def test_rows_are_in_the_file_as_appended(tmp_path: Path, piece: int) -> None:
    make(tmp_path / "run.h5", piece=piece)
    assert_holds(tmp_path / "run.h5", 11)


@pytest.mark.usefixtures("always_due")
@pytest.mark.parametrize("piece", [1, 4, 7])
def test_rows_are_in_the_file_as_appended_over_many_flushes(tmp_path: Path, piece: int) -> None:
    make(tmp_path / "run.h5", count=23, piece=piece, after="flush_if_due")
    assert_holds(tmp_path / "run.h5", 23)
    assert check(tmp_path / "run.h5") == []


def test_rows_beyond_the_buffer_are_written_as_they_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing_array, "BUFFER_BYTES", 5000)
    make(tmp_path / "run.h5", count=500, piece=170)
    assert_holds(tmp_path / "run.h5", 500)
    assert check(tmp_path / "run.h5") == []


def test_storage_has_no_say_in_the_hash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make(tmp_path / "one.h5", count=100)
    monkeypatch.setattr(growing_array, "BUFFER_BYTES", 5000)
    make(tmp_path / "two.h5", count=100, piece=7)
    with load(tmp_path / "one.h5") as one, load(tmp_path / "two.h5") as two:
        assert one.data_sha256 == two.data_sha256
        assert one.file["energy/total"].chunks is None
        assert two.file["energy/total"].chunks is not None


def test_appended_arrays_are_copied(tmp_path: Path) -> None:
    named = names()
    with_rows, with_steps = rows(3, named), steps(2)
    into = writer(tmp_path / "run.h5")
    into.append(with_rows)
    into.append_numbered("steps", with_steps)
    for values in (*with_rows.values(), *with_steps.values()):
        values[...] = -1
    into.finish(Ending("complete", "", STATS, largest(3, named)))
    assert_holds(tmp_path / "run.h5", 3)


def test_part_is_flushed_when_a_second_has_passed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    into = writer(tmp_path / "run.h5")
    fill(into, 4)
    part = tmp_path / "run.h5.part"
    now = 100.9
    into.flush_if_due()
    assert part.stat().st_size == 0
    now = 101.0
    into.flush_if_due()
    size = part.stat().st_size
    assert size > 0
    into.append(rows(5000, names(), 4))
    now = 102.0
    into.flush_if_due()
    assert part.stat().st_size > size
    into.abandon()


@pytest.mark.parametrize("moment", ["_write_end", "_write_verdict", "flush", "sync"])
def test_run_killed_while_it_ends_is_running_or_valid(tmp_path: Path, monkeypatch: Any, moment: str) -> None:
    into = writer(tmp_path / "run.h5")
    fill(into, 30)
    into._write_more()
    left = tmp_path / "killed.h5.part"
    owner = into._target if moment == "sync" else into
    if moment == "flush":
        owner, moment = into, "_write_verdict"
        write = into._write_verdict

        def killed(*given: Any) -> None:
            write(*given)
            into._file.flush()
            left.write_bytes((tmp_path / "run.h5.part").read_bytes())
    else:

        def killed(*given: Any) -> None:
            if moment != "sync":
                into._file.flush()
            left.write_bytes((tmp_path / "run.h5.part").read_bytes())
            if moment != "sync":
                raise KeyboardInterrupt

    monkeypatch.setattr(owner, moment, killed)
    with contextlib.suppress(KeyboardInterrupt):
        into.finish(Ending("complete", "", STATS, largest(30, names())))
    with load(left) as run:
        assert len(run.time) == len(run.energy.total) == 30
        assert run.status == ("complete" if moment == "sync" else "running")
    if moment == "sync":
        assert check(left) == []


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        ("complete", ""),
        ("failed", "newton-failed: the step at t = 0.05 s did not converge"),
        ("interrupted", ""),
    ],
)
def test_every_end_gives_the_archive_its_name_and_status(tmp_path: Path, status: str, reason: str) -> None:
    make(tmp_path / "run.h5", status=status, reason=reason)
    assert os.listdir(tmp_path) == ["run.h5"]
    with load(tmp_path / "run.h5") as run:
        assert (run.status, run.status_reason) == (status, reason)
    assert check(tmp_path / "run.h5") == []


def test_finish_adds_its_own_time_and_keeps_integers_integers(tmp_path: Path) -> None:
    make(tmp_path / "run.h5")
    with load(tmp_path / "run.h5") as run:
        assert {name: run.stats[name] for name in STATS} == STATS
        assert [type(run.stats[name]) for name in STATS] == [type(value) for value in STATS.values()]
        assert 0.0 < run.stats["finish_s"] < 10.0


@pytest.mark.parametrize("recorded", [set(), {"energy"}, {"joints"}, {"constraints", "joints"}])
def test_only_the_asked_quantities_are_recorded(tmp_path: Path, recorded: set[str]) -> None:
    spec = {**SPEC, "output": {"quantities": sorted(recorded)}}
    make(tmp_path / "run.h5", quantities=frozenset(recorded), spec=spec)
    assert check(tmp_path / "run.h5") == []
    with load(tmp_path / "run.h5") as run:
        assert run.records("energy/total") == ("energy" in recorded)
        assert run.records("joints/misalignment") == ("joints" in recorded)
        assert run.records("constraints/multiplier") == ("constraints" in recorded)
        assert run.joints["J2"].misalignment_max == 1.001  # over every step, so it needs no rows


def test_method_brings_its_own_multiplier(tmp_path: Path) -> None:
    make(tmp_path / "run.h5", extra_datasets=["constraints/method_multiplier"])
    assert check(tmp_path / "run.h5") == []
    with load(tmp_path / "run.h5") as run:
        wanted = rows(11, names())["constraints/method_multiplier"][:, 1]
        np.testing.assert_array_equal(run.constraints["J1.y"].method_multiplier, wanted)


def test_rows_of_another_shape_are_refused(tmp_path: Path) -> None:
    into = writer(tmp_path / "run.h5")
    with pytest.raises(ValueError, match="joints/reaction_force has shape"):
        into.append({**rows(2, names()), "joints/reaction_force": np.zeros((2, 2, 3))})
    with pytest.raises(ValueError, match="no trajectory/speed"):
        into.append({**rows(2, names()), "trajectory/speed": np.zeros(2)})
    into.abandon()


def test_refused_rows_leave_no_trace(tmp_path: Path) -> None:
    into = writer(tmp_path / "run.h5")
    fill(into, 5)
    with pytest.raises(ValueError, match="has shape"):
        into.append({**rows(2, names(), 5), "energy/work": np.zeros(3)})
    into.finish(Ending("complete", "", STATS, largest(5, names())))
    assert_holds(tmp_path / "run.h5", 5)


@pytest.mark.parametrize("torn", ["joints/misalignment", "energy/balance", "steps/size"])
def test_interrupted_write_is_taken_up_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, torn: str) -> None:
    into = writer(tmp_path / "run.h5")
    fill(into, 20, piece=5)
    into._write_more()
    into.append(rows(3, names(), 20))
    into.append_numbered("steps", steps(3, 19))
    extend = growing_array.Series.extend

    def interrupted(series: growing_array.Series, values: np.ndarray, start: int) -> None:
        if series.array.path == torn:
            raise KeyboardInterrupt
        extend(series, values, start)

    monkeypatch.setattr(growing_array.Series, "extend", interrupted)
    with pytest.raises(KeyboardInterrupt):
        into._write_more()
    monkeypatch.setattr(growing_array.Series, "extend", extend)
    into.append(rows(2, names(), 23))
    into.append_numbered("steps", steps(2, 22))
    into.finish(Ending("interrupted", "", STATS, largest(25, names())))
    assert_holds(tmp_path / "run.h5", 25)
    assert check(tmp_path / "run.h5") == []


def test_spec_and_misalignments_may_exceed_64_kib(tmp_path: Path) -> None:
    named = names(1, 10_000, 0)
    spec = {**SPEC, "model": {**SPEC["model"], "lengths": [1.0] * 30_000}}
    make(tmp_path / "run.h5", count=2, named=named, spec=spec)
    with load(tmp_path / "run.h5") as run:
        assert run.spec["model"]["lengths"] == [1.0] * 30_000
        assert run.joints["J10000"].misalignment_max == largest(2, named)[-1]


def test_names_may_be_in_any_script(tmp_path: Path) -> None:
    named = names()
    named = replace(named, bodies=["Schenkel links", "大腿"], joints=["knee joint", "Hüfte"])
    make(tmp_path / "run.h5", named=named)
    with load(tmp_path / "run.h5") as run:
        assert list(run.bodies) == ["Schenkel links", "大腿"]
        assert list(run.joints) == ["knee joint", "Hüfte"]


def test_small_runs_make_small_files(tmp_path: Path) -> None:
    make(tmp_path / "run.h5", count=3, named=names(1, 1, forces=0))
    assert (tmp_path / "run.h5").stat().st_size < 56_000
    make(tmp_path / "more.h5", count=3, named=names(1, 1))
    assert (tmp_path / "more.h5").stat().st_size < 74_000


@pytest.mark.usefixtures("always_due")
def test_slow_runs_make_small_files(tmp_path: Path) -> None:
    make(tmp_path / "run.h5", count=20, named=names(1, 1), piece=1, after="flush_if_due")
    assert (tmp_path / "run.h5").stat().st_size < 1_000_000


@pytest.mark.usefixtures("always_due")
def test_chunks_are_of_moderate_size(tmp_path: Path) -> None:
    make(tmp_path / "run.h5", count=40_000, named=names(3, 1), piece=20_000, after="flush_if_due")
    with h5py.File(tmp_path / "run.h5") as file:
        for array in every_array():
            if array.grows and array.path in file:
                chunks = file[array.path].chunks
                assert 1 << 14 <= 8 * np.prod(chunks) <= 1 << 17, array.path
    assert check(tmp_path / "run.h5") == []
