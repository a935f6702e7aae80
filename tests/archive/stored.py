"""A small mechanism, and mechanisms as archives hold them."""

from __future__ import annotations

import json
from typing import Any

from mbdkit.archive.stored_mechanism import read_mechanism
from mbdkit.mechanism.mechanism import Mechanism

SHORT = {"integrator": {"name": "rk4"}, "time": {"end": 0.02, "step": 0.01}}


def swing() -> Mechanism:
    m = Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("pin", m.ground, rod, at=(0.0, 0.0))
    m.spring_damper("spring", m.ground, rod, from_=(0.0, 1.0), to=(1.0, 0.0), stiffness=10.0)
    m.marker("tip", rod, at=(1.0, 0.0))
    return m


def stored(data: dict[str, Any], bodies: tuple[str, ...] = ("rod",)) -> Any:
    return read_mechanism(json.dumps(data), bodies)
