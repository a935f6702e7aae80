"""A pendulum whose angle is measured in a table."""

from __future__ import annotations

from typing import Any

import mbdkit


def pendulum(file: str, **motion: Any) -> dict[str, Any]:
    """Return the spec of a pendulum whose angle is the column ``hip`` of a table."""
    m = mbdkit.Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.body("toy", mass=1.0, inertia=0.1, position=(1.0, 0.0))
    m.revolute("hip", m.ground, "rod", at=(0, 0))
    m.weld("glue", "rod", "toy", at=(1, 0))
    m.marker("tip", "rod", point=(0.5, 0.0))
    given = {"file": file, "columns": {"hip.angle": "hip"}, **motion}
    return {"mbdkit": 1, "model": m.to_spec(), "motion": given}
