"""Orders, energy, constraints and published digits of the discrete gradient and of HBVM(k, s)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import cos, sin
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.spec import load_spec
from mbdkit_energy.line_integral import LineIntegral, polynomials

METHODS: dict[str, dict[str, Any]] = {
    "discrete gradient": {"name": "discrete-gradient"},
    "HBVM(8, 1)": {"name": "hbvm", "s": 1},
    "HBVM(8, 2)": {"name": "hbvm", "s": 2},
    "HBVM(8, 3)": {"name": "hbvm", "s": 3},
}
every_method = pytest.mark.parametrize("method", METHODS)


def two_rods(*, driven: bool = False) -> mbdkit.Mechanism:
    """Return two rods and a spring, with a free length, from the end of the second one to ground.

    If it is driven, a motor turns the first rod and the spring is damped.
    """
    m = mbdkit.Mechanism()
    m.body("a", mass=1.0, inertia=1 / 12, position=(0.5, 0.0))
    m.body("b", mass=0.7, inertia=0.05, position=(1.0, -0.4), angle=-1.57)
    m.revolute("A", m.ground, "a", points=((0.0, 0.0), (-0.5, 0.0)))
    m.revolute("B", "a", "b", points=((0.5, 0.0), (-0.4, 0.0)))
    if driven:
        m.driver("motor", m.ground, "a", coordinate="angle", motion="0.4*sin(2*t) - 0.1*t**2")
    points, damping = ((0.0, 2.5), (0.4, 0.0)), 1.0 if driven else 0.0
    m.spring_damper("s", m.ground, "b", points=points, stiffness=20.0, damping=damping, free_length=2.0)
    return m


def slider_crank() -> mbdkit.Mechanism:
    """Return a slider-crank, which is a closed loop, under a torque that depends on time, with a damped slider."""
    m, crank, rod = mbdkit.Mechanism(), 0.3, 0.9
    height = crank * sin(1.0)
    tilt = -np.arcsin(height / rod)
    end = crank * cos(1.0) + rod * cos(tilt)
    m.body("crank", mass=1.0, inertia=0.01, position=(crank / 2 * cos(1.0), crank / 2 * sin(1.0)), angle=1.0)
    m.body("rod", mass=0.8, inertia=0.06, position=(end - rod / 2 * cos(tilt), height / 2), angle=tilt)
    m.body("slider", mass=0.5, inertia=0.01, position=(end, 0.0))
    m.revolute("A", m.ground, "crank", at=(0.0, 0.0))
    m.revolute("B", "crank", "rod", at=(crank * cos(1.0), height))
    m.revolute("C", "rod", "slider", at=(end, 0.0))
    m.prismatic("D", m.ground, "slider", at=(0.0, 0.0), axis=(1.0, 0.0))
    m.torque("drive", "crank", value="3 + 2*sin(7*t)")
    m.spring_damper("s", m.ground, "slider", points=((2.0, 0.3), (0.0, 0.0)), stiffness=15.0, damping=2.0)
    return m


MECHANISMS = {"driven rods": lambda: two_rods(driven=True), "slider-crank": slider_crank}


def run(model: Any, integrator: dict[str, Any], steps: int, end: float = 0.4) -> mbdkit.Run:
    formulation = "index-1" if integrator["name"] == "gauss" else "index-3"
    spec = {"mbdkit": 1, "model": model, "formulation": formulation, "integrator": integrator}
    return mbdkit.run(spec | {"time": {"end": end, "step": end / steps}, "output": {"every": steps // 10}}).check()


@cache
def reference(mechanism: str) -> mbdkit.Run:
    """Return the motion computed by Gauss-5 on the index-1 equations, with an error far below those of the tests."""
    return run(MECHANISMS[mechanism]().to_spec(), {"name": "gauss", "stages": 5}, 80)


@pytest.mark.parametrize("mechanism", MECHANISMS)
@every_method
def test_driven_and_damped_motions_and_their_energy_balance_converge_with_the_claimed_order(
    method: str, mechanism: str
) -> None:
    # expected: orders of Gonzalez (1996), and of Gauss collocation with projected ends (Ascher and Petzold 1991)
    there, model, integrator = reference(mechanism), MECHANISMS[mechanism]().to_spec(), METHODS[method]
    order = 2 * integrator.get("s", 1)
    runs = [run(model, integrator, steps) for steps in {2: (80, 160), 4: (40, 80), 6: (20, 40)}[order]]
    pairs = (
        ("trajectory/position", "trajectory/position"),
        ("trajectory/velocity", "trajectory/velocity"),
        ("constraints/method_multiplier", "constraints/multiplier"),
    )
    for mine, theirs in pairs:
        errors = [np.abs(each.array(mine) - there.array(theirs)).max() for each in runs]
        assert np.log2(errors[0] / errors[1]) > order - 0.3, (mine, errors)
    unbalanced = [np.abs(each.array("energy/balance")).max() for each in runs]
    # the work is integrated along the dense output, the velocity of which is of order 5 in the interior of a step
    assert np.log2(unbalanced[0] / unbalanced[1]) > min(order, 5) - 0.3, unbalanced
    for each in runs:
        np.testing.assert_allclose(each.misalignment_max, 0.0, rtol=0, atol=1e-14)
        np.testing.assert_allclose(each.array("constraints/velocity_residual")[1:], 0.0, rtol=0, atol=1e-13)


def change_of_energy(model: mbdkit.Mechanism, method: LineIntegral, h: float, steps: int) -> float:
    """Return the largest change of the energy in steps of size `h` [s], as a share of the largest kinetic energy."""
    p = mbdkit.EquationsOfMotion.of(model)
    state = mbdkit.StepState(p.q0, p.v0)
    state = replace(state, memory=method.begin(p, 0.0, state, "start"))
    total, change, largest = p.potential(0.0, p.q0) + p.kinetic(p.v0), 0.0, 0.0
    for i in range(steps):
        state = method.step(p, i * h, state, h).state
        kinetic = p.kinetic(state.v)
        change, largest = max(change, abs(p.potential(0.0, state.q) + kinetic - total)), max(largest, kinetic)
    return change / largest


DISCRETE_GRADIENT = LineIntegral(1, 1, 50, is_corrected=True)


def rods_on_a_nonlinear_spring() -> mbdkit.Mechanism:
    """Return two rods and a spring that hardens, from a table of forces."""
    m = mbdkit.Mechanism()
    m.body("a", mass=1.0, inertia=1 / 12, position=(0.5, 0.0))
    m.body("b", mass=0.7, inertia=0.05, position=(1.0, -0.4), angle=-1.57)
    m.revolute("A", m.ground, "a", points=((0.0, 0.0), (-0.5, 0.0)))
    m.revolute("B", "a", "b", points=((0.5, 0.0), (-0.4, 0.0)))
    table = [[0.5, 1.0, 1.8, 2.6, 3.4, 4.5], [-60.0, -20.0, -3.0, 5.0, 30.0, 150.0]]
    m.law("s", m.ground, "b", law="table", from_=(0.0, 2.5), to=(0.4, 0.0), table=table)
    return m


@pytest.mark.parametrize(
    ("method", "model"),
    [(DISCRETE_GRADIENT, rods_on_a_nonlinear_spring), (LineIntegral(8, 2, 50), two_rods)],
    ids=["discrete gradient", "HBVM(8, 2)"],
)
@pytest.mark.parametrize("steps", [500, pytest.param(100_000, marks=pytest.mark.slow)])
def test_the_energy_of_rods_with_joints_changes_by_rounding_errors_only(
    method: LineIntegral, model: Any, steps: int
) -> None:
    # expected: Gonzalez (1999) and Brugnano, Gurioli, Iavernaro and Weinmueller (2018)
    np.testing.assert_allclose(change_of_energy(model(), method, 0.01, steps), 0.0, rtol=0, atol=1e-12)


def test_the_midpoint_rule_and_too_few_nodes_lose_energy_where_the_methods_do_not() -> None:
    for loses, conserves in (
        (LineIntegral(1, 1, 50), DISCRETE_GRADIENT),
        (LineIntegral(2, 2, 50), LineIntegral(10, 2, 50)),
    ):
        assert change_of_energy(two_rods(), loses, 0.05, 40) > 1e-7
        np.testing.assert_allclose(change_of_energy(two_rods(), conserves, 0.05, 40), 0.0, rtol=0, atol=1e-12)


def pinned_pair(kind: str, tilt: float, torque: float, stiffness: float) -> mbdkit.Mechanism:
    """Return two bodies that are pinned at their centres and joined by a gear or belt; nothing but angles changes."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    place = 0.3 * cos(tilt), 0.3 * sin(tilt)
    m.body("a", mass=1.0, inertia=0.01)
    m.body("b", mass=1.0, inertia=0.02, position=place)
    m.revolute("A", m.ground, "a", at=(0.0, 0.0))
    m.revolute("B", m.ground, "b", at=place)
    if kind == "gear":
        m.gear("G", "a", "b", radii=(0.1, 0.2))
    else:
        m.belt("G", "a", "b", radii=(0.05, 0.1))
    m.torque("T", "a", value=torque)
    if stiffness:
        m.torsion_spring("K", m.ground, "a", stiffness=stiffness)
    return m


