"""Dry friction inside joints, against closed forms, SciPy, and the equations of motion of single bodies."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit import EquationsOfMotion
from mbdkit.base.errors import SpecError
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import load_spec
from tests.margins import assert_within
from tests.runs.rubbing_joints import ARM, INERTIA, MASS, MU, RADIUS, TRANSITION, pendulum, slide

G = 9.81
DOP853 = {"name": "dop853", "adaptive": True, "rtol": 1e-11, "atol": 1e-12}


def run(m: Mechanism, end: float, integrator: dict[str, Any], step: float | None = None, **more: Any) -> mbdkit.Run:
    time = {"end": end} if step is None else {"end": end, "step": step}
    return mbdkit.run({"mbdkit": 1, "model": m.to_spec(), "time": time, "integrator": integrator, **more})


def wheel(**friction: float) -> Mechanism:
    m = Mechanism()
    m.body("wheel", mass=2.0, inertia=0.05, angular_velocity=20.0)
    m.revolute("pin", m.ground, "wheel", at=(0.0, 0.0), friction={"radius": 0.01, "transition_speed": 1e-3} | friction)
    return m


def test_a_wheel_on_a_pin_slows_down_at_a_constant_rate(tmp_path: Path) -> None:
    # expected: coefficient * radius * weight / inertia, and a wheel that stands after 20 / 0.7848 s
    rate = 0.2 * 0.01 * 2.0 * G / 0.05
    spec = {"mbdkit": 1, "model": wheel(coefficient=0.2).to_spec(), "time": {"end": 1.0, "step": 0.05}}
    more: dict[str, Any] = {"integrator": {"name": "rk4"}, "measures": {"largest": "max(abs(joints.pin.friction))"}}
    path = tmp_path / "wheel.h5"
    mbdkit.run({**spec, **more}, archive=path).close()
    with mbdkit.load(path) as done:
        assert done["wheel"].angular_velocity[-1] == pytest.approx(20.0 - rate, rel=1e-14)
        np.testing.assert_allclose(done.joints["pin"].friction, -0.05 * rate, rtol=1e-14)
        assert done.measures["largest"] == pytest.approx(0.05 * rate, rel=1e-14)
        assert done.energy.dissipated[-1] == pytest.approx(0.05 * rate * (20.0 - rate / 2), rel=1e-12)
        assert done.energy.work[-1] == 0.0
    with run(wheel(coefficient=0.2), 26.0, DOP853) as done:
        assert done["wheel"].angular_velocity[-1] == pytest.approx(0.0, abs=0.1)  # transition speed over radius
    with run(wheel(static=0.4, kinetic=0.2), 0.001, {"name": "rk4"}, 0.001) as done:
        torque = 0.05 * rate * (1.0 + 2.0 / (1.0 + (0.2 / 1e-3) ** 2))  # as in contacts
        assert done.joints["pin"].friction[0] == pytest.approx(-torque, rel=1e-14)


def swing(t: float, y: np.ndarray) -> list[float]:
    """The pendulum in its angle; the reaction, which depends on the acceleration, is found by Newton's method."""
    angle, rate = y
    about, pull = INERTIA + MASS * ARM**2, MASS * G * ARM * math.sin(angle)
    arm = MU * RADIUS * max(-1.0, min(1.0, RADIUS * rate / TRANSITION))
    radial, found = MASS * (ARM * rate**2 + G * math.cos(angle)), -pull / about
    for _ in range(50):
        across = MASS * (ARM * found + G * math.sin(angle))
        force = math.hypot(radial, across)
        change = (about * found + pull + arm * force) / (about + arm * across / force * MASS * ARM)
        found -= change
        if abs(change) < 1e-15 * abs(found):
            break
    return [rate, found]


@lru_cache
def swung(rate: float, end: float) -> np.ndarray:
    more: dict[str, Any] = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14, "max_step": 5e-4}
    return np.asarray(solve_ivp(swing, (0.0, end), [1.2, rate], **more).y[:, -1])


# Steps are short because error estimates do not see the corners of the friction law: without `max_step`, the result was
# off by less than 1e-9 on one processor and by 2e-8 on another.
SHORT = {"max_step": 1e-3}


@pytest.mark.parametrize("method", [DOP853, {"name": "scipy-dop853", "rtol": 1e-11, "atol": 1e-12} | SHORT])
def test_a_pendulum_with_friction_in_its_pin_swings_back_as_scipy_integrates_it(method: dict[str, Any]) -> None:
    with run(pendulum(0.0), 1.0, method) as done:
        assert done["rod"].angle[-1] == pytest.approx(swung(0.0, 1.0)[0], abs=1e-9)
        assert_within(done.energy.balance, 1e-9)
        assert done.energy.dissipated[-1] > 0.5


