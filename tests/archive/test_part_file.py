"""The unfinished file of an archive, when a plugin changes what belongs to the whole process."""

from __future__ import annotations

import os
import random
import select
import sys
from pathlib import Path

import pytest

import mbdkit
from mbdkit.archive import writer
from mbdkit.archive.archive_check import check
from mbdkit.archive.part_stream import complete_flush
from mbdkit.base.errors import ResourceError
from mbdkit.integrators import interface

from .recorded_writes import Change, content_after, drawn_states, problems_of_state, recorded_writes

SPEC = {"mbdkit": 1, "model": {"name": "single-pendulum"}, "integrator": {"name": "rk4"}}


def test_an_archive_gets_its_name_in_the_folder_where_the_run_began(in_tmp_path: Path) -> None:
    (in_tmp_path / "elsewhere").mkdir()

    def wander(*told: object) -> None:
        os.chdir(in_tmp_path / "elsewhere")

    run = mbdkit.run({**SPEC, "time": {"steps": 20_000, "step": 1e-4}}, archive="run.h5", progress=wander)
    assert Path.cwd() == in_tmp_path / "elsewhere"
    with run:
        assert run.path == in_tmp_path / "run.h5"
    assert os.listdir(in_tmp_path / "elsewhere") == []
    assert check(in_tmp_path / "run.h5") == []


@pytest.mark.skipif(sys.platform == "win32", reason="there is no fork on Windows")
@pytest.mark.parametrize("child", ["goes on", "outlives the run"])
def test_a_forked_copy_of_a_run_writes_nothing(child: str, tmp_path: Path) -> None:
    children: list[int] = []
    pipe = os.pipe()

    def fork(*told: object) -> None:
        if not children:
            children.append(os.fork())
            if not children[0] and child == "outlives the run":
                select.select([pipe[0]], [], [], 20.0)

    with mbdkit.run(
        {**SPEC, "time": {"steps": 20_000, "step": 1e-4}}, archive=tmp_path / "run.h5", progress=fork
    ) as run:
        assert run.status == "complete"
    os.write(pipe[1], b"\n")
    _, status = os.waitpid(children[0], 0)
    assert os.waitstatus_to_exitcode(status) == 1
    assert os.listdir(tmp_path) == ["run.h5"]
    assert check(tmp_path / "run.h5") == []


RECORDS = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="the names of open files are not known")


def changes_of(path: Path, monkeypatch: pytest.MonkeyPatch, flush: float) -> list[Change]:
    """Return the changes of the ``.part`` of a run with some events, which is flushed after this time [s]."""
    monkeypatch.setattr(writer, "FLUSH_INTERVAL", flush)
    monkeypatch.setattr(interface, "STRETCH", 0.001)
    spec = {**SPEC, "time": {"steps": 2000, "step": 2e-3}, "events": {"down": {"when": "rod1.x"}}}
    return recorded_writes(path, lambda: mbdkit.run(spec, archive=path).close(), monkeypatch)


@RECORDS
@pytest.mark.parametrize(("flush", "number"), [(0.0, 60), (1e9, 10)], ids=["during the run", "as a whole"])
def test_a_run_killed_after_any_page_of_any_write_keeps_all_flushed_rows(
    flush: float, number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, part = tmp_path / "run.h5", tmp_path / "killed.h5.part"
    states = drawn_states(changes_of(path, monkeypatch, flush), number, random.Random(115))
    with mbdkit.load(path) as whole:
        assert [problem for state in states for problem in problems_of_state(part, state, whole)] == []


@RECORDS
def test_a_flush_is_completed_if_its_journal_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, part = tmp_path / "run.h5", tmp_path / "killed.h5.part"
    changes = changes_of(path, monkeypatch, 0.0)
    last = max(index for index, change in enumerate(changes) if b"mbdkit journal" in (change.data or b"")[-100:])
    whole = content_after(changes[: last + 1])
    part.write_bytes(whole)
    complete_flush(part)
    assert part.read_bytes() == path.read_bytes()
    for position in (1, 60, 5000):
        damaged = bytearray(whole)
        damaged[-position] ^= 1
        part.write_bytes(damaged)
        complete_flush(part)
        assert part.read_bytes() == damaged

    def refuse(*arguments: object) -> int:
        raise PermissionError(13, "Permission denied")

    part.write_bytes(whole)
    monkeypatch.setattr("mbdkit.base.file_locks.open_file", refuse)
    with pytest.raises(ResourceError, match="cannot be completed here: Permission denied; copy the file"):
        mbdkit.load(part)