@pytest.mark.parametrize(
    ("kind", "tilt", "torque", "stiffness"),
    [("gear", 0.0, 1.0, 0.0), ("gear", 0.7, 100.0, 0.0), ("belt", -2.0, 1e-3, 0.0), ("gear", 2.0, 1.0, 1.5)],
)
@every_method
def test_pairs_whose_centres_are_pinned_turn_as_one_degree_of_freedom(
    method: str, kind: str, tilt: float, torque: float, stiffness: float
) -> None:
    # expected: the inertia of both bodies, the second at half the speed; velocities in x and y are rounding errors
    found = run(pinned_pair(kind, tilt, torque, stiffness).to_spec(), METHODS[method], 50)
    inertia, rate = 0.015, np.sqrt(stiffness / 0.015)
    time = found.time
    angle = torque / stiffness * (1 - np.cos(rate * time)) if stiffness else torque / inertia * time**2 / 2
    accuracy = {1: 5e-3, 2: 5e-6, 3: 1e-8}[METHODS[method].get("s", 1)] if stiffness else 1e-11
    np.testing.assert_allclose(found["a"].angle, angle, rtol=0, atol=accuracy * np.abs(angle).max())


@pytest.mark.parametrize("s", [1, 2, 3])
def test_hbvm_with_as_many_nodes_as_coefficients_is_the_gauss_method(s: int) -> None:
    # expected: mbdkit's Gauss methods (Brugnano and Iavernaro, Line Integral Methods, 2016, chapter 3)
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("ball", mass=1.0, inertia=0.1, position=(1.0, 0.0), velocity=(0.0, 0.7))
    m.spring_damper("s", m.ground, "ball", points=((0.0, 0.0), (0.0, 0.0)), stiffness=2.0, free_length=0.3)
    there = run(m.to_spec(), {"name": "gauss", "stages": s}, 10, end=2.0)
    p, method = mbdkit.EquationsOfMotion.of(m), LineIntegral(s, s, 50)
    state = mbdkit.StepState(p.q0, p.v0)
    state = replace(state, memory=method.begin(p, 0.0, state, "start"))
    for i in range(10):
        state = method.step(p, 0.2 * i, state, 0.2).state
    np.testing.assert_allclose(state.q, there.array("trajectory/position")[-1].ravel(), rtol=0, atol=1e-13)


