"""Test problems as models of a spec, most of them in ``trial_models.yaml``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import yaml

Model = dict[str, Any]


def _rod(length: float, mass: float, angle: float, start: list[float], speed: list[float], rate: float) -> Model:
    """Return a uniform rod that rotates at `rate` [rad/s]; its left end is at `start` and moves at `speed`."""
    c, s, r = math.cos(angle), math.sin(angle), length / 2
    return {
        "mass": mass,
        "inertia": mass * length**2 / 12,
        "position": [start[0] + r * c, start[1] + r * s],
        "angle": angle,
        "velocity": [speed[0] - r * s * rate, speed[1] + r * c * rate],
        "angular_velocity": rate,
    }


def _with_rods(model: Model) -> Model:
    """Return a model of the file as that of a spec: rods become bodies."""
    ends: dict[str, tuple[list[float], list[float]]] = {"": ([0.0, 0.0], [0.0, 0.0])}
    bodies: dict[str, Model] = {}
    for name, body in model["bodies"].items():
        if "length" not in body:
            bodies[name] = body
            continue
        start, speed = ends[body.get("after", "")]
        start, length, angle, rate = body.get("start", start), body["length"], body["angle"], body.get("rate", 0.0)
        bodies[name] = _rod(length, body["mass"], angle, start, speed, rate)
        c, s = length * math.cos(angle), length * math.sin(angle)
        ends[name] = [start[0] + c, start[1] + s], [speed[0] - s * rate, speed[1] + c * rate]
    return {"name": "mechanism", "forces": {}, **model, "bodies": bodies}


_FILE = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))
RESTING: dict[str, Model] = {name: _with_rods(model) for name, model in _FILE.pop("RESTING").items()}
_MODELS: dict[str, Model] = {name: _with_rods(model) for name, model in _FILE.items()}
FORCED_PENDULUM = _MODELS["FORCED_PENDULUM"]
LAGGING_PENDULUM = _MODELS["LAGGING_PENDULUM"]
DRIVEN_PENDULUM = _MODELS["DRIVEN_PENDULUM"]
FOUR_BAR = _MODELS["FOUR_BAR"]
BEAM = _MODELS["BEAM"]
SWINGING = _MODELS["SWINGING"]
FREE_FOUR_BAR = _MODELS["FREE_FOUR_BAR"]
ORBIT = _MODELS["ORBIT"]
HARMONIC = _MODELS["HARMONIC"]
FLOATING = _MODELS["FLOATING"]
SLIPPING = _MODELS["SLIPPING"]
FLOATING_RODS = _MODELS["FLOATING_RODS"]
COASTING = _MODELS["COASTING"]
NO_NUMBER = _MODELS["NO_NUMBER"]
OUT_OF_REACH = _MODELS["OUT_OF_REACH"]
CANNOT_MEET = _MODELS["CANNOT_MEET"]
COASTING_BODY = _MODELS["COASTING_BODY"]
WITH_STATE = _MODELS["WITH_STATE"]
#: Closed form of the state of `WITH_STATE` after 1 s.
LAG_AT_1 = (2.0 * math.cos(3.0) + 3.0 * math.sin(3.0)) / 13.0 + (0.5 - 2.0 / 13.0) * math.exp(-2.0)


def forced_pendulum(start: float) -> Model:
    """Return the forced pendulum with forces that begin at the time `start` [s] instead of 0."""
    if not start:
        return FORCED_PENDULUM
    forces = json.dumps(FORCED_PENDULUM["forces"]).replace("*t)", f"*(t - {start:g}))")
    return {**FORCED_PENDULUM, "forces": json.loads(forces)}


def pushed(power: int) -> Model:
    """Return a point mass of 1 kg under the force ``t**power`` along x: its motion is a polynomial."""
    force = {"type": "force", "body": "mass", "point": [0.0, 0.0], "value": [f"t**{power}" if power else "1", "0"]}
    return {**{key: WITH_STATE[key] for key in ("name", "gravity", "bodies")}, "forces": {"push": force}}


def oscillators(frequency: float, damping: tuple[float, ...], deflection: float = 1.0) -> Model:
    """Return masses of 1 kg, each `deflection` [m] from its equilibrium at x = 1 m on a linear spring along x, of one
    undamped frequency [rad/s] and of the given damping ratios.
    """
    linear = {"type": "law", "law": "mbdkit:linear", "stiffness": frequency**2, "free_length": 1.0}
    bodies, forces = dict[str, Model](), dict[str, Model]()
    for i, ratio in enumerate(damping):
        pathway = {"type": "coordinate", "coordinate": "x", "bodies": ["ground", f"mass{i}"]}
        bodies[f"mass{i}"] = {"mass": 1.0, "position": [1.0 + deflection, 0.0]}
        forces[f"spring{i}"] = {**linear, "pathway": pathway, "damping": 2.0 * ratio * frequency}
    return {"name": "mechanism", "gravity": [0.0, 0.0], "bodies": bodies, "forces": forces}
