"""Rods on stiff springs."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from scipy.integrate import solve_ivp

G = 9.81


METHODS = (("radau-iia", 2), ("radau-iia", 3), ("radau-iia", 5), ("gauss", 1), ("gauss", 2), ("gauss", 3), ("gauss", 4))


def on_a_spring(stiffness: float, damping: float) -> dict[str, Any]:
    """Return a body 1 m from the point to which a spring holds it."""
    spring = {
        "type": "spring-damper", "bodies": ["ground", "m"], "points": [[0, 0], [0, 0]],
        "stiffness": stiffness, "damping": damping, "free_length": 1.0,
    }  # fmt: skip
    body = {"mass": 1.0, "inertia": 0.1, "position": [1.0, 0.0]}
    return {"name": "mechanism", "bodies": {"m": body}, "forces": {"s": spring}}


def in_a_bushing(stiffness: float, damping: float) -> dict[str, Any]:
    """Return a rod of 1 m whose left end is held by two springs, along x and along y."""
    forces = {
        axis: {
            "type": "law", "law": "linear", "stiffness": stiffness, "damping": damping,
            "pathway": {
                "type": "coordinate", "coordinate": axis, "bodies": ["ground", "m"], "points": [[0, 0], [-0.5, 0]],
            },
        }
        for axis in ("x", "y")
    }  # fmt: skip
    body = {"mass": 1.0, "inertia": 1 / 12, "position": [0.5, 0.0]}
    return {"name": "mechanism", "bodies": {"m": body}, "forces": forces}


@cache
def tilt_after_a_second(pull: float) -> float:
    """Return the angle of a pendulum released at 0 with ``angle'' = -pull cos(angle)`` [rad]."""
    solution = solve_ivp(
        lambda t, y: [y[1], -pull * math.cos(y[0])], (0.0, 1.0), [0.0, 0.0], "DOP853", rtol=1e-12, atol=1e-12
    )
    return float(solution.y[0, -1])


HOLDS = {"spring": (on_a_spring, 1.0, G), "bushing": (in_a_bushing, 0.5, 1.5 * G)}
