"""Mechanisms with a known fault: drivers that part, motions with corners, springs that steps overturn."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import Any


def two_cranks(second: str, first: str = "0.7+0.5*t") -> dict[str, Any]:
    """Return a parallelogram whose two cranks of 1 m, 2 m apart, are both driven."""
    rest = {"mass": 1.0, "inertia": 0.1}
    bodies = {
        "c0": {**rest, "position": [0.38242109364224425, 0.3221088436188455], "angle": 0.7},
        "c1": {**rest, "position": [2.382421093642244, 0.3221088436188455], "angle": 0.7},
        "k": {**rest, "position": [1.7648421872844886, 0.644217687237691]},
    }
    pins = {
        "A0": (["ground", "c0"], [[0.0, 0.0], [-0.5, 0.0]]),
        "B0": (["c0", "k"], [[0.5, 0.0], [-1.0, 0.0]]),
        "A1": (["ground", "c1"], [[2.0, 0.0], [-0.5, 0.0]]),
        "B1": (["c1", "k"], [[0.5, 0.0], [1.0, 0.0]]),
    }
    joints: dict[str, Any] = {
        name: {"type": "revolute", "bodies": held, "points": points} for name, (held, points) in pins.items()
    }
    for name, crank, motion in (("d1", "c0", first), ("d2", "c1", second)):
        joints[name] = {"type": "driver", "bodies": ["ground", crank], "coordinate": "angle", "motion": motion}
    return {"name": "mechanism", "bodies": bodies, "joints": joints}


def cranks(bases: Sequence[float], angle: float = -2.3, rate: float = 0.4, length: float = 1.2) -> dict[str, Any]:
    """Return parallel cranks pinned to the ground at `bases` and to one coupler from the first to the second of them.

    Each crank more than two is redundant: its upper pin adds one constraint row that follows from the others.
    """
    e, along = (math.cos(angle), math.sin(angle)), (-math.sin(angle), math.cos(angle))
    middle = bases[1] / 2
    swing = [length * rate * x for x in along]
    bodies: dict[str, Any] = {
        "coupler": {
            "mass": 2.0, "inertia": 0.6, "position": [middle + length * e[0], length * e[1]], "velocity": swing,
        }
    }  # fmt: skip
    joints: dict[str, Any] = {}
    for i, base in enumerate(bases):
        bodies[f"crank{i}"] = {
            "mass": 1.0 + 0.2 * i, "inertia": 0.12, "position": [base + length / 2 * e[0], length / 2 * e[1]],
            "angle": angle, "velocity": [x / 2 for x in swing], "angular_velocity": rate,
        }  # fmt: skip
        for name, held, points in (
            (f"foot{i}", ["ground", f"crank{i}"], [[base, 0.0], [-length / 2, 0.0]]),
            (f"top{i}", [f"crank{i}", "coupler"], [[length / 2, 0.0], [base - middle, 0.0]]),
        ):
            joints[name] = {"type": "revolute", "bodies": held, "points": points}
    return {"name": "mechanism", "bodies": bodies, "joints": joints}


def guided_tip(y: str) -> dict[str, Any]:
    """Return a rod of 1 m on a pin whose tip is driven in x and in y; on the circle only if `y` is sin(t + 0.3)."""
    drivers = {"X": ("x", "cos(t+0.3)"), "Y": ("y", y)}
    joints: dict[str, Any] = {"A": {"type": "revolute", "bodies": ["ground", "c"], "points": [[0, 0], [-0.5, 0]]}}
    for name, (coordinate, motion) in drivers.items():
        joints[name] = {
            "type": "driver", "bodies": ["ground", "c"], "coordinate": coordinate, "motion": motion,
            "points": [[0, 0], [0.5, 0]],
        }  # fmt: skip
    return {"name": "mechanism", "bodies": {"c": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0]}}, "joints": joints}


def spec(model: Any, integrator: dict[str, Any], end: float, step: float | None = None, **more: Any) -> dict[str, Any]:
    """Return a run spec."""
    time = {"end": end} if step is None else {"end": end, "step": step}
    return copy.deepcopy({"mbdkit": 1, "model": model, "integrator": integrator, "time": time, **more})
