"""Planar mechanisms from URDF and MJCF. The expected motions were printed by MuJoCo 4.0.0 (RK4 with steps of 0.1
ms).
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit

pytest.importorskip("defusedxml")
import mbdkit_robots

FILES = Path(mbdkit_robots.__file__).parent
GAUSS = {"name": "gauss", "stages": 3}

FOUR_BAR = [  # time, coordinates of A, B and D; the loop with solref="0.0005 1" solimp="0.9999 0.9999 0.001"
    [0.1, -0.051639798, 0.054631072, -0.037813693],
    [0.2, -0.223618939, 0.241058163, -0.159388471],
    [0.3, -0.591014702, 0.675627713, -0.376189459],
    [0.4, -1.239401469, 1.874905758, -0.151547115],
    [0.5, -1.571717306, 2.748846631, 0.491593529],
]
ARM = [  # time, shoulder, elbow, from (0.8, -0.5) rad at (0.3, 1) rad/s
    [0.2, 0.562450727, -0.285102488],
    [0.4, -0.029264602, 0.157066467],
    [0.6, -0.693292007, 0.121780558],
    [0.8, -0.755343259, 0.471702576],
    [1.0, -0.303229885, 0.559910789],
]


DYNAMICS = [  # time, shoulder, elbow, rail; the friction with solref="0.00005 1" solimp="0.9999 0.9999 0.001"
    [0.2, 0.041427925, -0.385792269, 0.036186977],
    [0.4, -0.808518967, -0.211270445, -0.156153539],
    [0.6, -1.991300014, 0.107279966, -0.059043291],
    [0.8, -2.834111470, -0.077425775, 0.110758505],
    [1.0, -3.116568717, -0.077425773, 0.066533440],
]
DYNAMICS_FILE = """<mujoco>
<compiler angle="radian"/>
<option><flag contact="disable"/></option>
<default><geom type="capsule" size="0.02" density="900"/><joint axis="0 -1 0"/></default>
<worldbody>
  <body name="upper">
    <joint name="shoulder" armature="0.05" damping="0.02" frictionloss="0.1"/>
    <geom fromto="0 0 0 0.4 0 0"/>
    <body name="lower" pos="0.4 0 0">
      <joint name="elbow" frictionloss="0.05"/>
      <geom fromto="0 0 0 0.3 0 0"/>
    </body>
  </body>
  <body name="cart" pos="0 0 -2">
    <joint name="rail" type="slide" axis="-1 0 0" frictionloss="0.3" stiffness="20" damping="0.1"/>
    <geom fromto="0 0 0 0.3 0 0"/>
  </body>
