"""A slider-crank mechanism with parameters."""

from __future__ import annotations

from math import pi, sqrt
from typing import Any

SLIDER_CRANK: dict[str, Any] = {
    "mbdkit": 1, "parameters": {"k": 1.0, "c": 1.0},
    "model": {
        "name": "mechanism", "gravity": [0.0, 0.0],
        "bodies": {
            "crank": {"mass": 1.0, "inertia": 1.0, "position": [0.0, 0.0], "angle": pi / 2},
            "rod": {"mass": 1.0, "inertia": 2.0, "position": [sqrt(3) / 2, 0.0], "angle": -pi / 6},
        },
        "joints": {
            "A": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0, 0], [0, 0]]},
            "B": {"type": "revolute", "bodies": ["crank", "rod"], "points": [[0.5, 0], [-1, 0]]},
            "C": {"type": "point-on-line", "bodies": ["ground", "rod"], "points": [[0, 0], [0, 0]], "axis": [1, 0]},
        },
        "forces": {
            "s": {
                "type": "spring-damper", "bodies": ["crank", "rod"], "points": [[0.25, 0], [-0.5, 0]], "stiffness": "k",
                "damping": "c", "free_length": 1.0,
            },
            "f": {"type": "force", "body": "rod", "point": [1, 0], "value": [1.0, 0.0]},
        },
    },
}  # fmt: skip
"""The slider-crank of SUNDIALS, example idasSlCrank_FSA_dns."""
