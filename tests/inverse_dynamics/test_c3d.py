"""Markers of C3D files that ezc3d writes, and what is said of files that are none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import SpecError
from tests.inverse_dynamics.test_bad_input import pendulum

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


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_markers_come_back_in_their_unit(tmp_path: Path, unit: str) -> None:
    run = inverse(write(tmp_path / "walk.c3d", ["HEEL", "TOE"], unit))
    np.testing.assert_allclose(run.joints["hip"].angle, ANGLE, rtol=0, atol=1e-6)  # the file has 32 bits
    np.testing.assert_allclose(run.time, 0.01 * np.arange(20), rtol=0, atol=1e-12)


def test_more_markers_than_one_parameter_of_the_file_names(tmp_path: Path) -> None:
    run = inverse(write(tmp_path / "many.c3d", [*(f"M{k}" for k in range(299)), "TOE"]))
    np.testing.assert_allclose(run.joints["hip"].angle, ANGLE, rtol=0, atol=1e-6)


def test_a_marker_that_no_camera_saw_is_a_gap(tmp_path: Path) -> None:
    path = write(tmp_path / "walk.c3d", ["HEEL", "TOE"], gap=7)
    with pytest.raises(SpecError, match=r"walk.c3d: row 8: column 'TOE.x': the value is missing"):
        inverse(path)
    run = inverse(path, gaps={"longest": 0.1})
    np.testing.assert_allclose(run.joints["hip"].angle, ANGLE, rtol=0, atol=1e-4)
    assert np.isnan(run.motion["tip.x"].raw[7])


def test_wrong_names_and_wrong_files_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "walk.c3d", ["HEEL", "TOES"])
    with pytest.raises(
        SpecError, match=r"motion\.columns\.\"tip\.x\"\.column: walk.c3d has no column 'TOE.x'.*'TOES.x'"
    ):
        inverse(path)
    with pytest.raises(SpecError, match=r"walk.c3d: two columns have the heading 'TOE.x'"):
        inverse(write(tmp_path / "walk.c3d", ["TOE", "TOE"]))
    whole = path.read_bytes()
    for content in (b"", b"time,hip\n0,1\n", whole[: len(whole) // 2]):
        (tmp_path / "bad.c3d").write_bytes(content)
        with pytest.raises(SpecError, match=r"bad.c3d: this (is not a C3D file that can be read|C3D file)"):
            inverse(tmp_path / "bad.c3d")
