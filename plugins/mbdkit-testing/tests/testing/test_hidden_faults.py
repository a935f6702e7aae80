"""Faults that hardly show in the results of a method or a measure are found by the checks that look for them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.testing.corpus_of_wrong_plugins import RK4, outcome

import mbdkit
from mbdkit import EquationsOfMotion, Step, StepState
from mbdkit.registry.manager import forget
from mbdkit_testing.contract_checks import repeatable
from mbdkit_testing.item_checks import imports
from mbdkit_testing.kit import plugin_under_test
from tests.installing import install_module

from . import corpus, wrong_steps


class EverySecond(corpus.RungeKutta):
    """It projects after every second step."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        is_even = round(t / h) % 2 == 0
        return replace(new, q=equations.project_positions(t + h, new.q)) if is_even else new


class OwnProjection(corpus.RungeKutta):
    """It projects velocities after every third step by a pseudo-inverse of its own."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        if round(t / h) % 3:
            return new
        jacobian = equations.constraint_jacobian(t + h, new.q).toarray()
        rates = equations.constraint_rates(t + h, new.q, new.v)
        return replace(new, v=new.v - np.linalg.pinv(jacobian) @ rates)


class Iterating(corpus.RungeKutta):
    """The implicit midpoint rule by fixed-point iterations of its own, to a tolerance that it does not mention."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        v, change = state.v, 1.0
        while change > 1e-6:
            middle = (state.v + v) / 2
            new = state.v + h * equations.accelerations(t + h / 2, state.q + h / 2 * middle, middle)[0]
            v, change = new, float(np.max(np.abs(new - v)))
        return StepState(state.q + h * (state.v + v) / 2, v)


class Jumping(wrong_steps.Pair):
    """Its dense output does not end at the end of the step, by a gap that vanishes with the step."""

    def made(self, new: StepState, error: Any, dense: Any, h: float, *others: Any) -> Step:
        return Step(new, error, lambda x: tuple(part + 0.02 * h**5 * x for part in dense(x)))


WRONG = {
    EverySecond: ("honesty.projections", "it projects, a stabilization that the spec did not request"),
    OwnProjection: ("honesty.projections", "it moves states onto the constraints at velocity level"),
    Iterating: ("newton.tolerance", "the number of evaluations in a step varies, so that it iterates"),
}


@pytest.mark.parametrize("method", WRONG, ids=lambda method: method.__name__)
def test_what_a_method_does_without_saying_so_is_found(method: type[Any]) -> None:
    check, cause = WRONG[method]
    found = outcome("integrator", corpus.offer_method(method, **RK4), check)
    assert found.outcome == "fail", found
    assert cause in found.cause
    assert outcome("integrator", corpus.offer_method(corpus.RungeKutta, **RK4), check).outcome in ("pass", "skip")


def test_dense_output_that_jumps_at_the_end_of_a_step_is_found() -> None:
    found = outcome("integrator", wrong_steps.adaptive(Jumping, dense_order=3), "order.dense-output")
    assert "differs from the state at the end of a step of 0.4 s" in found.cause


def speeds(run: Any, power: float) -> float:
    size = np.abs(np.asarray(run.array("trajectory/velocity")))
    return float(np.sum(size) if power else np.max(size))


@pytest.mark.parametrize(("power", "expected"), [(1.0, "fail"), (0.0, "pass")])
def test_a_measure_that_sums_over_rows_is_found(power: float, expected: str) -> None:
    item = mbdkit.plugin.MeasurePlugin(
        name="mine",
        summary="Speeds.",
        options=corpus.NoOptions,
        units="m/s",
        take=lambda run, options: speeds(run, power),
    )
    found = outcome("measure", corpus._with(mbdkit_measures=item), "measure.value")
    assert found.outcome == expected, found


CACHING = '''
import mbdkit
import numpy as np
import stray_helper
from pydantic import BaseModel
SEEN = []
class Euler(mbdkit.StepMethod):
    """Symplectic Euler, with a share of the first accelerations that it has ever seen in this process."""
    def step(self, equations, t, state, h):
        a, _ = equations.accelerations(t, state.q, state.v)
        SEEN.append(float(np.max(np.abs(a))))
        v = state.v + h * a * (1 + 1e-6 * SEEN[0])
        return mbdkit.StepState(state.q + h * v, v)
@mbdkit.hookimpl
def mbdkit_integrators():
    return [mbdkit.IntegratorPlugin("cached", "Euler.", BaseModel, create=lambda options: Euler(),
            claims=lambda options: mbdkit.Claims(order=1, needs=("accelerations",)))]
'''


@pytest.fixture
def cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return the method `cached` of a distribution, which imports a module that belongs to none."""
    install_module(tmp_path / "site", "cached-kit", CACHING)
    (tmp_path / "stray").mkdir()
    (tmp_path / "stray" / "stray_helper.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.syspath_prepend(tmp_path / "stray")
    forget()
    yield plugin_under_test("integrator", "cached", {})
    for name in ("cached_kit", "stray_helper"):
        del sys.modules[name]
    forget()


def test_data_that_a_method_keeps_between_runs_are_found_in_a_new_process(cached: Any) -> None:
    found = repeatable.run(cached)
    assert found.cause == "a run after others differs from one in a new process: it keeps data between runs"


def test_code_from_outside_the_distribution_and_what_it_requires_is_found(cached: Any) -> None:
    assert imports.run(cached).cause == (
        "it imports what belongs neither to its distribution nor to what that requires: stray_helper (cached_kit.py)"
    )
