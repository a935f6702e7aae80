"""Recorded force elements of every type, recomputed from positions and velocities, and their share in the energy."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import mbdkit
from mbdkit import Mechanism
from mbdkit.mechanism.values import Table

PULSE = Table(table=((0.0, 0.2, 0.5, 0.8, 1.0), (1.0, -2.0, 0.5, 3.0, 0.0)))
GRAVITY = (0.3, -9.81)


def mechanism() -> Mechanism:
    """Return two hinged bodies and two point masses, one of them on a driver, with force elements of every type."""
    m = Mechanism(GRAVITY)
    m.body("arm", mass=1.2, inertia=0.2, position=(0.5, 0.1), angle=0.3, angular_velocity=0.5)
    m.body("leg", mass=0.8, inertia=0.1, position=(1.2, -0.3), angle=-0.7)
    m.body("ball", mass=0.5, position=(0.4, 1.1), velocity=(0.2, -0.1))
    m.body("cart", mass=0.7, position=(-0.5, 0.2))
    m.revolute("A", m.ground, "arm", at=(0.0, 0.0))
    m.revolute("B", "arm", "leg", at=(0.95, 0.25))
    m.driver("track", m.ground, "cart", coordinate="y", motion="0.2 + 0.1*sin(4*t)")
    m.spring_damper("spring", "arm", "ball", points=((0.1, 0.2), (0, 0)), stiffness=30.0, damping=0.4, free_length=0.6)
    m.spring_damper("damper", m.ground, "leg", points=((0.5, -1.0), (0.1, 0.0)), damping=1.5)
    m.torsion_spring("twist", "arm", "leg", stiffness=4.0, damping=0.3, free_angle=-0.4)
    m.torsion_spring("bush", m.ground, "arm", stiffness=2.0, free_angle=0.2)
    m.law("line", m.ground, "ball", law="linear", points=((0, 2), (0, 0)), stiffness=9.0, damping=0.2, free_length=0.5)
    stop = {"law": "one-sided", "acts": "tension", "stiffness": 50.0, "damping": 0.5, "free_length": -0.6}
    m.law("stop", m.ground, "leg", along="angle", **stop)
    m.law("x", "arm", "ball", law="linear", along="x", stiffness=5.0, damping=0.1, free_length=0.1)
    m.law("y", "arm", "cart", law="table", along="y", points=((0, 0), (0, 0)), table=[[-3.0, 0.0, 3.0], [-5.0, 0, 7.0]])
    m.law("duffing", m.ground, "cart", law="acme:duffing-numba", points=((-1.5, 0), (0, 0)), stiffness=6.0, cubic=3.0)
    m.law("pump", m.ground, "arm", law="acme:pump-numba", along="angle")
    m.law("poly", m.ground, "ball", law="acme:polynomial", along="x", weights=[0.5, 2.0, 0.3])
    m.torque("motor", "leg", value="0.7*sin(3*t)", reaction_body="arm")
    m.torque("wind", "arm", value=PULSE)
    m.force("push", "leg", value=["0.5*cos(2*t)", PULSE], point=(0.3, -0.1))
    m.force("thrust", "arm", value=[1.5, "t - 0.4"], point=(0.2, 0.1), frame="body")
    m.force("weight", "ball", value=[0.0, -2.0])
    m.force("nothing", "ball", value=[0.0, 0.0])
    return m


class Case(NamedTuple):
    run: mbdkit.Run
    m: Mechanism

    def pose(self, body: str) -> tuple[np.ndarray, np.ndarray]:
        """Return (x, y, angle) (T, 3) and its rate; ground rests at zero."""
        if body == "ground":
            return np.zeros((2, len(self.run.time), 3))
        at = list(self.m.bodies).index(body)
        return self.run.array("trajectory/position")[:, at], self.run.array("trajectory/velocity")[:, at]

    def point(self, body: str, point: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return position and velocity (T, 2) of a point of a body."""
        x, v = self.pose(body)
        arm = turned(np.broadcast_to(point, (len(x), 2)), x[:, 2])
        return x[:, :2] + arm, v[:, :2] + v[:, 2:] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)

    def pathway(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return length and rate of a force element by formulas of its own."""
        force: Any = self.m.forces[name]
        path = force.pathway
        (a, u), (b, v) = (self.pose(body) for body in path.bodies)
        if path.length_unit == "rad":
            return b[:, 2] - a[:, 2], v[:, 2] - u[:, 2]
        points = (path.points or ((0, 0), (0, 0))) if hasattr(path, "points") else ((0, 0), (0, 0))
        (p, dp), (q, dq) = (self.point(body, at) for body, at in zip(path.bodies, points, strict=True))
        if path.is_line:
            length = np.linalg.norm(q - p, axis=1)
            return length, np.sum((q - p) * (dq - dp), axis=1) / length
        axis = turned(np.broadcast_to((1.0, 0.0) if path.coordinate == "x" else (0.0, 1.0), p.shape), a[:, 2])
        across = np.stack([-axis[:, 1], axis[:, 0]], axis=1) * u[:, 2:]
        return np.sum((q - p) * axis, axis=1), np.sum((dq - dp) * axis + (q - p) * across, axis=1)


def turned(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return vectors (T, 2) turned by angles (T,)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * vectors[:, 0] - s * vectors[:, 1], s * vectors[:, 0] + c * vectors[:, 1]], axis=1)


PATHWAYS = ("spring", "damper", "twist", "bush", "line", "stop", "x", "y", "duffing", "pump", "poly")
TORQUES = ("motor", "wind")
POINT_FORCES = ("push", "thrust", "weight", "nothing")


@pytest.fixture(scope="module")
def case(acme: None) -> Iterator[Case]:
    m = mechanism()
    with mbdkit.run(m, integrator={"name": "gauss", "stages": 3}, time={"end": 1.0, "step": 0.002}).check() as run:
        yield Case(run, m)


def tension(name: str, s: Any, rate: Any, t: Any) -> tuple[Any, Any]:
    """Return tension and potential of an element on a pathway, from its law as documented."""
    linear = {"spring": (30, 0.4, 0.6), "damper": (0, 1.5, 0), "twist": (4, 0.3, -0.4), "bush": (2, 0, 0.2)}
    linear |= {"line": (9, 0.2, 0.5), "x": (5, 0.1, 0.1)}
    if name in linear:
        k, c, free = linear[name]
        return k * (s - free) + c * rate, k * (s - free) ** 2 / 2
    if name == "stop":
        stretch = s + 0.6
        push = 50 * stretch + 0.5 * rate
        return np.where((stretch > 0) & (push > 0), push, 0.0), np.where(stretch > 0, 25 * stretch**2, 0.0)
    if name == "duffing":
        return 6 * s + 3 * s**3, 3 * s**2 + 3 * s**4 / 4
    if name == "pump":
        return np.sin(3 * t) * s + 0.2 * np.sin(rate), np.zeros_like(s)
    if name == "poly":
        return 0.5 + 2 * s + 0.3 * s**2, 0.5 * s + s**2 + 0.1 * s**3
    raise KeyError(name)


def test_names_and_bodies_are_those_of_the_mechanism(case: Case) -> None:
    forces = case.run.forces
    assert list(forces) == list(case.m.forces) == list(case.run.array("forces/force"))
    assert {name for name in forces if forces[name].units == "N m"} == {"twist", "bush", "stop", "pump", *TORQUES}
    assert forces["spring"].bodies == ("arm", "ball")
    assert forces["motor"].bodies == ("arm", "leg")  # the reaction body is the first
    assert forces["wind"].bodies == ("ground", "arm")
    assert forces["push"].bodies == ("ground", "leg")
    assert {*PATHWAYS, *TORQUES, *POINT_FORCES} == {*forces}


@pytest.mark.parametrize("name", PATHWAYS)
def test_length_and_rate_follow_from_the_motion_of_the_bodies(case: Case, name: str) -> None:
    length, rate = case.pathway(name)
    np.testing.assert_allclose(case.run.forces[name].length, length, rtol=0, atol=1e-14 * (1 + np.max(np.abs(length))))
    np.testing.assert_allclose(case.run.forces[name].rate, rate, rtol=0, atol=1e-13 * (1 + np.max(np.abs(rate))))


@pytest.mark.parametrize("name", [name for name in PATHWAYS if name != "y"])
def test_value_and_potential_are_those_of_the_law(case: Case, name: str) -> None:
    force = case.run.forces[name]
    pull, stored = tension(name, force.length, force.rate, case.run.time)
    sign = -1.0 if force.units == "N m" else 1.0  # a tension reduces the angle: its torque on the second body is -F
    np.testing.assert_allclose(force.value, sign * pull, rtol=0, atol=1e-13 * (1 + np.max(np.abs(pull))))
    np.testing.assert_allclose(force.potential, stored, rtol=0, atol=1e-13 * (1 + np.max(stored)))


def test_force_times_rate_is_power_to_the_bit_for_elements_on_pathways_and_torques(case: Case) -> None:
    for name in (*PATHWAYS, *TORQUES):
        force = case.run.forces[name]
        sign = 1.0 if force.units == "N m" else -1.0
        assert np.array_equal(force.power, sign * force.value * force.rate), name
        assert np.any(force.power != 0), name


@pytest.mark.parametrize("name", TORQUES)
def test_a_torque_has_the_relative_angle_of_its_bodies_and_its_prescribed_value(case: Case, name: str) -> None:
    force = case.run.forces[name]
    (a, u), (b, v) = (case.pose(body) for body in force.bodies)
    np.testing.assert_array_equal(force.length, b[:, 2] - a[:, 2])
    np.testing.assert_array_equal(force.rate, v[:, 2] - u[:, 2])
    assert not np.any(force.potential)
    if name == "motor":
        np.testing.assert_allclose(force.value, 0.7 * np.sin(3 * case.run.time), rtol=1e-14)


@pytest.mark.parametrize("name", POINT_FORCES)
def test_a_force_at_a_point_has_its_magnitude_and_the_velocity_of_the_point_along_it(case: Case, name: str) -> None:
    t, force = case.run.time, case.run.forces[name]
    pulse = CubicSpline(*PULSE.table)(t)
    vector = {
        "push": np.stack([0.5 * np.cos(2 * t), pulse], axis=1),
        "thrust": turned(np.stack([np.full_like(t, 1.5), t - 0.4], axis=1), case.pose("arm")[0][:, 2]),
        "weight": np.stack([0 * t, np.full_like(t, -2.0)], axis=1),
        "nothing": np.zeros((len(t), 2)),
    }[name]
    element: Any = case.m.forces[name]
    size, velocity = np.linalg.norm(vector, axis=1), case.point(element.body, element.point)[1]
    power = np.sum(vector * velocity, axis=1)
    np.testing.assert_allclose(force.value, size, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(force.power, power, rtol=0, atol=1e-12)
    np.testing.assert_allclose(force.value * force.rate, force.power, rtol=9e-16, atol=0)
    assert not np.any(force.length)
    assert not np.any(force.potential)
    if name == "nothing":
        assert not np.any(force.rate)


def test_potentials_of_elements_and_gravity_add_up_to_the_potential_energy(case: Case) -> None:
    total = case.run.array("forces/potential").sum(axis=1)
    for name, body in case.m.bodies.items():
        total = total - body.mass * case.pose(name)[0][:, :2] @ GRAVITY
    recorded = case.run.energy.potential
    np.testing.assert_allclose(total, recorded, rtol=0, atol=1e-14 * np.max(np.abs(recorded)) * len(case.run.forces))


def test_powers_add_up_to_the_rate_of_the_mechanical_energy_at_every_row(case: Case) -> None:
    # v^T (M a - M g) = powers of forces and drivers, minus lambda^T (Phi_q v + Phi_t), which is zero but for drift
    run = case.run
    rate = np.zeros(len(run.time))
    for name, body in case.m.bodies.items():
        v, a = case.pose(name)[1], run.array("trajectory/acceleration")[:, list(case.m.bodies).index(name)]
        rate += body.mass * np.sum(v[:, :2] * (a[:, :2] - GRAVITY), axis=1)
        rate += (body.inertia or 0.0) * v[:, 2] * a[:, 2]
    drift = np.sum(run.array("constraints/multiplier") * run.array("constraints/velocity_residual"), axis=1)
    supplied = run.array("forces/power").sum(axis=1) + run.array("joints/driver_power").sum(axis=1)
    size = np.max(np.abs(run.array("forces/power")).sum(axis=1))
    np.testing.assert_allclose(supplied - drift, rate, rtol=0, atol=1e-13 * size)


def test_powers_add_up_to_the_rates_of_work_and_dissipated_energy_and_of_the_potentials(case: Case) -> None:
    # the ledger integrates the powers of `EquationsOfMotion.powers`; potentials change by dV/ds s' = F(s, 0) s'
    from mbdkit.engine.consistent_start import workspace_at_start
    from mbdkit.engine.equations_of_motion import EquationsOfMotion

    equations = EquationsOfMotion(workspace_at_start(case.m, 0.0, 1.0)[0])
    run = case.run
    for row in range(0, len(run.time), 50):
        q, v = (run.array(f"trajectory/{name}")[row].ravel() for name in ("position", "velocity"))
        lam = equations.accelerations(run.time[row], q, v)[1]
        work, lost = equations.powers(run.time[row], q, v, lam)
        stored = 0.0
        for name in PATHWAYS:
            force = run.forces[name]
            if name == "y":  # without damping
                stored += force.value[row] * force.rate[row]
            elif name != "pump":  # without potential
                stored += float(tension(name, force.length[row], 0.0, run.time[row])[0]) * force.rate[row]
        supplied = run.array("forces/power")[row].sum() + run.array("joints/driver_power")[row].sum()
        assert supplied == pytest.approx(work - lost - stored, rel=1e-12, abs=1e-12)