</worldbody>
</mujoco>
"""


def coordinates(run: mbdkit.Run, model: dict[str, Any]) -> np.ndarray:
    """Return the coordinates of joints, (T, joints), with the sign convention of the file."""
    spec = mbdkit.RunSpec(mbdkit=1, model=model, integrator=GAUSS, time={"end": 1.0, "step": 0.1})
    named = spec.mechanism().coordinates
    columns = [one.scale * run.joints[name].angle + one.offset for name, one in named.items()]
    return np.stack(columns, axis=1)


def test_a_four_bar_of_mjcf_moves_as_in_mujoco() -> None:
    model = {"name": "mjcf", "file": str(FILES / "four_bar.xml")}
    run = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 0.5, "step": 0.005},
                     output={"every": 20})  # fmt: skip
    expected = np.array(FOUR_BAR)
    assert list(run.joints) == ["A", "B", "D", "C"]
    np.testing.assert_allclose(run.time[1:], expected[:, 0], atol=1e-12)
    np.testing.assert_allclose(coordinates(run, model)[1:], expected[:, 1:], atol=1e-7)  # MuJoCo's loop is soft
    assert run.warnings == ["elements of <sensor> left out: angle of A"]


def test_a_chain_of_urdf_moves_as_in_mujoco() -> None:
    model = {"name": "urdf", "file": str(FILES / "arm.urdf"), "initial": {"shoulder": 0.8, "elbow": -0.5},
             "speeds": {"shoulder": 0.3, "elbow": 1.0}}  # fmt: skip
    run = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 1.0, "step": 0.005},
                     output={"every": 40})  # fmt: skip
    assert [body.name for body in run.bodies.values()] == ["upper", "lower", "tool"]
    np.testing.assert_allclose(coordinates(run, model)[1:], np.array(ARM)[:, 1:], atol=2e-9)
    assert run.warnings == ["limits of joints left out: elbow"]
    assert "elbow limits" in run.forces


def test_friction_damping_and_armatures_of_joints_act_as_in_mujoco(tmp_path: Path) -> None:
    path = tmp_path / "dynamics.xml"
    path.write_text(DYNAMICS_FILE)
    model = {"name": "mjcf", "file": str(path), "initial": {"shoulder": 0.3, "elbow": -0.4, "rail": 0.2},
             "speeds": {"elbow": 1.0}, "transition_speed": 0.002}  # fmt: skip
    run = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 1.0, "step": 0.0005},
                     output={"every": 400})  # fmt: skip
    # friction at rest creeps: at most 0.002 rad/s here, less in MuJoCo
    np.testing.assert_allclose(coordinates(run, model)[1:], np.array(DYNAMICS)[:, 1:], atol=3e-4)
    assert run.energy.dissipated[-1] > 0.9
    assert run.warnings == []


@pytest.mark.parametrize(
    ("before", "after", "what"),
    [
        ('name="elbow"', 'name="elbow" armature="0.1"', "armatures of joints on rotating bodies .*: elbow"),
        ('name="rail"', 'name="rail" armature="1"', "armatures of slide joints .*: rail"),
        ("</worldbody>", '</worldbody><actuator><position name="servo" joint="rail" kp="9"/></actuator>',
         "actuators that act without control .*: servo"),
        ("<option>", '<option density="1000">', "forces of the surrounding fluid .*: density"),
        ('<flag contact="disable"/></option>', "</option>", "contacts with fixed geoms .*: capsule of base"),
        ('name="elbow"', 'name="elbow" limited="true" range="-0.5 -0.395"', "elbow limits.* leaves the range"),
    ],
    ids=["armature", "armature-of-slide", "servo", "fluid", "contact", "limits"],
)  # fmt: skip
def test_left_out_effects_make_the_verdict_doubtful(tmp_path: Path, before: str, after: str, what: str) -> None:
    text = DYNAMICS_FILE.replace("<worldbody>", '<worldbody><body name="base"><geom fromto="0 0 0 1 0 0"/></body>')
    path = tmp_path / "dynamics.xml"
    path.write_text(text.replace(before, after))
    model = {"name": "mjcf", "file": str(path), "initial": {"elbow": -0.4}, "speeds": {"elbow": 1.0}}
    run = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 0.02, "step": 0.001})
    assert run.verdict == "doubtful"
    assert re.search(what, run.verdict_reasons[0])
    accepting = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 0.02, "step": 0.001},
                           accept=["left-out"])  # fmt: skip
    assert accepting.verdict == ("doubtful" if "limits" in what else "unknown")
    prefix = "" if "limits" in what else "Accepted by the spec: "
    assert accepting.verdict_reasons[0] == prefix + run.verdict_reasons[0]


def test_inverse_dynamics_is_doubtful_if_a_tendon_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "dynamics.xml"
    path.write_text(DYNAMICS_FILE.replace("</mujoco>", '<tendon><spatial name="rope"/></tendon></mujoco>'))
    time = np.linspace(0.0, 1.0, 41)
    angles = {"shoulder": np.sin(3 * time), "elbow": np.cos(3 * time), "rail": 0.1 * np.sin(3 * time)}
    data = {"time": time.tolist(), **{name: values.tolist() for name, values in angles.items()}}
    spec = {"mbdkit": 1, "model": {"name": "mjcf", "file": str(path)},
            "motion": {"data": data, "columns": {name: name for name in angles}, "smooth": "quintic"}}  # fmt: skip
    (reason,) = (one for one in mbdkit.inverse(spec).verdict_reasons if "left-out" in one)
    assert reason == "left-out: tendons left out, which may change the motion: rope."
    accepting = mbdkit.inverse(spec, accept=["left-out"]).verdict_reasons
    assert f"Accepted by the spec: {reason}" in accepting


def test_actuators_without_control_are_no_doubt(tmp_path: Path) -> None:
    path = tmp_path / "dynamics.xml"
    motor = '</worldbody><actuator><motor joint="rail"/><general joint="elbow"/></actuator>'
    path.write_text(DYNAMICS_FILE.replace("</worldbody>", motor))
    run = mbdkit.run({"mbdkit": 1, "model": {"name": "mjcf", "file": str(path)}}, integrator=GAUSS,
                     time={"end": 0.02, "step": 0.001})  # fmt: skip
    assert (run.verdict, run.warnings) == ("unknown", ["actuators without control left out: motor, general"])


def test_initial_angles_that_look_like_degrees_cause_a_warning() -> None:
    model = {"name": "urdf", "file": str(FILES / "arm.urdf"), "initial": {"shoulder": 45.0, "elbow": -0.5}}
    run = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 0.01, "step": 0.005})
    (told,) = [warning for warning in run.warnings if "degrees(45)" in warning]
    assert told.startswith("the initial angle of joint 'shoulder', 45 rad, is more than a full rotation")


@pytest.mark.parametrize(
    ("file", "before", "after", "message"),
    [
        ("arm.urdf", '<axis xyz="0 -1 0"/>', '<axis xyz="1 0 0"/>', "'elbow' turns about .1, 0, 0., not normal"),
        ("arm.urdf", "<mass value=\"1\"/>", "<mass value=\"0\"/>", "'lower' moves, by joint 'elbow', but has no mass"),
        ("arm.urdf", 'type="revolute"', 'type="planar"', "joint 'elbow' has the type 'planar', which is not read"),
        ("arm.urdf", '<child link="tip"/>', '<child link="tap"/>', "has no <child> among the links: 'tap'"),
        ("arm.urdf", 'value="2"', 'value="two"', "should have 1 finite number"),
        ("arm.urdf", "<robot", "<!DOCTYPE a><robot", "document type definition"),
        ("four_bar.xml", "<connect", "<tendon", "equality <tendon> 'C' is not read"),
        ("four_bar.xml", "<equality>", '<equality><joint joint1="B" joint2="D"/>', "'B' follows 'D', which is not"),
        ("four_bar.xml", "<equality>", '<equality><joint joint1="B" joint2="E"/>', "refers to 'E', which is no joint"),
        ("four_bar.xml", '<joint name="B"/>', '<joint name="B" type="ball"/>', "has the type 'ball'"),
        ("four_bar.xml", '<joint name="B"/>', '<joint name="B"/><joint name="E" type="slide"/>', "has 2 joints"),
        ("four_bar.xml", "<mujoco", "<robot", "is not XML"),
        ("four_bar.xml", "<worldbody>", "<worldbody><frame/>", "<frame> is not read"),
        ("four_bar.xml", "<default>", '<option><flag gravity="disable"/></option><default>', "the flag gravity"),
    ],
)  # fmt: skip
def test_what_is_not_planar_or_not_read_is_refused(
    tmp_path: Path, file: str, before: str, after: str, message: str
) -> None:
    text = (FILES / file).read_text()
    assert before in text
    path = tmp_path / file
    path.write_text(text.replace(before, after))
    model = {"name": "urdf" if file.endswith("urdf") else "mjcf", "file": str(path)}
    with pytest.raises(mbdkit.SpecError, match=message):
        mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 0.1, "step": 0.1})


def test_names_of_joints_may_have_dots(tmp_path: Path) -> None:
    """A dot in the name of a joint changes neither its coordinate nor the motion."""
    path = tmp_path / "dotted.urdf"
    path.write_text((FILES / "arm.urdf").read_text().replace('name="elbow"', 'name="elbow.1 (left)"'))
    runs = []
    for file, name in ((FILES / "arm.urdf", "elbow"), (path, "elbow.1 (left)")):
        model = {"name": "urdf", "file": str(file), "initial": {name: -0.5}}
        run = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 0.1, "step": 0.01})
        assert name in run.joints
        runs.append(coordinates(run, model))
    np.testing.assert_array_equal(*runs)


def test_a_missing_file_is_said_to_be_missing() -> None:
    with pytest.raises(mbdkit.SpecError, match=r"nofile\.xml: this file cannot be read: No such file") as raised:
        mbdkit.run({"mbdkit": 1, "model": {"name": "mjcf", "file": "nofile.xml"}}, integrator=GAUSS,
                   time={"end": 0.1, "step": 0.1})  # fmt: skip
    assert "not XML" not in str(raised.value)


@pytest.mark.parametrize("name", ["mjcf", "urdf", "pylinkage"])
def test_only_regular_files_are_read(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    pipe = str(tmp_path / "pipe")
    for file, message in (
        (pipe, "not a regular file"),
        ("/dev/zero", "not a regular file"),
        ("~nosuchuser/a", "No such"),
    ):
        model = {"name": name, "file": file}
        with pytest.raises(mbdkit.SpecError, match=message):
            mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 0.1, "step": 0.1})


def test_shapes_have_the_masses_and_moments_of_mujoco(tmp_path: Path) -> None:
    """The values for `crank` are MuJoCo's body_mass and body_inertia, with the digits that MuJoCo prints."""
    spec = mbdkit.RunSpec(mbdkit=1, model={"name": "mjcf", "file": str(FILES / "four_bar.xml")}, integrator=GAUSS,
                          time={"end": 1.0, "step": 0.1})  # fmt: skip
    crank, coupler = (spec.mechanism().bodies[name] for name in ("crank", "coupler"))
    assert (crank.mass, coupler.mass) == pytest.approx((0.387804467, 0.60684481), abs=1e-9)
    assert (crank.inertia, coupler.inertia) == pytest.approx((0.003846478, 0.014633038), abs=1e-9)


