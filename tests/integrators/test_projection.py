"""Steps, written in Python above all, are projected as a spec asks: nearest, counted, symmetric if wanted."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import EquationsOfMotion, StepError, StepMethod, StepState
from mbdkit.engine.stabilization import Stabilization
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.start import start_method
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec
from tests.engine.linkages_in_sympy import parallelogram
from tests.margins import assert_within
from tests.slow_cases import slow

from .running import DOUBLE, driven_chain, spec_run
from .step_methods import Remembering, RungeKutta, run_with

PROJECTION = {"name": "projection"}
SYMMETRIC = {"name": "projection", "symmetric": True}
ROUND_OFF = 1e-13
MODELS = {"double pendulum": DOUBLE, "driven chain": driven_chain(), "spare crank": parallelogram(1.0, cranks=3)}
models = pytest.mark.parametrize("name", MODELS)


class Midpoint(StepMethod):
    """The implicit midpoint rule: symmetric, of order 2."""

    def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
        a, before = np.zeros(equations.n), np.inf
        for _ in range(200):
            v = state.v + h / 2 * a
            new, _ = equations.accelerations(t + h / 2, state.q + h / 2 * v, v)
            change = np.abs(new - a).max()
            a = new
            if change == 0 or (change >= before and change < 1e-9):
                return state.moved(h * (state.v + h / 2 * a), h * a)
            before = change
        raise StepError("newton-failed", "the midpoint was not found")


def residuals(run: mbdkit.Run) -> float:
    return float(max(np.abs(run.array(f"constraints/{x}_residual")).max() for x in ("position", "velocity")))


@models
@pytest.mark.parametrize("stabilization", [PROJECTION, SYMMETRIC], ids=["plain", "symmetric"])
def test_every_projected_state_meets_the_joints_to_round_off(name: str, stabilization: Any) -> None:
    time = {"end": 0.507, "step": 0.01}
    free, held = (run_with(Midpoint(), MODELS[name], time, stabilization=x).check() for x in ("none", stabilization))
    assert residuals(held) < ROUND_OFF < 1e-6 < residuals(free)
    assert held.misalignment_max < ROUND_OFF  # over every step, what is not projected yet is no state
    np.testing.assert_array_equal(held.steps.projections, 1)
    assert held.stats["projections"] == held.stats["steps"] == 51
    assert np.all(held.steps.position_correction > 0)
    assert np.all(held.steps.velocity_correction > 0)
    assert free.records("steps/projections") is False
    off = np.abs(held.array("trajectory/position") - free.array("trajectory/position")).max()
    assert 0 < off < 0.05


@pytest.mark.parametrize("name", ["dopri5", "dop853", "gauss", "radau-iia"])
@pytest.mark.parametrize("adaptive", [False, True], ids=["fixed", "adaptive"])
def test_projected_states_between_steps_meet_the_joints_too(name: str, adaptive: bool) -> None:
    time = {"end": 1.0} if adaptive else {"end": 1.0, "step": 0.05}
    integrator: dict[str, Any] = {"name": name} | ({"adaptive": True, "rtol": 1e-6} if adaptive else {})
    held = spec_run(DOUBLE, integrator, time, stabilization="projection", output={"interval": 0.013}).check()
    assert len(held.time) == 78
    assert held.stats["steps"] < 70
    assert residuals(held) < ROUND_OFF
    fine = spec_run(DOUBLE, {"name": "dop853"}, {"end": 1.0, "step": 1e-3}, output={"every": 13}).check()
    shift = np.abs(held.array("trajectory/position") - fine.array("trajectory/position"))
    assert_within(shift, 1e-4)


@models
def test_a_projected_state_is_the_nearest_one_in_the_mass_metric(name: str) -> None:
    # expected: M (p - q) is a combination of the constraints' gradients at p, and so M (w - v) at p for velocities
    found: list[tuple[StepState, StepState]] = []

    class Watching(RungeKutta):
        def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
            new = super().step(equations, t, state, h)
            found.append((state, new))
            return new

    run_with(Watching(), MODELS[name], {"steps": 2, "step": 0.05}, stabilization=PROJECTION).check()
    p = (
        EquationsOfMotion.of(MODELS[name])
        if isinstance(MODELS[name], mbdkit.Mechanism)
        else EquationsOfMotion(workspace_of(DOUBLE))
    )
    made, reached = found[0][1], found[1][0]
    gradients = p.constraint_jacobian(0.05, reached.q).toarray().T
    for moved in (p.mass * (reached.q - made.q), p.mass * (reached.v - made.v)):
        left = moved - gradients @ np.linalg.lstsq(gradients, moved, rcond=None)[0]
        assert np.abs(moved).max() > 1e-9
        assert_within(left, 1e-12)


def workspace_of(model: Any, stabilization: Stabilization | None = None) -> Workspace:
    sections = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}}
    spec = load_spec(model, (), **sections) if isinstance(model, mbdkit.Mechanism) else None
    spec = spec or load_spec({"mbdkit": 1, "model": model, **sections}, ())
    return replace(build(spec)[0], stabilization=stabilization or Stabilization())


def defect(method: StepMethod, stabilization: Stabilization) -> float:
    """Return how far a run there and back ends from its start."""
    start, q, v = workspace_of(DOUBLE, stabilization), np.zeros(0), np.zeros(0)
    now = start
    for _ in range(2):
        stepper = start_method(method, now, Timetable(0.0, 2.0, step=0.01, steps=200))
        while not (stepper.finished or stepper.failure):
            stretch = stepper.advance()
            q, v = stretch.q[-1], stretch.v[-1]
        assert stepper.failure is None
        now = replace(start, q0=q.copy(), v0=-v)
    return float(max(np.abs(q - start.q0).max(), np.abs(v + start.v0).max()))


def test_symmetric_projection_keeps_a_symmetric_method_reversible_and_plain_projection_does_not() -> None:
    # expected: Hairer 2000, BIT 40
    assert_within(defect(Midpoint(), Stabilization()), 1e-12)
    assert_within(defect(Midpoint(), Stabilization("projection", symmetric=True)), 1e-12)
    assert defect(Midpoint(), Stabilization("projection")) > 1e-6


@pytest.mark.parametrize("stabilization", [PROJECTION, SYMMETRIC], ids=["plain", "symmetric"])
def test_projection_keeps_the_order_of_a_method(stabilization: Any) -> None:
    ends = [
        run_with(Midpoint(), driven_chain(), {"end": 0.5, "step": step}, stabilization=stabilization)
        .check()
        .array("trajectory/position")[-1]
        for step in (0.02, 0.01, 0.005)
    ]
    first, second = (np.abs(a - b).max() for a, b in pairwise(ends))
    assert np.log2(first / second) == pytest.approx(2, abs=0.2)  # margin: order, from errors of mbdkit alone


def test_every_k_steps_means_every_kth_step_counted_from_the_start() -> None:
    time = {"steps": 10, "step": 0.01}
    run = run_with(RungeKutta(), DOUBLE, time, stabilization={"name": "projection", "every": 4}).check()
    np.testing.assert_array_equal(run.steps.projections, [0, 0, 0, 1, 0, 0, 0, 1, 0, 0])
    np.testing.assert_array_equal(run.steps.position_correction > 0, run.steps.projections)
    off = np.abs(run.array("constraints/position_residual")).max(axis=1)
    assert np.all(off[[4, 8]] < ROUND_OFF)
    assert np.all(off[[3, 7, 10]] > 10 * ROUND_OFF)
    rows = run_with(RungeKutta(), DOUBLE, time, stabilization={"name": "projection", "every": 4}, output={"every": 3})
    np.testing.assert_array_equal(rows.check().steps.projections, [0, 1, 1, 0])


def test_with_a_bound_a_state_is_left_alone_until_it_is_off_by_more() -> None:
    bound = 1e-7
    time = {"end": 2.0, "step": 0.01}
    run = run_with(RungeKutta(), DOUBLE, time, stabilization={"name": "projection", "bound": bound}).check()
    made = run.steps.projections
    assert 0 < made.sum() < 150
    off = np.maximum(*(np.abs(run.array(f"constraints/{x}_residual")).max(axis=1) for x in ("position", "velocity")))
    assert np.all(off <= bound)
    assert np.all(off[1:][made == 1] < ROUND_OFF)
    assert np.all(off[1:][made == 0] > ROUND_OFF)


@pytest.mark.parametrize("stabilization", [PROJECTION, SYMMETRIC], ids=["plain", "symmetric"])
def test_work_is_that_of_the_steps_and_projection_shows_in_the_balance(stabilization: Any) -> None:
    class Booking(RungeKutta):
        def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
            new = super().step(equations, t, state, h)
            return replace(new, work=2 * h, dissipated=3 * h)

    run = run_with(Booking(), driven_chain(), {"steps": 20, "step": 0.01}, stabilization=stabilization).check()
    np.testing.assert_allclose(run.energy.work, 2 * run.time, atol=1e-15)
    np.testing.assert_allclose(run.energy.dissipated, 3 * run.time, atol=1e-15)


def test_multipliers_and_memory_are_handed_on_as_the_method_made_them() -> None:
    run = run_with(Remembering(), DOUBLE, {"steps": 6, "step": 0.01}, stabilization=PROJECTION).check()
    np.testing.assert_array_equal(run.array("constraints/method_multiplier")[1:, 0], np.arange(1, 7))


def test_baumgarte_reaches_methods_written_in_python() -> None:
    time = {"end": 10.0, "step": 0.02}
    free, held = (run_with(RungeKutta(), DOUBLE, time, stabilization=x).check() for x in ("none", "baumgarte"))
    assert held.misalignment_max < 0.5 * free.misalignment_max
    assert held.steps.acceleration_correction.max() > 0
    assert held.records("steps/projections") is False


def test_a_state_that_no_projection_can_reach_ends_the_run() -> None:
    class Leaping(RungeKutta):
        def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
            return StepState(state.q * np.nan, state.v)

    run = run_with(Leaping(), DOUBLE, {"steps": 3, "step": 0.01}, stabilization=PROJECTION)
    assert run.status_reason.startswith("not-finite: ")


def spinning_rods(rate: float) -> dict[str, Any]:
    """Return a double pendulum whose rods turn by `rate` [rad/s] about its pivot, free of gravity."""
    first, second = -0.6, 0.1
    elbow = np.array([np.cos(first), np.sin(first)])
    centers = 0.5 * elbow, elbow + 0.4 * np.array([np.cos(second), np.sin(second)])
    bodies = {
        f"rod{number}": {
            "mass": mass,
            "inertia": mass * length**2 / 12.0,
            "position": center.tolist(),
            "angle": angle,
            "velocity": [-rate * center[1], rate * center[0]],
            "angular_velocity": rate,
        }
        for number, mass, length, center, angle in ((1, 1.0, 1.0, centers[0], first), (2, 0.7, 0.8, centers[1], second))
    }
    return {
        "name": "mechanism",
        "gravity": [0.0, 0.0],
        "bodies": bodies,
        "joints": {
            "J1": {"type": "revolute", "bodies": ["ground", "rod1"], "points": [[0.0, 0.0], [-0.5, 0.0]]},
            "J2": {"type": "revolute", "bodies": ["rod1", "rod2"], "points": [[0.5, 0.0], [-0.4, 0.0]]},
        },
    }


@pytest.mark.parametrize("turn", [0.4, *slow(0.1, 0.25)])
@pytest.mark.parametrize(
    "method", [{"name": "gauss"}, {"name": "radau-iia"}, Midpoint()], ids=["gauss", "radau", "python"]
)
def test_symmetric_projection_succeeds_in_steps_in_which_bodies_turn_far(method: Any, turn: float) -> None:
    # expected: closed joints, as with plain projection, which needs no iteration over steps
    model, time = spinning_rods(5.0), {"step": turn / 5.0, "steps": 30}
    if isinstance(method, StepMethod):
        run = run_with(method, model, time, stabilization=SYMMETRIC)
    else:
        run = spec_run(model=model, integrator=method, time=time, stabilization=SYMMETRIC)
    assert run.status == "complete", run.status_reason
    assert_within(residuals(run), 2e-13)


class Restless(StepMethod):
    """A method whose steps from the same state differ, so that no iteration over them converges."""

    def __init__(self) -> None:
        self.calls = 0

    def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
        self.calls += 1
        return state.moved(h * state.v + 1e-3 * np.sin(self.calls**2 + np.arange(equations.n)), np.zeros(equations.n))


def test_a_symmetric_projection_that_fails_names_the_way_out() -> None:
    run = run_with(Restless(), spinning_rods(5.0), {"step": 0.01, "steps": 2}, stabilization=SYMMETRIC)
    assert run.status == "failed"
    assert "projection without `symmetric` takes larger steps" in run.status_reason
