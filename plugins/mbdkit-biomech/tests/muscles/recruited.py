"""Specs of inverse dynamics of the leg of `leg.py`, with exact derivatives of its motion."""

from typing import Any

import numpy as np
from tests.muscles import leg
from tests.muscles.models import leg_mechanism


def leg_spec(muscles: tuple[str, ...] = leg.RECRUITED, *, changed: dict[str, Any] | None = None, **recruitment: Any):
    """Return the spec of the motion of `leg.motion`; `changed` are properties of all muscles."""
    m = leg_mechanism(**({"pennation": 0.0, "curves": "millard"} | (changed or {})))
    m.muscles = {name: m.muscles[name] for name in muscles}
    time, angles = leg.motion()
    phase, w = 2 * np.pi * time / 0.8, 2 * np.pi / 0.8
    rates = 0.25 * w * np.cos(phase), -0.45 * w * np.sin(phase)
    accelerations = -0.25 * w**2 * np.sin(phase), -0.45 * w**2 * np.cos(phase)
    data: dict[str, list[float]] = {"time": time.tolist()}
    columns = {}
    for index, name in enumerate(("hip", "knee")):
        for key, values in (("", angles[:, index]), ("_rate", rates[index]), ("_acceleration", accelerations[index])):
            data[name + key] = values.tolist()
        columns[f"{name}.angle"] = {"column": name, "rate": f"{name}_rate", "acceleration": f"{name}_acceleration"}
    motion = {"data": data, "columns": columns}
    return {"mbdkit": 1, "model": m.to_spec(), "motion": motion, "recruitment": recruitment}
