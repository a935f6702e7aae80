"""Designs some of whose runs fail: the result tells it, and is never a point whose run fails."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from tests.designs.oscillator import moved, tuned

import mbdkit
from mbdkit.measures import take
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.design_verdict import design_verdict
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.problem import Problem
from mbdkit_design.search import searches

LIMIT = 3.0
"""Value of x at which the mass of the sledge is zero."""


def sledge(**sections: Any) -> dict[str, Any]:
    """Return the design of a mass 3 - x that a force of -1 N accelerates for 1 s: its end is at -1 / (2 (3 - x))."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("sledge", mass=1.0, inertia=1.0)
    m.force("push", "sledge", value=(-1.0, 0.0))
    model = m.to_spec()
    model["bodies"]["sledge"]["mass"] = f"{LIMIT} - x"
    method = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}}
    return {
        "mbdkit_design": 1, "base": {"mbdkit": 1, "parameters": {"x": 1.0}, "model": model, **method},
        "variables": {"x": {"bounds": [0.0, 10.0], "start": 0.5}}, "minimize": "final(sledge.x)",
        "optimizer": {"name": "slsqp", "max_iterations": 20}, **sections,
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("optimizer", ["slsqp", "trust-constr"])
def test_the_best_point_is_none_whose_run_fails(optimizer: str) -> None:
    # the goal falls up to the value at which runs begin to fail; trust-constr ends beyond it
    found = mbdkit.design(sledge(optimizer={"name": optimizer, "max_iterations": 20}))
    x = found.best.variables["x"]
    assert x < LIMIT
    assert found.best.goals["goal"] == pytest.approx(-0.5 / (LIMIT - x), rel=1e-6)
    assert found.failures > 0
    assert f"{found.runs} runs ({found.failures} failed)" in found.summary()


def test_unknown_errors_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(take, "measure_error", lambda *given: math.nan)
    found = mbdkit.design(tuned(), out=tmp_path / "out")
    told = "are unknown: the values in runs with smaller steps or tolerances do not converge"
    assert found.trust.is_gain == {"goal": None}
    for point in ("start", "best point"):
        assert f"The errors of goal at the {point} {told}" in found.summary()
    assert told in design_verdict(found).sentence
    assert mbdkit.load_design(tmp_path / "out").trust.failures == found.trust.failures


def test_a_best_point_of_other_settings_whose_run_fails_in_fact_is_told() -> None:
    # with a mass of 20 - x, the bound of x is the best point; in fact, the mass would be negative there
    found = mbdkit.design(sledge(compare={"heavier": {"model.bodies.sledge.mass": "20 - x"}}))
    (heavier,) = found.compared
    assert heavier.believed is not None
    assert heavier.believed.variables["x"] == pytest.approx(10.0)
    assert heavier.fails
    assert not heavier.is_feasible
    (line,) = (line for line in found.summary().splitlines() if line.startswith("  heavier "))
    assert "a run fails" in line
    assert "in fact a run fails there" in design_verdict(found).sentence


def test_other_settings_without_a_point_within_the_limits_are_told() -> None:
    # the angle is cos(sqrt(stiffness) t), so at most cos(1) = 0.54 after one second, and 0.88 after half of it
    limits = {"angle": {"value": "final(wheel.angle)", "min": 0.6}}
    sections = {"subject_to": limits, "overrides": {"time.end": 0.5}}
    found = mbdkit.design(tuned(compare={"later": {"time.end": 1.0}}, **sections))
    assert found.is_feasible
    assert "With later, the search found no point that satisfies all limits." in found.summary()


def test_of_points_that_violate_limits_the_one_that_does_least_is_the_best() -> None:
    # after one iteration, no search has reached x = 3, and the goal is smaller away from it
    limits = {"x": {"value": "final(point.x)", "min": 3.0}}
    goal = "(final(point.x) + 1)**2 + final(point.y)**2"
    optimizer = {"name": "trust-constr", "starts": 4, "max_iterations": 1}
    spec = load_design_spec(moved(goal, subject_to=limits, optimizer=optimizer))
    evaluator = Evaluator(spec)
    found = searches(Problem(evaluator), spec.optimizer, evaluator.first)
    places = [next(iter(evaluator.variables(one.end).values())) for one in found]
    assert not any(one.feasible for one in found)
    assert places == sorted(places, reverse=True)
    assert found[0].cost > min(one.cost for one in found)
