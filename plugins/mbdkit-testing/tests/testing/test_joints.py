"""The kit verifies the template of joints and those of mbdkit, and finds what is wrong with copies of the template."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit.testing
from mbdkit.registry.manager import forget
from mbdkit.spec import load_spec
from mbdkit_testing.check_result import Result
from mbdkit_testing.example_under_test import completed
from mbdkit_testing.joint_under_test import JointUnderTest
from mbdkit_testing.kit import checks_of, plugin_under_test
from mbdkit_testing.scaffold.new_plugin import new_project
from tests.first_party import ROOT
from tests.installing import install_module, install_project
from tests.printed_code import fenced_blocks

LEFT = 'p["radius"] * np.arctan2(np.sin(left), np.cos(left))'
ROWS = 'rows: ClassVar[tuple[str, ...]] = ("mesh",)'
SLIP = "def slip("
WRONG: dict[str, tuple[str, str, dict[str, str]]] = {
    "type": (
        "joint.class",
        "is 'oval' by default, not the name of the kind, 'wrong-type'",
        {'type: Literal["wrong-type"] = "wrong-type"': 'type: Literal["oval"] = "oval"'},
    ),
    "rows": (
        "joint.functions",
        "'mesh' has 2 rows, mesh, axis, but 1 functions",
        {ROWS: ROWS.replace('("mesh",)', '("mesh", "axis")'), '= ("m",)': '= ("m", "m")'},
    ),
    "counter": (
        "joint.functions",
        "is another one when it is called again",
        {SLIP: f"CALLS = []\n\n\n{SLIP}", f"return {LEFT}": f"CALLS.append(0)\n    return {LEFT} * len(CALLS)"},
    ),
    "clock": (
        "joint.functions",
        "is another one when it is called again",
        {
            SLIP: f"CLOCK = [0.0]\n\n\n{SLIP}",
            f"return {LEFT}": f"return {LEFT} + 0.01 * np.sin(CLOCK[0])",
            "apart = math.hypot": "CLOCK[0] = start.angle\n        apart = math.hypot",
        },
    ),
    "closure": (
        "joint.functions",
        "equal joints have different functions",
        {"PoseFunction(slip,": "PoseFunction(lambda pose, p: slip(pose, p),"},
    ),
    "global": (
        "joint.functions",
        "so that its curve lies in the global frame",
        {LEFT: f"{LEFT} + 1e-3 * (pose.x * np.sin(pose.first) + pose.y * (np.cos(pose.first) - 1))"},
    ),
    "abs": (
        "joint.functions",
        "'abs' has no derivative where its operand is 0",
        {LEFT: 'p["radius"] * (np.abs(np.sin(left / 2)) - 1e-9)'},
    ),
    "sign": (
        "joint.start",
        "compare signs and offsets of the functions with `start`",
        {'pose.angle - p["start"] - turned': 'pose.angle - p["start"] + turned'},
    ),
    "nan": (
        "joint.start",
        "is not a finite number next to the start",
        {LEFT: f"{LEFT} + 1e-9 * np.sqrt(0.0400001 - pose.x * pose.x - pose.y * pose.y)"},
    ),
    "turns": ("joint.turns", "of 'mesh' jumps after", {LEFT: 'p["radius"] * left'}),
    "points": (
        "joint.points",
        "which is not among the `attachments`",
        {"    def functions(": "    def attachments(self) -> list[Any]:\n        return []\n\n    def functions("},
    ),
    "unit": (
        "joint.units",
        "row 'mesh' of 'mesh' is in m, but does not double if all lengths double",
        {LEFT: LEFT.removeprefix('p["radius"] * ')},
    ),
    "plain": (
        "derivatives.rows",
        "differs from differences",
        {"e * np.sin(s), 1 - e * np.cos(s))\n    left": "e * np.sin(s.plain), 1 - e * np.cos(s))\n    left"},
    ),
    "curvature": (
        "derivatives.curvature",
        "the curvature of the rows of 'mesh' jumps",
        {LEFT: f"{LEFT} + np.where(pose.x > -0.05, 0.0, (pose.x + 0.05) ** 2)"},
    ),
    "drawing": (
        "drawing.lines",
        "is drawn on the body 2",
        {"self._ellipse(1,": "self._ellipse(2,", "points[body]": "points[0]"},
    ),
}
"""Faults in copies of the template: the check that finds it, part of the cause, and texts and what replaces them."""
# fmt: off
PINS: dict[str, Any] = {
    "l": {"type": "revolute", "bodies": ["ground", "left"], "at": [0.0, 0.0]},
    "r": {"type": "revolute", "bodies": ["ground", "right"], "at": [0.3, 0.0]},
}
GUIDED: dict[str, Any] = {
    "l": PINS["l"],
    "r": {"type": "prismatic", "bodies": ["ground", "right"], "at": [0.0, 0.0], "axis": [0.0, 1.0]},
}
FREE = {"l": PINS["l"]}
# fmt: on


def example(x: float, y: float, pins: dict[str, Any], **joint: Any) -> dict[str, Any]:
    """Return a spec with a joint of two bodies, off their centres of mass; its point on the second is (x, y)."""
    bodies: dict[str, Any] = {
        "left": {"mass": 1.0, "inertia": 0.01, "position": [0.0, -0.02], "angular_velocity": 2.0},
        "right": {"mass": 1.0, "inertia": 0.02, "position": [x, y - 0.02]},
    }
    mesh = {"bodies": ["left", "right"], "points": [[0.0, 0.02], [0.0, 0.02]], **joint}
    return {
        "mbdkit": 1,
        "model": {"name": "mechanism", "bodies": bodies, "joints": {**pins, "mesh": mesh}},
        "integrator": {"name": "gauss", "stages": 3},
        "time": {"end": 0.2, "step": 0.01},
    }


RIGHT = {
    "gear": example(0.3, 0.0, PINS, type="gear", radii=[0.1, 0.2]),
    "belt": example(0.5, 0.0, PINS, type="belt", radii=[0.1, 0.2], crossed=False),
    "rolling": example(0.0, -0.3, FREE, type="rolling", radius=0.1, on_radius=0.2),
    "cam": example(0.0, 0.15, GUIDED, type="cam", profile="0.1 - 0.02*cos(2*angle)", follower={"roller": 0.03}),
    "slot": example(0.05, 0.0025, FREE, type="slot", curve={"y": "x**2"}),
    "coupling": example(0.3, 0.0, PINS, type="coupling", equation="angle + 2*first"),
}
"""Mechanisms with joints of mbdkit that fit at the start."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Install the template and all wrong copies in this process, and remove them at the end."""
    folder, before = tmp_path_factory.mktemp("joints"), list(sys.path)
    for name in ("right", *WRONG):
        project = new_project(f"mbdkit-wrong-{name}", "joint", folder)
        install_project(folder / "site", project)
        sys.path.append(str(project / "src"))
        file = project / "src" / f"mbdkit_wrong_{name}" / "code.py"
        for old, new in WRONG[name][2].items() if name in WRONG else ():
            assert old in file.read_text(), old
            file.write_text(file.read_text().replace(old, new))
    page = (ROOT / "mbdkit" / "guide" / "joints.md").read_text(encoding="utf-8")
    (printed,) = (one.code for one in fenced_blocks(page) if "class PinInSlot" in one.code)
    install_module(folder / "site", "geneva-kit", printed)
    sys.path.append(str(folder / "site"))
    forget()
    yield folder
    sys.path[:] = before
    for name in [name for name in sys.modules if name.startswith(("mbdkit_wrong_", "geneva_kit"))]:
        del sys.modules[name]  # parallel tests may use this fixture twice in a process
    forget()


