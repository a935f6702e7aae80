"""A pendulum whose angle is measured with noise."""

from __future__ import annotations

from typing import Any

import numpy as np
from tests.inverse_dynamics.noisy import DEVIATION

import mbdkit

T = np.linspace(0.0, 1.0, 101)


def pendulum(**motion: Any) -> dict[str, Any]:
    """Return the spec of a pendulum, whose angle is measured in degrees with noise."""
    m = mbdkit.Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, position=(0.0, -0.5))
    m.revolute("hip", m.ground, "rod", at=(0, 0))
    noise = np.degrees(DEVIATION) * np.random.default_rng(3).standard_normal(len(T))
    data = {"time": T, "hip": np.degrees(0.5 * np.sin(3 * T)) + noise}
    column = {"column": "hip", "unit": "deg"}
    return {"mbdkit": 1, "model": m.to_spec(), "motion": {"data": data, "columns": {"hip.angle": column}, **motion}}
