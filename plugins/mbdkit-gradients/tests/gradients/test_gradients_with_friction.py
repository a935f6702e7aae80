"""Gradients of mechanisms with friction in joints: closed forms, variational equations, and differences of runs."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.gradients.checks import assert_passed

import mbdkit
from mbdkit import Mechanism
from mbdkit.spec import load_spec

G = 9.81


def wheel(**friction: float) -> mbdkit.Mechanism:
    m = mbdkit.Mechanism()
    m.body("wheel", mass=2.0, inertia=0.05, angular_velocity=20.0)
    m.revolute("pin", m.ground, "wheel", at=(0.0, 0.0), friction={"radius": 0.01, "transition_speed": 1e-3} | friction)
    return m


RK4: dict[str, Any] = {"name": "rk4"}
GAUSS, RADAU = {"name": "gauss", "stages": 3}, {"name": "radau-iia", "stages": 3}


def spec_of(mechanism: Mechanism, end: float, step: float, integrator: Any = RK4, **more: Any) -> dict[str, Any]:
    time = {"end": end, "step": step}
    return {"mbdkit": 1, "model": mechanism.to_spec(), "time": time, "integrator": integrator, **more}


def by_complex_step(function: Callable[..., Sequence[complex]], *values: float) -> np.ndarray:
    """Return the derivatives (results, values) of a function."""
    moved = np.array(values) + 1e-30j * np.eye(len(values))
    return np.array([[x.imag / 1e-30 for x in function(*some)] for some in moved]).T


def test_a_wheel_on_a_pin_has_the_derivatives_of_its_closed_form() -> None:
    def exact(mu: Any, radius: Any, inertia: Any) -> tuple[Any, ...]:
        torque = mu * radius * 2.0 * G
        rate, at_half = 20.0 - torque / inertia, 10.0 - torque / inertia / 8.0
        turned = 20.0 - torque / inertia / 2.0
        return rate, at_half, 10.0 - torque / inertia / 6.0, torque * turned, torque, (20.0 - 16.0) * inertia / torque

    measures = ["final(wheel.angular_velocity)", "at(wheel.angle, 0.5)", "integral(wheel.angle)",
                "final(energy.dissipated)", "max(abs(joints.pin.friction))", "events.slow.time"]  # fmt: skip
    events = {"slow": {"when": "wheel.angular_velocity - 16"}}
    spec = spec_of(wheel(coefficient=0.8, radius=0.02), 1.0, 0.05, events=events)
    names = [*(f"model.joints.pin.friction.{key}" for key in ("coefficient", "radius")), "model.bodies.wheel.inertia"]
    found = mbdkit.gradient(spec, measures, names)
    np.testing.assert_allclose(found.value, exact(0.8, 0.02, 0.05), rtol=1e-10)
    np.testing.assert_allclose(found.jacobian, by_complex_step(exact, 0.8, 0.02, 0.05), rtol=1e-9, atol=1e-12)
    assert_passed(found)


@pytest.mark.parametrize(("integrator", "step"), [(RK4, 0.002), (GAUSS, 0.01)])
def test_a_block_that_comes_to_rest_on_an_incline_has_the_derivatives_of_its_closed_form(
    integrator: Any, step: float
) -> None:
    # the friction is constant down to the transition speed, and then proportional to the speed: the block creeps
    slope = 0.3

    def exact(mu: Any, speed: Any, transition: Any) -> tuple[Any, Any]:
        braking, k = G * (mu * math.cos(slope) - math.sin(slope)), mu * G * math.cos(slope) / transition
        creeping, late = G * math.sin(slope) / k, 1.2 - (speed - transition) / braking
        share = cmath.exp(-k * late)
        way = (speed**2 - transition**2) / (2.0 * braking) + creeping * late
        return way + (transition - creeping) * (1.0 - share) / k, creeping + (transition - creeping) * share

    m = Mechanism(gravity=(G * math.sin(slope), -G * math.cos(slope)))
    m.body("block", mass=2.0, inertia=0.1, velocity=(2.0, 0.0))
    m.prismatic(
        "guide", m.ground, "block", at=(0, 0), axis=(1, 0), friction={"coefficient": 0.5, "transition_speed": 0.05}
    )
    friction = "model.joints.guide.friction"
    names = [f"{friction}.coefficient", "model.bodies.block.velocity.0", f"{friction}.transition_speed"]
    found = mbdkit.gradient(spec_of(m, 1.2, step, integrator), ["final(block.x)", "final(block.vx)"], names)
    np.testing.assert_allclose(found.jacobian, by_complex_step(exact, 0.5, 2.0, 0.05), rtol=1e-6, atol=1e-7)
    assert_passed(found)


def test_a_rod_at_rest_is_damped_by_the_friction_of_its_pin() -> None:
    # expected: at rest, the friction is zero, but its derivative with respect to the rate is that of a damper
    m = Mechanism(gravity=(0.0, -G))
    m.body("rod", mass=1.0, inertia=0.1, position=(0.0, -0.5))
    m.revolute("pin", m.ground, "rod", at=(0, 0), friction={"coefficient": 0.3, "radius": 0.05})
    spec = spec_of(m, 1.0, 0.01, GAUSS, parameters={"rate": 0.0})
    spec["model"]["bodies"]["rod"] |= {"velocity": ["0.5*rate", 0], "angular_velocity": "rate"}
    found = mbdkit.gradient(spec, ["final(rod.angle)"], ["rate"])
    inertia, damping = 0.35, 0.3 * 0.05**2 * G / 0.01
    fade = damping / (2.0 * inertia)
    turn = math.sqrt(0.5 * G / inertia - fade**2)
    assert found.jacobian[0, 0] == pytest.approx(math.exp(-fade) * math.sin(turn) / turn, rel=1e-9)


def test_a_bead_on_a_turning_rod_has_the_derivatives_of_its_variational_equations() -> None:
    # expected: DOP853; the normal force m (2 w s' + g cos w t) changes its sign at 0.68 s
    turn, mu, transition = 3.0, 0.2, 0.05

    def slope(t: float, y: np.ndarray) -> list[float]:
        place, rate, by_mu, rate_by_mu = y
        normal = 2 * turn * rate + G * math.cos(turn * t)
        share, by_rate = max(-1.0, min(1.0, rate / transition)), float(abs(rate) < transition) / transition
        changed = mu * (math.copysign(2 * turn, normal) * share + abs(normal) * by_rate) * rate_by_mu
        return [rate, turn**2 * place - G * math.sin(turn * t) - mu * abs(normal) * share,
                rate_by_mu, turn**2 * by_mu - abs(normal) * share - changed]  # fmt: skip

    exact = solve_ivp(slope, (0.0, 1.0), [0.3, 0.2, 0, 0], method="DOP853", rtol=1e-12, atol=1e-13, max_step=5e-4).y
    m = Mechanism(gravity=(0.0, -G))
    m.body("rod", mass=1.0, inertia=0.1, angular_velocity=turn)
    m.body("bead", mass=0.5, position=(0.3, 0.0), velocity=(0.2, 0.3 * turn))
    m.revolute("pin", m.ground, "rod", at=(0.0, 0.0))
    m.driver("motor", m.ground, "rod", coordinate="angle", motion=f"{turn}*t")
    friction = {"coefficient": mu, "transition_speed": transition}
    m.point_on_line("rail", "rod", "bead", points=((0, 0), (0, 0)), axis=(1, 0), friction=friction)
    measures, names = ["final(joints.rail.angle)"], ["model.joints.rail.friction.coefficient"]
    found = mbdkit.gradient(spec_of(m, 1.0, 0.005, GAUSS), measures, names)
    assert found.value[0] == pytest.approx(exact[0, -1], abs=1e-8)
    assert found.jacobian[0, 0] == pytest.approx(exact[2, -1], rel=1e-6)
    assert_passed(found)


def vector(length: float, angle: float) -> Any:
    """Return a vector of this length, counterclockwise from the x-axis."""
    return length * np.array([math.cos(angle), math.sin(angle)])


def double_pendulum(rates: tuple[float, float], mass: float = 1.0, inertia: float = 0.1) -> Mechanism:
    m, (a, b), down = Mechanism(gravity=(0.0, -G)), (1.2, 0.4), 0.5 * math.pi
    end, middle, speed = vector(1.0, a - down), vector(0.4, b - down), vector(rates[0], a)
    m.body("one", mass=mass, inertia=inertia, position=end / 2, angle=a, velocity=speed / 2, angular_velocity=rates[0])
    m.body("two", mass=0.6, inertia=0.05, position=end + middle, angle=b, velocity=speed + vector(0.4 * rates[1], b),
           angular_velocity=rates[1])  # fmt: skip
    m.revolute("A", m.ground, "one", at=(0, 0), friction={"static": 0.3, "kinetic": 0.2, "radius": 0.03})
    m.revolute("B", "one", "two", at=end, friction={"coefficient": 0.15, "radius": 0.02})
    return m


MEASURES = ["final(two.angular_velocity)", "at(one.angle, 0.11)", "integral(energy.kinetic)",
            "final(energy.dissipated)", "final(joints.B.friction)", "max(abs(joints.A.force))"]  # fmt: skip
NAMES = ["model.joints.A.friction.static", "model.joints.A.friction.kinetic", "model.joints.B.friction.coefficient",
         "model.joints.A.friction.radius", "model.bodies.two.mass"]  # fmt: skip


def differences(spec: dict[str, Any], measures: Sequence[str], name: str) -> np.ndarray:
    """Return central differences of runs at two distances, extrapolated."""
    *path, last = name.split(".")
    place: Any = spec
    for key in path:
        place = place[key]
    given, found = place[last], []
    for distance in (1e-3 * given, 5e-4 * given):
        ends = []
        for place[last] in (given - distance, given + distance):
            run = mbdkit.run(spec, measures={f"m{i}": text for i, text in enumerate(measures)})
            ends.append(np.array(list(run.measures.values())))
        found.append((ends[1] - ends[0]) / (2.0 * distance))
    place[last] = given
    return np.asarray((4.0 * found[1] - found[0]) / 3.0)


KINDS: list[tuple[Any, dict[str, Any]]] = [
    (RK4, {}), (RK4, {"stabilization": "projection"}), (RK4, {"formulation": "joint-coordinates"}), (GAUSS, {}),
    *((RADAU, {"formulation": name}) for name in ("index-1", "index-2", "index-3", "ggl")),
]  # fmt: skip


@pytest.mark.parametrize(("integrator", "more"), KINDS)
def test_gradients_of_a_double_pendulum_with_friction_are_differences_of_runs(
    integrator: Any, more: dict[str, Any]
) -> None:
    spec = spec_of(double_pendulum((4.0, -3.0)), 0.2, 0.005, integrator, **more)
    found = mbdkit.gradient(spec, MEASURES, NAMES, check=False)
    assert not found.doubts
    for k, name in enumerate(NAMES):
        np.testing.assert_allclose(found.jacobian[:, k], differences(spec, MEASURES, name), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(
    ("integrator", "more"), [KINDS[1], *(pytest.param(*kind, marks=pytest.mark.slow) for kind in KINDS[3::2])]
)
def test_gradients_pass_their_check_where_joints_turn_back(integrator: Any, more: dict[str, Any]) -> None:
    spec = spec_of(double_pendulum((0.0, 0.0)), 0.8, 0.005, integrator, **more)
    found = mbdkit.gradient(spec, MEASURES, NAMES)
    assert not found.doubts
    assert_passed(found)


def test_the_pivoted_solver_has_derivatives_of_friction() -> None:
    spec = spec_of(double_pendulum((4.0, -3.0), 1e-7, 1e-8), 0.2, 0.002)
    assert_passed(mbdkit.gradient(spec, MEASURES, NAMES))


def test_adaptive_steps_end_at_corners_of_friction() -> None:
    spec = spec_of(double_pendulum((0.0, 0.0)), 0.8, 0.005, {"name": "dopri5", "adaptive": True})
    del spec["time"]["step"]
    assert_passed(mbdkit.gradient(spec, MEASURES[:1], NAMES[:1]))


@pytest.mark.slow
def test_a_slide_whose_normal_forces_change_their_signs_has_accurate_derivatives() -> None:
    # expected: differences of runs with small steps, in which corners inside steps cause errors of about 1e-4
    m, a = Mechanism(gravity=(0.0, -G)), 0.7
    b = -math.asin(math.sin(a) / 3.0)
    pin, x = vector(0.1, a), 0.1 * math.cos(a) + 0.3 * math.cos(b)
    m.body("crank", mass=1.0, inertia=0.01, position=pin / 2, angle=a)
    m.body("rod", mass=0.8, inertia=0.02, position=pin + vector(0.15, b), angle=b)
    m.body("slider", mass=0.5, inertia=0.01, position=(x, 0.0))
    friction = {"coefficient": 0.2, "radius": 0.02, "transition_speed": 0.1}
    m.revolute("shaft", m.ground, "crank", at=(0.0, 0.0), friction=friction)
    m.revolute("crankpin", "crank", "rod", at=pin, friction=friction)
    m.revolute("gudgeon", "rod", "slider", at=(x, 0.0), friction=friction)
    guide = {"static": 0.3, "kinetic": 0.2, "length": 0.05, "transition_speed": 0.1}
    m.prismatic("cylinder", m.ground, "slider", at=(x, 0.0), axis=(1, 0), friction=guide)
    m.torque("engine", "crank", value=3.0)
    measures = ["final(crank.angle)", "integral(energy.kinetic)", "final(energy.dissipated)"]
    names = [*(f"model.joints.cylinder.friction.{key}" for key in ("kinetic", "length")), "model.bodies.rod.mass"]
    found, fine = mbdkit.gradient(spec_of(m, 0.3, 0.002, GAUSS), measures, names, check=False), spec_of(m, 0.3, 1e-4)
    for k, name in enumerate(names):
        np.testing.assert_allclose(found.jacobian[:, k], differences(fine, measures, name), rtol=5e-4)


def test_radial_forces_of_gears_have_derivatives() -> None:
    m = Mechanism(gravity=(0.0, -G))
    m.body("a", mass=1.0, inertia=0.002, angular_velocity=5.0)
    m.body("b", mass=2.0, inertia=0.01, position=(0.15, 0.0), angular_velocity=-2.5)
    for name, body, x in (("A", "a", 0.0), ("B", "b", 0.15)):
        m.revolute(name, m.ground, body, at=(x, 0.0), friction={"coefficient": 0.2, "radius": 0.02})
    m.torque("load", "a", value="0.8*cos(3*t)")
    spec = spec_of(m, 0.8, 0.01)
    gear = {
        "type": "gear",
        "bodies": ["a", "b"],
        "points": [[0, 0], [0, 0]],
        "radii": [0.05, 0.1],
        "pressure_angle": 0.35,
    }
    spec["model"]["joints"]["G"] = gear
    names = ["model.joints.G.pressure_angle", "model.joints.B.friction.coefficient", "model.bodies.b.inertia"]
    found = mbdkit.gradient(spec, ["final(a.angle)", "max(abs(joints.B.force))", "final(energy.dissipated)"], names)
    assert np.all(found.jacobian != 0.0)
    assert_passed(found)


@pytest.mark.slow
def test_the_pins_of_a_knee_have_derivatives() -> None:
    measures = ["final(energy.dissipated)", "max(abs(joints.A.force))", "integral(energy.kinetic)"]
    names = ["model.pin_friction.coefficient", "model.pin_friction.radius", "model.springs.support.stiffness"]
    spec = load_spec("knee", ["model.pin_friction={coefficient: 0.1, radius: 0.008}"])
    found = mbdkit.gradient(spec, measures, names, time={"end": 0.4, "step": 0.005})
    assert_passed(found)
