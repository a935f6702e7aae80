"""Linkages that are moved as prescribed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mbdkit
from mbdkit.spec import load_spec

TORQUES = {
    "knee": {"A": "2*sin(5*t)"},
    "watt-six-bar": {"A": "4*sin(3*t)"},
    "double-wishbone": {"lower inner": "300*sin(8*t)", "guide": ""},
}
"""Torques on the joints of an example, by joint; an empty one is an actuator whose value should be zero."""


def moved(example: str, path: Path) -> tuple[mbdkit.Run, dict[str, Any]]:
    """Run an example under torques and save it; return the run, and the spec of its inverse dynamics."""
    mechanism = load_spec(example).mechanism()
    model, torques = mechanism.to_spec(), TORQUES[example]
    forces = dict(model.get("forces", {}))
    for joint, value in torques.items():
        first, second = mechanism.joints[joint].bodies
        if value:
            on = {} if first == "ground" else {"reaction_body": first}
            forces[f"on {joint}"] = {"type": "torque", "body": second, "value": value, **on}
    method = {"integrator": {"name": "gauss", "stages": 3}, "time": {"end": 0.3, "step": 0.002}}
    run = mbdkit.run({"mbdkit": 1, "model": {**model, "forces": forces}, **method})
    run.check().save(path)
    actuators = {f"on {joint}": {"joint": joint} for joint in torques}
    return run, {"mbdkit": 1, "model": model, "motion": {"file": str(path)}, "actuators": actuators}
