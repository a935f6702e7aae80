"""Tables of spreadsheets, measuring and motion capture programs: read without loss, or refused in one sentence."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from tests.inverse_dynamics.noisy_pendulum import pendulum

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.files.measured_table import MeasuredTable
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table
from mbdkit_biomech.inverse_dynamics.motion.measured import times_of
from mbdkit_biomech.inverse_dynamics.motion.smoothing import low_passed
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Butterworth, TimeColumn

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
        (["%time,hip,knee,8 Feb 2018", *ROWS], "t.csv:2: this row has 3 cells, but line 1 has 4: remove the heading"),
        (["time;hip", "0,0;1.234,5", "1,0;2"], "'0,0' is not a number; decimal commas are read only in tables"),
        (["time,hip,knee", *ROWS, "mean,0.5,1"], "t.csv:5: column 'time': 'mean' is not a number; write nan for"),
        (["time left hip", "0.0 1", "0.5 2"], "there are 3 headings and 2 columns of numbers; separate the cells"),
        (["t,hip", "0.0,1"], "no column 'time'; its columns: t, hip; name the column with the times in `motion.time`"),
        (["Zeit (s),hip", "0.0,1"], "in `motion.time`, such as `time: Zeit"),
        (
            ["t,1_ground_force_vx", "0.0,1"],
            "`force: [1_ground_force_vx, 1_ground_force_vy], point: [1_ground_force_px",
        ),
        ([",,", ",,,"], "t.csv: this table is empty"),
        (["PK\x03\x04"], "this is a workbook or an archive, not a text; save the table as .csv"),
    ],
    ids=[
        "no-headings",
        "longer-header",
        "thousands",
        "footer",
        "blanks",
        "no-time",
        "other-time",
        "opensim",
        "delimiters",
        "workbook",
    ],
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


@pytest.mark.parametrize(
    "changes",
    [(), (("A\t\t\t", "\t\t\t"),), (("A\t\t\tB\t\t", "A\tB"),), (("100\t1\t2\tmm", "  100.0\t\t 1\t\t 2\t\t mm"),)],
)
def test_each_marker_has_the_three_columns_below_its_name(tmp_path: Path, changes: tuple[tuple[str, str], ...]) -> None:
    table = trc(tmp_path, *changes)
    assert (table.column("B.x", "")[0], table.column("B.z", "")[0], table.unit("B.x")) == (4.0, 6.0, "mm")


def timed(folder: Path, rate: str, times: list[str]) -> np.ndarray:
    rows = "\n".join(f"{number}\t{time}\t1\t2\t3\t4\t5\t6" for number, time in enumerate(times, 1))
    return trc(folder, ("100\t1\t2", f"{rate}\t{len(times)}\t2"), (TRC[-1], rows)).column("time", "")


@pytest.mark.parametrize("first", [0, 24])
def test_rounded_times_of_frames_get_the_digits_that_their_rate_states(tmp_path: Path, first: int) -> None:
    frames = (first + np.arange(9)) / 60
    np.testing.assert_array_equal(timed(tmp_path, "60.00", [f"{time:.3f}000" for time in frames]), frames)


@pytest.mark.parametrize(
    ("rate", "times"),
    [
        ("60", ["0.000", "0.017", "0.033", "0.067", "0.083"]),  # a row is missing
        ("60", ["0.000", "0.017", "0.034", "0.051", "0.068"]),  # another rate
        ("50", ["0.00", "0.02", "0.04", "0.06"]),
        ("60", ["0.0", "0.0", "0.0", "0.1"]),  # too coarse
    ],
)
def test_other_times_of_frames_stay_as_they_are_written(tmp_path: Path, rate: str, times: list[str]) -> None:
    np.testing.assert_array_equal(timed(tmp_path, rate, times), np.array(times, dtype=float))


def test_a_filter_names_rounding_as_the_cause_of_uneven_times() -> None:
    time, how = np.round(np.arange(60) / 60, 3), Butterworth(name="butterworth", cutoff=6.0)
    with pytest.raises(SpecError, match=re.escape("even apart from rounding to 0.001 s: write them with more digits")):
        low_passed(time, np.zeros((60, 1)), how)
    time[30:] += 1 / 60  # a row is missing
    with pytest.raises(SpecError, match="if rows are missing"):
        low_passed(time, np.zeros((60, 1)), how)


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


VICON = """

