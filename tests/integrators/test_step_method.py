"""A method written in NumPy is stepped, checked, recorded and stopped like a compiled one."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import StepError, StepState
from mbdkit.integrators import interface
from mbdkit.spec.run_spec import spec_type
from tests.engine.linkages_in_sympy import parallelogram
from tests.margins import assert_within
from tests.slow_cases import slow

from .running import DOUBLE, driven_chain, spec_run
from .step_methods import Failing, Remembering, RungeKutta, offering, run_with

MODELS = pytest.mark.parametrize("model", [DOUBLE, driven_chain()], ids=["double pendulum", "driven chain"])


@MODELS
def test_runge_kutta_in_numpy_is_the_compiled_one(model: Any) -> None:
    # expected: the compiled method of the same tableau; the sums are taken in another order
    time = {"end": 1.003, "step": 0.01}
    mine, ours = run_with(RungeKutta(), model, time).check(), spec_run(model, {"name": "rk4"}, time).check()
    np.testing.assert_array_equal(mine.time, ours.time)
    np.testing.assert_array_equal(mine.array("steps/size"), ours.array("steps/size"))
    for name in ("position", "velocity"):
        there = ours.array(f"trajectory/{name}")
        np.testing.assert_allclose(mine.array(f"trajectory/{name}"), there, rtol=0, atol=2e-13 * np.abs(there).max())
    np.testing.assert_allclose(mine.array("joints/misalignment"), ours.array("joints/misalignment"), atol=1e-13)


def test_work_and_dissipation_that_a_method_does_not_book_are_integrated_to_order_four() -> None:
    # expected: the balance of energy closes as fast as the method converges
    open_by = []
    for steps in (400, 800):
        run = run_with(RungeKutta(), driven_chain(), {"steps": steps, "step": 1.0 / steps}).check()
        open_by.append(np.abs(run.energy.balance).max())
        assert run.stats["rhs_evaluations"] == 4 * steps  # those of the method, as in the compiled one
        assert run.stats["host_evaluations"] == 3 * steps  # Simpson's rule
    assert np.abs(run.energy.work).max() > 0.1
    assert np.abs(run.energy.dissipated).max() > 0.1
    assert_within(open_by[1], 1e-6)
    assert np.log2(open_by[0] / open_by[1]) > 3.8


def test_multipliers_of_the_method_are_recorded_beside_those_of_index_one() -> None:
    run = run_with(Remembering(), DOUBLE, {"steps": 10, "step": 0.01}, output={"every": 3}).check()
    own = run.array("constraints/method_multiplier")
    np.testing.assert_array_equal(own[1:, 0], [3, 6, 9, 10])
    np.testing.assert_array_equal(own[0], run.array("constraints/multiplier")[0])
    assert run_with(RungeKutta(), DOUBLE, {"steps": 2, "step": 0.01}).records("constraints/method_multiplier") is False


def test_a_redundant_mechanism_runs_as_under_the_compiled_method() -> None:
    # expected: the compiled method of the same tableau, and for every row of the archive a multiplier that is as good
    class Carrying(RungeKutta):
        carries_multipliers = True

        def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
            new = super().step(equations, t, state, h)
            return StepState(new.q, new.v, multipliers=equations.accelerations(t + h, new.q, new.v)[1])

    model, time = parallelogram(1.0, cranks=3), {"end": 0.5, "step": 0.005}
    mine, ours = run_with(Carrying(), model, time).check(), spec_run(model, {"name": "rk4"}, time).check()
    assert mine.redundancy == ours.redundancy != ""
    np.testing.assert_allclose(mine.array("trajectory/position"), ours.array("trajectory/position"), rtol=0, atol=1e-12)
    own, least = mine.array("constraints/method_multiplier"), mine.array("constraints/multiplier")
    assert own.shape == least.shape
    pushes = [x.reshape(len(x), -1, 2)[:, 1::2].sum(axis=1) for x in (own, least)]  # of the tops on the coupler
    np.testing.assert_allclose(pushes[0], pushes[1], rtol=0, atol=1e-10)


@pytest.mark.parametrize("every", [7, *slow(1, 400)])
def test_results_do_not_depend_on_the_stretches_that_a_run_is_cut_into(
    every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # expected: equal to the bit, hash of all arrays included
    hashes = []
    for length in (1e-9, 0.1, 100.0):
        monkeypatch.setattr(interface, "STRETCH", length)
        run = run_with(Remembering(), driven_chain(), {"end": 1.0, "step": 0.003}, output={"every": every})
        hashes.append((run.check().data_sha256, {k: x for k, x in run.stats.items() if not k.endswith("_s")}))
    assert hashes[0] == hashes[1] == hashes[2]


def test_slow_steps_still_return_to_the_recorder_in_time() -> None:
    class Slow(RungeKutta):
        def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
            time.sleep(0.03 if t > 0.1 else 0.0)
            return super().step(equations, t, state, h)

    run = run_with(Slow(), DOUBLE, {"steps": 60, "step": 0.01}, limits={"wall_time": 0.5})
    assert run.status_reason.startswith("wall-time")
    assert run.stats["wall_s"] < 0.5 + 0.2


def test_moved_carries_the_rounding_errors_of_its_sums() -> None:
    # expected: ten million times 0.1 added to 1e8 is exact in the rational numbers; a plain sum loses six digits
    state = StepState(np.array([1e8]), np.array([0.0]))
    for _ in range(10_000):
        state = state.moved(np.array([1e-9]), np.array([0.1]))
    assert state.q[0] - 1e8 == pytest.approx(1e-5, abs=1.5e-8)
    assert state.v[0] == 1000.0


def raising(error: BaseException) -> Any:
    def then(equations: Any, state: StepState) -> Any:
        raise error

    return then


STOPS = {
    "its own iteration fails": (raising(StepError("newton-failed", "the last change was 0.3")), "newton-failed"),
    "it finds no solution": (raising(StepError("singular", "nothing left")), "singular"),
    "it returns what is not a number": (lambda p, s: StepState(s.q * np.nan, s.v), "not-finite"),
    "it runs away": (lambda p, s: StepState(s.q, s.v + 1e80), "not-finite"),
    "it asks for what overflows": (lambda p, s: p.accelerations(0.0, s.q, s.v * 1e200), "not-finite"),
}


@pytest.mark.parametrize("case", STOPS)
def test_a_step_that_cannot_be_taken_ends_the_run_with_its_reason_and_keeps_what_was_recorded(case: str) -> None:
    then, code = STOPS[case]
    run = run_with(Failing(5, then), DOUBLE, {"steps": 10, "step": 0.01}, output={"every": 2})
    assert run.status == "failed"
    assert run.status_reason.startswith(f"{code}: ")
    assert "in step 6 from t = 0.05 s; a smaller time.step may help." in run.status_reason
    np.testing.assert_allclose(run.time, [0.0, 0.02, 0.04, 0.05])
    assert run.stats["steps"] == 5


WRONGS = {
    "it raises": (raising(KeyError("alpha")), "acme:mine raised KeyError: 'alpha'"),
    "it leaves the program": (raising(SystemExit(1)), "acme:mine raised"),
    "it returns a tuple": (lambda p, s: (s.q, s.v), "Failing.step returned tuple, not a StepState"),
    "it returns nothing": (lambda p, s: None, "Failing.step returned NoneType, not a StepState"),
    "too short": (lambda p, s: StepState(s.q[:3], s.v), "invalid `q`: expected an array of shape (6,), got shape (3,)"),
    "its velocities are text": (lambda p, s: StepState(s.q, "fast"), "Failing.step returned an invalid `v`"),
    "it asks wrongly": (lambda p, s: p.accelerations(0.0, s.q.reshape(2, 3), s.v), "of shape (6,), got shape (2, 3)"),
}


@pytest.mark.parametrize("case", WRONGS)
@pytest.mark.parametrize("end", [0.1, 0.055])
def test_a_step_that_is_wrong_is_a_failure_of_the_plugin_and_keeps_what_was_recorded(case: str, end: float) -> None:
    then, sentence = WRONGS[case]
    run = run_with(Failing(5, then), DOUBLE, {"end": end, "step": 0.01}, output={"every": 2})
    assert run.status == "failed"
    assert run.status_reason.startswith("plugin-error: integrator acme:mine raised ")
    assert sentence in run.status_reason
    np.testing.assert_allclose(run.time, [0.0, 0.02, 0.04, 0.05])


def test_a_method_that_fails_while_its_step_is_chosen_is_a_failure_of_the_plugin() -> None:
    def then(p: Any, s: StepState) -> StepState:
        raise KeyError("oops")

    run = run_with(Failing(5, then), DOUBLE, {"end": 0.5}, accuracy=1e-3)
    assert run.status == "failed"
    assert run.status_reason.startswith("plugin-error: integrator acme:mine raised ")
    assert "oops" in run.status_reason


def test_multipliers_that_were_promised_must_come() -> None:
    class Silent(RungeKutta):
        carries_multipliers = True

    run = run_with(Silent(), DOUBLE, {"steps": 3, "step": 0.01})
    assert run.status_reason.startswith("plugin-error")
    assert "Silent.step returned an invalid `multipliers`" in run.status_reason


def test_a_method_that_is_none_is_refused_by_name() -> None:
    class Bare:
        def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
            return state

    with pytest.raises(mbdkit.PluginError, match=r"type Bare; .* subclass of StepMethod or ExternalMethod"):
        run_with(Bare(), DOUBLE, {"steps": 3, "step": 0.01})


def test_a_method_of_another_formulation_is_refused_by_name() -> None:
    spec: dict[str, Any] = {"mbdkit": 1, "model": DOUBLE, "time": {"steps": 3, "step": 0.01}}
    with pytest.raises(
        mbdkit.SpecError, match=r"'rk4' does not support the formulation 'ggl', .*support it: radau-iia"
    ):
        mbdkit.run(spec | {"integrator": {"name": "rk4"}, "formulation": "ggl"})
    wanted = (
        "'mine' does not support the formulation 'index-1', only index-3; add `formulation: index-3` to the spec, or "
        "choose another integrator; integrators that support it: rk-gill, rk4, dopri5"
    )
    with pytest.raises(mbdkit.SpecError, match=wanted):
        spec_type(offering(RungeKutta(), formulations=("index-3",)))(**spec, integrator={"name": "mine"})
    with pytest.raises(mbdkit.SpecError, match="only index-3; integrators that support it"):
        spec_type(offering(RungeKutta(), formulations=("index-3",)))(
            **spec, integrator={"name": "mine"}, formulation="index-1"
        )
    run = run_with(Remembering(), DOUBLE, {"steps": 3, "step": 0.01}, formulation="index-3").check()
    assert run.spec["formulation"] == "index-3"