@pytest.mark.parametrize(
    ("method", "step", "more", "error"),
    [
        ("rk4", 0.001, {"stabilization": {"name": "projection"}}, 1e-9),
        ("gauss", 0.005, {}, 1e-9),
        ("radau-iia", 0.005, {"formulation": "index-1"}, 1e-9),
        ("radau-iia", 0.005, {"formulation": "index-2"}, 1e-9),
        ("radau-iia", 0.005, {"formulation": "index-3"}, 1e-8),
        ("radau-iia", 0.005, {"formulation": "ggl"}, 1e-9),
        ("lobatto-pair", 0.005, {"formulation": "index-3"}, 1e-8),
    ],
)
def test_every_method_swings_a_pendulum_with_friction(
    method: str, step: float, more: dict[str, Any], error: float
) -> None:
    # one swing: where the motion turns back, the friction has a kink, and fixed steps lose their order
    stages = {} if method == "rk4" else {"stages": 3}
    with run(pendulum(-1.0), 0.5, {"name": method, **stages}, step, **more) as done:
        assert done.status == "complete"
        assert done["rod"].angle[-1] == pytest.approx(swung(-1.0, 0.5)[0], abs=error)
        assert_within(done.energy.balance, 100 * error)


def test_the_forces_of_the_equations_of_motion_hold_the_friction_of_the_reaction() -> None:
    # expected: coefficient times radius times the reaction force, from the accelerations of `swing`
    p = EquationsOfMotion.of(pendulum(-1.0))
    turn = swing(0.0, np.array([1.2, -1.0]))[1]
    radial, across = ARM * 1.0 + G * math.cos(1.2), ARM * turn + G * math.sin(1.2)
    torque = MU * RADIUS * MASS * math.hypot(radial, across)
    np.testing.assert_allclose(p.forces(0.0, p.q0, p.v0), [0.0, -MASS * G, torque], rtol=1e-12, atol=1e-13)
    assert p.counters.rhs_evaluations == 2
    a, lam = p.accelerations(0.0, p.q0, p.v0)
    np.testing.assert_allclose(p.residual(0.0, p.q0, p.v0, a, lam), 0.0, atol=1e-13)
    at_rest = p.forces(0.0, p.q0, 0.0 * p.v0)
    np.testing.assert_allclose(at_rest, [0.0, -MASS * G, 0.0], rtol=1e-14, atol=1e-14)


def half_explicit(p: EquationsOfMotion, h: float, steps: int) -> np.ndarray:
    """The half-explicit Euler method of index 2 (Hairer, Lubich and Roche 1989), of order 1."""
    q, v = p.q0, p.v0
    for n in range(steps):
        force, q = p.forces(n * h, q, v), q + h * v
        v = v + p.solve((n + 1) * h, q, h * force, -p.constraint_rates((n + 1) * h, q, v))[0]
    return np.array([q[2], v[2]])


def test_a_method_that_calls_forces_converges_to_the_motion_with_friction() -> None:
    # expected: the angle and its rate by SciPy; without friction they are 0.044 rad and 0.18 rad/s off
    p, exact = EquationsOfMotion.of(pendulum(-1.0)), swung(-1.0, 0.5)
    coarse, fine = (np.max(np.abs(half_explicit(p, 0.5 / n, n) - exact)) for n in (100, 200))
    assert np.log2(coarse / fine) == pytest.approx(1, abs=0.1)
    assert fine < 0.03


@pytest.mark.parametrize("coefficient", [0.1, 0.2, 0.39, 0.8])
def test_a_slide_is_braked_by_the_forces_at_its_ends(coefficient: float) -> None:
    # expected: moments about the centre of mass: the force f = 2 coefficient M / L of two opposite ends has the arm
    # 0.1 m, by which it adds to the torque or takes from it
    for torque in (3.0, -3.0):
        locks = 2 * coefficient * 0.1 >= 0.08
        wanted = 2 * coefficient * 3.0 / (0.08 - math.copysign(2 * coefficient * 0.1, torque))
        if torque > 0 and locks:
            with pytest.raises(SpecError, match="'guide' have no solution: the joint locks itself"):
                run(slide(coefficient, torque), 0.001, {"name": "rk4"}, 0.001)
            continue
        with run(slide(coefficient, torque), 0.001, {"name": "rk4"}, 0.001) as done:
            assert done.joints["guide"].friction[0] == pytest.approx(-wanted, rel=1e-12)
            assert done["block"].acceleration[0, 0] == pytest.approx(-wanted / 2.0, rel=1e-12)


