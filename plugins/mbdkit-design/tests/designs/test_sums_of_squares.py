"""Least squares, and variables of which only a combination is determined."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.designs.swinging_shank import BRACE, T, design_of, mean, moments, shank, swing

import mbdkit
from mbdkit import SpecError

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
