"""Least squares, variables of which only a combination is determined, and goals with a number of the best point off."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.designs.oscillator import STIFFNESS, distance, moved, tuned, tuned_stiffness
from tests.designs.swinging_shank import BRACE, T, design_of, mean, moments, shank, swing

import mbdkit
from mbdkit import SpecError
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.design_verdict import robustness_table
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.known_points import point_of
from mbdkit_design.robustness import robustness

STRAP = "model.forces.strap"
BOTH = {f"{name}.stiffness": {"bounds": [0.0, 200.0], "start": 20.0 + k} for k, name in enumerate((BRACE, STRAP))}


def strapped() -> dict[str, Any]:
    """Return the swing with a second spring in parallel to the brace."""
    m = shank()
    m.torsion_spring("strap", m.ground, "shank", stiffness=1.0, free_angle=0.0)
    return swing(mechanism=m)


def test_least_squares_finds_the_spring_of_given_moments() -> None:
    # expected: k phi_0 - k phi of the brace is linear in k phi_0 and k, for which NumPy solves the least squares
    angle, _ = moments(at=T)
    places = range(10, 200, 10)
    given = np.array([3.0 - 8.0 * angle[k] + 0.3 * np.cos(5 * T[k]) for k in places])
    matrix = np.array([[1.0, -angle[k]] for k in places])
    (preload, stiffness), rest, *_ = np.linalg.lstsq(matrix, given)
    terms = {
        f"at_{k}": f"at(forces.brace.value, {T[k]:.2f}) - ({moment:.17g})"
        for k, moment in zip(places, given, strict=True)
    }
    options = {"name": "least-squares", "tolerance": 1e-15}
    found = mbdkit.design(design_of(swing(step=0.02), minimize=terms, optimizer=options))
    assert found.best.variables[f"{BRACE}.stiffness"] == pytest.approx(stiffness, rel=1e-10)
    assert found.best.variables[f"{BRACE}.free_angle"] == pytest.approx(preload / stiffness, rel=1e-10)
    assert list(found.best.goals) == ["goal"]
    assert found.best.goals["goal"] == pytest.approx(rest[0], rel=1e-10)
    assert found.start.goals["goal"] == pytest.approx(sum(value**2 for value in found.start.measures[""].values()))
    assert not found.undetermined


@pytest.mark.parametrize("optimizer", ["slsqp", "least-squares"])
def test_of_two_springs_in_parallel_only_the_sum_is_determined(optimizer: str) -> None:
    angle, moment = moments()
    total, base = -mean(moment * angle) / mean(angle**2), strapped()
    goal: Any = {"slsqp": "mean(joints.motor.torque**2)"}.get(optimizer)
    if goal is None:  # torques that a spring of 30 N m/rad exerts
        angle, moment = moments(at=T)
        total, goal = 30.0, {f"at_{k}": f"at(joints.motor.torque, {T[k]:.2f}) - ({moment[k] + 30 * angle[k]:.17g})"
                             for k in (30, 80, 170)}  # fmt: skip
    found = mbdkit.design(design_of(base, variables=BOTH, minimize=goal, optimizer={"name": optimizer}))
    assert sum(found.best.variables.values()) == pytest.approx(total, rel=1e-4)
    (change,) = found.undetermined
    assert sorted(change) == sorted(BOTH)
    assert sum(change.values()) == pytest.approx(0.0, abs=1e-3 * max(change.values()))
    assert "Only a combination of model.forces.brace.stiffness, model.forces.strap.stiffness" in found.summary()


@pytest.mark.parametrize("most", [20.0, 1e3, 1e5])
def test_springs_in_parallel_are_named_whatever_their_bounds(most: float) -> None:
    # a wheel that turns freely: its last angle is no quadratic function of the stiffnesses
    spec = tuned()
    forces = spec["base"]["model"]["forces"]
    forces["other"] = dict(forces["spring"])
    names = STIFFNESS, "model.forces.other.stiffness"
    spec["variables"] = {name: {"bounds": [0.0, most], "start": 1.1 + 0.1 * k} for k, name in enumerate(names)}
    found = mbdkit.design(spec)
    assert sum(found.best.variables.values()) == pytest.approx(tuned_stiffness(), rel=1e-3)
    (change,) = found.undetermined
    assert change[names[0]] == pytest.approx(-change[names[1]], rel=1e-3)


@pytest.mark.parametrize("most", [2.0, 1e3])
def test_variables_of_unequal_bounds_and_effects_are_determined(most: float) -> None:
    spec = moved(f"{distance(0.3, 0.0)} + 0.01*({distance(0.3, 0.2)})")
    first, second = spec["variables"]
    spec["variables"] = {first: {"bounds": [-most, most], "start": 0.7}, second: {"bounds": [-1.0, 2.0], "start": 0.6}}
    found = mbdkit.design({**spec, "optimizer": {"name": "slsqp", "tolerance": 1e-12}})
    assert found.best.variables[first] == pytest.approx(0.3, abs=1e-2)
    assert not found.undetermined


@pytest.mark.slow
def test_a_limit_or_a_bound_determines_one_of_two_springs() -> None:
    rough = {"name": "slsqp", "tolerance": 1e-9}
    limited = {"strap": {"value": "max(abs(forces.strap.value))", "max": 2.0, "min": 2.0}}
    angle, _ = moments()
    assert not mbdkit.design(design_of(strapped(), variables=BOTH, subject_to=limited, optimizer=rough)).undetermined
    held = BOTH | {f"{STRAP}.stiffness": {"bounds": [0.0, 5.0]}}
    goal = f"mean(joints.motor.torque**2) + mean((forces.strap.value + 50*{mean(angle):.3f})**2)"
    found = mbdkit.design(design_of(strapped(), variables=held, minimize=goal, optimizer=rough))
    assert found.best.variables[f"{STRAP}.stiffness"] == pytest.approx(5.0, rel=1e-6)
    assert not found.undetermined


def test_a_variable_without_effect_is_named() -> None:
    # the motor holds the angle, up to the errors of the steps
    variables = {f"{BRACE}.damping": {"bounds": [0.0, 1.0]}}
    given = design_of(swing(step=0.01), variables=variables, minimize="final(shank.angle)")
    assert "model.forces.brace.damping is not determined" in mbdkit.design(given).summary()


@pytest.mark.parametrize("most", [1e-3, 200.0], ids=["narrow", "wide"])
def test_the_free_angle_of_a_spring_with_the_stiffness_zero_is_not_determined(most: float) -> None:
    # with these free angles, the brace increases the torque of the motor
    variables = {
        f"{BRACE}.stiffness": {"bounds": [0.0, most], "start": most / 100},
        f"{BRACE}.free_angle": {"bounds": [1.5, 2.5]},
    }
    found = mbdkit.design(design_of(swing(), variables=variables))
    assert found.best.variables[f"{BRACE}.stiffness"] == pytest.approx(0.0, abs=1e-9 * most)
    assert [list(change) for change in found.undetermined] == [[f"{BRACE}.free_angle"]]


def test_least_squares_keeps_no_limits() -> None:
    limits = {"strap": {"value": "max(abs(forces.brace.value))", "max": 2.0}}
    with pytest.raises(SpecError, match=r"optimizer.name.*does not support limits"):
        mbdkit.design(design_of(swing(), subject_to=limits, optimizer={"name": "least-squares"}))


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
    table = robustness_table(evaluator.spec, point_of(evaluator, np.array([0.0])), list(found.values()))
    assert table.rows[0] == ("stiffness of spring", "5 %", *map(pytest.approx, (9.5, 10.5, 10, 10)), "load")


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
