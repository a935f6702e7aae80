"""Small mechanisms that several tests move."""

from __future__ import annotations

from typing import Any

import mbdkit


def driven_crank(corner: float) -> dict[str, Any]:
    """Return a driven crank with a rod; the crank stops at the corner."""
    return {
        "name": "mechanism",
        "bodies": {
            "crank": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]},
            "rod": {"mass": 2.0, "inertia": 0.3, "position": [1.3, 0.4], "angle": 0.9, "angular_velocity": 0.7},
        },
        "joints": {
            "A": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0, 0], [-0.5, 0]]},
            "B": {"type": "revolute", "bodies": ["crank", "rod"], "points": [[0.5, 0], [-0.5, 0]]},
            "D": {"type": "driver", "bodies": ["ground", "crank"], "coordinate": "angle",
                  "motion": f"2*min(t, {corner})"},
        },
    }  # fmt: skip


def driven_wheel() -> mbdkit.Mechanism:
    """Return a wheel with a motor, a torsion spring and a spring."""
    m = mbdkit.Mechanism()
    m.body("wheel", mass=1.0, inertia=0.5, position=(0.3, 0.0))
    m.revolute("hub", m.ground, "wheel", at=(0.0, 0.0))
    m.driver("motor", m.ground, "wheel", coordinate="angle", motion="sin(2*t)")
    m.torsion_spring("twist", m.ground, "wheel", stiffness=3.0)
    m.spring_damper("spring", m.ground, "wheel", points=((0.0, 2.0), (0.0, 0.0)), stiffness=5.0)
    return m
