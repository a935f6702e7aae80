"""Costates and Pontryagin's minimum principle against closed forms, and motions that are no extremals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_predict.pontryagin import minimum_principle
from mbdkit_predict.predict_loading import load_predict_spec
from mbdkit_predict.predicted_run import transcribed
from mbdkit_predict.processes import Stop
from mbdkit_predict.transcription import Mesh
from predict.exact_optima import EFFORT, EXACT, PUSH, block
from tests.margins import assert_within

LEAST_TIME: dict[str, Any] = {"duration": {"bounds": [0.05, 9]}, "minimize": "final(t)"}


def of_rates(states: dict[str, tuple[float, str]], final: dict[str, float], **sections: Any) -> dict[str, Any]:
    """Return a problem in first-order states, by name their start and rate, with the control `u`."""
    rates = {name: {"initial": start, "rate": rate} for name, (start, rate) in states.items()}
    model = {"name": "mechanism", "gravity": [0, 0], "bodies": {"dot": {"mass": 1}}, "states": rates}
    model["states"]["u"] = {"initial": 0.1, "rate": "0"}
    first = {"duration": 1.0, "controls": {"states.u": {"bounds": [-30, 30]}}} | sections
    still = {f"dot.{name}": 0 for name in ("x", "y", "vx", "vy")}
    ends = {f"states.{name}": value for name, value in final.items()}
    return {"mbdkit_predict": 1, "base": {"model": model}, "initial": still, "final": ends, **first}


def zermelo(**sections: Any) -> dict[str, Any]:
    """Return the problem of a boat in a shear flow (Bryson and Ho, section 2.7), of which a wrong motion is near."""
    return of_rates(
        {"x": (3.66, "cos(states.u) - states.y"), "y": (-1.86, "sin(states.u)")}, {"x": 0, "y": 0}, minimize="final(t)",
        duration={"bounds": [2, 9], "start": 5.5}, controls={"states.u": {"bounds": [-1, 7], "start": 2}}, **sections,
    )  # fmt: skip


COST = 'integral(controls["states.u"]**2)'


def exponential(rate: float, time: np.ndarray, end: float = 1.0) -> dict[str, np.ndarray]:
    """Return the costate of x' = rate x + u from 1 to 0 with least integral of u^2: u = -costate/2."""
    size = np.exp(rate * end) / ((np.exp(rate * end) - np.exp(-rate * end)) / (2.0 * rate))
    return {"x": 2.0 * size * np.exp(-rate * time)}


def regulator(time: np.ndarray) -> dict[str, np.ndarray]:
    # x' = u with the integral of x^2 + u^2, free at the end: costate 2 tanh(1 - t) x, and x = cosh(1 - t)/cosh(1)
    return {"x": 2.0 * np.sinh(1.0 - time) / np.cosh(1.0)}


#: Specs, their exact costates as functions of time, and relative tolerances: costates have a lower order than
#: the objective.
COSTATES: dict[str, tuple[Any, Any, float]] = {
    "least effort": (block(), lambda t: {"block.x": -24.0 + 0.0 * t, "block.vx": -12.0 + 24.0 * t}, 1e-9),
    "least effort by gauss": (
        block(collocation={"method": "gauss", "points": 2, "intervals": 5}),
        lambda t: {"block.x": -24.0 + 0.0 * t, "block.vx": -12.0 + 24.0 * t}, 1e-9,
    ),
    "heavier": (
        block(3.0, controls={PUSH: {"bounds": [-300, 300]}}),
        lambda t: {"block.x": -216.0 + 0.0 * t, "block.vx": -108.0 + 216.0 * t}, 1e-8,
    ),
    # the velocity at the end is free: u = 3 (1 - t)
    "free speed": (
        block(final={"block.x": 1}), lambda t: {"block.x": -6.0 + 0.0 * t, "block.vx": -6.0 * (1.0 - t)}, 1e-9,
    ),
    # one second of 12/T^3 + 36 T, at T = 1: the same motion, and a Hamiltonian that is zero
    "effort and time": (
        block(duration={"bounds": [0.5, 5]}, minimize=f"{EFFORT} + 36*final(t)"),
        lambda t: {"block.x": -24.0 + 0.0 * t, "block.vx": -12.0 + 24.0 * t}, 1e-5,
    ),
    # bang-bang from rest to rest: T = 2 sqrt(m s/F), costates -T/(2 s) and its integral, zero at T/2
    "least time": (
        block(2.0, controls={PUSH: {"bounds": [-50, 50]}}, **LEAST_TIME | {"duration": {"bounds": [0.05, 5]}}),
        lambda t: {"block.x": -0.2 + 0.0 * t, "block.vx": -0.2 * (0.2 - t)}, 1e-3,
    ),
    **{
        f"linear {rate}": (
            of_rates({"x": (1.0, f"{rate}*states.x + states.u")}, {"x": 0}, minimize=COST),
            lambda t, rate=rate: exponential(rate, t), 1e-5,
        )
        for rate in (-2.0, -0.5, 0.5, 2.0)
    },
    "regulator": (
        of_rates({"x": (1.0, "states.u")}, {}, minimize=COST + " + integral(states.x.value**2)"), regulator, 1e-6,
    ),
    # x'' = -x + u from (0, 1) to x = 0 at a quarter of a period, where the costate of the free velocity vanishes
    "oscillator": (
        of_rates(
            {"x": (0.0, "states.v"), "v": (1.0, "states.u - states.x")}, {"x": 0}, duration=np.pi / 2, minimize=COST,
        ),
        lambda t: {"x": 8.0 / np.pi * np.sin(t), "v": 8.0 / np.pi * np.cos(t)}, 1e-5,
    ),
}  # fmt: skip
QUICK = ("least effort", "regulator", "least time")


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in COSTATES]
)
def test_costates_have_their_closed_form(name: str) -> None:
    spec, exact, tolerance = COSTATES[name]
    run = mbdkit.predict(spec)
    assert run.verdict == "good", run.verdict_reasons
    for state, values in exact(run.time).items():
        assert_within(run.costates[state] - values, tolerance * abs(values).max())
    assert run.pontryagin["violation"] <= 1e-6 * run.objective


