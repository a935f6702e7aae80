"""Pendulum and slide with friction in their joints."""

from __future__ import annotations

import math

from mbdkit.mechanism.mechanism import Mechanism

MASS, INERTIA, ARM, MU, RADIUS, TRANSITION = 2.0, 0.1, 0.6, 0.3, 0.05, 0.02


def pendulum(rate: float) -> Mechanism:
    m = Mechanism()
    x, y = ARM * math.sin(1.2), -ARM * math.cos(1.2)
    m.body("rod", mass=MASS, inertia=INERTIA, position=(x, y), angle=1.2, velocity=(-rate * y, rate * x))
    m.bodies["rod"] = m.bodies["rod"].model_copy(update={"angular_velocity": rate})
    friction = {"coefficient": MU, "radius": RADIUS, "transition_speed": TRANSITION}
    m.revolute("pin", m.ground, "rod", at=(0.0, 0.0), friction=friction)
    return m


def slide(coefficient: float, torque: float) -> Mechanism:
    """A block of 2 kg that slides to the right in a guide 0.1 m above its centre of mass."""
    m = Mechanism()
    m.body("block", mass=2.0, inertia=0.1, velocity=(1.0, 0.0))
    friction = {"coefficient": coefficient, "length": 0.08, "transition_speed": 1e-4}
    m.prismatic("guide", m.ground, "block", points=((0, 0.1), (0, 0.1)), axis=(1, 0), friction=friction)
    m.torque("turn", "block", value=torque)
    return m
