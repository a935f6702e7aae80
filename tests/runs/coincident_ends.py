"""A mass that passes the anchor of its spring."""

from __future__ import annotations

from typing import Any

import mbdkit

G, K, SPEED = 9.81, 40.0, 6.0


def passing(free_length: float, x: float = 0.0) -> dict[str, Any]:
    """Return the spec of a mass of 1 kg that is thrown up past the anchor of its spring, at the distance `x`."""
    m = mbdkit.Mechanism()
    m.body("mass", mass=1.0, position=(x, -0.5), velocity=(0.0, SPEED))
    m.spring_damper("spring", m.ground, "mass", points=((0, 0), (0, 0)), stiffness=K, free_length=free_length)
    method = {"name": "gauss", "stages": 2}
    return {"mbdkit": 1, "model": m.to_spec(), "integrator": method, "time": {"end": 0.3, "step": 0.002}}