@pytest.mark.slow
@pytest.mark.parametrize("name", EXACT)
def test_known_optima_satisfy_the_minimum_principle(name: str) -> None:
    run = mbdkit.predict(EXACT[name][0])
    assert run.verdict == "good", run.verdict_reasons
    assert run.pontryagin["violation"] <= 1e-6 * run.objective


def test_a_boat_in_a_shear_flow_crosses_in_least_time() -> None:
    # 5.45787 by an independent collocation with Legendre points; the first optimum of the optimizer is 6.19
    run = mbdkit.predict(zermelo(tolerance=1e-3))
    assert run.verdict == "good", run.verdict_reasons
    assert_within(run.objective - 5.45787, 1e-5)
    # the Hamiltonian is zero, and its derivative by the heading vanishes
    x, y = run.costates["x"], run.costates["y"]
    heading, drift = run.controls["states.u"].value, run.states["y"].value
    assert_within(1.0 + x * (np.cos(heading) - drift) + y * np.sin(heading), 1e-5)
    assert_within(x * np.sin(heading) - y * np.cos(heading), 1e-5)


def varied(spec: dict[str, Any], change: Any) -> tuple[Any, Mesh, float]:
    """Return the problem of a spec, and its solution with other controls (U, K)."""
    method = transcribed(load_predict_spec(spec, ()))
    mesh = method.solved(method.guess(), Stop())
    assert mesh.solution is not None
    changed = replace(mesh, values=dict(mesh.values) | {"u": change(mesh.values["u"], mesh.times)})
    return method, changed, mesh.solution.objective


CHANGES = {
    "more": lambda u, t: u + 1.0,
    "less": lambda u, t: 0.9 * u,
    "a pulse": lambda u, t: u + 5.0 * (abs(t - 0.3) < 0.1),
    "a wave": lambda u, t: u + np.sin(20.0 * t),
    "reversed": lambda u, t: -u,
}


@pytest.mark.parametrize("problem", ["least effort", "linear 0.5"])
@pytest.mark.parametrize("change", CHANGES)
def test_controls_that_are_no_extremals_are_refused(problem: str, change: str) -> None:
    method, mesh, objective = varied(COSTATES[problem][0], CHANGES[change])
    principle = minimum_principle(method, mesh)
    assert principle is not None
    assert principle.gain > 1e-3 * objective
    # the minimum is that of the optimum, whose multipliers the mesh has
    right = varied(COSTATES[problem][0], lambda u, t: u)[1].values["u"]
    assert_within(principle.controls - right, 1e-4)


@pytest.mark.slow
def test_a_local_optimum_whose_heading_is_at_a_bound_is_refused() -> None:
    method = transcribed(load_predict_spec(zermelo(), ()))
    mesh = method.solved(method.guess(), Stop())
    assert mesh.solution is not None
    assert mesh.solution.is_optimum
    principle = minimum_principle(method, mesh)
    assert principle is not None
    assert abs(mesh.solution.objective - 5.45787) < 1e-4 or principle.gain > 0.01 * mesh.solution.objective
