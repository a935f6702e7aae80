"""Columns of CSV files are read strictly, and a cell that is not a number is named with its line and column."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbdkit.base.errors import SpecError
from mbdkit.spec.input_tables import read_columns


def read(folder: Path, text: str) -> list[list[float]]:
    (folder / "a.csv").write_text(text, "utf-8")
    return read_columns(folder / "a.csv", ["t", "angle"])


def test_numbers_and_comments_are_read(tmp_path: Path) -> None:
    assert read(tmp_path, '# rig 2\n"t";"angle" \n0;-1.5e-3\n3;+.5;\n') == [[0.0, 3.0], [-1.5e-3, 0.5]]


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        ("1,1_0", "the column 'angle' should have a number here, not '1_0'"),
        ("1,\u0661\u0662", "the column 'angle' should have a number here, not"),
        ("1,0x10", "the column 'angle' should have a number here, not '0x10'"),
        ("1,nan", "the column 'angle' should have a number here, not 'nan'"),
        ("1,", "the column 'angle' should have a number here, not ''"),
        ("1,inf", "the column 'angle' should have a number here, not 'inf'"),
        ("1,1e999", "the column 'angle' should have a number here, not '1e999'"),
        ("1,2\0", "the column 'angle' should have a number here, not"),
        ('1,"2', "cell 2 of this row has a quotation mark that is not closed"),
        ("1," + "3" * 131_073, "cell 2 of this row has more than 131072 characters"),
        ("0,5,1,5", "this row has 4 cells, but there are 2 headings"),
        ("1", "this row has 1 cell, but there are 2 headings"),
    ],
)
def test_what_is_no_number_is_refused_with_its_line(tmp_path: Path, row: str, sentence: str) -> None:
    with pytest.raises(SpecError) as error:
        read(tmp_path, f"t,angle\n0,0\n{row}\n2,2\n")
    assert (error.value.line, error.value.message[: len(sentence)]) == (3, sentence)


def test_a_name_with_a_nul_character_is_refused() -> None:
    with pytest.raises(SpecError, match="has a NUL character"):
        read_columns(Path("a\0.csv"), ["t"])
