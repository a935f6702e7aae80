"""The formulas have their orders on a driven, damped loop, and runs meet published digits within a few tolerances."""

from __future__ import annotations

import math
import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.testing import conformance
from mbdkit_multistep.adams import Adams, AdamsOptions, derivative, integral
from mbdkit_multistep.bdf import Bdf, BdfOptions, end_derivative

#: beta, Theta, gamma, Phi, delta, Omega, epsilon of Andrews' squeezing mechanism at t = 0.03 s, in the Test Set for IVP
#: Solvers (Mazzia and Magherini 2008): digits of a solution of order 16 in minimal coordinates with 80-bit numbers. The
#: published ones, 15.81077119629904 for beta, belong to a time that differs by 1e-12 s.
END = (15.81077119515371776, -15.7563710584118527, 0.040822240119645908, -0.53473011634207941, 0.524409965879954074,
       0.534730116342079413, 1.048080741041937875)  # fmt: skip
#: The car axis of the same test set at t = 3 s: xl, yl, xr, yr, refined by two formulations with 34 digits that agree
#: to 3e-26; the published ones hold to 5e-12.
AXIS_END = (0.04934557842752409213, 0.49698946023000810671, 1.04174252488542611519, 0.37391102726536581936)
FORMULATIONS = ("index-1", "index-2", "ggl")
BEFORE_CHANGES = 10**6  # steps before the order may change


def four_bar() -> mbdkit.Mechanism:
    """Return a loop of three bars with a torque that depends on time, and a spring and damper across it."""
    m = mbdkit.Mechanism()
    m.body("crank", mass=1.0, inertia=0.1, position=(0.0, 0.25), angle=math.pi / 2)
    m.body("coupler", mass=2.0, inertia=0.3, position=(0.6, 0.75), angle=math.atan2(0.5, 1.2))
    m.body("rocker", mass=1.5, inertia=0.2, position=(1.2, 0.5), angle=math.pi / 2)
    m.revolute("A", m.ground, "crank", at=(0.0, 0.0))
    m.revolute("B", "crank", "coupler", at=(0.0, 0.5))
    m.revolute("C", "coupler", "rocker", at=(1.2, 1.0))
    m.revolute("D", m.ground, "rocker", at=(1.2, 0.0))
    m.torque("drive", "crank", value="8*sin(5*t)")
    m.spring_damper(
        "s", "crank", "rocker", points=((0.25, 0.0), (0.0, 0.0)), stiffness=40.0, damping=1.5, free_length=1
    )
    return m


LOOP = {"mbdkit": 1, "model": four_bar().to_spec()}


def run(source: Any, end: float, integrator: dict[str, Any], **sections: Any) -> mbdkit.Run:
    sections = {"time": {"end": end}, "output": {"every": 10**9}} | sections
    return mbdkit.run(source, integrator=integrator, **sections).check()


@cache
def reference() -> tuple[np.ndarray, np.ndarray]:
    """Return (161, 18) positions and velocities of the loop at multiples of 0.0025 s, and (161, 8) multipliers, by
    Gauss-6 on the index-1 equations, in a quarter of the step that suffices for 1e-13.
    """
    there = run(LOOP, 0.4, {"name": "gauss", "stages": 6}, time={"end": 0.4, "step": 0.0025}, output={"every": 1})
    states = [there.array(f"trajectory/{name}").reshape(161, 9) for name in ("position", "velocity")]
    return np.hstack(states), there.array("constraints/multiplier")


def exact_memory(kind: str, order: int, at: int, each: int) -> mbdkit.StepState:
    """Return the state of the loop at row `at` of the reference, with every `each`-th row before it as history."""
    (y, lam), back = reference(), slice(at, None, -each)
    times, past = 0.0025 * np.arange(len(y))[back], np.hstack([y, lam])[back]
    if kind == "adams":
        equations, rows = mbdkit.EquationsOfMotion.of(four_bar()), zip(times, y[back], strict=True)
        past = np.array([derivative(equations, t, *np.split(x, 2), np.zeros(0)) for t, x in rows])
    return mbdkit.StepState(*np.split(y[at], 2), lam[at], (order, BEFORE_CHANGES, times, past))


