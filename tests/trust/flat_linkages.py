"""A parallelogram that starts near its flat position."""

from __future__ import annotations

from typing import Any

import numpy as np

import mbdkit
from tests.trust.mechanisms import spec


def angle_between_cranks(run: mbdkit.Run, n: int) -> float:
    """Return the largest difference between the angles of two cranks of n linkages [rad]."""
    cranks = run.dataset("trajectory/position")[:, : n + 1, 2]
    return float(np.max(np.abs(cranks - cranks[:, :1])))


def flat_linkage(n: int, integrator: dict[str, Any], step: float | None = None, **more: Any) -> mbdkit.Run:
    """Run n linkages, which are flat twice in every turn, for ten seconds."""
    model = {"name": "n-four-bar", "n": n, **more.pop("model", {})}
    return mbdkit.run(spec(model, integrator, 10.0, step, limits={"wall_time": 30.0}, **more))
