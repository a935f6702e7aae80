"""Every step is watched, whoever takes it: compiled methods, solvers of SciPy, and methods of plugins."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.methods.step_methods import StepState
from tests.integrators.step_methods import RungeKutta, run_with
from tests.slow_cases import slow, slow_but
from tests.trust.flat_linkages import angle_between_cranks, flat_linkage

from .mechanisms import cranks, spec

DOUBLE = {"name": "double-pendulum"}
HANGING = {"name": "n-pendulum", "n": 3, "angle": -np.pi / 2}
SCIPY = ("scipy-radau", "scipy-dop853", "scipy-lsoda")

METHODS: dict[str, dict[str, Any]] = {
    "rk4": {"integrator": {"name": "rk4"}},
    "gauss": {"integrator": {"name": "gauss", "stages": 2}},
    "projection": {"integrator": {"name": "rk4"}, "stabilization": "projection"},
    "dop853": {"integrator": {"name": "dop853", "adaptive": True}},
    **{name: {"integrator": {"name": name}} for name in SCIPY},
}


@pytest.mark.parametrize("method", METHODS)
def test_a_limit_of_the_energy_does_not_stop_a_mechanism_at_rest(method: str) -> None:
    given = spec(HANGING, end=1.0, step=0.01, limits={"energy_jump": 0.01}, **METHODS[method])
    with mbdkit.run(given) as run:
        run.check()
        assert (run.verdict, run.verdict_reasons) == ("unknown", [])


class Pushed(RungeKutta):
    """Adds speed in the step that ends at 0.45 s, and takes it away in the next."""

    def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        if abs(t + h - 0.45) < 0.1 * h:
            return StepState(new.q, 1.5 * new.v)
        if abs(t - 0.45) < 0.1 * h:
            return StepState(new.q, new.v / 1.5)
        return new


def test_a_jump_in_energy_between_two_rows_of_a_plugin_is_seen() -> None:
    # no row shows it: the energy is right again in the second step after
    time = {"end": 1.0, "step": 0.001}
    with run_with(Pushed(), DOUBLE, time, output={"every": 100}) as run:
        assert (run.status, run.verdict) == ("complete", "bad")
        assert "in one step at t = 0.45" in run.verdict_reasons[0]
    with run_with(Pushed(), DOUBLE, time, output={"every": 100}, limits={"energy_jump": 0.05}) as run:
        assert run.status_reason.startswith("energy-jump: the energy balance changes by ")
        assert run.time[-1] == pytest.approx(0.45)


@pytest.mark.parametrize("name", slow_but(SCIPY, SCIPY[0]))
@pytest.mark.parametrize("rtol", [1e-3, *slow(1e-6, 1e-9)])
def test_no_solver_of_scipy_leaves_its_branch_without_a_word(name: str, rtol: float) -> None:
    for n in (1, 2):
        run = flat_linkage(n, {"name": name, "rtol": rtol, "atol": rtol})
        if run.status == "complete" and run.verdict in ("good", "unknown"):
            assert angle_between_cranks(run, n) < 0.05


@pytest.mark.parametrize("step", [0.01, 0.02, *slow(0.002)])
@pytest.mark.parametrize("n", [1, 2])
def test_no_plugin_leaves_its_branch_without_a_word(n: int, step: float) -> None:
    run = run_with(RungeKutta(), {"name": "n-four-bar", "n": n}, {"end": 10.0, "step": step})
    if run.status == "complete" and run.verdict in ("good", "unknown"):
        assert angle_between_cranks(run, n) < 0.05


@pytest.mark.parametrize(
    "stabilization", ["none", "baumgarte", "projection", {"name": "projection", "symmetric": True}]
)
def test_a_healthy_run_of_a_plugin_is_not_flagged(stabilization: Any) -> None:
    more = {} if stabilization == "none" else {"stabilization": stabilization}
    with run_with(RungeKutta(), DOUBLE, {"end": 2.0, "step": 0.002}, limits={"energy_jump": 0.01}, **more) as run:
        run.check()
        assert (run.verdict, run.verdict_reasons) == ("unknown", [])


def test_a_run_that_falls_apart_between_two_rows_stops_there() -> None:
    # of 10 s; joints and centres of the two rods span 1.5 m
    given = spec(DOUBLE, {"name": "scipy-lsoda", "rtol": 0.1, "atol": 0.1}, 10.0, output={"every": 100_000})
    with mbdkit.run(given) as run:
        assert run.status_reason.startswith("fell-apart: joint 'J")
        assert run.verdict == "bad"
        assert run.stats["steps"] < 200


def test_a_redundant_crank_that_opens_proves_that_the_branch_is_left() -> None:
    # three parallel cranks, flat after 1.05 s: the third holds on this branch only, and no driver moves it
    given = spec(cranks((0.0, 2.0, 0.7), angle=np.pi / 2, rate=2.0), {"name": "scipy-dop853"}, 6.0)
    with mbdkit.run(given) as run:
        assert run.status_reason.startswith("branch-left: joint 'top2' is misaligned by ")
        assert "same motion as " in run.status_reason
        assert "`stabilization: projection`" in run.status_reason
        assert run.time[-1] < 1.2
