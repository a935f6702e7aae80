"""An arm with one muscle, whose curves are written by hand."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbdkit import Mechanism

FORCE, FIBER, PENNATION, SPEED, DAMPING = 600.0, 0.12, 0.1, 10.0, 0.1


WIDTH = FIBER * np.sin(PENNATION)


EXCITATION = "0.3 + 0.2*sin(5*t)"


# De Groote et al., 2016, supplementary material, with the constants of OpenSim 4 (DeGrooteFregly2016Muscle)
def active(x: float) -> float:
    parts = (
        (0.8150671134243542, 1.055033428970575, 0.162384573599574, 0.063303448465465),
        (0.433004984392647, 0.716775413397760, -0.029947116970696, 0.200356847296188),
        (0.1, 1.0, 0.353553390593274, 0.0),
    )
    return sum(b1 * np.exp(-((x - b2) ** 2) / (2 * (b3 + b4 * x) ** 2)) for b1, b2, b3, b4 in parts)


def passive(x: float) -> float:
    least = np.exp(4 * (0.2 - 1) / 0.6)
    return (np.exp(4 * (x - 1) / 0.6) - least) / (np.exp(4) - least)


def by_velocity(v: float) -> float:
    x = -8.149 * v - 0.374
    return -0.3211346127989808 * np.log(x + np.sqrt(x * x + 1)) + 0.8825327733249912


def arm(kind: str, fiber: float = FIBER, slack: float = 0.18, excitation: Any = EXCITATION, **more: Any) -> Mechanism:
    """A forearm with a muscle from (0.04, 0.3) to a point 0.04 m from the elbow."""
    m = Mechanism()
    m.body("forearm", mass=1.5, inertia=0.02, position=(0.15, 0.0))
    m.revolute("elbow", m.ground, "forearm", at=(0, 0))
    path = [{"body": "ground", "point": (0.04, 0.3)}, {"body": "forearm", "point": (-0.11, 0.0)}]
    values = {"max_force": FORCE, "optimal_length": fiber, "tendon_length": slack, "pennation": PENNATION}
    m.muscle("biceps", path, tendon=kind, excitation=excitation, **(values | more))
    return m
