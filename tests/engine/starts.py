"""Starts that are moved and compared."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.consistent_start import MechanismAtStart
from mbdkit.mechanism.mechanism import Mechanism


def moved(mechanism: Mechanism, rng: np.random.Generator) -> Mechanism:
    """Return a mechanism with other initial positions and velocities."""
    for name, body in list(mechanism.bodies.items()):
        position = tuple(x + float(rng.uniform(-0.01, 0.01)) for x in body.position)
        update = {"position": position, "angle": body.angle + 0.01, "angular_velocity": float(rng.uniform(-1, 1))}
        mechanism.bodies[name] = body.model_copy(update=update)
    return mechanism


def assert_same_bits(one: MechanismAtStart, other: MechanismAtStart) -> None:
    for name, mine, theirs in zip(
        one.mechanism.topology._fields, one.mechanism.topology, other.mechanism.topology, strict=True
    ):
        assert mine.tobytes() == theirs.tobytes(), name
    assert one.q0.tobytes() == other.q0.tobytes()
    assert one.v0.tobytes() == other.v0.tobytes()
    assert one.assembled.describe() == other.assembled.describe()
    for name in ("order", "below", "rows", "length", "well_scaled", "redundancy"):
        assert getattr(one.mechanism, name) == getattr(other.mechanism, name)
