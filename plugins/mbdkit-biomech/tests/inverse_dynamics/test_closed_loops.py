"""The torques that moved mechanisms with closed loops in forward runs come back from their motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.inverse_dynamics.moved_linkages import TORQUES, moved

import mbdkit


@pytest.mark.parametrize("example", TORQUES)
def test_the_torques_of_a_forward_run_come_back(example: str, tmp_path: Path) -> None:
    run, spec = moved(example, tmp_path / "run.h5")
    inverse = mbdkit.inverse(spec)
    assert inverse.kind == "inverse"
    assert run.kind == "forward"
    peak = max(np.max(np.abs(run.forces[f"on {joint}"].value)) for joint, value in TORQUES[example].items() if value)
    for joint, value in TORQUES[example].items():
        known = run.forces[f"on {joint}"].value if value else 0.0
        assert np.max(np.abs(inverse.actuators[f"on {joint}"].value - known)) < 1e-9 * peak
    force, found = (one.array("joints/reaction_force") for one in (run, inverse))
    assert np.max(np.abs(found - force)) < 1e-9 * np.max(np.abs(force))
    assert inverse.misalignment_max < 1e-14


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
    assert np.max(np.abs(run.joints["A"].angle - angle)) < 1e-12
    # virtual work: the torque times the crank's rate is the rate of the kinetic energy
    energy = run.energy.kinetic
    rate = np.gradient(energy, t, edge_order=2)
    power = run.actuators["A"].power
    assert np.max(np.abs(power - rate)[50:-50]) < 1e-4 * np.max(np.abs(rate))