def test_a_run_ends_where_a_joint_locks_itself() -> None:
    m = slide(0.39, 3.0)
    spec = {"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.001}}
    spec["model"]["forces"]["turn"]["value"] = "3*(1 - t)"
    spec["model"]["forces"]["late"] = {"type": "force", "body": "block", "point": [0, 0], "value": ["200*t", 0]}
    with mbdkit.run(spec) as done:
        assert done.status == "complete"
    spec["model"]["joints"]["guide"]["friction"]["static"] = 0.5
    spec["model"]["joints"]["guide"]["friction"]["kinetic"] = 0.39
    del spec["model"]["joints"]["guide"]["friction"]["coefficient"]
    spec["model"]["bodies"]["block"]["velocity"] = [0.01, 0.0]
    spec["model"]["joints"]["guide"]["friction"]["transition_speed"] = 1e-3
    with mbdkit.run(spec) as done:
        assert done.status == "failed"
        assert done.status_reason.startswith("self-locking: the friction and the reaction of joint 'guide'")


def test_a_bead_on_a_turning_rod_is_braked_by_the_normal_force() -> None:
    # expected: DOP853 of the motion along the rod, whose normal force is m (2 w s' + g cos w t)
    turn, mu, transition = 3.0, 0.2, 0.01

    def slope(t: float, y: np.ndarray) -> list[float]:
        normal = abs(2 * turn * y[1] + G * math.cos(turn * t))
        brake = mu * normal * max(-1.0, min(1.0, y[1] / transition))
        return [y[1], turn**2 * y[0] - G * math.sin(turn * t) - brake]

    wanted = solve_ivp(slope, (0.0, 0.5), [0.3, 0.2], method="DOP853", rtol=1e-13, atol=1e-14, max_step=5e-4).y[:, -1]
    m = Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, angular_velocity=turn)
    m.body("bead", mass=0.5, position=(0.3, 0.0), velocity=(0.2, 0.3 * turn))
    m.revolute("pin", m.ground, "rod", at=(0.0, 0.0))
    m.driver("motor", m.ground, "rod", coordinate="angle", motion=f"{turn}*t")
    friction = {"coefficient": mu, "transition_speed": transition}
    m.point_on_line("rail", "rod", "bead", points=((0, 0), (0, 0)), axis=(1, 0), friction=friction)
    with run(m, 0.5, DOP853) as done:
        assert done.joints["rail"].angle[-1] == pytest.approx(wanted[0], abs=1e-9)
        assert_within(done.energy.balance, 1e-9)


@pytest.mark.parametrize("solver", ["schur", "pivoted"])
def test_every_body_of_a_slider_crank_obeys_newton_with_the_recorded_reactions_and_friction(solver: str) -> None:
    # expected: force and moment balance of each body, and the law of friction with the recorded reactions
    mass, inertia = (0.8, 0.02) if solver == "schur" else (4e-7, 1e-8)  # masses of different size need pivots
    ends = {}
    m = Mechanism(gravity=(0.0, -G))
    a = 0.7
    b = -math.asin(0.1 * math.sin(a) / 0.3)
    m.body("crank", mass=1.0, inertia=0.01, position=(0.05 * math.cos(a), 0.05 * math.sin(a)), angle=a)
    x, y = 0.1 * math.cos(a), 0.1 * math.sin(a)
    middle = (x + 0.15 * math.cos(b), y + 0.15 * math.sin(b))
    m.body("rod", mass=mass, inertia=inertia, position=middle, angle=b)
    m.body("slider", mass=0.5, inertia=0.01, position=(x + 0.3 * math.cos(b), 0.0))
    pin = {"coefficient": 0.2, "radius": 0.02, "transition_speed": 0.02}
    m.revolute("shaft", m.ground, "crank", at=(0.0, 0.0), friction=pin)
    m.revolute("crankpin", "crank", "rod", at=(x, y), friction=pin)
    m.revolute("gudgeon", "rod", "slider", at=(x + 0.3 * math.cos(b), 0.0), friction={**pin, "radius": 0.03})
    guide = {"static": 0.3, "kinetic": 0.2, "length": 0.05, "transition_speed": 0.02}
    m.prismatic("cylinder", m.ground, "slider", at=(x + 0.3 * math.cos(b), 0.0), axis=(1, 0), friction=guide)
    m.torque("engine", "crank", value=3.0)
    with run(m, 0.3, {**DOP853, "rtol": 1e-10, "atol": 1e-11}) as done:
        assert_within(done.energy.balance, 1e-7 * done.energy.kinetic.max())
        joints = done.joints
        rates = {"shaft": ("ground", "crank"), "crankpin": ("crank", "rod"), "gudgeon": ("rod", "slider")}
        spin = {name: done[name].angular_velocity for name in m.bodies} | {"ground": 0.0}
        for name, (first, second) in rates.items():
            radius = 0.03 if name == "gudgeon" else 0.02
            slip = radius * (spin[second] - spin[first])
            torque = 0.2 * radius * np.hypot(*joints[name].reaction_force.T) * np.clip(slip / 0.02, -1, 1)
            np.testing.assert_allclose(joints[name].friction, -torque, rtol=1e-11, atol=1e-9 * np.abs(torque).max())
            ends[name] = joints[name].reaction_force
        speed, cylinder = done["slider"].velocity[:, 0], joints["cylinder"]
        half, couple = cylinder.reaction_force[:, 1] / 2, cylinder.reaction_torque / 0.05
        normal = np.abs(half + couple) + np.abs(half - couple)
        size = 0.2 + 2 * 0.1 / (1 + (speed / 0.02) ** 2)
        brake = normal * size * np.clip(speed / 0.02, -1, 1)
        np.testing.assert_allclose(cylinder.friction, -brake, rtol=1e-11, atol=1e-9 * np.abs(brake).max())
        size = np.abs(ends["crankpin"]).max()
        along = 0.5 * done["slider"].acceleration[:, 0] - ends["gudgeon"][:, 0] - cylinder.friction
        np.testing.assert_allclose(along, 0.0, atol=1e-10 * size)
        rod, angle = done["rod"], done["rod"].angle
        force = ends["crankpin"] - ends["gudgeon"] - [0.0, mass * G]
        np.testing.assert_allclose(mass * rod.acceleration, force, rtol=0, atol=1e-10 * size)
        both = ends["crankpin"] + ends["gudgeon"]
        moment = 0.15 * (np.sin(angle) * both[:, 0] - np.cos(angle) * both[:, 1])
        moment += joints["crankpin"].friction - joints["gudgeon"].friction
        np.testing.assert_allclose(inertia * rod.angular_acceleration, moment, rtol=0, atol=1e-10 * size)


