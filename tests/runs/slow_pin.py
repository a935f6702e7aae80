"""A body on a pin that turns slowly."""

from __future__ import annotations

from typing import Any


def pin(transition: float, step: float = 0.005) -> dict[str, Any]:
    """Return the spec of a body that turns in a pin of 8 mm at 1 rad/s, loaded with 800 N through the pin."""
    friction = {"coefficient": 0.1, "radius": 0.008, "transition_speed": transition}
    return {
        "mbdkit": 1,
        "model": {
            "name": "mechanism",
            "gravity": [0, 0],
            "bodies": {"leg": {"mass": 4, "inertia": 0.46, "position": [0, 0], "angular_velocity": 1.0}},
            "joints": {"knee": {"type": "revolute", "bodies": ["ground", "leg"], "at": [0, 0], "friction": friction}},
            "forces": {"push": {"type": "force", "body": "leg", "at": [0, 0], "value": [0, -800]}},
        },
        "integrator": {"name": "radau-iia"},
        "time": {"end": 5.0, "step": step},
    }