def result(kind: JointUnderTest, check: str) -> Result:
    (found,) = (one.run(kind) for one in checks_of("joint-kind") if one.name == check)
    return found


def test_the_template_is_verified(site: Path) -> None:
    report = mbdkit.testing.check_joint("wrong-right", quick=True)
    assert report.verified, report.text()
    assert {one.name for one in report.of("skip")} == set()


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_with_a_copy_of_the_template_is_found(name: str, site: Path) -> None:
    check, cause, _ = WRONG[name]
    found = result(plugin_under_test("joint-kind", f"wrong-{name}", {}), check)
    assert found.outcome == "fail", found
    assert cause in found.cause


@pytest.mark.parametrize("name", RIGHT)
def test_joints_of_mbdkit_conform_on_mechanisms_with_them(name: str) -> None:
    kind = plugin_under_test("joint-kind", name, {})
    kind.spec = load_spec(RIGHT[name])
    found = [one.run(kind) for one in checks_of("joint-kind", quick=True)]
    assert not [(one.name, one.cause) for one in found if one.outcome == "fail"]
    assert not {"energy.balance", "energy.methods", "derivatives.rows"} & {
        one.name for one in found if one.outcome == "skip"
    }


def test_the_joint_of_the_guide_conforms_and_turns_a_geneva_wheel(site: Path) -> None:
    axes = 0.1 * np.sqrt(2.0)
    pins = {
        "crank": {"type": "revolute", "bodies": ["ground", "disc"], "at": [0.0, 0.0]},
        "center": {"type": "revolute", "bodies": ["ground", "wheel"], "at": [axes, 0.0]},
    }
    slot = {"bodies": ["wheel", "disc"], "points": [[0.0, 0.0], [0.1, 0.0]], "type": "pin-in-slot", "direction": np.pi}
    bodies = {
        "disc": {"mass": 1.0, "inertia": 0.01, "position": [0.0, 0.0], "angle": -0.6, "angular_velocity": 3.0},
        "wheel": {"mass": 1.0, "inertia": 0.002, "position": [axes, 0.0]},
    }
    pin = 0.1 * np.exp(-0.6j) - axes
    bodies["wheel"]["angle"] = float(np.angle(-pin))
    spec = {
        "mbdkit": 1,
        "model": {"name": "mechanism", "bodies": bodies, "joints": {**pins, "slot": slot}},
        "integrator": {"name": "gauss", "stages": 4},
        "time": {"end": 0.2, "step": 0.01},
    }
    kind = plugin_under_test("joint-kind", "pin-in-slot", {})
    kind.spec = load_spec(spec)
    found = [one.run(kind) for one in checks_of("joint-kind", quick=True)]
    assert not [(one.name, one.cause) for one in found if one.outcome == "fail"]
    # expected: the wheel turns to the pin, seen from its axis
    run = completed(kind.spec)
    pin = 0.1 * np.exp(1j * run["disc"].angle) - axes
    np.testing.assert_allclose(run["wheel"].angle, np.angle(-pin), atol=1e-9)