def test_the_modes_of_the_iteration_diagonalise_the_coupling() -> None:
    for s in (1, 2, 3):
        p = polynomials(8, s)
        total = sum((root * np.outer(right, left)).real for root, right, left in p.modes)
        np.testing.assert_allclose(total, p.coupling, rtol=0, atol=3e-15)
        weighted = p.weights[:, None] * p.values
        np.testing.assert_allclose(weighted.T @ p.integrals, p.coupling, rtol=0, atol=3e-15)


def test_the_car_axis_ends_at_the_published_positions() -> None:
    # expected: Test Set for IVP Solvers, problem "Car axis", at t = 3, in its packaged form
    settings = ["formulation=index-3", "integrator={name: hbvm, s: 3}", "time={end: 3.0, step: 0.005}"]
    result = mbdkit.run(load_spec("car-axis", settings)).check()
    ends = np.concatenate([result["left"].position[-1], result["right"].position[-1]])
    there = [0.0493455784275, 0.4969894602300, 1.0417425248854, 0.3739110272654]
    np.testing.assert_allclose(ends, there, rtol=0, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["discrete gradient", "HBVM(8, 1)"])  # others have a lower order with joint friction
def test_the_conformance_kit_passes(method: str) -> None:
    import mbdkit.testing

    options = dict(METHODS[method])
    report = mbdkit.testing.check_integrator(f"mbdkit-energy:{options.pop('name')}", options)
    assert report.verified, report.text()
    assert not report.of("warn"), report.text()
