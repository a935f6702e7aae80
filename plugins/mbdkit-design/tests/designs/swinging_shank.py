"""A limb that a motor swings, with a brace at its joint: designs of the brace have closed-form optima."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss

import mbdkit

BRACE = "model.forces.brace"
MASS, INERTIA, ARM = 4.0, 0.1, 0.25
ANGLE = 0.2
"""Angle about which the motor swings the limb [rad]."""
T = np.linspace(0.0, 2.0, 201)
"""Times of measured angles, and of the rows of runs with steps of 0.01 s."""
NODES, WEIGHTS = leggauss(40)
"""Nodes and weights of Gauss-Legendre quadrature, exact for these functions, on [-1, 1]."""
ONE = {f"{BRACE}.stiffness": {"bounds": [0.0, 200.0]}}
"""The stiffness as the only variable."""


def shank() -> mbdkit.Mechanism:
    """Return a limb that stands on its joint at the ground, with a brace there."""
    m = mbdkit.Mechanism()
    position = (-ARM * np.sin(ANGLE), ARM * np.cos(ANGLE))
    m.body("shank", mass=MASS, inertia=INERTIA, position=position, angle=ANGLE)
    m.revolute("knee", m.ground, "shank", at=(0, 0))
    m.torsion_spring("brace", m.ground, "shank", stiffness=1.0, free_angle=0.0)
    return m


def swing(amplitude: float = 0.5, mechanism: mbdkit.Mechanism | None = None, step: float = 0.1) -> dict[str, Any]:
    """Return the spec of a run in which a motor swings the shank."""
    m = mechanism or shank()
    m.driver("motor", m.ground, "shank", coordinate="angle", motion=f"{ANGLE} + {amplitude}*sin(3*t)")
    method = {"integrator": {"name": "gauss", "stages": 3}, "time": {"end": T[-1], "step": step}}
    return {"mbdkit": 1, "model": m.to_spec(), **method}


def moments(amplitude: float = 0.5, at: np.ndarray = 1.0 + NODES) -> tuple[np.ndarray, np.ndarray]:
    """Return angle and torque of the motor without the brace at some times, in closed form."""
    angle, acceleration = ANGLE + amplitude * np.sin(3 * at), -9 * amplitude * np.sin(3 * at)
    return angle, (INERTIA + MASS * ARM**2) * acceleration - MASS * 9.81 * ARM * np.sin(angle)


def mean(x: np.ndarray) -> float:
    """Return the mean over the 2 s of the values at the nodes."""
    return float(WEIGHTS @ x) / 2.0


def design_of(base: Any, **sections: Any) -> dict[str, Any]:
    """Return a design of the brace, by default for the least mean square of the motor's torque."""
    return {
        "mbdkit_design": 1, "base": base,
        "variables": {f"{BRACE}.stiffness": {"bounds": [0.0, 200.0]}, f"{BRACE}.free_angle": {"bounds": [-2.0, 2.0]}},
        "minimize": "mean(joints.motor.torque**2)", "optimizer": {"name": "slsqp", "tolerance": 1e-14}, **sections,
    }  # fmt: skip
