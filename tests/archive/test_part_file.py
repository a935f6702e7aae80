"""The unfinished file of an archive, when a plugin changes what belongs to the whole process."""

from __future__ import annotations

import os
import select
import sys
from pathlib import Path

import pytest

import mbdkit
from mbdkit.archive.archive_check import check

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
