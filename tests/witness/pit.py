"""Circles that fall into a pit: a spec for time-stepping methods with many contacts."""

from __future__ import annotations

from typing import Any

import numpy as np

RADIUS = 0.05


def pit(columns: int, rows: int, seed: int = 1) -> dict[str, Any]:
    """Return a run spec of circles of 1 kg above the floor of a pit that is a little wider than a row of them."""
    rng = np.random.default_rng(seed)
    bodies = {
        f"circle{i}-{j}": {
            "mass": 1.0,
            "inertia": 0.5 * RADIUS**2,
            "position": [
                float((i - (columns - 1) / 2) * 2.06 * RADIUS + 0.01 * RADIUS * rng.standard_normal()),
                1.02 * RADIUS + j * 2.06 * RADIUS,
            ],
        }
        for j in range(rows)
        for i in range(columns)
    }
    half = columns * 1.05 * RADIUS
    walls = {"floor": ([0.0, 0.0], [0.0, 1.0]), "left": ([-half, 0.0], [1.0, 0.0]), "right": ([half, 0.0], [-1.0, 0.0])}
    circle = {"circle": {"radius": RADIUS}}
    contacts: dict[str, Any] = {
        f"{wall}-{name}": {
            "bodies": ["ground", name],
            "shapes": [{"line": {"point": point, "normal": normal}}, circle],
            "friction": 0.3,
        }
        for wall, (point, normal) in walls.items()
        for name in bodies
    }
    contacts["circles"] = {"among": list(bodies), "shapes": dict.fromkeys(bodies, circle), "friction": 0.3}
    return {
        "mbdkit": 1,
        "model": {"name": "mechanism", "bodies": bodies, "contacts": contacts},
        "integrator": {"name": "moreau-jean"},
        "contact": {"treatment": "time-stepping"},
        "time": {"end": 1.0, "step": 0.001},
    }
