"""Stiff springs and dampers: where explicit steps overflow, and where the round-off of large forces sets the floor."""

from __future__ import annotations

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.run import Run

STEP = 1e-3
STIFFNESS = 1e8


def two_masses(damping: float, stretch: float) -> mbdkit.Mechanism:
    """Return a rod on a pin with a second body on a spring of 1e8 N/m: 14,000 rad/s, fourteen radians a step."""
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(1.0, 0.0))
    m.revolute("A", m.ground, rod, points=((0.0, 0.0), (-1.0, 0.0)))
    bob = m.body("bob", mass=1.0, inertia=0.1, position=(2.0 + stretch, 0.0))
    m.spring_damper("spring", rod, bob, points=((0, 0), (0, 0)), stiffness=STIFFNESS, damping=damping, free_length=1.0)
    return m


def pendulum_with_rigid_link(end: float) -> Run:
    """Return the limit of an infinitely stiff spring: a distance joint in its place, resolved to round-off."""
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(1.0, 0.0))
    m.revolute("A", m.ground, rod, points=((0.0, 0.0), (-1.0, 0.0)))
    bob = m.body("bob", mass=1.0, inertia=0.1, position=(2.0, 0.0))
    m.distance("link", rod, bob, points=((0, 0), (0, 0)), length=1.0)
    return mbdkit.run(m, integrator={"name": "gauss", "stages": 4}, time={"end": end, "step": 1e-3})


@pytest.mark.parametrize("stages", [2, 3, 5])
def test_radau_iia_damps_a_fast_vibration_that_it_cannot_resolve(stages: int) -> None:
    # L-stability: the 50 J of a spring stretched by 1 mm are gone, the slow swing remains
    run = mbdkit.run(
        two_masses(0.0, 1e-3), integrator={"name": "radau-iia", "stages": stages}, time={"end": 1.0, "step": STEP}
    ).check()
    assert run.energy.balance[-1] == pytest.approx(-50.0, abs=0.1)
    limit = pendulum_with_rigid_link(1.0)
    np.testing.assert_allclose(run["bob"].position[-1], limit["bob"].position[-1], rtol=0, atol=2e-3)


@pytest.mark.parametrize("stages", range(1, 7))
def test_a_damped_rod_may_come_to_rest_under_gauss(stages: int) -> None:
    # the iteration's changes are then round-off of forces that cancel: nothing to do with divergence
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=1 / 12, position=(0.5, 0.0))
    m.revolute("A", m.ground, rod, at=(0.0, 0.0))
    m.torsion_spring("damper", m.ground, rod, stiffness=0.0, damping=0.3)
    run = mbdkit.run(
        m, integrator={"name": "gauss", "stages": stages}, time={"end": 200.0, "step": 0.01}, output={"every": 1000}
    ).check()
    # expected: hanging straight down at rest, as far from there as the joint came apart; the pin carries the weight
    apart = 1e-12 + 2 * run.misalignment_max
    # margin: as far as the joint came apart
    np.testing.assert_allclose(run["rod"].position[-1], [0.0, -0.5], rtol=0, atol=apart)
    np.testing.assert_allclose(run.joints["A"].reaction_force[-1], [0.0, 9.81], rtol=0, atol=1e-8)
