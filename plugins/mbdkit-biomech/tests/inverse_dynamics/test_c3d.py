"""Markers and force plates of C3D files in the conventions of several makers, and what is said of damaged files."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.inverse_dynamics.c3d_files import DEC, INTEL, MIPS, Convention, Plate, c3d_bytes
from tests.inverse_dynamics.force_plates import plate
from tests.inverse_dynamics.measured_pendulum import pendulum

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.files.c3d_file import read_c3d
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table

ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed: pip install mbdkit[c3d]")

ANGLE = 0.1 * np.arange(20)
MARKERS = {"tip.x": "TOE.x", "tip.y": "TOE.y"}


def write(path: Path, labels: list[str], unit: str = "mm", gap: int | None = None) -> Path:
    """Write a file with a marker at the tip of a rod of 1 m; the others are at rest, and one has a gap in a frame."""
    file = ezc3d.c3d()
    points, residuals = np.zeros((4, len(labels), len(ANGLE))), np.zeros((1, len(labels), len(ANGLE)))
    size = {"mm": 1000.0, "m": 1.0}[unit]
    points[0, -1], points[1, -1], points[3] = size * np.cos(ANGLE), size * np.sin(ANGLE), 1.0
    if gap is not None:
        points[:3, -1, gap], residuals[0, -1, gap] = 0.0, -1.0  # as systems mark a point that no camera saw
    about = file["parameters"]["POINT"]
    about["RATE"]["value"], about["LABELS"]["value"], about["UNITS"]["value"] = [100.0], labels, [unit]
    file["data"]["points"], file["data"]["meta_points"]["residuals"] = points, residuals
    file.write(str(path))
    return path


def inverse(path: Path, **motion: Any) -> mbdkit.Run:
    spec = pendulum(str(path), columns=MARKERS, **motion)
    return mbdkit.inverse(spec, actuators={"hip": {"joint": "hip"}})


def test_more_markers_than_one_parameter_of_the_file_names(tmp_path: Path) -> None:
    run = inverse(write(tmp_path / "many.c3d", [*(f"M{k}" for k in range(299)), "TOE"]))
    np.testing.assert_allclose(run.joints["hip"].angle, ANGLE, rtol=0, atol=1e-6)


def test_wrong_names_and_wrong_files_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "walk.c3d", ["HEEL", "TOES"])
    with pytest.raises(SpecError, match=r"\"tip\.x\"\.column: walk.c3d has no column 'TOE.x'.*'TOES.x'"):
        inverse(path)
    with pytest.raises(SpecError, match=r"walk.c3d: two columns have the heading 'TOE.x'"):
        inverse(write(tmp_path / "walk.c3d", ["TOE", "TOE"]))
    inverse(write(tmp_path / "walk.c3d", ["rest", "rest", "TOE"]))  # columns that are not used
    whole = path.read_bytes()
    for content in (b"", b"time,hip\n0,1\n", whole[: len(whole) // 2]):
        (tmp_path / "bad.c3d").write_bytes(content)
        with pytest.raises(SpecError, match=r"bad.c3d: this (is not a C3D file that can be read|C3D file)"):
            inverse(tmp_path / "bad.c3d")


CONVENTIONS = {  # byte order, numbers and names as the systems of these makers write them
    "Vicon": (Convention(unit="mm", first_frame=1), "Subject:"),
    "Qualisys": (Convention(unit="mm", analog_scale=0.01), ""),
    "Motion Analysis": (Convention(MIPS, scale=0.02, analog_scale=0.05, analog_offset=2048), ""),
    "older systems on DEC computers": (Convention(DEC, scale=0.02, analog_scale=0.05, analog_offset=10), ""),
    "floating-point numbers of DEC": (Convention(DEC, analog_scale=0.5), ""),
}


@pytest.mark.parametrize("kind", [1, 2, 3, 4])
@pytest.mark.parametrize("maker", CONVENTIONS)
def test_markers_and_plates_of_a_maker_come_back(tmp_path: Path, maker: str, kind: int) -> None:
    how, subject = CONVENTIONS[maker]
    time, samples = np.arange(24) / 100.0, 5
    knee = np.column_stack([500 + 100 * time, 0 * time + 20.0, 450 + 50 * np.sin(7 * time)])
    ankle = np.where(np.arange(24)[:, None] == 7, np.nan, knee - [20.0, 0.0, 400.0])
    fine = np.arange(24 * samples) / 500.0
    force = np.column_stack([60 * np.sin(9 * fine), 10 + 0 * fine, 600 + 100 * np.cos(8 * fine)])
    force[:20] = 0.0  # before the foot touches the plate
    point = np.column_stack([600 + 300 * fine, 30 + 0 * fine, 0 * fine])
    torque = np.column_stack([0 * fine, 0 * fine, 4000 * np.sin(6 * fine)]) * (np.arange(len(fine)) >= 20)[:, None]
    plates = [plate(kind, 0.0 * force, point, 0.0 * torque, np.array([0.0, 0.0, 0.0])),
              plate(kind, force, point, torque, np.array([650.0, 0.0, 0.0]))]  # fmt: skip
    file = tmp_path / "gait.c3d"
    file.write_bytes(c3d_bytes({f"{subject}LKNE": knee, f"{subject}LANK": ankle}, 100.0, how, plates, samples))
    table = read_table(file, "motion.file")

    def columns(name: str) -> np.ndarray:
        return np.column_stack([table.column(f"{name}.{axis}", "") for axis in "xyz"])

    assert table.unit("LKNE.x") == table.unit("plate2.point.x") == "mm"
    assert table.unit("plate2.force.x") is None
    np.testing.assert_allclose(table.column("time", ""), time, atol=1e-12)
    # margin: half a unit of the file's integers
    np.testing.assert_allclose(columns("LKNE"), knee, atol=1e-4 if how.scale == 0 else 0.014)
    # margin: half a unit of the file's integers
    np.testing.assert_allclose(columns("LANK"), ankle, atol=1e-4 if how.scale == 0 else 0.014)
    np.testing.assert_array_equal(columns(f"{subject}LKNE"), columns("LKNE"))
    # integers of 0.05 N and 10 N mm; forces of type 3 are sums of up to four of them
    digits = (0.11 if kind == 3 else 0.06) if how.scale else 1e-3
    # margin: half a unit of the file's integers
    np.testing.assert_allclose(columns("plate2.force"), force[::samples], atol=digits)
    np.testing.assert_allclose(columns("plate2.torque"), 1e-3 * torque[::samples], atol=digits)
    np.testing.assert_allclose(columns("plate2.point")[4:], point[::samples][4:], atol=0.5 if how.scale else 1e-2)
    assert np.all(np.isnan(columns("plate2.point")[:4]))
    assert not np.any(columns("plate1.force"))


def test_plates_of_several_types_without_markers_are_a_table_of_all_samples(tmp_path: Path) -> None:
    # as programs of force plates write them, with a frame rate of 0 in some of them
    force = np.column_stack([np.full(30, 40.0), np.full(30, -20.0), 500.0 + np.arange(30)])
    point, torque = np.full((30, 3), [20.0, -30.0, 0.0]), np.full((30, 3), [0.0, 0.0, 1500.0])
    middle = np.array([[0.0, 0.0, 0.0], [10.0, 20.0, 0.0], [0.0, -20.0, 0.0]])
    plates = [plate(kind, force, point, torque, one) for kind, one in zip((3, 2, 1), middle, strict=True)]
    for rate, unit in ((100.0, "mm"), (0.0, "mm"), (0.0, "")):
        path = tmp_path / "plates.c3d"
        path.write_bytes(c3d_bytes({}, rate, Convention(analog_rate=500.0, unit=unit), plates, 5))
        table = read_table(path, "motion.file")
        assert table.unit("plate1.point.x") == "mm"
        np.testing.assert_allclose(table.column("time", ""), np.arange(30) / 500.0, atol=1e-12)
        for number in (1, 2, 3):
            own = [
                np.column_stack([table.column(f"plate{number}.{quantity}.{axis}", "") for axis in "xyz"])
                for quantity in ("force", "point", "torque")
            ]
            for found, expected in zip(own, (force, point, 1e-3 * torque), strict=True):
                np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.mark.parametrize(("frames", "remains"), [((1, 4), 0.0), ((1, 0), 1.0), ((1, 20), 1.0)],
                         ids=["unloaded", "none", "loaded"])  # fmt: skip
@pytest.mark.parametrize("kind", [2, 3, 4])
def test_the_offset_of_a_plate_in_its_baseline_is_subtracted(
    tmp_path: Path, kind: int, frames: tuple[int, int], remains: float
) -> None:
    force = np.tile([40.0, -20.0, 500.0], (100, 1)) * (np.arange(100)[:, None] >= 20)
    point, torque = np.full((100, 3), [20.0, -30.0, 0.0]), np.full((100, 3), [0.0, 0.0, 1500.0])
    made = plate(kind, force, point, torque * (force[:, 2:] > 0), np.array([10.0, 5.0, 0.0]))
    offset = np.array(
        [0.5, -0.5, 0.3, 0.2, 1.0, 2.0, 1.5, 1.0] if kind == 3 else [1.0, -2.0, -6.0, 300.0, 500.0, 200.0]
    )
    made.channels, made.zero = made.channels + offset, frames
    file = tmp_path / "plates.c3d"
    file.write_bytes(c3d_bytes({"LKNE": np.zeros((20, 3))}, 100.0, Convention(), [made], 5))
    table = read_table(file, "motion.file")
    found = [
        np.column_stack([table.column(f"plate1.{quantity}.{axis}", "") for axis in "xyz"])[4:]
        for quantity in ("force", "point", "torque")
    ]
    expected = force[::5][4:], point[::5][4:], 1e-3 * torque[::5][4:]
    for values, exact in zip(found, expected, strict=True):
        np.testing.assert_allclose(values, exact, atol=1e-3 + remains * 20.0)
    assert np.allclose(found[0], expected[0], atol=1e-3) == (remains == 0.0)


def test_names_of_two_subjects_need_their_subject_and_plates_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    rest = np.zeros((5, 3))
    wrong = Plate(np.zeros((4, 3)), np.zeros(3), np.zeros((5, 6)))
    content = c3d_bytes({"A:LKNE": rest, "B:LKNE": rest + 1.0, "A:RKNE": rest}, 100.0, Convention(), [wrong])
    path = tmp_path / "two.c3d"
    path.write_bytes(content.replace(b"TYPE\x08\x00\x02\x01\x01\x02\x00", b"TYPE\x08\x00\x02\x01\x01\x07\x00"))
    table = read_table(path, "motion.file")
    assert table.column("RKNE.x", "").tolist() == [0.0] * 5
    with pytest.raises(SpecError, match=r"no column 'LKNE.x'"):
        table.column("LKNE.x", "")
    with pytest.raises(SpecError, match=r"no column 'plate1.force.x'.*its force plates cannot be read"):
        table.column("plate1.force.x", "")
    path.write_bytes(c3d_bytes({"LKNE": rest}, 100.0, Convention(analog_offset=-10), [wrong]))
    with pytest.raises(SpecError, match=r"no column 'plate1.force.x'.*negative offsets"):
        read_table(path, "motion.file").column("plate1.force.x", "")


@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
@pytest.mark.parametrize(("cut", "frames"), [(2048, 0), (600, 90)])
def test_a_file_whose_end_is_missing_is_refused(tmp_path: Path, processor: int, cut: int, frames: int) -> None:
    whole = c3d_bytes({"TOE": np.zeros((100, 3))}, 100.0, Convention(processor=processor, first_frame=17))
    (tmp_path / "walk.c3d").write_bytes(whole[:-cut])
    with pytest.raises(SpecError, match=rf"walk.c3d: this C3D file ends after {frames} of its 100 frames"):
        read_table(tmp_path / "walk.c3d", "motion.file")


@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
def test_a_parameter_that_is_longer_than_its_place_is_refused(tmp_path: Path, processor: int) -> None:
    # ezc3d reads beyond the end of the file, which may end the process
    content = bytearray(c3d_bytes({"TOE": np.zeros((100, 3))}, 100.0, Convention(processor=processor)))
    shape = content.index(b"LABELS") + len("LABELS") + 4
    content[shape : shape + 2] = b"\xff\xff"
    (tmp_path / "walk.c3d").write_bytes(content)
    with pytest.raises(SpecError, match="not a C3D file that can be read: a parameter is longer than its place"):
        read_table(tmp_path / "walk.c3d", "motion.file")


@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
@pytest.mark.parametrize("name", [b"SCALE", b"OFFSET"])
def test_analog_channels_without_scale_or_offset_are_refused(tmp_path: Path, name: bytes, processor: int) -> None:
    # ezc3d reads memory that is not its own, which ends the process
    plate = Plate(np.zeros((4, 3)), np.zeros(3), np.zeros((100, 6)))
    content = c3d_bytes({"TOE": np.zeros((100, 3))}, 100.0, Convention(processor=processor), [plate], 1)
    at = content.index(b"ANALOG")
    damaged = content[:at] + content[at:].replace(b"GEN_SCALE", b"GEN_@").replace(name, name[:-1] + b"\xc5", 1)
    (tmp_path / "walk.c3d").write_bytes(damaged.replace(b"GEN_@", b"GEN_SCALE"))
    with pytest.raises(SpecError, match=f"some of its 6 analog channels have no {name.decode().lower()}"):
        read_table(tmp_path / "walk.c3d", "motion.file")


pytest.importorskip("ezc3d", reason="ezc3d is not installed: pip install mbdkit[c3d]")

FRAMES = 12


def walk(processor: int, scale: float, *, has_plate: bool) -> bytes:
    corners = np.array([[400.0, 600, 0], [0, 600, 0], [0, 0, 0], [400, 0, 0]])
    plates = [Plate(corners, np.array([0.0, 0, -20]), np.ones((2 * FRAMES, 6)))] if has_plate else []
    markers = {"TOE": np.ones((FRAMES, 3)), "HEEL": np.zeros((FRAMES, 3))}
    return c3d_bytes(markers, 100.0, Convention(processor=processor, scale=scale), plates, samples=2)


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """Return a file with one of six kinds of damage, most of them in its header and its parameters."""
    kind, at = random.integers(6), int(random.integers(len(content) if random.random() < 0.2 else 2048))
    if kind == 0:  # single bytes
        places = random.integers(0, 2048, random.integers(1, 9))
        return bytes(random.integers(256) if k in places else byte for k, byte in enumerate(content))
    if kind == 1:  # a length or a count
        values = [0, 1, 127, 128, 254, 255]
        return content[:at] + bytes([values[random.integers(6)]]) + content[at + 1 :]
    if kind == 2:  # a number of two bytes
        return content[:at] + struct.pack("<H", [0, 1, 0x7FFF, 0x8000, 0xFFFF][random.integers(5)]) + content[at + 2 :]
    if kind == 3:
        return content[:at]
    if kind == 4:  # bytes are missing, or there are too many
        count = int(random.integers(1, 600))
        return content[:at] + content[at + count :] if random.random() < 0.5 else content[:at] + content[at - count :]
    return content[:at] + bytes(int(random.integers(1, 64))) + content[at + 64 :]


@pytest.mark.parametrize("count", [8, pytest.param(2000, marks=pytest.mark.slow)])
def test_drawn_damages_are_refused_or_read(tmp_path: Path, count: int) -> None:
    random, refused = np.random.default_rng(13), 0
    file = tmp_path / "walk.c3d"
    for _ in range(count):
        processor, scale = [INTEL, DEC, MIPS][random.integers(3)], float(random.integers(2))
        file.write_bytes(damaged(walk(processor, scale, has_plate=bool(random.integers(2))), random))
        try:
            read_table(file, "motion.file")
        except SpecError:
            refused += 1
    assert 0 < refused < count


def test_the_length_of_a_description_beyond_the_file_is_refused(tmp_path: Path) -> None:
    # the reader ends its process by a signal
    content = bytearray(walk(INTEL, 0.0, has_plate=True))
    content[content.index(b"FORCE_PLATFORM") + len("FORCE_PLATFORM") + 2] = 255
    (tmp_path / "walk.c3d").write_bytes(content)
    with pytest.raises(SpecError, match="this is not a C3D file that can be read"):
        read_table(tmp_path / "walk.c3d", "motion.file")


def test_a_header_that_announces_too_many_samples_takes_no_memory(tmp_path: Path) -> None:
    content = bytearray(walk(INTEL, 0.0, has_plate=False))
    content[2:12] = struct.pack("<5H", 32767, 0, 1, 65535, 10)
    (tmp_path / "walk.c3d").write_bytes(content)
    with pytest.raises(SpecError):
        read_table(tmp_path / "walk.c3d", "motion.file")


def test_analog_channels_are_read_at_their_own_rate(tmp_path: Path) -> None:
    random, samples, frames = np.random.default_rng(4), 10, 20
    zero = np.zeros((frames * samples, 3))
    one = plate(2, zero, zero, zero, np.zeros(3))
    one.channels[:] = random.standard_normal(one.channels.shape)
    markers = {"TOE": 1000.0 * np.stack([np.cos(ANGLE), np.sin(ANGLE), 0 * ANGLE], axis=1)}
    (path := tmp_path / "emg.c3d").write_bytes(c3d_bytes(markers, 100.0, Convention(first_frame=5), [one], samples))
    table = read_c3d(path, 10**6, channels=True)
    assert table is not None
    assert table.headings == ["time", *(f"ch{k}" for k in range(6))]
    np.testing.assert_allclose(table.column("time", "emg"), 0.04 + np.arange(frames * samples) / 1000.0, rtol=1e-6)
    np.testing.assert_allclose(table.column("ch4", "emg"), one.channels[:, 4], rtol=0, atol=1e-4)
    assert read_c3d(path, 100, channels=True) is None
