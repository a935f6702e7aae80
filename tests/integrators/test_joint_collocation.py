"""Collocation methods with joint-coordinates: orders, motion and reactions, drift, stiff forces, refusals."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit.mechanism.mechanism import Mechanism
from tests.engine.random_mechanisms import flexible
from tests.integrators.pendulums_on_joints import JOINT, KINDS, forced_pendulum, lagrange
from tests.margins import assert_within

from .running import EPS, assert_same_end

RADAU: dict[str, Any] = {"name": "radau-iia"}


def driven_rods(stiffness: float = 4.0, damping: float = 0.3) -> Mechanism:
    """Return two rods of 1 m and 1 kg with a spring between them; a driver turns the first by 0.5 sin(2 t) - 1."""
    m = Mechanism()
    end, moving = np.zeros(2), np.zeros(2)
    for i, (angle, rate) in enumerate(((-1.0, 1.0), (-0.8, 1.0))):
        along = np.array([np.cos(angle), np.sin(angle)])
        turning = rate * np.array([-np.sin(angle), np.cos(angle)])
        place: dict[str, Any] = {"position": end + along / 2, "angle": angle}
        m.body(f"r{i}", mass=1.0, inertia=1 / 12, **place, velocity=moving + turning / 2, angular_velocity=rate)
        end, moving = end + along, moving + turning
    m.revolute("A", m.ground, "r0", points=((0, 0), (-0.5, 0)))
    m.revolute("B", "r0", "r1", points=((0.5, 0), (-0.5, 0)))
    m.driver("turn", m.ground, "r0", coordinate="angle", motion="0.5*sin(2*t) - 1")
    m.torsion_spring("spring", "r0", "r1", stiffness=stiffness, damping=damping, free_angle=0.2)
    return m


@cache
def second_rod(end: float, stiffness: float = 4.0, damping: float = 0.3) -> np.ndarray:
    """Return angle and rate of the second rod at a time, by its moment balance on the moving pin, solved by SciPy."""

    def rates(t: float, y: np.ndarray) -> list[float]:
        a, u, du = 0.5 * np.sin(2 * t) - 1.0, np.cos(2 * t), -2.0 * np.sin(2 * t)
        b, w = y
        couple = -stiffness * (b - a - 0.2) - damping * (w - u)
        moved = 0.5 * (np.cos(a - b) * du - np.sin(a - b) * u * u)
        return [w, (couple - 0.5 * 9.81 * np.cos(b) - moved) / (1 / 12 + 0.25)]

    return solve_ivp(rates, (0.0, end), [-0.8, 1.0], "Radau", rtol=1e-12, atol=1e-12).y[:, -1]


@pytest.mark.parametrize(
    ("integrator", "order"), [({"name": "gauss", "stages": 2}, 4), (RADAU, 5), ({"name": "gauss", "stages": 3}, 6)]
)
def test_methods_keep_their_order_with_a_driver(integrator: dict[str, Any], order: int) -> None:
    expected = second_rod(2.0)
    errors = []
    for n in (20, 40):
        run = mbdkit.run(driven_rods(), formulation=JOINT, integrator=integrator, time={"end": 2.0, "step": 2.0 / n})
        found = np.array([run.bodies["r1"].angle[-1], run.bodies["r1"].angular_velocity[-1]])
        errors.append(np.max(np.abs(found - expected)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize("kind", [*KINDS, "flexible"])
def test_motion_and_reactions_are_those_in_the_coordinates_of_the_bodies(kind: str) -> None:
    # expected: index-1 in absolute coordinates with the same method and steps, at which both have converged
    make, cut = (flexible, set()) if kind == "flexible" else KINDS[kind][:2]
    steps: dict[str, Any] = {"integrator": {**RADAU, "stages": 5}, "time": {"end": 0.05, "step": 0.0025}}
    ours, theirs = (mbdkit.run(make(np.random.default_rng(1)), formulation=one, **steps) for one in (JOINT, "index-1"))
    size = assert_same_end(ours, theirs)
    for name, mine in ours.joints.items():
        if name not in cut:
            assert np.max(mine.misalignment[1:]) <= 4 * EPS * size, name
            assert_within(mine.velocity_misalignment[1:], 1e-13 * size)


@pytest.mark.parametrize("stage_solver", ["newton", "fixed-point"])
def test_adaptive_rows_events_and_measures_are_on_the_joints(stage_solver: str) -> None:
    # expected: Lagrange's equations by DOP853 at 1e-12
    run = mbdkit.run(
        forced_pendulum(),
        formulation=JOINT,
        integrator={"name": "gauss", "stages": 3, "adaptive": True, "rtol": 1e-9, "stage_solver": stage_solver},
        time={"end": 2.0},
        output={"interval": 0.013},
        events={"down": {"when": "bodies.r0.angle + pi/2"}},
        measures={"square": "integral(bodies.r0.angle**2)", "place": "at(bodies.r1.angle, 0.777)"},
    )
    assert max(float(np.max(joint.misalignment)) for joint in run.joints.values()) <= 4 * EPS * 2.0
    found = solve_ivp(
        lambda t, y: [*lagrange(t, y[:4]), y[0] ** 2], (0.0, 2.0), [-1.0, -0.4, 0.0, 0.0, 0.0], "DOP853",
        rtol=1e-12, atol=1e-12, dense_output=True, events=lambda t, y: y[0] + np.pi / 2,
    )  # fmt: skip
    np.testing.assert_allclose(run.events.of_name("down").time, found.t_events[0], atol=1e-7)
    assert run.measures["square"] == pytest.approx(found.y[4, -1], abs=1e-7)
    assert run.measures["place"] == pytest.approx(found.sol(0.777)[1], abs=1e-7)
    angles = np.column_stack([run.bodies[name].angle for name in ("r0", "r1")])
    np.testing.assert_allclose(angles, found.sol(run.time)[:2].T, atol=1e-7)


@pytest.mark.parametrize("integrator", [RADAU, {"name": "gauss"}, {**RADAU, "adaptive": True, "rtol": 1e-6}])
def test_stiff_springs_allow_steps_far_beyond_the_stability_of_explicit_methods(integrator: dict[str, Any]) -> None:
    # 1e6 N m/rad and 1e4 N m s/rad damp the second rod at 4e4/s, so that rk4 would need steps below 7e-5 s
    stiff = {"stiffness": 1e6, "damping": 1e4}
    step = {} if integrator.get("adaptive") else {"step": 0.05}
    run = mbdkit.run(driven_rods(**stiff), formulation=JOINT, integrator=integrator, time={"end": 1.0, **step})
    run.check()
    assert run.bodies["r1"].angle[-1] == pytest.approx(second_rod(1.0, **stiff)[0], abs=3e-5)
    assert run.stats["newton_iterations"] <= 8 * run.stats["steps"] + 8 * run.stats["rejected"]


def test_first_order_states_act_in_joint_coordinates() -> None:
    # expected: index-1 in absolute coordinates, with the same method
    m = forced_pendulum()
    m.state("z", rate="bodies.r1.angle - states.z*bodies.r0.angular_velocity", initial=0.3)
    m.torque("feedback", "r1", value="3*states.z")
    runs = [
        mbdkit.run(m, formulation=one, integrator={**RADAU, "stages": 5}, time={"end": 0.5, "step": 0.025})
        for one in (JOINT, "index-1")
    ]
    ours, theirs = ((run.states["z"].value[-1], run.bodies["r1"].angle[-1]) for run in runs)
    assert ours == pytest.approx(theirs, abs=1e-10)
