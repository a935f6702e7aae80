"""Designs of inverse dynamics: errors of measures and gains by samples of noise, and the spring that unloads a knee."""

from __future__ import annotations

import numpy as np
import pytest

import mbdkit
from mbdkit_biomech.inverse_dynamics.results import measure_samples
from mbdkit_design.derivatives import derivatives, differences
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.trust import certified

ROWS, DEVIATION, LEVER = 50, 4.0, 0.3


def pushed_rod() -> dict:
    """Return a rod at rest that a vertical force with noise pushes at a lever, and a spring at its hinge."""
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(LEVER, 0.0))
    m.revolute("hip", m.ground, rod, at=(0, 0))
    m.torsion_spring("spring", m.ground, rod, stiffness=10.0, free_angle=0.5)
    time, zero, push = np.linspace(0, 1, ROWS).tolist(), [0.0] * ROWS, [30.0] * ROWS
    columns = {"hip.angle": {"column": "a", "deviation": 1e-9}}
    force = [0.0, {"column": "push", "deviation": DEVIATION}]
    loads = {"push": {"body": "rod", "force": force, "data": {"time": time, "push": push}}}
    motion = {"data": {"time": time, "a": zero}, "columns": columns, "smooth": {"name": "butterworth", "cutoff": 5}}
    return {"mbdkit": 1, "model": m.to_spec(), "motion": motion, "loads": loads}


def test_noise_cancels_in_the_gain_of_a_spring_and_leaves_what_the_spring_changes(monkeypatch):
    # expected: the mean of N independent values has the deviation of one over sqrt(N), which is the same at both
    # points; with the torque u + e of noisy loads, mean((u + e)^2) - mean((u + e - s)^2) has the error 2 s mean(e).
    # Bounds of 16 samples scatter by 18 %.
    monkeypatch.setattr(measure_samples, "SAMPLES", 16)
    variables = {"model.forces.spring.stiffness": {"bounds": [5, 15], "start": 10.0}}
    goals = {"mean": "mean(actuators.hip.value)", "square": "mean(actuators.hip.value**2)"}
    design = {"mbdkit_design": 1, "base": pushed_rod(), "variables": variables, "minimize": goals}
    trust = certified(Evaluator(load_design_spec(design)), np.array([0.5]), np.array([0.9]))
    bound = 1.96 * LEVER * DEVIATION / np.sqrt(ROWS)
    assert abs(trust.gain["mean"]) == pytest.approx(4.0 * 0.5, rel=1e-9)
    assert trust.errors["mean"] == pytest.approx(bound, rel=0.5)
    assert trust.gain_errors["mean"] < 1e-6
    assert trust.gain_errors["square"] == pytest.approx(2 * (4.0 * 0.5) * bound, rel=0.5)


def test_goals_and_limits_of_the_packaged_design_have_exact_derivatives():
    evaluator = Evaluator(load_design_spec("knee-spring-muscles"))
    x = evaluator.point({"model.forces.knee spring.stiffness": 20.0, "model.forces.knee spring.free_angle": 0.1})
    found = derivatives(evaluator, x)
    assert not evaluator.why_differences
    places = [
        evaluator.names.index(name) for name in ("knee", "hip")
    ]  # frames at their peaks, whose muscles stay active
    np.testing.assert_allclose(found[:, places], differences(evaluator, x)[:, places], rtol=1e-6)
