"""Singly diagonally implicit tableaus from the literature: order, stability, and stages solved one after the other."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import ButcherTableau, ImplicitRungeKutta
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.start import start_method
from mbdkit.methods import gauss
from mbdkit.methods.tableau import TableauError
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec
from tests.integrators.diagonal_tableaus import TABLEAUS
from tests.integrators.running import end_of

SWING = {"name": "double-pendulum", "angles": [-1.0, -0.4]}


def final(method: ImplicitRungeKutta, steps: int) -> np.ndarray:
    """Return positions and velocities of a double pendulum after 1 s."""
    time = {"end": 1.0, "step": 0.1}
    workspace = build(load_spec({"mbdkit": 1, "model": SWING, "integrator": {"name": "rk4"}, "time": time}))[0]
    table = Timetable(start=0.0, end=1.0, step=1.0 / steps, steps=steps, every=10**9, max_steps=10**7, single=False)
    return np.concatenate(end_of(start_method(method, workspace, table)))


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    """The end by Gauss with five stages, of order 10."""
    return final(ImplicitRungeKutta(gauss.tableau(5)), 200)


@pytest.mark.parametrize("name", TABLEAUS)
@pytest.mark.parametrize("solver", ["newton", "fixed-point"])
def test_the_order_of_the_literature_is_observed_on_the_double_pendulum(
    name: str, solver: Any, exact: np.ndarray
) -> None:
    tableau = TABLEAUS[name]
    assert tableau.is_diagonally_implicit
    assert not tableau.is_diagonalisable
    method = ImplicitRungeKutta(tableau, stage_solver=solver)
    coarse, fine = (float(np.max(np.abs(final(method, steps) - exact))) for steps in (50, 100))
    # margin: order, from errors of mbdkit alone
    assert math.log2(coarse / fine) == pytest.approx(tableau.order, abs=0.2)


def test_a_step_of_a_linear_oscillator_is_that_of_the_stability_function() -> None:
    """For x'' = -w^2 x, a step multiplies (x, v) by R(h J), whatever w is; here h w = 50, a stiff spring."""
    w, h = 5000.0, 0.01
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    ball = m.body("ball", mass=1.0, position=(0.1, 0.0))  # so near that no stage passes the anchor of the spring
    m.spring_damper("spring", m.ground, ball, from_=(-99.0, 0.0), to=(0.1, 0.0), stiffness=w * w, free_length=99.0)
    spec = load_spec(m, integrator={"name": "rk4"}, time={"end": h, "step": h})
    for tableau in TABLEAUS.values():
        workspace = build(spec)[0]
        table = Timetable(start=0.0, end=h, step=h, steps=1, every=1, max_steps=10, single=False)
        q, v = end_of(start_method(ImplicitRungeKutta(tableau), workspace, table))
        a, b, _ = tableau.floats()
        z, s = h * np.array([[0.0, 1.0], [-w * w, 0.0]]), tableau.stages
        stages = np.linalg.solve(np.eye(2 * s) - np.kron(a, z), np.kron(np.ones((s, 1)), np.eye(2)))
        growth = np.eye(2) + np.kron(b[None], z) @ stages
        assert (q[0], v[0]) == pytest.approx(growth @ [0.1, 0.0], rel=1e-6, abs=1e-6)


def test_work_is_booked_by_the_weights_of_the_method() -> None:
    m = mbdkit.Mechanism()
    wheel = m.body("wheel", mass=1.0, inertia=0.5)
    m.revolute("axle", m.ground, wheel, at=(0.0, 0.0))
    m.torque("motor", wheel, value="1 + t")
    spec = load_spec(m, integrator={"name": "rk4"}, time={"end": 1.0, "step": 0.01})
    workspace = build(spec)[0]
    table = Timetable(start=0.0, end=1.0, step=0.01, steps=100, every=10**9, max_steps=1000, single=False)
    stepper = start_method(ImplicitRungeKutta(TABLEAUS["sdirk-4"]), workspace, table)
    assert isinstance(stepper, StepHost)
    stretch = stepper.advance()
    while not stepper.finished:
        stretch = stepper.advance()
    rate = 2.0 * 1.5  # the integral of 1 + t, by the inertia
    assert stretch.v[-1, 2] == pytest.approx(rate, rel=1e-12)
    assert stretch.work[-1] == pytest.approx(0.25 * rate**2, rel=1e-9)


def test_formulations_that_it_cannot_solve_are_refused() -> None:
    table = Timetable(start=0.0, end=1.0, step=0.1, steps=10, every=1, max_steps=100, single=False)
    for formulation in ("index-3", "joint-coordinates"):
        spec = load_spec(
            {"mbdkit": 1, "model": SWING, "time": {"end": 1.0, "step": 0.1}, "formulation": formulation},
            integrator={"name": "radau-iia", "stages": 2},
        )
        with pytest.raises(TableauError, match=r"one after the other, which this formulation does not support"):
            start_method(ImplicitRungeKutta(TABLEAUS["alexander-2"]), build(spec)[0], table)
    jordan = ButcherTableau("odd", [["1/2", "1/2"], [0, "1/2"]], ["1/2", "1/2"], [1, "1/2"], 1)
    with pytest.raises(TableauError, match=r"is neither diagonalisable nor lower triangular"):
        ImplicitRungeKutta(jordan)
