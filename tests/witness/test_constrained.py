"""Collocation on index 3, index 2 and ggl, and Lobatto pairs: solved to round-off, constraints held, refusals."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.start import start_method
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec
from tests.integrators.running import end_of
from tests.margins import assert_within
from tests.slow_cases import slow

from . import constrained as dense
from .parallelogram import Parallelogram
from .problems import DRIVEN_PENDULUM, FORCED_PENDULUM

FORMULATIONS = ("index-3", "index-2", "ggl")
RADAU = [({"name": "radau-iia", "stages": s}, formulation) for s in (2, 3, 5) for formulation in FORMULATIONS]
PAIRS: list[tuple[dict[str, Any], str]] = [
    ({"name": "rattle"}, "index-3"),
    ({"name": "lobatto-pair", "stages": 3}, "index-3"),
]
MODELS = {
    "forced": FORCED_PENDULUM.model(),
    "driven": DRIVEN_PENDULUM.model(),
    "redundant": Parallelogram().model(-1.0, 0.5),
}
COVER = [
    (name, method)
    for number, method in enumerate([*RADAU, *PAIRS])
    for place, name in enumerate(MODELS)
    if number % len(MODELS) == place or method[0].get("stages") == 3
]
"""Every method on one model, and those of three stages on all of them."""

SWINGING = {"name": "double-pendulum", "angles": [-1.0, -1.0]}


def run(model: dict[str, Any], method: tuple[dict[str, Any], str], end: float, step: float, **sections: Any) -> Any:
    integrator, formulation = method
    spec = {"mbdkit": 1, "model": model, "integrator": integrator, "formulation": formulation}
    return mbdkit.run({**spec, "time": {"end": end, "step": step}, **sections})


def dense_step(method: tuple[dict[str, Any], str]) -> Callable[..., dense.State]:
    integrator, formulation = method
    stages = integrator.get("stages", 2)
    if integrator["name"] == "radau-iia":
        return lambda p, t, z, h: dense.radau_step(p, t, z, h, stages, formulation)
    return lambda p, t, z, h: dense.lobatto_step(p, t, z, h, stages)


def floor_of_multipliers(method: tuple[dict[str, Any], str], h: float) -> float:
    """Return the change of the multipliers by a rounding error of Phi, for a mechanism of 1 m and 1 kg."""
    stages = method[0].get("stages", 2)
    if method[1] != "index-3":
        weights = h * dense.radau(stages)[0]
    elif method[0]["name"] == "radau-iia":
        weights = h**2 * np.linalg.matrix_power(dense.radau(stages)[0], 2)
    else:
        a, bar, _, _ = dense.lobatto(stages)
        weights = h**2 * (a @ bar)[1:, :-1]
    return float(np.finfo(float).eps * np.linalg.norm(np.linalg.inv(weights), np.inf))


@pytest.mark.parametrize(("name", "method"), COVER, ids=str)
def test_steps_are_those_of_the_dense_witness_to_round_off(name: str, method: tuple[dict[str, Any], str]) -> None:
    # expected: the same equations, solved by Newton's method with the full matrix
    steps, h = 2, 0.02
    result = run(MODELS[name], method, steps * h, h).check()
    p = EquationsOfMotion.of(mbdkit.Mechanism.from_spec(MODELS[name]))
    z = dense.integrate(p, h, steps, dense_step(method))
    np.testing.assert_allclose(np.ravel(result.array("trajectory/position")[-1]), z.q, rtol=0, atol=5e-14)
    np.testing.assert_allclose(np.ravel(result.array("trajectory/velocity")[-1]), z.v, rtol=0, atol=1e-12)
    own = p.recorded_multipliers(steps * h, z.q, z.lam)
    few = 10 * max(floor_of_multipliers(method, h), np.finfo(float).eps * np.max(np.abs(own)))
    np.testing.assert_allclose(result.array("constraints/method_multiplier")[-1], own, rtol=0, atol=few)


@pytest.mark.parametrize(("name", "method"), COVER, ids=str)
def test_constraints_hold_to_round_off_where_the_formulation_asks_for_them(
    name: str, method: tuple[dict[str, Any], str]
) -> None:
    result = run(MODELS[name], method, 5.0, 0.01).check()
    pairs = method[0]["name"] != "radau-iia"
    if method[1] != "index-2":
        assert_within(result.misalignment_max, 1e-14)
    if method[1] != "index-3" or pairs:
        assert_within(result.array("joints/velocity_misalignment"), 1e-13)


def over_many_steps(method: tuple[dict[str, Any], str], end: float) -> Any:
    """Return a run in steps of 0.01 s, whose constraints are those of a method that holds them."""
    result = run(SWINGING, method, end, 0.01, output={"every": 7}).check()
    assert_within(result.misalignment_max, 1e-14)
    assert_within(result.array("joints/velocity_misalignment"), 1e-13)
    return result


MANY = pytest.mark.parametrize("end", [100.0, pytest.param(1000.0, marks=pytest.mark.slow)])


@MANY
def test_constraints_stay_at_round_off_over_many_steps(end: float) -> None:
    over_many_steps(({"name": "radau-iia", "stages": 3}, "ggl"), end)


@MANY
@pytest.mark.parametrize(("method", "wiggle"), list(zip(PAIRS, (2e-3, 1e-7), strict=True)), ids=str)
def test_constraints_and_energy_of_a_pair_have_no_trend_over_many_steps(
    method: tuple[dict[str, Any], str], wiggle: float, end: float
) -> None:
    # expected: symplectic methods conserve a modified energy (Hairer, Lubich and Wanner, IX.8)
    result = over_many_steps(method, end)
    total = np.asarray(result.energy.total)
    assert np.ptp(total) < wiggle
    slope = np.polyfit(result.time, total, 1)[0]
    assert_within(abs(slope) * end, 0.1 * np.ptp(total))


@pytest.mark.parametrize("method", PAIRS, ids=str)
def test_a_pair_leads_back_to_its_start(method: tuple[dict[str, Any], str]) -> None:
    # expected: the start itself; the pairs are symmetric (Hairer, Lubich and Wanner, VII.1.4)
    spec = load_spec({"mbdkit": 1, "model": SWINGING, "integrator": method[0], "time": {"end": 5.0, "step": 0.02},
                      "formulation": method[1]})  # fmt: skip
    table = Timetable(start=0.0, end=5.0, step=0.02, steps=250, every=10**9, max_steps=10**7, single=False)
    workspace = build(spec)[0]
    q, v = end_of(start_method(spec.integrator_plugin.create(spec.integrator), workspace, table))
    back = Workspace(workspace.mechanism, 0.0, q, -v, formulation="index-3")
    there = end_of(start_method(spec.integrator_plugin.create(spec.integrator), back, table))
    np.testing.assert_allclose(there[0], workspace.q0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(-there[1], workspace.v0, rtol=0, atol=1e-10)


def stiff(stiffness: float) -> dict[str, Any]:
    """Return the forced pendulum with a spring from its second rod to the ground, not stretched at the start."""
    model = FORCED_PENDULUM.model()
    rod = model["bodies"]["rod2"]
    turn = complex(math.cos(rod["angle"]), math.sin(rod["angle"]))
    point = complex(*rod["position"]) + turn * complex(0.1, 0.05)
    model["forces"]["stiff"] = {
        "type": "spring-damper",
        "bodies": ["ground", "rod2"],
        "points": [[0.3, -1.5], [0.1, 0.05]],
        "stiffness": stiffness,
        "free_length": abs(point - complex(0.3, -1.5)),
    }
    return model


@pytest.mark.parametrize("method", RADAU, ids=str)
@pytest.mark.parametrize("step", [0.01, *slow(0.001)])
def test_a_spring_of_1e8_newton_per_metre_is_taken_on_every_formulation(
    method: tuple[dict[str, Any], str], step: float
) -> None:
    # expected: a rod of the spring's length in its place, up to the spring's stretch of 1e-7 m and the method's error
    model = stiff(1e8)
    spring = model["forces"].pop("stiff")
    rod = {key: spring[key] for key in ("bodies", "points")} | {"type": "distance", "length": spring["free_length"]}
    rigid = {**model, "joints": {**model["joints"], "rod": rod}}
    exact = run(rigid, ({"name": "gauss", "stages": 4}, "index-1"), 1.0, 0.005).check()
    result = run(stiff(1e8), method, 1.0, step).check()
    gap = np.abs(result.array("trajectory/position")[-1] - exact.array("trajectory/position")[-1])
    assert_within(gap, 2e-5 if method[0]["stages"] == 2 else 1e-6)


@pytest.mark.parametrize("method", PAIRS, ids=str)
def test_a_pair_fails_honestly_on_a_stiff_spring(method: tuple[dict[str, Any], str]) -> None:
    result = run(stiff(1e8), method, 1.0, 0.01)
    assert result.status == "failed"
    assert result.status_reason.startswith("newton-failed")
    assert "radau-iia" in result.status_reason


@pytest.mark.parametrize("method", [*RADAU[3:6], *PAIRS], ids=str)
def test_a_linkage_with_a_spare_rod_moves_as_in_one_coordinate(method: tuple[dict[str, Any], str]) -> None:
    # expected: DOP853 in the common angle of the cranks; errors of the method's own order
    linkage = Parallelogram()
    result = run(linkage.model(-1.0, 0.5), method, 2.0, 0.01).check()
    phi = linkage.solve(-1.0, 0.5, np.array([2.0]))[0, 0]
    angle = result["crank0"].angle[-1]
    assert angle == pytest.approx(phi, abs=2e-3 if method[0]["name"] == "rattle" else 1e-6)


@pytest.mark.parametrize("formulation", ["index-2", "ggl"])
@pytest.mark.parametrize("name", ["forced", "driven"])
def test_work_and_dissipation_balance_the_energy_with_the_order_of_the_method(name: str, formulation: str) -> None:
    gaps = []
    for step in (0.04, 0.02):
        result = run(MODELS[name], ({"name": "radau-iia", "stages": 3}, formulation), 2.0, step).check()
        gaps.append(abs(float(result.energy.balance[-1])))
    assert_within(gaps[1], 1e-5)
    assert math.log2(gaps[0] / gaps[1]) > 3.5


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_states_between_steps_come_from_the_collocation_polynomial(formulation: str) -> None:
    # expected: DOP853 in the rods' angles; a polynomial of degree 3 is of order 4 within the step
    method = ({"name": "radau-iia", "stages": 3}, formulation)
    result = run(MODELS["forced"], method, 1.0, 0.02, output={"interval": 0.0137}).check()
    times = np.asarray(result.time)
    assert times[1] == pytest.approx(0.0137)
    solution = FORCED_PENDULUM.solve(times)
    exact = np.array([FORCED_PENDULUM.state(row[:2], row[2:4])[:6] for row in solution])
    assert_within(result.array("trajectory/position").reshape(len(times), -1) - exact, 1e-6)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_adaptive_steps_follow_the_tolerance_and_hold_the_constraints(formulation: str) -> None:
    # expected: DOP853 in the rods' angles; an error in proportion to the tolerance within some factor
    solution = FORCED_PENDULUM.solve(np.array([2.0]))[0]
    exact = FORCED_PENDULUM.state(solution[:2], solution[2:4])[:6]
    errors, steps = [], []
    for rtol in (1e-4, 1e-6, 1e-8):
        integrator = {"name": "radau-iia", "adaptive": True, "rtol": rtol, "atol": rtol}
        spec = {"mbdkit": 1, "model": MODELS["forced"], "integrator": integrator, "formulation": formulation}
        result = mbdkit.run({**spec, "time": {"end": 2.0}}).check()
        errors.append(float(np.max(np.abs(np.ravel(result.array("trajectory/position")[-1]) - exact))))
        steps.append(result.stats["steps"])
        # some ten roundings: the iteration ends when positions change by four, with tangents of the start of the step
        if formulation != "index-2":
            assert_within(result.misalignment_max, 1e-13)
        if formulation != "index-3":
            assert_within(result.array("joints/velocity_misalignment"), 1e-12)
    assert all(error < 100 * rtol for error, rtol in zip(errors, (1e-4, 1e-6, 1e-8), strict=True))
    assert errors[0] > 10 * errors[1] > 100 * errors[2]
    assert steps[0] < steps[1] < steps[2]