def spec_with(joint: dict[str, Any], **more: Any) -> dict[str, Any]:
    bodies = {"b": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}}
    joints = {"j": {"bodies": ["ground", "b"], "points": [[0, 0], [-0.5, 0]], **joint}}
    model = {"name": "mechanism", "bodies": bodies, "joints": joints}
    time, integrator = {"end": 0.01, "step": 0.001}, {"name": "rk4"}
    return {"mbdkit": 1, "model": model, "integrator": integrator, "time": time, **more}


PIN = {"type": "revolute", "friction": {"coefficient": 0.1, "radius": 0.01}}


def test_friction_has_no_place_in_drivers_with_redundant_joints_or_rigid_contacts() -> None:
    driver = {"type": "driver", "coordinate": "angle", "motion": "t", "friction": {"coefficient": 0.1}, "points": None}
    with pytest.raises(SpecError, match="a driver has no bearing"):
        load_spec(spec_with(driver))
    twice = spec_with(PIN)
    twice["model"]["joints"]["again"] = dict(twice["model"]["joints"]["j"])
    with pytest.raises(SpecError, match="the reaction of joint 'j' is not unique"):
        mbdkit.run(twice)
    rigid = spec_with(PIN, contact={"treatment": "event-driven"}, integrator={"name": "dop853"})
    shapes = [{"line": {"normal": [0, 1], "point": [0, -1]}}, {"point": [0, 0]}]
    rigid["model"]["contacts"] = {"floor": {"bodies": ["ground", "b"], "shapes": shapes}}
    with pytest.raises(SpecError, match="runs with rigid contacts do not support friction in joints"):
        mbdkit.run(rigid)


def test_friction_comes_back_from_to_spec_and_changes_the_compiled_mechanism() -> None:
    given = load_spec(spec_with(PIN)).mechanism()
    model = given.to_spec()
    assert model["joints"]["j"]["friction"] == {"coefficient": 0.1, "radius": 0.01}
    assert Mechanism.from_spec(model).to_spec() == model
    spec = spec_with({"type": "revolute", "friction": {"coefficient": 0.1, "radius": "10 mm"}})
    values = {"model.joints.j.friction.coefficient": np.array([0.1, 0.9, 0.0])}
    assert len(set(mbdkit.ensemble(spec, values).to_frame()["data_sha256"])) == 3


def test_a_coefficient_of_zero_is_kept_when_a_spec_is_written_again() -> None:
    # the comparison runs of `check` are made from a spec that is written out; without friction, the measure is exact
    m = Mechanism(gravity=(0.0, -9.81))
    m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("pin", m.ground, "rod", at=(0, 0), friction={"coefficient": 0.1, "radius": 0.01})
    model = m.to_spec()
    model["joints"]["pin"]["friction"]["coefficient"] = "mu"
    spec = {"mbdkit": 1, "parameters": {"mu": 0.0}, "model": model, "integrator": {"name": "rk4"}}
    run = mbdkit.run(spec, time={"end": 0.1, "step": 0.01}, measures={"last": "final(t)"}, check=True)
    assert run.measures["last"] == 0.1
    assert load_spec(run.spec).canonical_json() == load_spec(load_spec(run.spec).sections()).canonical_json()
