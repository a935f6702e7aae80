"""Mechanisms with rigid contacts that several tests use, and their runs."""

from __future__ import annotations

from typing import Any

import numpy as np

import mbdkit

G = 9.81
FLOOR = {"line": {"normal": [0.0, 1.0]}}


def run(
    model: dict[str, Any],
    end: float,
    step: float | None = None,
    treatment: str = "event-driven",
    method: str | dict[str, Any] = "",
    **sections: Any,
) -> mbdkit.Run:
    """Return the run of a model by a method (its name, or with options); one that suits the treatment by default."""
    method = method or ("moreau-jean" if treatment == "time-stepping" else "dop853")
    given = {
        "integrator": {"name": method} if isinstance(method, str) else method,
        "time": {"end": end} if step is None else {"end": end, "step": step},
        "contact": {"treatment": treatment},
    }
    return mbdkit.run({"mbdkit": 1, "model": {"name": "mechanism"} | model}, **given | sections)


def outline(half_width: float, half_height: float) -> dict[str, Any]:
    """Return a rectangle around the origin."""
    b, h = half_width, half_height
    return {"polygon": [[-b, -h], [b, -h], [b, h], [-b, h]]}


def ball(e: float) -> dict[str, Any]:
    """Return a ball that falls on a floor from 1 m, with a coefficient of restitution."""
    contact = {"bodies": ["ground", "ball"], "shapes": [FLOOR, {"circle": {"radius": 0.1}}], "restitution": e}
    bodies = {"ball": {"mass": 2.0, "inertia": 0.1, "position": [0.0, 1.1]}}
    return {"bodies": bodies, "contacts": {"floor": contact}}


def block(mu: float) -> dict[str, Any]:
    """Return a block that slides up an incline of 30 degrees with 2 m/s."""
    angle = np.radians(30.0)
    along, normal = np.array([np.cos(angle), np.sin(angle)]), [-np.sin(angle), np.cos(angle)]
    place = {"position": (0.1 * np.array(normal)).tolist(), "angle": float(angle), "velocity": (2 * along).tolist()}
    contact = {"bodies": ["ground", "block"], "shapes": [{"line": {"normal": normal}}, outline(0.2, 0.1)]}
    bodies = {"block": {"mass": 1.0, "inertia": 0.1} | place}
    return {"bodies": bodies, "contacts": {"incline": contact | {"friction": mu}}}
