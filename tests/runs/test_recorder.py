"""What is recorded beside the motion, recomputed here from positions and velocities by formulas of its own."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import mbdkit
from mbdkit.mechanism.forces import PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.joints import Distance, Driver, PointOnLine, Prismatic, Revolute, Weld
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


FUNCTIONS: dict[Any, Callable[[np.ndarray], np.ndarray]] = {
    0.0: np.zeros_like,
    0.5: lambda t: np.full_like(t, 0.5),
    "0.5 + 4*t + 0.3*sin(5*t)": lambda t: 0.5 + 4 * t + 0.3 * np.sin(5 * t),
    "0.7*sin(3*t)": lambda t: 0.7 * np.sin(3 * t),
    "cos(2*t)": lambda t: np.cos(2 * t),
    TILT: CubicSpline(*TILT.table),
}
"""The motions and loads of the cases, again."""


def value(given: Any, t: np.ndarray) -> np.ndarray:
    """Return a motion or load over time."""
    return FUNCTIONS[given](t)


@cases
def test_energies_are_those_of_positions_and_velocities(case: str) -> None:
    # expected: sum m v^2/2 + I w^2/2; -m g.r; k (s - s0)^2/2
    r = recorded(case)
    kinetic, potential = np.zeros((2, len(r.t)))
    for name, body in r.m.bodies.items():
        x, v = r.pose(name)
        kinetic += body.mass * (v[:, 0] ** 2 + v[:, 1] ** 2) / 2 + (body.inertia or 0.0) * v[:, 2] ** 2 / 2
        potential -= body.mass * (x[:, :2] @ np.array(r.m.gravity))
    for force in r.m.forces.values():
        if isinstance(force, SpringDamper | TorsionSpring):
            free = force.free_length if isinstance(force, SpringDamper) else force.free_angle
            potential += force.stiffness * (r.stretch(force)[0] - free) ** 2 / 2
    energy = r.run.energy
    np.testing.assert_allclose(energy.kinetic, kinetic, rtol=1e-12)
    np.testing.assert_allclose(energy.potential, potential, rtol=0, atol=1e-12 * np.abs(potential).max())
    np.testing.assert_allclose(energy.total, energy.kinetic + energy.potential, rtol=0, atol=1e-13)
    balance = energy.total + energy.dissipated - energy.work - energy.total[0]
    np.testing.assert_allclose(energy.balance, balance, rtol=0, atol=1e-13)
    assert energy.balance[0] == energy.work[0] == energy.dissipated[0] == 0.0


def applied(r: Recorded) -> np.ndarray:
    """Return gravity and applied forces on every body, (T, B, 3), by hand; moments about the centres of mass."""
    load = np.zeros((len(r.t), len(r.m.bodies) + 1, 3))
    number = r.number | {"ground": len(r.m.bodies)}
    for i, body in enumerate(r.m.bodies.values()):
        load[:, i, :2] += body.mass * np.array(r.m.gravity)
    for force in r.m.forces.values():
        if isinstance(force, SpringDamper | TorsionSpring):
            length, rate, along = r.stretch(force)
            free = force.free_length if isinstance(force, SpringDamper) else force.free_angle
            tension = force.stiffness * (length - free) + force.damping * rate
            a, b = (number[name] for name in force.bodies)
            if isinstance(force, TorsionSpring):
                load[:, a, 2] += tension
                load[:, b, 2] -= tension
                continue
            pull = tension[:, None] * along
            for sign, body, name, point in ((1, a, *attach(force, 0)), (-1, b, *attach(force, 1))):
                load[:, body, :2] += sign * pull
                load[:, body, 2] += sign * cross(r.arm(name, point), pull)
        elif isinstance(force, Torque):
            load[:, number[force.body], 2] += value(force.value, r.t)
        elif isinstance(force, PointForce):
            push = np.column_stack([value(x, r.t) for x in force.value])
            load[:, number[force.body], :2] += push
            load[:, number[force.body], 2] += cross(r.arm(force.body, force.point), push)
    return load[:, :-1]


def attach(force: SpringDamper, side: int) -> tuple[str, Any]:
    return force.bodies[side], force.points[side]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


@cases
def test_reactions_and_loads_balance_every_body_at_every_row(case: str) -> None:
    # expected: Newton and Euler; a joint's force acts on its second body at its point there, and back on the first
    r = recorded(case)
    total = applied(r)
    force = r.run.array("joints/reaction_force")
    torque = r.run.array("joints/reaction_torque")
    largest = max(np.abs(total).max(), np.abs(force).max())
    for j, (name, joint) in enumerate(r.m.joints.items()):
        a, b = joint.bodies
        at = joint.point if isinstance(joint, Driver) else joint.points[1]
        place, _ = r.point(b, at)
        assert r.run.joint_names[j] == name
        for sign, body in ((1, b), (-1, a)):
            if body != "ground":
                arm = place - r.pose(body)[0][:, :2]
                total[:, r.number[body], :2] += sign * force[:, j]
                total[:, r.number[body], 2] += sign * (torque[:, j] + cross(arm, force[:, j]))
    mass = np.array([(body.mass, body.mass, body.inertia or 0.0) for body in r.m.bodies.values()])
    np.testing.assert_allclose(mass * r.acceleration, total, rtol=0, atol=1e-10 * largest)


@cases
def test_misalignment_is_the_gap_of_a_joint_and_its_velocity(case: str) -> None:
    # expected: |p_b - p_a|, ||p_b - p_a| - length|, |coordinate - motion|, distance of p_b from the line; velocities in
    # the constrained directions
    r = recorded(case)
    for name, joint in r.m.joints.items():
        history = r.run.joints[name]
        a, b = joint.bodies
        angle = np.zeros(len(r.t))
        if isinstance(joint, Driver):
            gap, speed, angle = driver_gap(r, joint)
        else:
            assert isinstance(joint, Revolute | Distance | Prismatic | PointOnLine | Weld)
            (pa, va), (pb, vb) = r.point(a, joint.points[0]), r.point(b, joint.points[1])
            gap, speed = np.hypot(*(pb - pa).T), np.hypot(*(vb - va).T)
            if isinstance(joint, Distance):
                along = (pb - pa) / gap[:, None]
                gap, speed = np.abs(gap - joint.length), np.abs(np.sum((vb - va) * along, axis=1))
            if isinstance(joint, Prismatic | PointOnLine):
                normal = r.arm(a, (-joint.axis[1] / np.hypot(*joint.axis), joint.axis[0] / np.hypot(*joint.axis)))
                turning = r.pose(a)[1][:, 2:] * np.column_stack([-normal[:, 1], normal[:, 0]])
                speed = np.abs(np.sum((vb - va) * normal + (pb - pa) * turning, axis=1))
                gap = np.abs(np.sum((pb - pa) * normal, axis=1))
            if isinstance(joint, Prismatic | Weld):
                held = r.m.bodies[b].angle - r.m.bodies[a].angle
                angle = np.abs(r.pose(b)[0][:, 2] - r.pose(a)[0][:, 2] - held)
        np.testing.assert_allclose(history.misalignment, gap, rtol=0, atol=4e-15)
        np.testing.assert_allclose(history.velocity_misalignment, speed, rtol=0, atol=2e-14)
        np.testing.assert_allclose(history.angle_misalignment, angle, rtol=0, atol=4e-15)
        assert history.misalignment_max >= np.asarray(history.misalignment).max()


def driver_gap(r: Recorded, joint: Driver) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return gap, speed and angle error of a driver whose first body is the ground."""
    u = value(joint.motion, r.t)
    assert joint.bodies[0] == "ground"
    if joint.coordinate == "angle":
        return np.zeros(len(r.t)), np.zeros(len(r.t)), np.abs(r.pose(joint.bodies[1])[0][:, 2] - u)
    place, velocity = r.point(joint.bodies[1], joint.point)
    axis = "xy".index(joint.coordinate)
    assert joint.motion == 0.0
    return np.abs(place[:, axis] - u), np.abs(velocity[:, axis]), np.zeros(len(r.t))


