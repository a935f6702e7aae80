"""A mass that is thrown against a spring whose law holds within a range."""

from __future__ import annotations

from typing import Any

FREE = {"table": [[-3.0, 0.45], [0.0, 0.0]], "law": "table"}
"""A law without force that holds up to 0.45 m."""


GAUSS = {"name": "gauss", "stages": 2}


def thrown(law: dict[str, Any] | None = None, speed: float = 3.0, **sections: Any) -> dict[str, Any]:
    """Return the spec of a mass that is thrown upwards, whose height is the length of a law."""
    pathway = {"type": "coordinate", "coordinate": "y", "bodies": ["ground", "mass"]}
    model = {
        "name": "mechanism",
        "bodies": {"mass": {"mass": 1.0, "position": [0.0, 0.0], "velocity": [0.0, speed]}},
        "forces": {"spring": {"type": "law", "pathway": pathway, **(law or FREE)}},
    }
    return {"mbdkit": 1, "model": model, "integrator": GAUSS, "time": {"end": 0.6, "step": 0.04}} | sections