Trajectories
100
,,Ann:LKNE,,,Ann:*17,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
101,0,1.5,2.5,3.5,10,20,30
102,0,,,,11,21,31
103,0,1.7,2.7,3.7,12,22,32

Model Outputs
100
,,Ann:LKneeAngles,,
Frame,Sub Frame,X,Y,Z
,,deg,deg,deg
101,0,45,0,0
102,0,46,0,0
103,0,47,0,0
"""
DEVICES = """Devices
200
,,Plate 1 - Force,,,Plate 1 - Moment,,,Trigger
Frame,Sub Frame,Fx,Fy,Fz,Mx,My,Mz,1
,,N,N,N,N.mm,N.mm,N.mm,V
101,0,1,2,700,1000,0,0,5
101,1,9,9,999,9,9,9,5
102,0,2,3,800,2000,0,0,5
102,1,9,9,999,9,9,9,5
103,0,3,4,900,3000,0,0,5
103,1,9,9,999,9,9,9,5

"""
QUALISYS = (
    "NO_OF_FRAMES\t3\nNO_OF_CAMERAS\t8\nNO_OF_MARKERS\t2\nFREQUENCY\t200\nNO_OF_ANALOG\t0\nANALOG_FREQUENCY\t0\n"
    "DESCRIPTION\t--\nTIME_STAMP\t2024-01-01, 12:00:00\t1.5\nDATA_INCLUDED\t3D\nEVENT\tkick\t2\t0.005\n"
    "MARKER_NAMES\tknee\tl ankle\n"
)


def table(folder: Path, name: str, text: str) -> MeasuredTable:
    (folder / name).write_text(text, encoding="utf-8")
    return read_table(folder / name, "motion.file")


def values(read: MeasuredTable, *headings: str) -> np.ndarray:
    return np.column_stack([read.column(heading, "motion.columns") for heading in headings])


def test_sections_of_vicon_nexus_are_one_table_with_times_and_units(tmp_path: Path) -> None:
    for text in (VICON, DEVICES + VICON, (DEVICES + VICON).replace(",", ";").replace("\n", "\r\n")):
        read = table(tmp_path, "t.csv", text)
        np.testing.assert_allclose(values(read, "time")[:, 0], [1.0, 1.01, 1.02], rtol=1e-14)
        expected = [[1.5, 2.5, 3.5], [np.nan] * 3, [1.7, 2.7, 3.7]]
        np.testing.assert_array_equal(values(read, "LKNE.x", "Ann:LKNE.y", "LKNE.z"), expected)
        np.testing.assert_array_equal(values(read, "LKneeAngles.x", "*17.z"), [[45, 30], [46, 31], [47, 32]])
        assert (read.unit("LKNE.x"), read.unit("LKneeAngles.x"), read.unit("time")) == ("mm", "deg", None)
    read = table(tmp_path, "t.csv", DEVICES + VICON)  # devices at the frames of the cameras
    np.testing.assert_array_equal(values(read, "Plate 1 - Force.Fz", "Plate 1 - Moment.Mx")[:, 0], [700, 800, 900])
    assert read.unit("Plate 1 - Moment.Mx") == "N mm"
    alone = table(tmp_path, "t.csv", DEVICES)  # without cameras, at their own rate
    np.testing.assert_allclose(values(alone, "time")[:, 0], 1 + np.arange(6) / 200, rtol=1e-14)
    np.testing.assert_array_equal(values(alone, "Plate 1 - Force.Fy")[:, 0], [2, 9, 3, 9, 4, 9])


def test_markers_of_qualisys_have_times_of_the_frequency_or_of_the_file(tmp_path: Path) -> None:
    rows = "1\t2\t3\t4\t5\t6\n0.000\t0.000\t0.000\t7\t0\t8\n\t\t\t9\t9\t9\n"
    read = table(tmp_path, "t.tsv", QUALISYS + rows)
    np.testing.assert_allclose(values(read, "time")[:, 0], [0, 0.005, 0.01], rtol=1e-14)
    expected = [[1, 2, 3], [np.nan] * 3, [np.nan] * 3]
    np.testing.assert_array_equal(values(read, "knee.x", "knee.y", "knee.z"), expected)
    np.testing.assert_array_equal(values(read, "l ankle.x", "l ankle.y"), [[4, 5], [7, 0], [9, 9]])
    assert read.unit("knee.z") == "mm"
    timed = "".join(f"{k + 1}\t{0.5 + k / 200}\t{row}\n" for k, row in enumerate(rows.splitlines()))
    types = "TRAJECTORY_TYPES\tMeasured\tMixed\n"
    heads = "Frame\tTime\tknee X\tknee Y\tknee Z\tl ankle X\tl ankle Y\tl ankle Z\n"
    for lines in (timed, types + timed, types + heads + timed):
        read = table(tmp_path, "t.tsv", "FILE_VERSION\t2.0.0\n" + QUALISYS + lines)
        np.testing.assert_allclose(values(read, "time")[:, 0], [0.5, 0.505, 0.51], rtol=1e-14)
        np.testing.assert_array_equal(values(read, "knee.x", "knee.y", "knee.z"), expected)


def test_a_row_of_units_converts_columns_unless_the_spec_has_units(tmp_path: Path) -> None:
    time = np.linspace(0.0, 1.0, 21)
    rows = [f"{1000 * t:.0f},{np.degrees(0.3 * np.sin(3 * t)):.12f},a" for t in time]
    (tmp_path / "t.csv").write_text("\n".join(["time,hip,note", "ms,[deg],-", *rows]))
    spec = pendulum(smooth="quintic")
    spec["motion"] = {"file": str(tmp_path / "t.csv"), "columns": {"hip.angle": "hip"}}
    run = mbdkit.inverse(spec)
    np.testing.assert_allclose(run.time, time, atol=1e-12)
    np.testing.assert_allclose(run.motion["hip.angle"].raw, 0.3 * np.sin(3 * time), atol=1e-12)
    spec["motion"]["columns"] = {"hip.angle": {"column": "hip", "unit": "rad"}}
    spec["motion"]["time"] = {"column": "time", "unit": "s"}
    assert mbdkit.inverse(spec).time[-1] == 1000.0
    (tmp_path / "t.csv").write_text("\n".join(["time,hip,note", "s,ell,-", *rows]))
    spec["motion"] = {"file": str(tmp_path / "t.csv"), "columns": {"hip.angle": "hip"}}
    with pytest.raises(SpecError, match="column 'hip': its unit in the file, 'ell' is not a known unit"):
        mbdkit.inverse(spec)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("t.csv", VICON.replace("100\n", "x\n"), "no section with a rate"),
        ("t.csv", VICON.replace("Frame,Sub", "Bild,Sub"), "beginning with Frame and Sub Frame"),
        ("t.csv", VICON.replace("102,0,,", "102,0,0,0,0,0,0,0,0,"), "t.csv:9: this row has"),
        ("t.csv", VICON.replace("102,0", "1o2,0"), "t.csv:9: '1o2' is not the number of a frame"),
        ("t.csv", "Trajectories\n100\n", "has no frames"),
        ("t.csv", VICON.replace("100", "0"), "'0' is not a rate in Hz"),
        ("t.tsv", QUALISYS.replace("3D", "2D") + "1\t2\t3\t4\t5\t6\n", "data of the kind 2D"),
        ("t.tsv", QUALISYS.replace("MARKER_NAMES", "BODY_NAMES") + "1\t2\n", "no row MARKER_NAMES"),
        ("t.tsv", QUALISYS + "1\t2\t3\t4\t5\t6\t7\t8\t9\n", "this row has 9 cells, but 2 markers need 8"),
        ("t.tsv", QUALISYS.replace("\t200", "\tEXT") + "1\t2\t3\t4\t5\t6\n", "'EXT' is not a rate in Hz"),
        ("t.tsv", "NO_OF_SAMPLES\t3\nFREQUENCY\t100\nForce_X\tForce_Y\n1\t2\n", "no row MARKER_NAMES"),
    ],
)
def test_files_that_are_not_understood_are_refused_in_one_sentence(
    tmp_path: Path, name: str, text: str, message: str
) -> None:
    with pytest.raises(SpecError) as refused:
        table(tmp_path, name, text)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
