"""An eccentric wheel that rolls."""

from __future__ import annotations

import math
from typing import Any

R, E, M, J, G = 0.3, 0.12, 2.0, 0.05, 9.81


START, SPEED = 0.4, 3.0


def wheel() -> dict[str, Any]:
    """Return the eccentric wheel at its start."""
    c, s = math.cos(START), math.sin(START)
    body = {
        "mass": M, "inertia": J, "position": [-R * START + E * c, E * s], "angle": START,
        "velocity": [(-R - E * s) * SPEED, E * c * SPEED], "angular_velocity": SPEED,
    }  # fmt: skip
    joint = {
        "type": "revolute", "bodies": ["ground", "wheel"], "points": [[0, 0], [-E, 0]],
        "center": {"x": f"-{R}*angle"},
    }  # fmt: skip
    return {"name": "mechanism", "bodies": {"wheel": body}, "joints": {"rolls": joint}}
