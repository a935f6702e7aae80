"""Text files of motion capture programs are read with their headings, units, times and gaps.

The files are synthetic, in the layouts of Vicon Nexus 2 (sections with name, rate, names, components and units) and of
the manual of Qualisys Track Manager (motion data, .tsv); expected values are the numbers that were written.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.inverse_dynamics.noisy_pendulum import pendulum

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.files.measured_table import MeasuredTable
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table

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
