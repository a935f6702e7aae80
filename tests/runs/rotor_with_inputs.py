"""A rotor whose torque is an input, and its closed form."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from mbdkit import Mechanism

INERTIA = 0.5
ON_GRID = ((-0.2, 0.1, 0.3, 0.7), (3.0, 1.0, -2.0, 0.5))
OFF_GRID = ((0.0, 0.1234, 0.4321, 0.777), (1.0, -1.5, 2.0, 0.5))
LONG = ((-0.5, 0.25, 0.61, 1.7), (1.0, -2.0, 0.5, 4.0))
TABLES = (ON_GRID, OFF_GRID, LONG)


def rotor(hold: str = "zero", gravity: float = 0.0) -> Mechanism:
    """A body on a pin, with its centre of mass 0.2 m away from it if there is gravity, and a torque as an input."""
    m = Mechanism(gravity=(0.0, -gravity))
    m.body("rotor", mass=1.0, inertia=INERTIA, position=(0.2 if gravity else 0.0, 0.0))
    m.revolute("pin", m.ground, "rotor", at=(0.0, 0.0))
    m.input("torque", unit="N m", initial=0.25, hold=hold)
    m.torque("motor", "rotor", value="inputs.torque")
    return m


def pieces(table: Any, hold: str, end: float = 1.0, initial: float = 0.25) -> list[tuple[float, float, float, float]]:
    """Return begin, end, first value and rate of each piece of an input in a run from 0 s on."""
    times, values = table
    inner = [t for t in times if 0.0 < t < end]
    found = []
    for a, b in itertools.pairwise([0.0, *inner, end]):
        k = int(np.searchsorted(times, a, side="right")) - 1
        is_ramp = hold == "linear" and 0 <= k < len(times) - 1
        slope = (values[k + 1] - values[k]) / (times[k + 1] - times[k]) if is_ramp else 0.0
        value = initial if k < 0 else values[k] + slope * (a - times[k])
        found.append((a, b, value, slope))
    return found


def exact_rotor(table: Any, hold: str, end: float = 1.0) -> tuple[float, float]:
    """Return angle and angular velocity at the end: the torque is constant or linear in each piece."""
    angle = speed = 0.0
    for a, b, value, slope in pieces(table, hold, end):
        h = b - a
        angle += speed * h + value / INERTIA * h**2 / 2 + slope / INERTIA * h**3 / 6
        speed += value / INERTIA * h + slope / INERTIA * h**2 / 2
    return angle, speed


def given(table: Any) -> dict[str, Any]:
    return {"torque": {"table": [list(column) for column in table]}}
