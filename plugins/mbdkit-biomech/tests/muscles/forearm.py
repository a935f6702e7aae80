"""A forearm with muscles."""

from __future__ import annotations

import numpy as np

import mbdkit


def forearm(**more: object) -> dict:
    """Return a horizontal forearm of 1.5 kg at rest, with one muscle that is vertical at 4 cm from the elbow."""
    m = mbdkit.Mechanism()
    arm = m.body("forearm", mass=1.5, inertia=0.02, position=(0.15, 0.0))
    m.revolute("elbow", m.ground, arm, at=(0, 0))
    path = [{"body": "ground", "point": (0.04, 0.3)}, {"body": arm, "point": (-0.11, 0.0)}]
    m.muscle("biceps", path, max_force=600.0, optimal_length=0.12, tendon_length=0.18)
    time = np.linspace(0, 1, 11).tolist()
    zero = [0.0] * 11
    columns = {"elbow.angle": {"column": "a", "rate": "b", "acceleration": "c"}}
    motion = {"data": {"time": time, "a": zero, "b": zero, "c": zero}, "columns": columns}
    return {"mbdkit": 1, "model": m.to_spec(), "motion": motion, "recruitment": {"capacity": "isometric"}} | more
