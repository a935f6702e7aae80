"""Tables as spreadsheets and measuring programs write them: read without loss, or refused in one sentence."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.files.measured_table import MeasuredTable
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table
from mbdkit_biomech.inverse_dynamics.motion.measured import times_of
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import TimeColumn

HIP = [1.5, -2.25, 1000.0]
ROWS = ["0.0,1.5,7", "0.5,-2.25,7", "1.0,1e3,7"]
BIOWARE = ["BioWare\tversion 5.3", "File name:\tjump.dat", "", "abs time (s)\thip\tknee", "s\tN\tN"]


def in_comma_locale(rows: list[str]) -> list[str]:
    return [row.replace(",", ";").replace(".", ",") for row in rows]


def read(folder: Path, lines: list[str], encoding: str = "utf-8") -> MeasuredTable:
    (folder / "t.csv").write_text("\n".join(lines), encoding=encoding)
    return read_table(folder / "t.csv", "motion.file")


@pytest.mark.parametrize(
    ("lines", "unit"),
    [
        (["time;hip;knee", *in_comma_locale(ROWS)], None),
        (["time;hip;knee", "s;deg;deg", *in_comma_locale(ROWS)], "deg"),
        (["time,hip [deg],knee", *ROWS], "deg"),
        (["Time (s),hip (\u00b0),knee", *ROWS], "deg"),
        (["time,hip [Nm],knee", *ROWS], "N m"),
        (["time,hip,knee,,", *(f"{row},," for row in ROWS), ",,,,"], None),
        (["time hip knee", *(row.replace(",", "  ") for row in ROWS)], None),
        (["sep=,", "time,hip,knee", *ROWS], None),
        (["Subject: A, B", "Rate: 100 Hz", "", "time,hip,knee", *ROWS], None),
        (["Left,,", "time,hip,knee", "s,deg,deg", *ROWS], "deg"),
    ],
    ids=["commas", "commas-units", "brackets", "degree-sign", "newton-metre", "empty", "blanks", "sep", "preamble",
         "title"],
)  # fmt: skip
def test_tables_of_spreadsheets_are_read(tmp_path: Path, lines: list[str], unit: str | None) -> None:
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        table = read(tmp_path, lines, encoding)
        np.testing.assert_array_equal(table.column("hip", ""), HIP)
        assert table.unit("hip") == unit
        np.testing.assert_array_equal(times_of(table, TimeColumn(), "motion.time"), [0.0, 0.5, 1.0])


def test_units_in_headings_apply_to_times_and_may_be_part_of_the_name(tmp_path: Path) -> None:
    table = read(tmp_path, ["Time [ms],F [N],F [V],leg (1),left\u00a0hip", "0,1,2,3,4", "500,5,6,7,8"])
    np.testing.assert_array_equal(times_of(table, TimeColumn(), "motion.time"), [0.0, 0.5])
    assert table.headings == ["Time", "F", "F [V]", "leg (1)", "left hip"]
    for heading, first in (("F [N]", 1), ("F", 1), ("F [V]", 2), ("leg (1)", 3), ("left hip", 4)):
        assert table.column(heading, "")[0] == first
    both = read(tmp_path, ["time,hip [rad],hip [deg]", "0,1,57.3", "1,2,114.6"])
    assert [both.unit(heading) for heading in ("hip [rad]", "hip [deg]")] == ["rad", "deg"]


def test_the_header_of_a_force_plate_program_is_left_out(tmp_path: Path) -> None:
    table = read(tmp_path, [*BIOWARE, *(row.replace(",", "\t") for row in ROWS)])
    np.testing.assert_array_equal(table.column("abs time (s)", ""), [0.0, 0.5, 1.0])
    assert table.lines[0] == len(BIOWARE) + 1


@pytest.mark.parametrize("text", ["NaN", "-nan", "#N/A", "<NA>", "None", "1.#QNAN", "-1.#IND", "--"])
def test_all_spellings_of_a_missing_value_are_gaps(tmp_path: Path, text: str) -> None:
    table = read(tmp_path, ["time,hip", "0.0,1", f"0.5,{text}", "1.0,2"])
    np.testing.assert_array_equal(table.column("hip", ""), [1.0, np.nan, 2.0])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (ROWS, "t.csv:1: this table has no headings: its first line has numbers"),
        (["time;hip", "0,0;1.234,5", "1,0;2"], "'0,0' is not a number; decimal commas are read only in tables"),
        (["time,hip,knee", *ROWS, "mean,0.5,1"], "t.csv:5: column 'time': 'mean' is not a number; write nan for"),
        (["time left hip", "0.0 1", "0.5 2"], "there are 3 headings and 2 columns of numbers; separate the cells"),
        (["t,hip", "0.0,1"], "no column 'time'; its columns: t, hip; name the column with the times in `motion.time`"),
        ([",,", ",,,"], "t.csv: this table is empty"),
        (["PK\x03\x04"], "this is a workbook or an archive, not a text; save the table as .csv"),
    ],
    ids=["no-headings", "thousands", "footer", "blanks", "no-time", "delimiters", "workbook"],
)
def test_other_tables_are_refused_in_one_sentence(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(SpecError) as refused:
        times_of(read(tmp_path, lines), TimeColumn(), "motion.time")
    assert message in str(refused.value)


MOTION = ["motion", "version=1", "inDegrees=yes", "endheader", "time\thip\tknee", "0.0\t1\t2", "0.5\t\t4"]


def storage(folder: Path, lines: list[str]) -> MeasuredTable:
    (folder / "t.mot").write_text("\n".join(lines))
    return read_table(folder / "t.mot", "motion.file")


@pytest.mark.parametrize(
    ("header", "is_in_degrees"),
    [
        (["version=1", "inDegrees=yes"], True),
        (["version=1", "inDegrees = No"], False),
        (["version=1"], False),
        (["datacolumns 3", "datarows 2", "range 0 1"], True),  # SIMM; read so by Storage of OpenSim 4.6
    ],
)
def test_the_header_of_a_motion_file_says_whether_angles_are_in_degrees(
    tmp_path: Path, header: list[str], is_in_degrees: bool
) -> None:
    table = storage(tmp_path, ["motion", *header, *MOTION[3:]])
    assert table.in_degrees == is_in_degrees
    np.testing.assert_array_equal(table.column("hip", ""), [1.0, np.nan])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([line.replace("=yes", "=true") for line in MOTION], "t.mot: the header has `inDegrees=true`; write"),
        ([line.replace("inD", "ind") for line in MOTION], "t.mot: the header has `indegrees=yes`; write"),
        ([line.replace("\t", " ") for line in MOTION], "t.mot:7: this row has 2 cells, but there are 3 headings"),
    ],
)
def test_motion_files_that_would_be_misread_are_refused(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(SpecError) as refused:
        storage(tmp_path, lines)
    assert message in str(refused.value)


TRC = ["PathFileType\t4\t(X/Y/Z)\tm.trc", "DataRate\tNumFrames\tNumMarkers\tUnits ", "100\t1\t2\tmm",
       "Frame#\tTime\tA\t\t\tB\t\t", "\t\tX1\tY1\tZ1\tX2\tY2\tZ2", "", "1\t0.5\t1\t2\t3\t4\t5\t6"]  # fmt: skip


def trc(folder: Path, *changes: tuple[str, str]) -> MeasuredTable:
    text = "\n".join(TRC)
    for old, new in changes:
        text = text.replace(old, new)
    (folder / "t.trc").write_text(text)
    return read_table(folder / "t.trc", "motion.file")


@pytest.mark.parametrize("changes", [(), (("A\t\t\t", "\t\t\t"),), (("A\t\t\tB\t\t", "A\tB"),)])
def test_each_marker_has_the_three_columns_below_its_name(tmp_path: Path, changes: tuple[tuple[str, str], ...]) -> None:
    table = trc(tmp_path, *changes)
    assert (table.column("B.x", "")[0], table.column("B.z", "")[0], table.unit("B.x")) == (4.0, 6.0, "mm")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("mm", ""), "t.trc:3: this file states no unit; write, for example, mm below `Units`"),
        (("\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n", ""), "t.trc:5: this row should be X1, Y1, Z1, X2 and so on"),
        (("X1\tY1", "Y1\tX1"), "t.trc:5: this row should be X1, Y1, Z1, X2 and so on"),
        (("100\t1\t2", "100\t1\t3"), "t.trc:4: NumMarkers is 3, but this row has the names of 2 markers"),
        (("\t6", "\t6\t7"), "t.trc:7: this row has 9 cells, but there are 8 headings"),
    ],
    ids=["unit", "no-axes", "axes", "count", "cells"],
)
def test_marker_files_that_would_be_misread_are_refused(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    with pytest.raises(SpecError) as refused:
        trc(tmp_path, change)
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"nRows": "1e14"}, "the header has `nRows=1e14`, but there are 2 rows"),
        ({"nRows": "3"}, "the header has `nRows=3`, but there are 2 rows; is the end missing?"),
        ({"nRows": "9" * 100_000}, "the header has `nRows=999"),
        ({"inDegrees": "x" * 100_000}, "the header has `inDegrees=xxx"),
    ],
)
def test_a_wrong_header_of_a_storage_file_is_a_short_sentence(
    tmp_path: Path, changed: dict[str, str], text: str
) -> None:
    header = {"version": "1", "nRows": "2", "nColumns": "2", "inDegrees": "yes"} | changed
    lines = ["walk", *(f"{key}={value}" for key, value in header.items()), "endheader", "time\thip", "0\t1", "1\t2", ""]
    (tmp_path / "walk.mot").write_text("\n".join(lines))
    with pytest.raises(SpecError) as caught:
        read_table(tmp_path / "walk.mot", "motion.file")
    assert text in caught.value.message
    assert len(caught.value.message) < 400


@pytest.mark.parametrize(
    ("rate", "frames", "text"),
    [
        ("nan", 1, "DataRate should be a rate in Hz, not 'nan'"),
        ("1e400", 1, "DataRate should be a rate in Hz, not '1e400'"),
        ("100", 2, "the header has `NumFrames=2`, but there are 1 rows"),
    ],
)
def test_a_wrong_header_of_a_trc_file_is_refused(tmp_path: Path, rate: str, frames: int, text: str) -> None:
    lines = ["PathFileType\t4\t(X/Y/Z)\tm.trc", "DataRate\tNumFrames\tNumMarkers\tUnits", f"{rate}\t{frames}\t1\tmm",
             "Frame#\tTime\tTOE\t\t", "\t\tX1\tY1\tZ1", "1\t0\t1\t2\t3", ""]  # fmt: skip
    (tmp_path / "walk.trc").write_text("\n".join(lines))
    with pytest.raises(SpecError, match=re.escape(text)):
        read_table(tmp_path / "walk.trc", "motion.file")
