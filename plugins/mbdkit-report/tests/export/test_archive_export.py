"""The command `archive export`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.archive.making import make


@pytest.fixture(autouse=True)
def archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    make(Path("run.h5"))


def test_each_group_becomes_a_file_whose_name_is_printed(mbdkit: Callable[..., Any]) -> None:
    result = mbdkit("archive", "export", "run.h5", "--to", "csv")
    assert result.exit_code == 0, result.stderr
    files = [Path(line) for line in result.stdout.splitlines()]
    assert Path("run-csv/joints.csv") in files
    assert all(file.is_file() for file in files)
    assert len(files) == len(list(Path("run-csv").iterdir()))


def test_another_folder_and_quiet(mbdkit: Callable[..., Any]) -> None:
    result = mbdkit("archive", "export", "run.h5", "--to", "json", "-o", "out", "--quiet")
    assert (result.exit_code, result.stdout) == (0, "")
    assert Path("out/energy.json").is_file()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--to", "xls"], "there is no format 'xls'; the formats are csv, parquet, mat, sto, json"),
        (["--to", "cvs"], "there is no format 'cvs' (did you mean 'csv'?)"),
        (["--to", "csv", "-o", "run.h5"], "run.h5: this is a file, not a folder"),
        (["--to", "csv", "-o", "no/where"], "the folder no does not exist"),
    ],
)
def test_wrong_options_are_refused_and_leave_nothing(
    refusal: Callable[..., str], options: list[str], message: str
) -> None:
    assert message in refusal("archive", "export", "run.h5", *options)
