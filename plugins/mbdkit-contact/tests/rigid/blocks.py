"""Blocks on a floor."""

from __future__ import annotations

from typing import Any

import numpy as np

import mbdkit

G = 9.81


FLOOR = {"line": {"normal": [0.0, 1.0]}}


def run(
    model: dict[str, Any], end: float, step: float, treatment: str = "event-driven", method: str = "", **more: Any
) -> mbdkit.Run:
    method = method or ("moreau-jean" if treatment == "time-stepping" else "dop853")
    sections = {"integrator": {"name": method}, "time": {"end": end, "step": step}, "contact": {"treatment": treatment}}
    return mbdkit.run({"mbdkit": 1, "model": {"name": "mechanism"} | model}, **sections, **more)


def block(mu: float) -> dict[str, Any]:
    angle = np.radians(30.0)
    along, normal = np.array([np.cos(angle), np.sin(angle)]), [-np.sin(angle), np.cos(angle)]
    place = {"position": (0.1 * np.array(normal)).tolist(), "angle": float(angle), "velocity": (2 * along).tolist()}
    corners = [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]
    contact = {
        "bodies": ["ground", "block"], "shapes": [{"line": {"normal": normal}}, {"polygon": corners}], "friction": mu,
    }  # fmt: skip
    return {"bodies": {"block": {"mass": 1.0, "inertia": 0.1} | place}, "contacts": {"incline": contact}}


def along(found: mbdkit.Run) -> np.ndarray:
    return found["block"].position @ [np.cos(np.radians(30.0)), np.sin(np.radians(30.0))]
