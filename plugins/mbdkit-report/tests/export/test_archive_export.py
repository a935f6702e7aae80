"""The command `archive export`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import openpyxl
import pytest

from mbdkit.base.errors import SpecError
from mbdkit_report.workbook import ROWS, write_xlsx
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
        (
            ["--to", "xls"],
            "there is no format 'xls' (did you mean 'xlsx'?); the formats are csv, parquet, xlsx, mat, sto, json",
        ),
        (["--to", "cvs"], "there is no format 'cvs' (did you mean 'csv'?)"),
        (["--to", "csv", "-o", "run.h5"], "run.h5: this is a file, not a folder"),
        (["--to", "csv", "-o", "no/where"], "the folder no does not exist"),
    ],
)
def test_wrong_options_are_refused_and_leave_nothing(
    refusal: Callable[..., str], options: list[str], message: str
) -> None:
    assert message in refusal("archive", "export", "run.h5", *options)


def test_a_workbook_has_the_values_of_the_groups_as_another_reader_sees_them(mbdkit: Callable[..., Any]) -> None:
    assert mbdkit("archive", "export", "run.h5", "--to", "xlsx").stdout.split() == ["run.xlsx"]
    assert mbdkit("archive", "export", "run.h5", "--to", "json").exit_code == 0
    book = openpyxl.load_workbook("run.xlsx")
    groups = {file.stem: json.loads(file.read_text()) for file in Path("run-json").iterdir()}
    assert {sheet.title for sheet in book} == {"contents", *groups}
    for name, group in groups.items():
        first, *rows = book[name].iter_rows(values_only=True)
        units = [f"{one['name']} [{one['units']}]".removesuffix(" [1]") for one in group["columns"]]
        assert list(first) == units
        for got, wanted in zip(rows, group["rows"], strict=True):
            numbers = [value for value in got if isinstance(value, int | float)]
            assert numbers == pytest.approx([value for value in wanted if isinstance(value, int | float)], rel=1e-14)


def test_limits_of_sheets_are_told(tmp_path: Path) -> None:
    table = SimpleNamespace(rows=ROWS, columns=(), first=None)
    with pytest.raises(SpecError, match="the sheet joints would have 1,048,577 rows, but Excel allows 1,048,576"):
        write_xlsx({"joints": table}, tmp_path / "a.xlsx")
    column = SimpleNamespace(name="=1+1", units="1")
    names = ["a/b", "A_b", 40 * "x", 41 * "x"]
    tables = {name: SimpleNamespace(rows=0, columns=(), first=column, blocks=lambda: iter(())) for name in names}
    write_xlsx(tables, tmp_path / "a.xlsx")
    book = openpyxl.load_workbook(tmp_path / "a.xlsx")
    contents = list(book["contents"].iter_rows(values_only=True))[1:]
    assert [row[1] for row in contents] == names
    assert len({row[0].lower() for row in contents}) == 4  # Excel does not distinguish capitals in names of sheets
    assert max(len(row[0]) for row in contents) == 31
    assert book["a_b"]["A1"].data_type == "s"  # text, not a formula