def test_a_slide_has_spring_and_travel_of_the_file(tmp_path: Path) -> None:
    """A mass on a spring: x = cos(omega t) with omega = sqrt(stiffness / mass) = 2 rad/s."""
    path = tmp_path / "slide.xml"
    path.write_text(
        '<mujoco><option gravity="0 0 0"/><worldbody><body name="cart" pos="3 0 1">'
        '<joint name="x" type="slide" axis="-1 0 0" stiffness="4"/><inertial mass="1" pos="0 0 0.5"/>'
        "</body></worldbody></mujoco>"
    )
    model = {"name": "mjcf", "file": str(path), "initial": {"x": 1.0}}
    with pytest.raises(mbdkit.SpecError, match="inertia"):
        mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 1.0, "step": 0.01})
    path.write_text(path.read_text().replace('pos="0 0 0.5"', 'pos="0 0 0.5" diaginertia="1 1 1"'))
    run = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 1.0, "step": 0.01})
    np.testing.assert_allclose(coordinates(run, model)[:, 0], np.cos(2 * run.time), atol=1e-9)
    np.testing.assert_allclose(run["cart"].position[:, 0], 3 - np.cos(2 * run.time), atol=1e-9)


def test_a_joint_that_follows_another_one_is_coupled_to_it(tmp_path: Path) -> None:
    """An elbow at 0.5 q - 0.2 q^2 of the shoulder, and wheels on the ground; the equations are those of the files."""
    path = tmp_path / "follow.xml"
    ends = '<equality><joint joint1="elbow" joint2="shoulder" polycoef="0.1 0.5 -0.2"/></equality></mujoco>'
    path.write_text(DYNAMICS_FILE.replace("</mujoco>", ends))
    model = {"name": "mjcf", "file": str(path), "initial": {"shoulder": 0.4, "elbow": 0.268}, "transition_speed": 0.05}
    run = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 0.3, "step": 0.002})
    shoulder, elbow, _ = coordinates(run, model).T
    assert np.ptp(shoulder) > 0.1
    np.testing.assert_allclose(elbow, 0.1 + 0.5 * shoulder - 0.2 * shoulder**2, atol=1e-9)
    assert run.joints["elbow to shoulder"].bodies == ("upper", "lower")


