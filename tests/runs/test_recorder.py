"""What is recorded beside the motion, recomputed here from positions and velocities by formulas of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import mbdkit
from mbdkit.mechanism.forces import PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.joints import Distance, Driver, PointOnLine, Prismatic, Revolute, Weld
from tests.runs.recorded_cases import KNEE, TILT, Recorded, cases, recorded

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
