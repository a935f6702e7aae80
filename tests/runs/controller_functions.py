"""Functions of controllers in Python, and a rotor that they control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbdkit import Mechanism

CALLS: list[tuple[float, dict[str, float]]] = []
"""The calls of `pd` so far: times and values."""


def pd(t: float, values: dict[str, float]) -> dict[str, float]:
    """Proportional and derivative control."""
    CALLS.append((t, values))
    return {"u": -6.0 * values["rotor.angle"] - 2.0 * values["rotor.angular_velocity"]}


def two(t: float, values: dict[str, float]) -> Mapping[str, Any]:
    return {"b": np.float64(t), "a": 1}


def raises(t: float, values: dict[str, float]) -> dict[str, float]:
    if t > 0.25:
        raise RuntimeError("the sensor is lost")
    return {"u": 0.5}


def raises_at_once(t: float, values: dict[str, float]) -> dict[str, float]:
    raise RuntimeError("no sensor")


def nothing(t: float, values: dict[str, float]) -> Any:
    return None if t > 0.25 else {"u": 0.0}


def not_a_number(t: float, values: dict[str, float]) -> Any:
    return {"u": float("nan") if t > 0.25 else 0.0}


def text(t: float, values: dict[str, float]) -> Any:
    return {"u": "1"}


def array(t: float, values: dict[str, float]) -> Any:
    return {"u": np.ones(2)}


def huge(t: float, values: dict[str, float]) -> Any:
    return {"u": 10**400}


def longer_than_python_prints(t: float, values: dict[str, float]) -> Any:
    return {"u": 10**5000}


def interrupting(t: float, values: dict[str, float]) -> Any:
    raise KeyboardInterrupt("stop")


def unreadable(t: float, values: dict[str, float]) -> Any:
    class Outputs(dict[str, float]):
        def __getitem__(self, name: str) -> float:
            raise RuntimeError("no values")

    return Outputs(u=1.0)


def another(t: float, values: dict[str, float]) -> Any:
    return {"u": 0.0, "w": 1.0}


def lacking(t: float, values: dict[str, float]) -> Any:
    return {}


A_NUMBER = 1.0


def rotor(python: str | None = "tests.runs.controller_functions:pd", delay: float = 0.0) -> Mechanism:
    """A rotor under the control of a function or, without one, of the expressions that are equal to `pd`."""
    m = Mechanism(gravity=(0.0, 0.0))
    m.body("rotor", mass=1.0, inertia=0.5, angle=0.3, angular_velocity=-0.2)
    m.revolute("pin", m.ground, "rotor", at=(0.0, 0.0))
    keys: dict[str, Any] = {"outputs": {"u": "-6*rotor.angle - 2*rotor.angular_velocity"}}
    if python is not None:
        inputs = ("rotor.angle", "rotor.angular_velocity")
        keys = {"python": python, "inputs": inputs, "outputs": {"u": {"unit": "N m"}}}
    m.controller("pd", period=0.1, delay=delay, **keys)
    m.torque("motor", "rotor", value="controllers.pd.u")
    return m