@cases
def test_residuals_by_row_make_up_the_misalignment(case: str) -> None:
    r = recorded(case)
    residual = r.run.array("constraints/position_residual")
    rows = [name for name, _ in r.m.constraint_rows()]
    assert list(r.run.array("constraints/constraint")) == rows
    for name, joint in r.m.joints.items():
        columns = [i for i, row in enumerate(rows) if row.rsplit(".", 1)[0] == name and not row.endswith(".angle")]
        turned = [i for i, row in enumerate(rows) if row == f"{name}.angle"]
        if turned:
            error = np.abs(residual[:, turned[0]])
            np.testing.assert_allclose(r.run.joints[name].angle_misalignment, error, rtol=0, atol=1e-16)
        if not (isinstance(joint, Driver) and joint.coordinate == "angle"):
            norm = np.sqrt(np.sum(residual[:, columns] ** 2, axis=1))
            np.testing.assert_allclose(r.run.joints[name].misalignment, norm, rtol=0, atol=1e-16)


@pytest.mark.parametrize("integrator", [{"name": "gauss"}, {"name": "rk4"}], ids=["gauss", "rk4"])
def test_the_largest_misalignment_covers_steps_that_are_not_recorded(integrator: dict[str, Any]) -> None:
    # expected: the same run with every step recorded; drift of gauss comes and goes
    spec = {"mbdkit": 1, "model": KNEE, "integrator": integrator, "time": {"end": 2.0, "step": 0.01}}
    fine, coarse = mbdkit.run(spec), mbdkit.run({**spec, "output": {"every": 190}})
    for name in "ABCD":
        largest = coarse.joints[name].misalignment_max
        assert largest == fine.joints[name].misalignment_max == np.asarray(fine.joints[name].misalignment).max()
        if integrator["name"] == "gauss":
            assert largest > np.asarray(coarse.joints[name].misalignment).max()


def test_recorded_rows_do_not_depend_on_what_else_is_recorded() -> None:
    spec = {"mbdkit": 1, "model": KNEE, "integrator": {"name": "gauss"}, "time": {"end": 0.2, "step": 0.01}}
    whole = mbdkit.run(spec)
    part = mbdkit.run({**spec, "output": {"quantities": ["joints"]}})
    for path in ("trajectory/position", "trajectory/acceleration", "joints/reaction_force", "joints/misalignment"):
        np.testing.assert_array_equal(part.array(path), whole.array(path))
    assert not part.records("energy/total")
    assert part.misalignment_max == whole.misalignment_max


def test_elapsed_time_rises_from_row_to_row() -> None:
    elapsed = recorded("knee").run.elapsed
    assert elapsed[0] == 0.0
    assert np.all(np.diff(elapsed) > 0)
