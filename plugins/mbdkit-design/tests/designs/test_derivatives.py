"""Derivatives of goals and limits with respect to the variables: exact ones beside differences, and what is said of
them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.designs.swinging_shank import BRACE, ONE, T, design_of, mean, moments, shank, swing

import mbdkit
from mbdkit_design.derivatives import checked, derivatives, derivatives_sentence, differences
from mbdkit_design.design_charts import sensitivity_section
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.landscape import sensitivities

LIMITS = {"stored": {"value": "max(forces.brace.potential)", "max": 50.0}}


def inverse_of_swing() -> dict[str, Any]:
    data = {"time": T.tolist(), "angle": (0.2 + 0.5 * np.sin(3 * T)).tolist()}
    motion = {"data": data, "columns": {"knee.angle": "angle"}, "smooth": "quintic"}
    return {"mbdkit": 1, "model": shank().to_spec(), "motion": motion}


@pytest.mark.parametrize("kind", ["run", "inverse dynamics"])
def test_exact_derivatives_are_those_of_the_measures(kind: str) -> None:
    # expected: central differences of the measures
    base, goal = (
        (swing(), {}) if kind == "run" else (inverse_of_swing(), {"minimize": "mean((-forces.brace.value - 2)**2)"})
    )
    evaluator = Evaluator(load_design_spec(design_of(base, subject_to=LIMITS, **goal)))
    x = np.array([0.4, 0.3])
    exact = derivatives(evaluator, x)
    assert derivatives_sentence(evaluator) == "Derivatives are exact, computed at 1 point."
    np.testing.assert_allclose(exact, differences(evaluator, x), rtol=1e-6, atol=1e-9 * np.max(np.abs(exact)))


@pytest.mark.slow
def test_the_optimum_is_found_to_more_digits_than_by_differences() -> None:
    # expected: the regression of the moments
    angle, moment = moments()
    matrix = [[mean(angle**2), -mean(angle)], [-mean(angle), 1.0]]
    k, k_free = np.linalg.solve(matrix, [-mean(angle * moment), mean(moment)])
    found = mbdkit.design(design_of(swing(step=0.05), optimizer={"name": "slsqp", "tolerance": 1e-15, "starts": 2}))
    assert found.derivatives.startswith("Derivatives are exact")
    assert found.derivatives in found.summary()
    assert found.unconfirmed == ()
    assert found.best.variables[f"{BRACE}.stiffness"] == pytest.approx(k, rel=1e-6)
    assert found.best.variables[f"{BRACE}.free_angle"] == pytest.approx(k_free / k, rel=1e-6)


def test_differences_say_why_they_are_used() -> None:
    spec = swing() | {"integrator": {"name": "scipy-dop853"}}
    spec["time"] = {"end": 0.2}
    spec["output"] = {"interval": 0.01}
    found = mbdkit.design(design_of(spec, optimizer={"name": "slsqp", "max_iterations": 2}))
    assert found.derivatives.startswith("Derivatives are differences of runs: integrator: mbdkit:scipy-dop853 has no")
    assert found.to_dict()["derivatives"] in found.summary()


def test_a_corner_of_the_goal_at_the_best_point_is_named() -> None:
    # expected: |k - 20| phi_max has a corner at k = 20, where differences are zero
    most = 20.0 * 0.7 + 1e-9  # the angle is 0.2 + 0.5 sin(3 t)
    goal = f"abs(max(abs(forces.brace.value)) - {most:.17g})"
    evaluator = Evaluator(load_design_spec(design_of(swing(), variables=ONE, minimize=goal)))
    (sentence,), _ = checked(evaluator, np.array([0.1]))
    assert "derivative of goal at the best point is not confirmed" in sentence
    assert checked(evaluator, np.array([0.2])) == ((), ())


def test_a_result_at_a_corner_of_the_goal_is_an_optimum_if_no_side_descends() -> None:
    # |k - 20| phi_max is least at its corner k = 20, where its derivatives do not say so
    most = 20.0 * 0.7 + 1e-9
    goal = f"abs(max(abs(forces.brace.value)) - {most:.17g})"
    (name,) = ONE
    found = mbdkit.design(design_of(swing(step=0.05), variables={name: {**ONE[name], "start": 20.0}}, minimize=goal))
    assert found.best.variables[name] == pytest.approx(20.0, rel=1e-9)
    assert "at a kink; from there, no linearization of a nearby point leads to a lower cost" in found.message
    assert not found.doubt
    doubtful = replace(found, unconfirmed=("The derivative of goal is not confirmed.",))
    assert doubtful.summary().startswith("This point may not be an optimum: a goal or limit is not smooth there")
    assert f"{name} has not moved from its start." in found.warnings
    rounded = replace(found.best, variables={name: 20.0 - 1e-12})  # the last digits of a point change in the search
    assert f"{name} has not moved from its start." in replace(found, best=rounded).warnings


def test_sensitivities_at_a_corner_have_two_sides_and_no_sign() -> None:
    # expected: |k - 20| phi_max has a corner at k = 20, and (k - 20)^2 phi_max^2 has none; bounds as in ONE
    most = 20.0 * 0.7
    for power, corner in ((1, True), (2, False)):
        goal = f"abs(max(abs(forces.brace.value)) - {most:.17g})**{power}"
        evaluator = Evaluator(load_design_spec(design_of(swing(), variables=ONE, minimize=goal)))
        (one,) = sensitivities(evaluator, np.array([0.1]))
        (name,) = one.changes
        assert bool(one.corners) == corner
        if corner:
            low, high = ONE[name]["bounds"]
            change = 0.01 * (high - low) * 0.7
            assert one.corners[name] == pytest.approx((change, change), rel=1e-3)
            assert np.isnan(one.changes[name])
            section = sensitivity_section([one], {name: "stiffness"}, {(one.scenario, one.measure): "N m"})
            assert "if increased" in str(section.tables[0].rows)


def test_the_discretization_error_of_a_smooth_goal_is_no_kink() -> None:
    # the goal, the square of cos(3 sqrt(k)), is smooth; its derivative is zero at the best point
    slide = {"type": "prismatic", "bodies": ["ground", "b"], "points": [[0, 0], [0, 0]], "axis": [1, 0]}
    along = {"type": "coordinate", "coordinate": "x", "bodies": ["ground", "b"], "points": [[0, 0], [0, 0]]}
    model = {
        "name": "mechanism",
        "gravity": [0, 0],
        "bodies": {"b": {"mass": 1.0, "inertia": 1.0, "position": [1.0, 0.0]}},
        "joints": {"slide": slide},
        "forces": {"spring": {"type": "law", "law": "linear", "stiffness": 6.6, "pathway": along}},
    }
    base = {
        "mbdkit": 1,
        "model": model,
        "integrator": {"name": "dopri5", "adaptive": True, "rtol": 1e-3},
        "time": {"end": 3.0},
    }
    variables = {"model.forces.spring.stiffness": {"bounds": [6.5, 7.2], "start": 6.6}}
    spec = {"mbdkit_design": 1, "base": base, "variables": variables, "minimize": "final(b.x)**2"}
    found = mbdkit.design(spec, optimum_only=True)
    assert not found.doubt
    assert "At the best point, the derivative of 'goal' is inaccurate" in found.derivatives
    assert "A single search finds a local minimum; `optimizer.starts` makes several." in found.summary()
    # an error that does not matter for the goal
    evaluator = Evaluator(load_design_spec(spec | {"minimize": "final(b.x)**2 + 1"}))
    assert checked(evaluator, evaluator.point(found.best.variables)) == ((), ())
