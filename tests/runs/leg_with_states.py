"""A leg with a state and a controlled rotor."""

from __future__ import annotations

from typing import Any

from mbdkit import Mechanism

INERTIA, STIFFNESS, DAMPING, LAG = 0.17, 40.0, 3.0, 0.05
"""A leg of 3 kg on a hip 0.2 m above its centre of mass; gains of its controller, and the time constant of a filter."""


def leg(value: str = "-Kp*(leg.angle - 0.5*sin(2*t)) - Kd*leg.angular_velocity + states.i") -> dict[str, Any]:
    """A leg under proportional and derivative control, with a filtered angle as a state."""
    return {
        "name": "mechanism",
        "bodies": {"leg": {"mass": 3.0, "inertia": 0.05, "position": [0.0, -0.2]}},
        "joints": {"hip": {"type": "revolute", "bodies": ["ground", "leg"], "points": [[0, 0], [0, 0.2]]}},
        "forces": {"motor": {"type": "torque", "body": "leg", "value": value}},
        "states": {"i": {"rate": "(bodies.leg.angle - states.i)/lag", "initial": 0.1, "unit": "N m"}},
    }


def spec_of(integrator: dict[str, Any], step: float | None = 0.01, **more: Any) -> dict[str, Any]:
    time = {"end": 0.5} if step is None else {"end": 0.5, "step": step}
    parameters = {"Kp": STIFFNESS, "Kd": DAMPING, "lag": LAG}
    return {"mbdkit": 1, "parameters": parameters, "model": leg(), "integrator": integrator, "time": time} | more


def rotor(delay: float) -> Mechanism:
    """A rotor under a sampled controller with an integral part."""
    m = Mechanism(gravity=(0, 0))
    m.body("rotor", mass=1, inertia=0.5, angle=0.3)
    m.revolute("pin", m.ground, "rotor", at=(0, 0))
    m.controller(
        "pid", period=0.02, delay=delay,
        outputs={"u": "-6*rotor.angle - 2*rotor.angular_velocity - controllers.pid.sum"},
        states={"sum": {"initial": 0.1, "next": "controllers.pid.sum + 0.1*rotor.angle"}},
    )  # fmt: skip
    m.torque("motor", "rotor", value="controllers.pid.u")
    return m