def test_a_mimic_joint_of_urdf_follows_the_other_one(tmp_path: Path) -> None:
    text = (FILES / "arm.urdf").read_text()
    path = tmp_path / "mimic.urdf"
    path.write_text(
        text.replace('<axis xyz="0 -1 0"/>', '<axis xyz="0 -1 0"/><mimic joint="shoulder" multiplier="2"/>')
    )
    model = {"name": "urdf", "file": str(path), "initial": {"shoulder": 0.3, "elbow": 0.6}}
    run = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 0.3, "step": 0.005})
    shoulder, elbow = coordinates(run, model).T
    assert np.ptp(shoulder) > 0.1
    np.testing.assert_allclose(elbow, 2 * shoulder, atol=1e-9)
    assert run.warnings == ["limits of joints left out: elbow"]


def test_a_slide_follows_the_turn_of_the_body_that_carries_it_and_a_joint_may_be_held(tmp_path: Path) -> None:
    inertial = '<inertial mass="1" pos="0 0 -0.1" diaginertia="0.1 0.1 0.1"/>'
    path = tmp_path / "slide.xml"
    path.write_text(
        f'<mujoco><compiler angle="radian"/><worldbody><body name="arm"><joint name="turn" axis="0 1 0"/>{inertial}'
        f'<body name="cart" pos="0 0 -0.3"><joint name="way" type="slide" axis="0.6 0 0.8"/>{inertial}</body></body>'
        f'<body name="wheel"><joint name="spin" axis="0 1 0"/>{inertial}</body></worldbody><equality>'
        '<joint name="screw" joint1="way" joint2="turn" polycoef="0 0.2"/><joint joint1="spin" polycoef="0.3"/>'
        "</equality></mujoco>"
    )
    model = {"name": "mjcf", "file": str(path), "initial": {"turn": 0.5, "way": 0.1, "spin": 0.3}}
    run = mbdkit.run({"mbdkit": 1, "model": model}, integrator=GAUSS, time={"end": 0.3, "step": 0.005})
    turn, way, spin = coordinates(run, model).T
    assert np.ptp(turn) > 0.1
    np.testing.assert_allclose(way, 0.2 * turn, atol=1e-9)
    np.testing.assert_allclose(spin, 0.3, atol=1e-12)