def largest_errors(method: Bdf | Adams, h: float, formulation: str, order: int) -> np.ndarray:
    """Return the largest errors of positions, velocities and multipliers from 0.12 to 0.4 s, in steps of one size by a
    formula of one order, from an exact history.
    """
    equations, each, at = mbdkit.EquationsOfMotion.of(four_bar()), round(h / 0.0025), 48
    equations.formulation = formulation
    state, errors = exact_memory("bdf" if isinstance(method, Bdf) else "adams", order, at, each), np.zeros(3)
    y, lam = reference()
    while at < len(y) - 1:
        state = method.step(equations, 0.0025 * at, state, h).state
        at += each
        own = lam[at] if state.multipliers is None else state.multipliers
        pairs = zip((state.q, state.v, own), (*np.split(y[at], 2), lam[at]), strict=True)
        errors = np.maximum(errors, [np.abs(x - exact).max() for x, exact in pairs])
    return errors


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_bdf_has_its_order_in_positions_velocities_and_multipliers(formulation: str, order: int) -> None:
    # expected: Brenan, Campbell and Petzold (1996), theorems 3.2.1 and 4.4.1, for index 1 and semi-explicit index 2
    method = Bdf(BdfOptions(max_order=order, rtol=1e-11))
    coarse, fine = (largest_errors(method, h, formulation, order) for h in (0.005, 0.0025))
    assert np.all(np.log2(coarse / fine) > order - 0.25)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6])
def test_adams_has_the_order_of_its_corrector(order: int) -> None:
    # expected: order + 1, by local extrapolation; Hairer, Norsett and Wanner (1993), III.1 and III.2
    method = Adams(AdamsOptions(rtol=1e-3, atol=1e3))  # accepts every step
    coarse, fine = (largest_errors(method, h, "index-1", order)[:2] for h in (0.01, 0.005))
    assert np.all(np.log2(coarse / fine) > order + 1 - 0.25)


