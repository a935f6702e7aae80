"""Forces of the ground and centres of pressure, against equilibrium and the balance of momentum."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit

G, MASS, INERTIA = 9.81, 2.0, 0.02
FLOOR = {"line": {"normal": [0.0, 1.0]}}
BOX = {"polygon": [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}
COMPLIANCE = {"law": "linear", "stiffness": 1e6, "dissipation": 2e3}


def run(
    treatment: str, body: dict[str, Any], end: float, step: float, floor: dict[str, Any] = FLOOR, **more: Any
) -> mbdkit.Run:
    """Return a run of a box that a force of 3 N pushes to the right at its centre."""
    methods = {"compliant": "dopri5", "event-driven": "dop853", "time-stepping": "moreau-jean"}
    contact = {"bodies": ["box", "ground"], "shapes": [BOX, floor], "friction": 0.5, "compliance": COMPLIANCE}
    model = {
        "name": "mechanism", "bodies": {"box": {"mass": MASS, "inertia": INERTIA, "position": [0.3, 0.1]} | body},
        "contacts": {"floor": contact}, "forces": {"push": {"type": "force", "body": "box", "value": [3.0, 0.0]}},
    }  # fmt: skip
    integrator = {"name": methods[treatment]} | ({"adaptive": True} if treatment == "compliant" else {})
    given = {"mbdkit": 1, "model": model, "contact": {"treatment": treatment}, "integrator": integrator}
    return mbdkit.run(given, time={"end": end, "step": step}, **more)


@pytest.mark.parametrize("treatment", ["compliant", "event-driven", "time-stepping"])
def test_a_box_that_is_pushed_stands_on_its_centre_of_pressure(treatment: str) -> None:
    # expected: equilibrium, with the centre of pressure ahead of the centre of mass by force times height over weight
    found = run(treatment, {}, 0.2, 0.01)
    foot = found.ground_reactions["box"]
    ahead = foot.center_of_pressure[-1, 0] - found["box"].position[-1, 0]
    error = 1e-5 if treatment == "compliant" else 1e-12  # the overlap is 1e-5 m
    assert ahead == pytest.approx(3.0 * 0.1 / (MASS * G), abs=error)
    assert foot.center_of_pressure[-1, 1] == pytest.approx(0.0, abs=100 * error)
    assert foot.force[-1] == pytest.approx([-3.0, MASS * G], rel=1e-9 if error < 1e-9 else 1e-4)
    assert foot.normal_force[-1] == pytest.approx(foot.force[-1, 1], rel=1e-12)


@pytest.mark.parametrize("treatment", ["compliant", "event-driven"])
def test_ground_reactions_are_what_the_motion_needs(treatment: str) -> None:
    # expected: Newton's and Euler's laws, with the force at the centre of pressure
    drop = {"position": [0.3, 0.2], "angle": 0.3, "angular_velocity": -2.0}
    found = run(treatment, drop, 0.4, 0.005)
    foot, box = found.ground_reactions["box"], found["box"]
    needed = MASS * (box.acceleration + np.array([0.0, G])) - np.array([3.0, 0.0])
    assert foot.force == pytest.approx(needed, abs=1e-8 * np.max(np.abs(needed)))
    touches = np.isfinite(foot.center_of_pressure[:, 0])
    assert touches.tolist() == (foot.normal_force > 0.0).tolist()
    assert 0 < np.sum(touches) < len(touches)
    (x, y), (fx, fy) = (foot.center_of_pressure - box.position)[touches].T, foot.force[touches].T
    moments = INERTIA * box.angular_acceleration[touches]
    assert x * fy - y * fx == pytest.approx(moments, abs=1e-9 * np.max(np.abs(moments)))


def test_the_center_of_pressure_of_a_rolling_wheel_is_ahead_by_the_arm_of_its_resistance() -> None:
    arm = 0.01
    contact = {
        "bodies": ["wheel", "ground"], "shapes": [{"circle": {"radius": 0.2}}, FLOOR], "friction": 0.5,
        "rolling_resistance": arm, "compliance": COMPLIANCE,
    }  # fmt: skip
    wheel = {
        "mass": MASS, "inertia": INERTIA, "position": [0.0, 0.2 - MASS * G / 1e6], "velocity": [1.0, 0.0],
        "angular_velocity": -5.0,
    }  # fmt: skip
    model = {"name": "mechanism", "bodies": {"wheel": wheel}, "contacts": {"road": contact}}
    given = {"mbdkit": 1, "model": model, "integrator": {"name": "dopri5", "adaptive": True}}
    found = mbdkit.run(given, time={"end": 0.3, "step": 0.01})
    ahead = found.ground_reactions["wheel"].center_of_pressure[-1] - found["wheel"].position[-1]
    assert ahead == pytest.approx([arm, -0.2], abs=1e-4)
    force = found.ground_reactions["wheel"].force[-1]
    assert ahead[0] * force[1] - ahead[1] * force[0] == pytest.approx(
        INERTIA * found["wheel"].angular_acceleration[-1], abs=1e-9
    )


def test_forces_of_time_stepping_add_up_to_the_change_of_momentum() -> None:
    # expected: the law of impulse; forces are those over the step before each row
    found = run("time-stepping", {"position": [0.3, 0.2], "angle": 0.3}, 0.3, 0.001)
    pushed = 0.001 * np.sum(found.ground_reactions["box"].force[1:], axis=0)
    change = MASS * (found["box"].velocity[-1] - found["box"].velocity[0])
    assert pushed + 0.3 * np.array([3.0, -MASS * G]) == pytest.approx(change, abs=1e-9)


def test_measures_events_and_archives_have_ground_reactions(tmp_path: Any) -> None:
    name = "ground_reactions.box"
    found = run(
        "compliant", {"position": [0.3, 0.15]}, 0.15, 0.001,
        measures={"peak": f"max({name}.force_y)", "place": f"final({name}.center_of_pressure_x)"},
        events={"lands": {"when": f"{name}.normal_force - 1", "direction": "rising"}},
    )  # fmt: skip
    foot = found.ground_reactions["box"]
    assert found.measures["peak"] >= np.max(foot.force[:, 1])
    assert found.measures["place"] == foot.center_of_pressure[-1, 0]
    assert found.events[0].time == pytest.approx(np.sqrt(2 * 0.05 / G), abs=1e-3)
    found.save(tmp_path / "run.h5")
    with mbdkit.load(tmp_path / "run.h5") as again:
        assert np.array_equal(again.ground_reactions["box"].center_of_pressure, foot.center_of_pressure, equal_nan=True)
    with pytest.raises(KeyError, match="the run has no ground reaction 'bax'"):
        found.ground_reactions["bax"]
