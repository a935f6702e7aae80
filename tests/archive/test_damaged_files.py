"""A damaged file that mbdkit wrote is an `ArchiveError`, which is also a `SpecError`; commands end with status 2."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.cli import app

RUN = {"integrator": {"name": "rk4"}, "time": {"end": 0.02, "step": 0.01}}
SPEC = {"mbdkit": 1, "model": {"name": "single-pendulum"}, **RUN}


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def study(folder: Path, **keys: object) -> mbdkit.Study:
    axes = [{"model.length": [1.0, 2.0]}]
    return mbdkit.study({"mbdkit_study": 1, "base": SPEC, "axes": axes, **keys}, out=folder, workers=1)


def test_a_truncated_archive(tmp_path: Path) -> None:
    mbdkit.run(SPEC, archive=tmp_path / "a.h5").close()
    cut(tmp_path / "a.h5")
    with pytest.raises(mbdkit.ArchiveError, match="this archive is truncated") as error:
        mbdkit.load(tmp_path / "a.h5")
    assert not isinstance(error.value, mbdkit.SpecError)
    assert CliRunner().invoke(app, ["archive", "info", str(tmp_path / "a.h5")]).exit_code == 2


def test_a_missing_archive_is_wrong_input_instead(tmp_path: Path) -> None:
    with pytest.raises(mbdkit.SpecError) as error:
        mbdkit.load(tmp_path / "a.h5")
    assert not isinstance(error.value, mbdkit.ArchiveError)


def test_a_truncated_index_of_a_study(tmp_path: Path) -> None:
    study(tmp_path / "study")
    cut(tmp_path / "study" / "index.h5")
    with pytest.raises(mbdkit.ArchiveError, match=r"truncated.*`mbdkit study` to write it again"):
        mbdkit.load_study(tmp_path / "study")


def test_a_truncated_block(tmp_path: Path) -> None:
    study(tmp_path / "study", store="all")
    cut(tmp_path / "study" / "runs" / "block-000000.h5")
    with pytest.raises(mbdkit.ArchiveError, match="truncated"):
        mbdkit.load_study(tmp_path / "study").run(0)


def test_a_damaged_reference_of_an_attribute(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    mbdkit.run(SPEC | {"check": True}, archive=path).close()
    content, problems = path.read_bytes(), []
    for at in range(len(content)):
        if content.startswith(b"units\0", at):  # 44 bytes further, there is its index in the heap
            damaged = bytearray(content)
            damaged[at + 44] ^= 8
            path.write_bytes(damaged)
            problems += check(path)
    assert any("attributes of the arrays cannot be read" in problem for problem in problems)
