"""A rotor whose events set states, and its motion in closed form."""

from __future__ import annotations

import math
from typing import Any

INERTIA, END = 0.5, 5.0


FIRES = {"fires": {"when": "states.charge - 1", "direction": "rising", "set": {"charge": 0}}}


def rotor(**states: Any) -> dict[str, Any]:
    """A rotor without gravity; its torque is the first of the states."""
    return {
        "name": "mechanism",
        "gravity": [0, 0],
        "bodies": {"rotor": {"mass": 1.0, "inertia": INERTIA}},
        "joints": {"pin": {"type": "revolute", "bodies": ["ground", "rotor"], "points": [[0, 0], [0, 0]]}},
        "forces": {"motor": {"type": "torque", "body": "rotor", "value": f"states.{next(iter(states))}"}},
        "states": states,
    }


def spec_of(integrator: dict[str, Any], step: float | None = None, **more: Any) -> dict[str, Any]:
    """A charge with charge' = 2 - charge from 0, which is taken when it reaches 1: every ln 2 seconds."""
    time = {"end": END} | ({} if step is None else {"step": step})
    model = rotor(charge={"rate": "2 - states.charge"})
    return {"mbdkit": 1, "model": model, "integrator": integrator, "time": time, "events": FIRES} | more


def exact() -> tuple[float, float]:
    """Charge and angular velocity at the end."""
    periods = math.floor(END / math.log(2))
    rest = END - periods * math.log(2)
    turned = periods * (2 * math.log(2) - 1) + 2 * rest - 2 * (1 - math.exp(-rest))
    return 2 - 2 * math.exp(-rest), turned / INERTIA
