"""An oscillator that a design tunes, and a point that it moves: designs with closed-form solutions."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import brentq

import mbdkit

STIFFNESS = "model.forces.spring.stiffness"
COARSE = 0.5
"""A coarse step [s]."""


def tuned(**sections: Any) -> dict[str, Any]:
    """Return the design of the stiffness with which an oscillator, at rest at 1 rad, is at 0 rad after one second."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("wheel", mass=1.0, inertia=1.0, angle=1.0)
    m.revolute("pin", m.ground, "wheel", at=(0, 0))
    m.torsion_spring("spring", m.ground, "wheel", stiffness=1.0, free_angle=0.0)
    method = {"integrator": {"name": "dop853"}, "time": {"end": 1.0, "step": 0.1}}
    return {
        "mbdkit_design": 1, "base": {"mbdkit": 1, "model": m.to_spec(), **method},
        "variables": {STIFFNESS: {"bounds": [1.0, 4.0], "start": 1.5}}, "minimize": "final(wheel.angle)**2",
        "optimizer": {"name": "slsqp", "tolerance": 1e-20}, **sections,
    }  # fmt: skip


def tuned_stiffness() -> float:
    """Return the stiffness of an oscillator that passes zero after a quarter of its period, one second."""
    return float((np.pi / 2) ** 2)


def stiffness_of_runge_kutta(step: float) -> float:
    """Return the stiffness with which four-stage methods of order 4 pass zero after one second.

    One step multiplies the complex amplitude by R(i omega h), the same polynomial for all these methods.
    """

    def angle(omega: float) -> float:
        z = 1j * omega * step
        return float(np.angle(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)) / step - np.pi / 2

    return float(brentq(angle, 1.0, 2.0, xtol=1e-14)) ** 2


def moved(goals: Any, **sections: Any) -> dict[str, Any]:
    """Return the design of the place of a point, with goals and limits in terms of ``point.x`` and ``point.y``."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("point", mass=1.0, inertia=1.0, position=(0.7, 0.7))
    method = {"integrator": {"name": "rk4"}, "time": {"end": 0.02, "step": 0.01}}
    bounds = {"bounds": [-1.0, 2.0], "start": 0.7}
    return {
        "mbdkit_design": 1, "base": {"mbdkit": 1, "model": m.to_spec(), **method},
        "variables": {f"model.bodies.point.position.{axis}": bounds for axis in (0, 1)}, "minimize": goals, **sections,
    }  # fmt: skip


def distance(x: float, y: float) -> str:
    """Return the squared distance of the point from a place, as a goal."""
    return f"(final(point.x) - {x})**2 + (final(point.y) - {y})**2"