@pytest.mark.parametrize(("kind", "order"), [("bdf", 1), ("bdf", 3), ("bdf", 5), ("adams", 3)])
def test_dense_output_has_the_order_of_the_formula(kind: str, order: int) -> None:
    # expected: errors inside one step from an exact history are of order k + 1 in h, those of Adams of order k + 2
    method = Bdf(BdfOptions(rtol=1e-12)) if kind == "bdf" else Adams(AdamsOptions())
    (states, _), at, errors = reference(), 120, []
    for each in (4, 2):
        equations, h, state = (
            mbdkit.EquationsOfMotion.of(four_bar()),
            0.0025 * each,
            exact_memory(kind, order, at, each),
        )
        step = method.step(equations, 0.0025 * at, state, h)
        assert step.dense is not None
        inside = np.concatenate(step.dense(0.5))
        errors.append(np.abs(inside - states[at + each // 2]).max())
        ends = [np.concatenate(step.dense(share)) for share in (0.0, 1.0)]
        np.testing.assert_allclose(ends[0], states[at], rtol=0, atol=1e-13)
        np.testing.assert_allclose(ends[1], np.concatenate([step.state.q, step.state.v]), rtol=0, atol=1e-9)
    assert math.log2(errors[0] / errors[1]) > order + (1 if kind == "bdf" else 2) - 0.4


def test_weights_are_those_of_constant_steps_in_the_books() -> None:
    # expected: Hairer, Norsett and Wanner (1993), III.1: (1.22'), the formulas of order 3, (1.5) and (1.9)
    h, t = 0.1, 2.0
    backwards = t + h - h * np.arange(4)
    np.testing.assert_allclose(h * end_derivative(backwards), [11 / 6, -3, 3 / 2, -1 / 3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(integral(backwards[1:], t, h) / h, [23 / 12, -16 / 12, 5 / 12], rtol=0, atol=1e-12)
    np.testing.assert_allclose(integral(backwards[:3], t, h) / h, [5 / 12, 8 / 12, -1 / 12], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "formulation", "factors"),
    [
        ("adams", "index-1", (3, 10)),
        ("bdf", "ggl", (5, 20)),
        pytest.param("bdf", "index-1", (20, 200), marks=pytest.mark.slow),
        pytest.param("bdf", "index-2", (5, 20), marks=pytest.mark.slow),
    ],
)
def test_runs_end_at_the_digits_of_the_test_set(name: str, formulation: str, factors: tuple[float, float]) -> None:
    # expected: the refined digits of Andrews' mechanism and of the car axis, to so many tolerances
    rtol = 1e-5
    integrator = {"name": name, "rtol": rtol, "atol": rtol}
    mine = run("andrews-squeezer", 0.03, integrator, formulation=formulation)
    k1, k2, k3, k4, k5, k6, k7 = (float(mine[f"K{i}"].angle[-1]) for i in range(1, 8))
    angles = np.array([k1, k2 - k1, k3, k4 - k5, k5, k6 - k7, k7])
    # margin: error at this tolerance
    np.testing.assert_allclose((angles - END) / (1 + np.abs(END)), 0.0, rtol=0, atol=factors[0] * rtol)
    axis = run("car-axis", 3.0, integrator, formulation=formulation)
    end = np.concatenate([np.asarray(axis[side].position)[-1] for side in ("left", "right")])
    np.testing.assert_allclose(end, AXIS_END, rtol=0, atol=factors[1] * rtol)  # margin: error at this tolerance
    if formulation == "ggl":
        for level in ("position", "velocity"):
            np.testing.assert_allclose(mine.array(f"constraints/{level}_residual")[-1], 0.0, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("name", "formulation"), [("adams", "index-1"), ("bdf", "ggl")])
def test_pendulum_of_the_iftomm_benchmark_is_where_elliptic_functions_put_it(name: str, formulation: str) -> None:
    # expected: problem A01 of the library of the IFToMM committee for multibody dynamics, in exact elliptic functions;
    # 100 tolerances after four periods
    m = mbdkit.Mechanism()
    m.body("mass", mass=1.0, position=(1.0, 0.0))
    m.distance("link", m.ground, "mass", points=((0, 0), (0, 0)), length=1.0)
    integrator = {"name": name, "rtol": 1e-6, "atol": 1e-6}
    mine = run({"mbdkit": 1, "model": m.to_spec()}, 10.0, integrator, formulation=formulation)
    # margin: error at this tolerance
    np.testing.assert_allclose(
        np.asarray(mine["mass"].position)[-1], [0.275087462576116860, -0.961419205099125064], rtol=0, atol=1e-4
    )


@pytest.mark.parametrize("method", [Bdf(BdfOptions()), Adams(AdamsOptions())])
def test_going_on_from_a_pickled_state_is_the_same_to_the_bit(method: Bdf | Adams) -> None:
    equations, others = mbdkit.EquationsOfMotion.of(four_bar()), mbdkit.EquationsOfMotion.of(four_bar())
    state, kept, t, h = mbdkit.StepState(equations.q0, equations.v0), b"", 0.0, 1e-5
    for k in range(60):
        kept = pickle.dumps((state, t, h)) if k == 40 else kept
        step = method.step(equations, t, state, h)
        if step.accepted:
            state, t = step.state, t + h
        h = step.next_step
    other, t, h = pickle.loads(kept)
    for _ in range(40, 60):
        step = method.step(others, t, other, h)
        if step.accepted:
            other, t = step.state, t + h
        h = step.next_step
    assert state.memory[0] > 3
    assert np.array_equal(state.q, other.q)
    assert np.array_equal(state.v, other.v)


def test_iterations_of_a_rejected_first_step_are_in_the_first_row() -> None:
    mine = run(LOOP, 0.2, {"name": "bdf"}, time={"end": 0.2, "step": 0.1}, output={"every": 1}, formulation="ggl")
    assert mine.stats["rejected"] > 0
    assert np.sum(mine.array("steps/iterations")) == mine.stats["newton_iterations"]


@pytest.mark.slow
@conformance(integrator="bdf")
def test_bdf_conforms(case: Any) -> None:
    case()


@pytest.mark.slow
@conformance(integrator="adams")
def test_adams_conforms(case: Any) -> None:
    case()
