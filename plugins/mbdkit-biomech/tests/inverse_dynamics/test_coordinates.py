"""Coordinates with names of their own, and closed loops: as observed quantities, as actuators, and as headings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.inverse_dynamics.moved_linkages import TORQUES, moved

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from tests.margins import assert_within

T = np.linspace(0.0, 1.0, 201)
ANGLES = {
    "hip_flexion": 0.3 * np.sin(3 * T),
    "knee_flexion": 0.6 - 0.5 * np.cos(4 * T),
    "ankle_dorsiflexion": 0.2 * np.sin(5 * T),
}
UP = np.array([0.0, 9.81])
ROOT = {"hip_x": 1.2 * T, "hip_y": 0.9 + 0.02 * np.cos(6 * T), "trunk_tilt": 0.1 * np.sin(2 * T)}


def inverse(model: dict[str, Any], data: dict[str, Any], **sections: Any) -> mbdkit.Run:
    motion = {"data": {"time": T, **data}, "smooth": "quintic"} | sections.pop("motion", {})
    return mbdkit.inverse({"mbdkit": 1, "model": model, "motion": motion, **sections})


def test_torques_have_the_sign_of_their_coordinates() -> None:
    named = inverse({"name": "leg"}, ANGLES)
    plain = {"hip": ANGLES["hip_flexion"], "knee": -ANGLES["knee_flexion"], "ankle": ANGLES["ankle_dorsiflexion"]}
    joints = inverse({"name": "leg"}, {f"{name}.angle": values for name, values in plain.items()})
    assert list(named.actuators) == list(ANGLES)
    for name, joint, sign in (
        ("hip_flexion", "hip", 1),
        ("knee_flexion", "knee", -1),
        ("ankle_dorsiflexion", "ankle", 1),
    ):
        value, other = named.actuators[name].value, joints.actuators[joint].value
        np.testing.assert_allclose(value, sign * other, rtol=0, atol=1e-10 * np.max(np.abs(other)))
        np.testing.assert_allclose(named.motion[name].fitted, ANGLES[name], rtol=0, atol=1e-12)


def test_a_scaled_coordinate_has_the_conjugate_torque_and_turns_with_its_own_period() -> None:
    m = mbdkit.Mechanism()
    wheel = m.body("wheel", mass=1.0, inertia=2.0)
    m.revolute("axle", m.ground, wheel, at=(0, 0))
    m.coordinate("gear", "axle.angle", scale=3.0, offset=1.0)
    turns = 3.0 * 4 * np.pi * T**2 + 1.0
    run = inverse(m.to_spec(), {"gear": np.mod(turns, 6 * np.pi)})
    # expected: the torque on the wheel is inertia * 8 pi, and power is torque * rate in either coordinate
    np.testing.assert_allclose(run.actuators["gear"].value, 2.0 * 8 * np.pi / 3.0, rtol=1e-6)
    assert run["wheel"].angle[-1] == pytest.approx(4 * np.pi)


def test_residuals_of_the_trunk_are_conjugate_to_its_coordinates() -> None:
    model = {"name": "leg", "root": "trunk"}
    named = inverse(model, ANGLES | ROOT)
    assert list(named.actuators) == [*ANGLES, *ROOT]
    # the same residual about the centre of mass, from Newton and Euler for the whole leg
    bodies = load_inverse_spec(named.spec).mechanism().bodies
    mass = sum(body.mass for body in bodies.values())
    total = sum(body.mass * named[name].acceleration for name, body in bodies.items())
    force = np.column_stack([named.actuators[name].value for name in ("hip_x", "hip_y")])
    np.testing.assert_allclose(force, total + mass * UP, rtol=0, atol=1e-9 * mass * 9.81)
    hip, moment = named.markers["hip"].position, np.zeros(len(T))
    for name, body in bodies.items():
        arm = named[name].position - hip
        push = body.mass * (named[name].acceleration + UP)
        moment += arm[:, 0] * push[:, 1] - arm[:, 1] * push[:, 0]
        moment += body.inertia * named[name].angular_acceleration
    np.testing.assert_allclose(named.actuators["trunk_tilt"].value, moment, rtol=0, atol=1e-9 * np.max(np.abs(moment)))


def test_flexion_of_a_four_bar_knee_is_the_angle_of_its_bodies() -> None:
    run = inverse({"name": "leg-four-bar"}, ANGLES)
    flexion = run["thigh"].angle - run["shank"].angle
    np.testing.assert_allclose(flexion, ANGLES["knee_flexion"], rtol=0, atol=1e-12)
    assert list(run.actuators) == list(ANGLES)
    rate = np.gradient(run.energy.total, T, edge_order=2)
    power = sum(run.actuators[name].power for name in ANGLES)
    np.testing.assert_allclose(rate[3:-3], power[3:-3], rtol=0, atol=3e-3 * np.max(np.abs(power)))


def test_headings_of_a_motion_file_are_found_and_only_rotations_are_in_degrees(tmp_path: Path) -> None:
    columns = ANGLES | ROOT
    rows = [T, *(values if name in ("hip_x", "hip_y") else np.degrees(values) for name, values in columns.items())]
    head = f"Coordinates\nversion=1\nnRows={len(T)}\nnColumns={len(rows)}\ninDegrees=yes\nendheader\n"
    table = "\n".join("\t".join(f"{x:.17g}" for x in row) for row in np.column_stack(rows))
    (tmp_path / "walk.mot").write_text(head + "\t".join(["time", *columns]) + "\n" + table + "\n")
    motion = {"file": str(tmp_path / "walk.mot"), "smooth": "quintic"}
    run = mbdkit.inverse({"mbdkit": 1, "model": {"name": "leg", "root": "trunk"}, "motion": motion})
    given = inverse({"name": "leg", "root": "trunk"}, columns)
    for name in columns:
        expected = given.actuators[name].value
        np.testing.assert_allclose(run.actuators[name].value, expected, rtol=0, atol=1e-7 * np.max(np.abs(expected)))


def test_actuators_are_chosen_by_the_names_of_coordinates() -> None:
    chosen = {"ankle_dorsiflexion": {}, "knee_flexion": {"weight": 2.0}, "hip": {"joint": "hip"}}
    run = inverse({"name": "leg"}, ANGLES, actuators=chosen)
    assert list(run.actuators) == list(chosen)
    np.testing.assert_allclose(
        run.actuators["knee_flexion"].value, inverse({"name": "leg"}, ANGLES).actuators["knee_flexion"].value
    )


@pytest.mark.parametrize(
    ("sections", "key", "message"),
    [
        ({"actuators": {"knee_flexon": {}}}, "actuators.knee_flexon", "(did you mean 'knee_flexion'?)"),
        ({"actuators": {"hip_x": {"joint": "hip"}}}, "actuators.hip_x", "is the residual actuator of the coordinate"),
        ({"motion": {"columns": {"knee_flexin": "hip_x"}}}, "motion.columns.knee_flexin", "mean 'knee_flexion'"),
        ({"motion": {"columns": None, "data": {"time": T, "a": T}}}, "motion.columns", "such as hip_flexion, knee_"),
    ],
)
def test_wrong_names_are_refused_with_those_that_there_are(sections: Any, key: str, message: str) -> None:
    with pytest.raises(SpecError) as error:
        inverse({"name": "leg", "root": "trunk"}, ANGLES | ROOT, **sections)
    assert error.value.key == key
    assert message in str(error.value)


def test_an_offset_in_degrees_is_doubted_but_not_one_in_metres() -> None:
    m = mbdkit.Mechanism()
    m.body("cart", mass=1.0, inertia=0.1)
    m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.prismatic("rail", m.ground, "cart", at=(0, 0), axis=(1, 0))
    m.revolute("hip", "cart", "rod", at=(0, 0))
    m.coordinate("place", "rail.angle", offset=40.0)
    m.coordinate("flexion", "hip.angle", offset=170.0)
    run = inverse(m.to_spec(), {"place": 40.0 + 0.1 * T, "flexion": 3.0 + 0.1 * T}, accept=["ends"])
    (reason,) = (one for one in run.verdict_reasons if one.startswith("units"))
    assert "the angle of 170 rad at model.coordinates.flexion.offset is more than a full rotation" in reason


@pytest.mark.parametrize("example", TORQUES)
def test_the_torques_of_a_forward_run_come_back(example: str, tmp_path: Path) -> None:
    run, spec = moved(example, tmp_path / "run.h5")
    inverse = mbdkit.inverse(spec)
    assert inverse.kind == "inverse"
    assert run.kind == "forward"
    peak = max(np.max(np.abs(run.forces[f"on {joint}"].value)) for joint, value in TORQUES[example].items() if value)
    for joint, value in TORQUES[example].items():
        known = run.forces[f"on {joint}"].value if value else 0.0
        assert_within(inverse.actuators[f"on {joint}"].value - known, 1e-9 * peak)
    force, found = (one.array("joints/reaction_force") for one in (run, inverse))
    assert_within(found - force, 1e-9 * np.max(np.abs(force)))
    assert_within(inverse.misalignment_max, 1e-14)


def test_a_crank_that_turns_fully_needs_no_other_coordinates() -> None:
    # a four-bar of 1, 3, 3, 3 m: the crank turns, and the follower's rate vanishes at its dead centres
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("crank", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    top = np.array([2.0, np.sqrt(8.0)])
    m.body("coupler", mass=1.0, inertia=1.0, position=(1.5, np.sqrt(2.0)), angle=float(np.arctan2(np.sqrt(8.0), 1.0)))
    m.body("follower", mass=1.0, inertia=1.0, position=(2.5, np.sqrt(2.0)), angle=float(np.arctan2(np.sqrt(8.0), -1.0)))
    m.revolute("A", m.ground, "crank", at=(0.0, 0.0))
    m.revolute("B", "crank", "coupler", at=(1.0, 0.0))
    m.revolute("C", "coupler", "follower", at=(float(top[0]), float(top[1])))
    m.revolute("D", m.ground, "follower", at=(3.0, 0.0))
    t = np.linspace(0.0, 2.0, 2001)
    angle = 2 * np.pi * t + 0.3 * np.sin(2 * t)
    wrapped = np.angle(np.exp(1j * angle))
    spec = {
        "mbdkit": 1,
        "model": m.to_spec(),
        "motion": {"data": {"time": t, "crank": wrapped}, "columns": {"A.angle": "crank"}, "smooth": "quintic"},
    }
    run = mbdkit.inverse(spec)
    assert not run.warnings
    assert_within(run.joints["A"].angle - angle, 1e-12)
    # virtual work: the torque times the crank's rate is the rate of the kinetic energy
    energy = run.energy.kinetic
    rate = np.gradient(energy, t, edge_order=2)
    power = run.actuators["A"].power
    assert_within((power - rate)[50:-50], 3e-4 * np.max(np.abs(rate)))
