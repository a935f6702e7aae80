"""Goals and limits with a number of the best point off: expected values are those of the spring's force, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.robustness import robustness, robustness_text

DESIGN = {
    "mbdkit_design": 1,
    "base": {
        "mbdkit": 1,
        "model": {
            "name": "mechanism",
            "gravity": [0, -10],
            "bodies": {"block": {"mass": 1, "inertia": 1, "position": [0.5, 0]}},
            "joints": {"hold": {"type": "weld", "bodies": ["ground", "block"], "at": [0.5, 0]}},
            "forces": {"spring": {"type": "spring-damper", "bodies": ["ground", "block"], "from": [0, 0],
                                  "to": [0.5, 0], "stiffness": 50, "free_length": 0.3}},
        },
        "integrator": {"name": "rk4"},
        "time": {"end": 0.02, "step": 0.01},
    },
    "variables": {"model.forces.spring.stiffness": {"bounds": [50, 100]}},
    "minimize": {"pull": "max(abs(joints.hold.force_x))", "weight": "max(abs(joints.hold.force_y))"},
    "subject_to": {"load": {"value": "max(abs(joints.hold.force))", "max": "14.2 N"}},
}  # fmt: skip


def test_variables_masses_and_attachments_are_off_by_five_percent_and_two_millimetres() -> None:
    evaluator = Evaluator(load_design_spec(DESIGN))
    found = {one.words: one for one in robustness(evaluator, np.array([0.0]))}
    assert {words: one.size for words, one in found.items()} == {
        "stiffness of spring": "5 %", "mass and inertia of block": "5 %", "x of point 1 of spring": "2 mm",
        "y of point 1 of spring": "2 mm", "x of point 2 of spring": "2 mm", "y of point 2 of spring": "2 mm",
    }  # fmt: skip
    assert found["stiffness of spring"].goals == pytest.approx(np.array([[9.5, 10], [10.5, 10]]), rel=1e-9)
    assert found["mass and inertia of block"].goals == pytest.approx(np.array([[10, 9.5], [10, 10.5]]), rel=1e-9)
    assert found["x of point 2 of spring"].goals[:, 0] == pytest.approx([9.9, 10.1], rel=1e-9)
    length = math.hypot(0.5, 0.002)
    assert found["y of point 1 of spring"].goals[:, 0] == pytest.approx(50 * (1 - 0.3 / length) * 0.5, rel=1e-9)
    assert found["stiffness of spring"].exceeds == ("load",)  # sqrt(10.5^2 + 10^2) = 14.5 N
    assert found["x of point 1 of spring"].exceeds == ("load",)  # sqrt(10.1^2 + 10^2) = 14.21 N
    assert found["y of point 1 of spring"].exceeds == ()
    table = robustness_text(evaluator.spec, list(found.values()))
    assert table.splitlines()[1].split() == ["stiffness", "of", "spring", "5", "%", "9.5", "10.5", "10", "10", "load"]


@pytest.mark.parametrize("is_variable", [False, True], ids=["inertia of the body", "inertia is a variable"])
def test_the_inertia_of_a_body_changes_with_its_mass(is_variable: bool) -> None:
    """The torque of the motor is the inertia times the acceleration, 0.3 kg m^2 times 10 rad/s^2."""
    bodies = {"rotor": {"mass": 2, "inertia": 0.3}}
    joints = {
        "hub": {"type": "revolute", "bodies": ["ground", "rotor"], "at": [0, 0]},
        "motor": {"type": "driver", "bodies": ["ground", "rotor"], "coordinate": "angle", "motion": "5*t**2"},
    }
    model = {"name": "mechanism", "gravity": [0, 0.5], "bodies": bodies, "joints": joints}
    variable = "model.bodies.rotor.inertia" if is_variable else "model.gravity.1"
    base = {**DESIGN["base"], "model": model}
    design = {"mbdkit_design": 1, "base": base, "minimize": "max(abs(joints.motor.torque))"}
    evaluator = Evaluator(load_design_spec({**design, "variables": {variable: {"bounds": [0.3, 1.0]}}}))
    found = {one.words: one.goals[:, 0] for one in robustness(evaluator, np.array([0.0]))}
    words, torques = ("mass of rotor", [3.0, 3.0]) if is_variable else ("mass and inertia of rotor", [2.85, 3.15])
    assert found[words] == pytest.approx(torques, rel=1e-9)


def test_masses_in_a_list_have_their_inertias_beside_them() -> None:
    model = {"name": "double-pendulum", "masses": [1.0, 2.0], "inertias": [0.1, 0.2], "gravity": [0.0, -9.81]}
    base = {**DESIGN["base"], "model": model}
    variables = {"model.gravity.1": {"bounds": [-10.0, -9.0]}}
    spec = {"mbdkit_design": 1, "base": base, "variables": variables, "minimize": "max(energy.kinetic)"}
    found = [one.words for one in robustness(Evaluator(load_design_spec(spec)), np.array([0.0]))]
    assert found[1:] == ["masses[1] and inertias[1]", "masses[0] and inertias[0]"]
