"""Actuators: defaults, residuals of free roots, more and fewer of them than degrees of freedom."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import light_roots
from tests.margins import assert_within

T = np.linspace(0.0, 1.0, 201)


def double_pendulum(**sections: Any) -> dict[str, Any]:
    """Return the spec of a double pendulum with prescribed joint angles."""
    m = mbdkit.Mechanism()
    m.body("upper", mass=2.0, inertia=0.2, position=(0.0, -0.5), angle=-np.pi / 2)
    m.body("lower", mass=1.0, inertia=0.1, position=(0.0, -1.5), angle=-np.pi / 2)
    m.revolute("hip", m.ground, "upper", at=(0, 0))
    m.revolute("knee", "upper", "lower", at=(0, -1))
    data = {"time": T, "hip": -np.pi / 2 + 0.4 * np.sin(3 * T), "knee": 0.6 * np.cos(2 * T)}
    columns = {"hip.angle": "hip", "knee.angle": "knee"}
    motion = {"data": data, "columns": columns, "smooth": "quintic"}
    return {"mbdkit": 1, "model": m.to_spec(), "motion": motion, **sections}


def test_each_observed_joint_has_an_actuator() -> None:
    run = mbdkit.inverse(double_pendulum())
    assert list(run.actuators) == ["hip", "knee"]
    # the moment about the knee of what the lower rod needs, by Newton and Euler
    lower = run["lower"]
    arm = 0.5 * np.column_stack([np.cos(lower.angle), np.sin(lower.angle)])
    force = lower.acceleration + np.array([0.0, 9.81])
    exact = 0.1 * lower.angular_acceleration + arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]
    assert_within(run.actuators["knee"].value - exact, 1e-12 * np.max(np.abs(exact)))


@pytest.mark.parametrize(("mass", "warns"), [(3.0, False), (0.1, True)])
def test_residual_actuators_on_the_lightest_body_of_a_part_cause_a_warning(mass: float, warns: bool) -> None:
    # they may act there because a program has sorted the bodies of a spec by their names
    m = mbdkit.Mechanism()
    m.body("trunk", mass=mass, inertia=0.5)
    m.body("arm", mass=1.0, inertia=0.1, position=(1.0, 0.0))
    m.revolute("shoulder", "trunk", "arm", at=(0.5, 0.0))
    found = light_roots(m)
    assert len(found) == warns
    assert all("act on 'trunk' (0.1 kg)" in text and "lighter than 'arm' (1 kg)" in text for text in found)


def test_more_actuators_than_freedoms_share_by_least_norm() -> None:
    twice = {"left": {"joint": "hip"}, "right": {"joint": "hip", "weight": 2.0}, "knee": {"joint": "knee"}}
    run, single = mbdkit.inverse(double_pendulum(actuators=twice)), mbdkit.inverse(double_pendulum())
    left, right = run.actuators["left"].value, run.actuators["right"].value
    assert np.allclose(left + right, single.actuators["hip"].value, rtol=0, atol=1e-10)
    # multiplier identity of the least weighted norm: weight^2 * value is the same multiplier for both
    assert np.allclose(left, 4.0 * right, rtol=0, atol=1e-10)
    assert "3 actuators drive 2 degrees of freedom" in run.warnings[0]


def test_too_few_actuators_are_refused_by_the_bodies_that_nothing_drives() -> None:
    with pytest.raises(SpecError, match=r"^actuators: no actuator drives .*upper .*: 1 actuator for 2 degrees"):
        mbdkit.inverse(double_pendulum(actuators={"knee": {"joint": "knee"}}))


def test_too_few_actuators_leave_a_reported_rest() -> None:
    run = mbdkit.inverse(double_pendulum(actuators={"knee": {"joint": "knee"}}, unbalanced="report"))
    assert "stay unbalanced" in run.warnings[0]


def test_a_tension_between_two_points_pulls_them_together() -> None:
    cable = {"cable": {"bodies": ["ground", "upper"], "points": [[1.0, 0.0], [0.5, 0.0]]}, "knee": {"joint": "knee"}}
    run, single = mbdkit.inverse(double_pendulum(actuators=cable)), mbdkit.inverse(double_pendulum())
    end = np.column_stack([np.cos(run["upper"].angle), np.sin(run["upper"].angle)])
    towards = [1.0, 0.0] - end
    unit = towards / np.linalg.norm(towards, axis=1)[:, None]
    moment = run.actuators["cable"].value * (end[:, 0] * unit[:, 1] - end[:, 1] * unit[:, 0])
    assert_within(moment - single.actuators["hip"].value, 1e-9)


def test_a_force_with_a_moving_point_is_subtracted() -> None:
    force = {"time": T, "fx": 5 * T, "fy": 0 * T - 3.0, "px": 0.1 * T, "py": 0 * T - 1.0, "mz": T}
    ground = {"body": "lower", "data": force, "force": ["fx", "fy"], "point": ["px", "py"], "torque": "mz"}
    loaded, free = (mbdkit.inverse(double_pendulum(loads=loads)) for loads in ({"ground": ground}, {}))
    knee = np.column_stack([np.cos(free["upper"].angle), np.sin(free["upper"].angle)])
    arm = np.column_stack([force["px"], force["py"]]) - knee
    moment = arm[:, 0] * force["fy"] - arm[:, 1] * force["fx"] + force["mz"]
    change = loaded.actuators["knee"].value - free.actuators["knee"].value
    assert_within(change + moment, 1e-11)
    assert np.array_equal(loaded.loads["ground"].force[:, 0], force["fx"])
    total = loaded.loads["ground"].power + sum(one.power for one in loaded.actuators.values())
    assert_within(total - sum(one.power for one in free.actuators.values()), 1e-10)


def test_a_point_in_the_frame_of_a_body_moves_with_it() -> None:
    force = {"time": T, "fx": 5 * T, "fy": 0 * T - 3.0}
    tip = {"body": "lower", "data": force, "force": ["fx", "fy"], "point": [0.5, 0.0], "point_frame": "lower"}
    run = mbdkit.inverse(double_pendulum(loads={"tip": tip}))
    lower = run["lower"]
    end = lower.position + 0.5 * np.column_stack([np.cos(lower.angle), np.sin(lower.angle)])
    assert_within(run.loads["tip"].point - end, 1e-14)


def test_an_angle_that_is_counted_in_the_other_direction_has_a_negative_scale() -> None:
    spec = double_pendulum()
    spec["motion"]["data"]["knee"] = -np.degrees(spec["motion"]["data"]["knee"])
    spec["motion"]["columns"]["knee.angle"] = {"column": "knee", "unit": "deg", "scale": -1}
    run, single = mbdkit.inverse(spec), mbdkit.inverse(double_pendulum())
    assert_within(run.actuators["knee"].value - single.actuators["knee"].value, 1e-8)
    spec["motion"]["columns"]["knee.angle"]["scale"] = 0
    with pytest.raises(SpecError, match=r"scale: must not be 0"):
        mbdkit.inverse(spec)


def test_a_torque_between_bodies_without_a_joint_acts_on_both() -> None:
    # expected: a belt from the ground to the lower rod; by virtual work, it has the torque of the knee, and what acts
    # on the upper rod is the rest of the hip's
    belt = {"hip": {"joint": "hip"}, "belt": {"bodies": ["ground", "lower"]}}
    run, single = mbdkit.inverse(double_pendulum(actuators=belt)), mbdkit.inverse(double_pendulum())
    hip, knee = single.actuators["hip"].value, single.actuators["knee"].value
    np.testing.assert_allclose(run.actuators["belt"].value, knee, rtol=0, atol=1e-10)
    np.testing.assert_allclose(run.actuators["hip"].value, hip - knee, rtol=0, atol=1e-10)
    assert run.actuators["belt"].units == "N m"
    same = {"hip": {"joint": "hip"}, "knee": {"bodies": ["upper", "lower"]}}
    again = mbdkit.inverse(double_pendulum(actuators=same))
    np.testing.assert_allclose(again.actuators["knee"].value, knee, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("actuator", "told"),
    [
        ({"points": [[0, 0], [0, 0]]}, "bodies: is missing: `points` are points of `bodies`"),
        ({"body": "upper"}, "coordinate: is missing: `body` and `coordinate` are given together"),
        ({"bodies": ["upper", "lowr"]}, "bodies.1.: .*did you mean 'lower'"),
        ({"bodies": ["upper", "upper"]}, "bodies: are both 'upper': an actuator acts between two bodies"),
    ],
)
def test_actuators_that_are_not_complete_are_refused(actuator: dict[str, Any], told: str) -> None:
    with pytest.raises(SpecError, match=told):
        mbdkit.inverse(double_pendulum(actuators={"a": actuator}))


def test_measures_take_values_and_powers_of_actuators_in_their_units() -> None:
    measures = {
        "torque": "max(abs(actuators.hip.value))",
        "work": {"value": "integral(actuators.knee.power)", "unit": "kJ"},
    }
    run = mbdkit.inverse(double_pendulum(measures=measures))
    hip, knee = run.actuators["hip"], run.actuators["knee"]
    assert run.measures["torque"] == np.max(np.abs(hip.value))
    assert run.measures.units["torque"] == "N m"
    assert run.measures["work"] == pytest.approx(np.trapezoid(knee.power, T) / 1000, rel=1e-12)


@pytest.mark.parametrize(
    ("expression", "told"),
    [
        ("rms(actuators.hpi.value)", r"there is no actuator 'hpi' \(did you mean 'hip'\?\)"),
        ("rms(actuators.hip.torque)", "actuator 'hip' has no 'torque'.*; it has value and power"),
        ("rms(actuators.hip.value + joints.hip.force_x)", "adds quantities of different units, N m and N"),
    ],
)
def test_wrong_quantities_of_actuators_are_refused(expression: str, told: str) -> None:
    with pytest.raises(SpecError, match=rf"^measures\.one.*{told}"):
        mbdkit.inverse(double_pendulum(measures={"one": expression}))


def test_residual_actuators_are_quoted_in_measures_and_runs_have_no_actuators() -> None:
    m = mbdkit.Mechanism()
    m.body("disc", mass=2.0, inertia=0.5)
    data = {"time": T, "disc.x": T**2, "disc.y": 0 * T, "disc.angle": 0 * T}
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": {"data": data, "smooth": "quintic"}}
    run = mbdkit.inverse(spec | {"measures": {"push": 'mean(actuators["root.x"].value)'}})
    assert run.measures["push"] == pytest.approx(4.0, rel=1e-9)
    with pytest.raises(SpecError, match=r"measures\.push.*only inverse dynamics has actuators"):
        mbdkit.run("pendulum", measures={"push": "mean(actuators.J1.value)"})
