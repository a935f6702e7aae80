"""Planar mechanisms with contacts for `python -m tests.benchmarks contacts`, as data of the model `mechanism`.

The positions at the end are known in closed form for the sliding boxes and the pendulum. For the skew boxes and the
biped, they are those of an event-driven run with small tolerances. The discs in a pit move chaotically: they have no
reference.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ellipj, ellipk

import mbdkit
from tests.witness.pit import pit

G = 9.81
FRICTION = 0.3
RESTITUTION = 0.5
SPEED = 0.5
"""Speed of the top box of a stack [m/s]."""
FLOOR = {"line": {"normal": [0.0, 1.0]}}


@dataclass(frozen=True)
class Case:
    """A mechanism and what is measured of it.

    Attributes
    ----------
    title
        What happens, for a table.
    model
        Data of the model `mechanism`; compliant runs use the key `compliance` of its contacts, the others ignore it.
    end
        Duration [s].
    quiet
        Duration from the start in which no contact changes [s]; 0 if it is not of interest.
    reference
        Function that returns the positions (bodies, 2) at the end [m].
    witness
        Where the reference is from, for a table; "" without one.
    """

    title: str
    model: dict[str, Any]
    end: float
    quiet: float = 0.0
    reference: Callable[[], np.ndarray] | None = None
    witness: str = ""


def positions(run: mbdkit.Run, model: dict[str, Any]) -> np.ndarray:
    """Return the positions (bodies, 2) at the end of a run [m]."""
    return np.array([run.bodies[name].position[-1] for name in model["bodies"]])


def event_driven(model: dict[str, Any], end: float) -> np.ndarray:
    """Return the positions (bodies, 2) at the end of an event-driven run with small tolerances [m]."""
    run = mbdkit.run(
        {
            "mbdkit": 1,
            "model": model,
            "contact": {"treatment": "event-driven"},
            "integrator": {"name": "dop853", "adaptive": True, "rtol": 1e-11, "atol": 1e-12},
            "time": {"end": end},
            "output": {"every": 10**7, "quantities": []},
        }
    )
    assert run.status == "complete", run.status
    return positions(run, model)


def _by_events(title: str, model: dict[str, Any], end: float, quiet: float) -> Case:
    reference = functools.cache(lambda: event_driven(model, end))
    return Case(title, model, end, quiet, reference, "event-driven dop853, rtol 1e-11")


def _boxes(count: int, skew: float, gap: float) -> dict[str, Any]:
    """Return boxes of 1 kg on each other; each is 8 mm narrower than the one below, so that no corners meet."""
    bodies: dict[str, Any] = {}
    contacts: dict[str, Any] = {}
    below: tuple[str, Any] = ("ground", FLOOR)
    for i in range(count):
        half = 0.12 - 0.004 * i
        bodies[f"box{i}"] = {
            "mass": 1.0,
            "inertia": ((2.0 * half) ** 2 + 0.1**2) / 12.0,
            "position": [0.0, 0.05 + 0.1 * i + gap * (i + 1)],
            "angle": skew * (-1) ** i / (1 + 0.3 * i),
        }
        box = {"polygon": [[-half, -0.05], [half, -0.05], [half, 0.05], [-half, 0.05]]}
        contacts[f"under{i}"] = {"bodies": [below[0], f"box{i}"], "shapes": [below[1], box], "friction": FRICTION}
        below = (f"box{i}", box)
    return _mechanism(bodies, contacts)


def _mechanism(bodies: dict[str, Any], contacts: dict[str, Any], **others: Any) -> dict[str, Any]:
    compliance = {"stiffness": 1e7, "dissipation": 1.0}
    contacts = {name: {**contact, "compliance": compliance} for name, contact in contacts.items()}
    return {"name": "mechanism", "bodies": bodies, "contacts": contacts, **others}


def slide(count: int) -> Case:
    """Return a stack at rest whose top box slides on it until friction stops it, in SPEED/(FRICTION*G) = 0.17 s."""
    model = _boxes(count, 0.0, 0.0)
    model["bodies"][f"box{count - 1}"]["velocity"] = [SPEED, 0.0]

    def reference() -> np.ndarray:
        at_rest = np.array([body["position"] for body in model["bodies"].values()])
        at_rest[-1, 0] = SPEED**2 / (2.0 * FRICTION * G)
        return at_rest

    boxes = "a box slides" if count == 1 else f"{count} boxes, of which the top one slides"
    return Case(f"{boxes} and stops", model, 0.4, 0.15, reference, "closed form")


def skew(count: int) -> Case:
    """Return boxes that fall on each other from gaps of 3 cm, in turns 0.1 rad to the left and right or less."""
    end = 0.4 if count < 10 else 0.15  # s; event-driven runs of ten boxes have 30 impacts until then
    return _by_events(
        f"{count} skew box{'es' * (count > 1)} dropped by 3 cm", _boxes(count, 0.1, 0.03), end, quiet=0.04
    )


def pendulum() -> Case:
    """Return a pendulum of 1 m, released from the horizontal, that strikes a wall where it is vertical, several times.

    Between impacts, sin(angle/2) = k sn(w t, k^2) with w = sqrt(m g c / I), and k decreases by the restitution.
    """
    mass, c, inertia, radius, end = 1.0, 0.5, 1.0 / 12.0, 0.05, 4.0
    rod = {"mass": mass, "inertia": inertia, "position": [-c, 0.0], "angle": -math.pi / 2}
    model = _mechanism(
        {"rod": rod},
        {
            "wall": {
                "bodies": ["ground", "rod"],
                "shapes": [
                    {"line": {"point": [radius, 0.0], "normal": [-1.0, 0.0]}},
                    {"circle": {"center": [0.0, -c], "radius": radius}},
                ],
                "friction": 0.0,
                "restitution": RESTITUTION,
            }
        },
        joints={"pin": {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0.0, 0.0], [0.0, c]]}},
    )

    def reference() -> np.ndarray:
        w, k = math.sqrt(mass * G * c / (inertia + mass * c**2)), math.sin(math.pi / 4)
        struck = float(ellipk(k**2)) / w
        while True:
            k *= RESTITUTION
            again = struck + 2.0 * float(ellipk(k**2)) / w
            if again > end:
                break
            struck = again
        angle = -2.0 * math.asin(k * float(ellipj(w * (end - struck), k**2)[0]))
        return np.array([[c * math.sin(angle), -c * math.cos(angle)]])

    return Case("a pendulum hits a wall, restitution 0.5", model, end, 0.4, reference, "closed form")


def biped() -> Case:
    """Return a biped that takes a step: the front heel strikes, the foot becomes flat, and the rear foot rolls off.

    Torsion springs with dampers, that is PD controllers, drive hips and ankles. Each foot has two round corners.
    """
    half, ankle, corners, radius = 0.45, [-0.03, 0.05], {"heel": -0.08, "toe": 0.16}, 0.02
    angles = {"torso": 0.0, "rear": -0.05, "front": 0.30}
    rates = {"torso": 0.0, "rear": -1.2, "front": 0.6}

    def along(angle: float, rate: float, length: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the vector of a length down along a leg, and its derivative."""
        way = length * np.array([math.sin(angle), -math.cos(angle)])
        return way, rate * length * np.array([math.cos(angle), math.sin(angle)])

    height = 0.03 + radius + ankle[1]
    way, rate = along(angles["rear"], rates["rear"], 2 * half)
    hip, hip_rate = np.array([0.0, height]) - way, -rate

    def body(mass: float, inertia: float, at: np.ndarray, v: np.ndarray, angle: float, w: float) -> dict[str, Any]:
        return {
            "mass": mass,
            "inertia": inertia,
            "position": at.tolist(),
            "velocity": v.tolist(),
            "angle": angle,
            "angular_velocity": w,
        }

    bodies = {"torso": body(40.0, 2.0, hip + np.array([0.0, 0.3]), hip_rate, 0.0, 0.0)}
    joints: dict[str, Any] = {}
    forces: dict[str, Any] = {}
    contacts: dict[str, Any] = {}
    for leg, tilt, free, foot_free in (("rear", 0.0, -0.35, 0.0), ("front", 0.15, 0.35, -0.2)):
        foot, (way, rate) = f"{leg}_foot", along(angles[leg], rates[leg], 2 * half)
        bodies[leg] = body(8.0, 0.5, hip + 0.5 * way, hip_rate + 0.5 * rate, angles[leg], rates[leg])
        arm = np.array([[math.cos(tilt), -math.sin(tilt)], [math.sin(tilt), math.cos(tilt)]]) @ ankle
        bodies[foot] = body(1.5, 0.01, hip + way - arm, hip_rate + rate, tilt, 0.0)
        joints[f"{leg}_hip"] = {"type": "revolute", "bodies": ["torso", leg], "points": [[0.0, -0.3], [0.0, half]]}
        joints[f"{leg}_ankle"] = {"type": "revolute", "bodies": [leg, foot], "points": [[0.0, -half], ankle]}
        for joint, stiffness, angle in (("hip", 300.0, free), ("ankle", 150.0, foot_free)):
            pd = {"stiffness": stiffness, "damping": 0.05 * stiffness, "free_angle": angle}
            forces[f"{leg}_{joint}"] = {
                "type": "torsion-spring",
                "bodies": joints[f"{leg}_{joint}"]["bodies"],
                **pd,
            }
        for corner, x in corners.items():
            circle = {"circle": {"center": [x, -0.03], "radius": radius}}
            contacts[f"{leg}_{corner}"] = {"bodies": ["ground", foot], "shapes": [FLOOR, circle], "friction": 0.8}
    return _by_events("a biped takes a step", _mechanism(bodies, contacts, joints=joints, forces=forces), 0.6, 0.2)


def discs() -> Case:
    """Return 100 discs that fall into a pit."""
    model = pit(10, 10)["model"]
    return Case("100 discs in a pit", _mechanism(model["bodies"], model["contacts"]), 0.3)


CASES: dict[str, Callable[[], Case]] = {
    **{f"slide-{count}": functools.partial(slide, count) for count in (1, 3, 10)},
    **{f"skew-{count}": functools.partial(skew, count) for count in (1, 3, 10)},
    "biped": biped,
    "pendulum": pendulum,
    "pit": discs,
}
