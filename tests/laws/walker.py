"""A leg of two rods that a cable passes."""

from __future__ import annotations

import numpy as np

from mbdkit import Mechanism

SWEEP = {"end": 1.0, "step": 0.01}


def walker() -> Mechanism:
    m = Mechanism(gravity=(0.0, -9.81))
    m.body("thigh", mass=8.0, inertia=0.12, position=(0.0, -0.2), angle=-np.pi / 2)
    m.body("shank", mass=4.0, inertia=0.06, position=(0.0, -0.6), angle=-np.pi / 2)
    m.revolute("hip", m.ground, "thigh", at=(0, 0))
    m.revolute("knee", "thigh", "shank", at=(0, -0.4))
    return m
