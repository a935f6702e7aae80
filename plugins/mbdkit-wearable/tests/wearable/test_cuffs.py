"""Cuffs against closed forms, and conservation of momentum."""

from __future__ import annotations

import numpy as np

import mbdkit


def free_pair() -> mbdkit.Mechanism:
    """Return two free bodies without gravity that a cuff connects, far from rest."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("limb", mass=3.0, inertia=0.05, velocity=(0.2, -0.1), angular_velocity=3.0)
    m.body("link", mass=0.7, inertia=0.01, position=(0.1, 0.06), angle=0.4, angular_velocity=-5.0)
    stiffness = {"normal": 900.0, "tangential": 400.0, "rotation": 3.0}
    m.cuff("cuff", bodies=("limb", "link"), at=(0.12, 0.02), on=(0.03, -0.02), angle=0.1, axis=(1.0, 2.0),
           stiffness=stiffness)  # fmt: skip
    return m


def test_momentum_and_angular_momentum_are_kept_with_displaced_points() -> None:
    m = free_pair()
    run = mbdkit.run(m, integrator={"name": "gauss", "stages": 3}, time={"end": 2.0, "step": 2e-3})
    mass = {name: (body.mass, body.inertia) for name, body in m.bodies.items()}
    p = sum(mass[name][0] * run[name].velocity for name in mass)
    turn = sum(
        mass[name][1] * run[name].angular_velocity
        + mass[name][0] * np.linalg.det(np.stack([run[name].position, run[name].velocity], axis=-1))
        for name in mass
    )
    assert np.ptp(run.cuffs["cuff"].displacement[:, 0]) > 0.05
    assert np.abs(p - p[0]).max() < 1e-12
    assert np.abs(turn - turn[0]).max() < 1e-12
    assert np.abs(run.energy.balance).max() < 1e-9 * run.energy.total.max()
