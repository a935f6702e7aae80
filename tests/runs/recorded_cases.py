"""Mechanisms whose recorded quantities are compared with definitions."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.mechanism.forces import SpringDamper, TorsionSpring
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.values import Table


def slider_crank() -> Mechanism:
    """Return a driven crank, a rod and a block on a line held by a y-driver and kept upright by an angle driver."""
    m = Mechanism()
    m.body("crank", mass=1.0, inertia=0.02, position=(0.15 * math.cos(0.5), 0.15 * math.sin(0.5)), angle=0.5)
    tip = (0.3 * math.cos(0.5), 0.3 * math.sin(0.5))
    slope = -math.asin(tip[1] / 0.8)
    pin = (tip[0] + 0.8 * math.cos(slope), 0.0)
    m.body("rod", mass=0.7, inertia=0.04, position=((tip[0] + pin[0]) / 2, tip[1] / 2), angle=slope)
    m.body("block", mass=1.5, inertia=0.01, position=pin)
    m.revolute("A", m.ground, "crank", at=(0.0, 0.0))
    m.revolute("B", "crank", "rod", at=tip)
    m.revolute("C", "rod", "block", at=pin)
    m.driver("track", m.ground, "block", coordinate="y", motion=0.0)
    m.driver("upright", m.ground, "block", coordinate="angle", motion=0.0)
    m.driver("motor", m.ground, "crank", coordinate="angle", motion="0.5 + 4*t + 0.3*sin(5*t)")
    m.spring_damper(
        "s", m.ground, "block", points=((1.5, 0.2), (0.1, 0.0)), stiffness=80.0, damping=3.0, free_length=0.4
    )
    return m


def hanging() -> Mechanism:
    """Return a body on a distance joint and a chain, with every kind of force."""
    m = Mechanism(gravity=(0.4, -9.81))
    m.body("bar", mass=1.2, inertia=0.2, position=(0.6, -0.1), angle=0.2)
    m.body("bob", mass=0.5, position=(1.4, -0.5))
    m.revolute("pin", m.ground, "bar", points=((0.0, 0.0), (-0.6, 0.1)))
    m.distance("string", "bar", "bob", points=((0.5, 0.0), (0.0, 0.0)), length=0.6)
    m.spring_damper("s", "bar", "bob", points=((-0.2, 0.3), (0.0, 0.0)), stiffness=20.0, damping=0.5, free_length=0.7)
    m.torsion_spring("twist", m.ground, "bar", stiffness=3.0, damping=0.2, free_angle=-0.1)
    m.torque("turn", "bar", value="0.7*sin(3*t)")
    m.force("push", "bar", value=[0.5, "cos(2*t)"], point=(0.3, 0.1))
    return m


def press() -> Mechanism:
    """Return a tilting frame, driven by a table, in which a slide carries a ram with a head welded to it."""
    m = Mechanism()
    m.body("frame", mass=3.0, inertia=0.5, position=(0.1, 0.4), angle=0.3)
    m.body("ram", mass=0.8, inertia=0.03, position=(0.4, 0.9), angle=0.9)
    m.body("head", mass=0.5, inertia=0.02, position=(0.7, 1.1), angle=-0.2)
    m.revolute("pivot", m.ground, "frame", at=(0.0, 0.0))
    m.driver("tilt", m.ground, "frame", coordinate="angle", motion=TILT)
    m.prismatic("slide", "frame", "ram", points=((0.1, 0.2), (-0.1, 0.05)), axis=(1.0, 0.4))
    m.weld("neck", "ram", "head", points=((0.3, 0.1), (-0.05, 0.1)))
    m.spring_damper("s", "frame", "ram", points=((-0.3, 0.1), (0.1, 0.0)), stiffness=90.0, damping=2.0, free_length=0.5)
    m.body("roller", mass=0.4, inertia=0.01, position=(1.0, 1.3), angle=0.6, angular_velocity=2.0)
    m.point_on_line("slot", "head", "roller", points=((0.1, 0.1), (0.05, -0.1)), axis=(-1.0, 0.7))
    m.force("load", "head", value=[TILT, 0.5], point=(0.1, 0.0))
    return m


TILT = Table(table=((0.0, 0.1, 0.3, 0.5), (0.3, 0.35, 0.2, 0.25)))


KNEE = {"name": "four-bar-knee", "flexion": 0.6, "damping": 0.3}


CASES: dict[str, Any] = {
    "double pendulum": {"name": "double-pendulum", "angles": [-0.3, 0.4], "masses": [1.0, 0.6]},
    "knee": KNEE,
    "slider-crank": slider_crank,
    "hanging": hanging,
    "press": press,
}


cases = pytest.mark.parametrize("case", CASES)


class Recorded:
    """A run of a case, and its mechanism."""

    def __init__(self, case: str):
        given = CASES[case]
        time, integrator = {"end": 0.5, "step": 0.005}, {"name": "gauss", "stages": 3}
        source = given() if callable(given) else {"mbdkit": 1, "model": given, "integrator": integrator, "time": time}
        spec = {"integrator": integrator, "time": time} if callable(given) else {}
        self.run = mbdkit.run(source, **spec).check()
        from mbdkit.spec import load_spec

        self.m: Mechanism = load_spec(source, (), **spec).mechanism()
        self.t = np.asarray(self.run.time)
        self.position = self.run.array("trajectory/position")
        self.velocity = self.run.array("trajectory/velocity")
        self.acceleration = self.run.array("trajectory/acceleration")
        self.number = {name: i for i, name in enumerate(self.m.bodies)}

    def pose(self, body: str) -> tuple[np.ndarray, np.ndarray]:
        """Return x (T, 3) and v (T, 3) of a body; ground rests at zero."""
        if body == "ground":
            return np.zeros((2, len(self.t), 3))
        return self.position[:, self.number[body]], self.velocity[:, self.number[body]]

    def arm(self, body: str, point: Any) -> np.ndarray:
        """Return R s (T, 2)."""
        angle = self.pose(body)[0][:, 2]
        c, s = np.cos(angle), np.sin(angle)
        return np.column_stack([c * point[0] - s * point[1], s * point[0] + c * point[1]])

    def point(self, body: str, point: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return place and velocity (T, 2) of a point of a body."""
        x, v = self.pose(body)
        arm = self.arm(body, point)
        return x[:, :2] + arm, v[:, :2] + v[:, 2:] * np.column_stack([-arm[:, 1], arm[:, 0]])

    def stretch(self, force: SpringDamper | TorsionSpring) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return length, rate and direction (T, 2) of a force element; a torsion spring has no direction."""
        a, b = force.bodies
        if isinstance(force, TorsionSpring):
            (xa, va), (xb, vb) = self.pose(a), self.pose(b)
            return xb[:, 2] - xa[:, 2], vb[:, 2] - va[:, 2], np.zeros((len(self.t), 2))
        (pa, va), (pb, vb) = self.point(a, force.points[0]), self.point(b, force.points[1])
        length = np.hypot(*(pb - pa).T)
        along = (pb - pa) / length[:, None]
        return length, np.sum((vb - va) * along, axis=1), along


@cache
def recorded(case: str) -> Recorded:
    return Recorded(case)
