"""Linkages of pylinkage: positions are compared with intersections of circles, and with pylinkage where it is
installed.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import mbdkit

pytest.importorskip("defusedxml")
import mbdkit_robots

FILE = Path(mbdkit_robots.__file__).with_name("linkage.json")
"""The four-bar in pylinkage's documentation: crank 1, coupler 3, rocker 3, ground 4, 100 steps per turn."""


def spec() -> mbdkit.RunSpec:
    """Return the spec of the four-bar for half a turn."""
    return mbdkit.RunSpec(mbdkit=1, model={"name": "pylinkage", "file": str(FILE)}, integrator={"name": "rk4"},
                          time={"end": 0.5, "step": 0.01})  # fmt: skip


def pin(step: int) -> np.ndarray:
    """Return the pin between coupler and rocker after some steps: the upper intersection of two circles with radius
    3.
    """
    angle = 2 * math.pi * step / 100
    tip, ground = np.array([math.cos(angle), math.sin(angle)]), np.array([4.0, 0.0])
    middle, way = (tip + ground) / 2, ground - tip
    height = math.sqrt(9.0 - way @ way / 4)
    return np.array(middle + height * np.array([-way[1], way[0]]) / np.linalg.norm(way))


def test_pins_move_as_in_pylinkage() -> None:
    motion = mbdkit.kinematics(spec())
    rocker = spec().mechanism().bodies["rocker"]
    local = np.array(spec().mechanism().to_local("rocker", tuple(pin(0))))
    assert rocker.mass == pytest.approx(3.0)
    for step in (0, 1, 2, 25, 50):
        x, y, angle = motion["rocker"].position[step]
        c, s = math.cos(angle), math.sin(angle)
        np.testing.assert_allclose(np.array([x, y]) + np.array([[c, -s], [s, c]]) @ local, pin(step), atol=1e-10)
    np.testing.assert_allclose(
        pin(1), [2.5533280365704525, 2.628143875480735], rtol=1e-14
    )  # printed by pylinkage 1.3.0


def test_pylinkage_moves_the_linkage_in_the_same_way() -> None:
    data = json.loads(FILE.read_text())
    made = pytest.importorskip("pylinkage.mechanism").mechanism_from_dict(data)
    place = [one["id"] for one in data["joints"]].index("coupler.1_rocker.0")
    assert next(iter(made.step()))[place] == pytest.approx(tuple(pin(1)), abs=1e-9)


def test_other_joints_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "linkage.json"
    path.write_text(FILE.read_text().replace('"revolute"', '"prismatic"', 1))
    with pytest.raises(mbdkit.SpecError, match="joints other than pins are not read"):
        mbdkit.RunSpec(mbdkit=1, model={"name": "pylinkage", "file": str(path)}, integrator={"name": "rk4"},
                       time={"end": 0.5, "step": 0.01}).mechanism()  # fmt: skip
    path.write_text("[1]")
    with pytest.raises(mbdkit.SpecError, match="is no mechanism of pylinkage"):
        mbdkit.RunSpec(mbdkit=1, model={"name": "pylinkage", "file": str(path)}, integrator={"name": "rk4"},
                       time={"end": 0.5, "step": 0.01}).mechanism()  # fmt: skip


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('"motor_joint": "crank.motor_ground.A"', '"motor_joint": "nowhere"', "without a motor_joint among the joints"),
        ('"initial_angle": 0.0', '"initial_angle": 1.0', "initial_angle 1 of link 'crank' differs"),
        ('"coupler.1_rocker.0"\n', '"nowhere"\n', "joints that do not exist: nowhere"),
    ],
)
def test_drivers_and_joints_that_pylinkage_would_not_read_so_are_refused(
    tmp_path: Path, before: str, after: str, message: str
) -> None:
    text = FILE.read_text()
    assert before in text
    path = tmp_path / "linkage.json"
    path.write_text(text.replace(before, after, 1))
    with pytest.raises(mbdkit.SpecError, match=message):
        mbdkit.RunSpec(mbdkit=1, model={"name": "pylinkage", "file": str(path)}, integrator={"name": "rk4"},
                       time={"end": 0.5, "step": 0.01}).mechanism()  # fmt: skip


def test_unknown_keys_are_a_doubt(tmp_path: Path) -> None:
    path = tmp_path / "linkage.json"
    path.write_text(FILE.read_text().replace('"initial_angle": 0.0', '"initial_angle": 0.0, "brake": 3', 1))
    m = mbdkit.RunSpec(mbdkit=1, model={"name": "pylinkage", "file": str(path)}, integrator={"name": "rk4"},
                           time={"end": 0.5, "step": 0.01}).mechanism()  # fmt: skip
    assert m.left_out == ("keys of the link left out, which may change the motion: 'brake'",)
