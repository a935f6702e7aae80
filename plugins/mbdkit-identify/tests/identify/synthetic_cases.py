"""Models with known parameters whose data are simulated, for tests of estimates and intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from mbdkit import load_spec


@dataclass(frozen=True)
class SyntheticCase:
    """A model with true parameters, and how it is observed.

    Attributes
    ----------
    base
        Spec of the run with the true parameters; samples are at the ends of its steps.
    deviations
        Standard deviation of the noise by observed quantity, in SI units or in the unit of the sensor.
    starts
        Start of the search of each parameter, relative to the true value.
    initial
        Initial state of the experiment; by default, that of the base.
    sensors
        Sensors by quantity.
    of_sensors
        True values of parameters that only sensors have.
    """

    base: dict[str, Any]
    deviations: Mapping[str, float]
    starts: Mapping[str, float]
    initial: Any = None
    sensors: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    of_sensors: Mapping[str, float] = field(default_factory=dict)

    @property
    def truth(self) -> dict[str, float]:
        """True values of the parameters."""
        return {**self.base["parameters"], **self.of_sensors}

    def spec(self, file: str, method: str) -> dict[str, Any]:
        """Return the spec of the identification from a file with the columns `time`, `0`, `1` and so on."""
        experiment = {"file": file, "observed": {name: str(i) for i, name in enumerate(self.deviations)}}
        if self.initial is not None:
            experiment["initial"] = self.initial
        return {
            "mbdkit_identify": 1, "base": self.base, "experiments": {"record": experiment},
            "parameters": {name: {"start": share * self.truth[name]} for name, share in self.starts.items()},
            "sensors": dict(self.sensors), "intervals": {"method": method},
        }  # fmt: skip


def _base(parameters: dict[str, float], end: float, step: float, model: dict[str, Any], **sections: Any) -> Any:
    return {
        "mbdkit": 1, "parameters": parameters, "model": {"name": "mechanism", **model},
        "integrator": {"name": "rk4"}, "time": {"end": end, "step": step}, **sections,
    }  # fmt: skip


def _pin(coefficient: str) -> dict[str, Any]:
    return {"coefficient": coefficient, "radius": 0.05}


def double_pendulum() -> SyntheticCase:
    """A double pendulum with viscous and Coulomb friction in both joints, whose initial state is unknown."""
    model = {
        "bodies": {
            "a": {"mass": 1.0, "inertia": 0.08, "position": [0.5, 0]},
            "b": {"mass": 0.8, "inertia": 0.07, "position": [1.5, 0]},
        },
        "joints": {
            "hub": {"type": "revolute", "bodies": ["ground", "a"], "at": [0, 0], "friction": _pin("mu1")},
            "elbow": {"type": "revolute", "bodies": ["a", "b"], "at": [1.0, 0], "friction": _pin("mu2")},
        },
        "forces": {
            "hub": {"type": "torsion-spring", "bodies": ["ground", "a"], "damping": "c1"},
            "elbow": {"type": "torsion-spring", "bodies": ["a", "b"], "damping": "c2"},
        },
    }
    values = {"c1": 0.4, "mu1": 0.5, "c2": 0.2, "mu2": 0.4}
    starts = {"c1": 0.6, "mu1": 1.3, "c2": 1.4, "mu2": 0.7}
    return SyntheticCase(
        _base(values, 3.0, 0.015, model), {"a.angle": 0.005, "b.angle": 0.005}, starts, initial="estimated"
    )


def slider_crank() -> SyntheticCase:
    """A slider-crank driven by a torque, whose crank has an encoder with an unknown offset."""
    model = {
        "gravity": [0, 0],
        "bodies": {
            "crank": {"mass": 1.0, "inertia": 0.01, "position": [0.1, 0]},
            "rod": {"mass": 0.8, "inertia": 0.03, "position": [0.45, 0]},
            "slider": {"mass": "m", "inertia": 0.02, "position": [0.8, 0]},
        },
        "joints": {
            "bearing": {"type": "revolute", "bodies": ["ground", "crank"], "at": [0, 0]},
            "crank pin": {"type": "revolute", "bodies": ["crank", "rod"], "at": [0.2, 0]},
            "wrist pin": {"type": "revolute", "bodies": ["rod", "slider"], "at": [0.8, 0]},
            "guide": {"type": "prismatic", "bodies": ["ground", "slider"], "at": [0.8, 0], "axis": [1, 0]},
        },
        "forces": {
            "drive": {"type": "torque", "body": "crank", "value": "0.4 + 0.2*sin(5*t)"},
            "bearing": {"type": "torsion-spring", "bodies": ["ground", "crank"], "damping": "c"},
        },
    }
    return SyntheticCase(
        _base({"m": 0.5, "c": 0.02}, 1.6, 0.008, model),
        {"crank.angle": 2.0},
        {"m": 1.4, "c": 0.6, "zero": 0.5},
        sensors={"crank.angle": {"gain": 1000 / (2 * np.pi), "offset": "zero"}},
        of_sensors={"zero": 40.0},
    )


def knee() -> SyntheticCase:
    """A lower leg on a four-bar knee, with a pad of an exponential law between thigh and shank."""
    model = load_spec("knee", ()).mechanism().to_spec()
    points = model["forces"]["support"]["points"]
    model["forces"] = {
        "tissue": {"type": "torsion-spring", "bodies": ["ground", "shank"], "damping": "c"},
        "pad": {
            "type": "law", "law": "exponential", "scale": "F", "growth": "g", "free_length": 0.38,
            "acts": "compression", "pathway": {"type": "two-points", "bodies": ["ground", "shank"], "points": points},
        },
    }  # fmt: skip
    return SyntheticCase(
        _base({"F": 8.0, "g": 30.0, "c": 0.6}, 2.0, 0.01, model),
        {"shank.angle": 0.005},
        {"F": 1.3, "g": 0.75, "c": 1.4},
    )


def motor() -> SyntheticCase:
    """A motor at a known voltage, whose current is a state; current and speed are measured."""
    model = {
        "gravity": [0, 0],
        "bodies": {"rotor": {"mass": 1.0, "inertia": "J", "position": [0, 0]}},
        "joints": {"shaft": {"type": "revolute", "bodies": ["ground", "rotor"], "at": [0, 0]}},
        "forces": {
            "motor": {"type": "torque", "body": "rotor", "value": "K*states.i - b*rotor.angular_velocity"},
        },
        "states": {
            "i": {
                "rate": "(6 + 4*sin(12*t) - R*states.i - K*rotor.angular_velocity)/0.05",
                "initial": 0.0,
                "unit": "A",
            }
        },
    }
    return SyntheticCase(
        _base({"R": 1.0, "K": 0.5, "J": 0.02, "b": 0.01}, 1.5, 0.01, model),
        {"states.i": 0.1, "rotor.angular_velocity": 0.2},
        {"R": 1.4, "K": 0.7, "J": 1.3, "b": 0.6},
    )


def beam() -> SyntheticCase:
    """A cantilever that is released under its weight, with unknown bending stiffness and damping."""
    section = {"axial": 2e4, "shear": "none", "bending": "EI"}
    model = {
        "beams": {
            "blade": {
                "a": [0, 0], "b": [0.5, 0], "elements": 3, "nodes": 3, "stiffness": section,
                "mass_per_length": 0.4, "rotary_inertia": 1e-6, "damping": "tau",
            }
        },
        "joints": {"clamp": {"type": "weld", "bodies": ["ground", "blade.0"], "at": [0, 0]}},
        "markers": {"tip": {"body": "blade.last"}},
    }  # fmt: skip
    base = _base({"EI": 2.0, "tau": 0.01}, 1.6, 0.008, model, integrator={"name": "radau-iia", "stages": 2})
    return SyntheticCase(base, {"markers.tip.y": 5e-4}, {"EI": 1.2, "tau": 0.5})


def ball() -> SyntheticCase:
    """A ball that is dropped from an unknown height and bounces with an unknown coefficient of restitution."""
    floor = {"line": {"normal": [0, 1]}}
    model = {
        "bodies": {"ball": {"mass": 1.0, "inertia": 0.004, "position": [0, "h"]}},
        "contacts": {
            "floor": {"bodies": ["ground", "ball"], "shapes": [floor, {"circle": {"radius": 0.1}}], "restitution": "e"}
        },
    }
    base = _base({"e": 0.8, "h": 0.6}, 1.2, 0.006, model, contact={"treatment": "event-driven"})
    return SyntheticCase(base, {"ball.y": 0.002}, {"e": 0.75, "h": 1.2})


@cache
def synthetic_cases() -> dict[str, SyntheticCase]:
    """Return the cases by name."""
    return {
        "double-pendulum": double_pendulum(), "slider-crank": slider_crank(), "knee": knee(), "motor": motor(),
        "beam": beam(), "ball": ball(),
    }  # fmt: skip
