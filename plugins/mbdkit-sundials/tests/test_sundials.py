"""CVODE and IDA meet their tolerances on mbdkit's equations, and state the reason if they stop."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_sundials import mbdkit_integrators


def spring(**values: float) -> dict[str, Any]:
    return {"type": "spring-damper", "bodies": ["a", "b"], "points": [[0.5, 0], [0, 0]]} | values


PENDULUM = {"name": "double-pendulum", "angles": [-1.0, -0.4]}
DRIVEN = {
    "name": "mechanism",
    "bodies": {
        "a": {"mass": 1.0, "inertia": 0.0833, "position": [0.5, 0.0]},
        "b": {"mass": 0.7, "position": [1.5, 0.0]},
    },
    "joints": {
        "A": {"type": "revolute", "bodies": ["ground", "a"], "points": [[0, 0], [-0.5, 0]]},
        "motor": {"type": "driver", "bodies": ["ground", "a"], "coordinate": "angle", "motion": "0.4*sin(2*t)"},
    },
    "forces": {"s": spring(stiffness=50.0, damping=0.5, free_length=0.4)},
}
MODELS = {"pendulum": PENDULUM, "driven": DRIVEN}
METHODS: list[dict[str, Any]] = [
    {"name": "sundials-cvode"}, {"name": "sundials-cvode", "family": "Adams"}, {"name": "sundials-ida"},
]  # fmt: skip
every_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: "-".join(method.values()))


def run(model: dict[str, Any], integrator: dict[str, Any], **sections: Any) -> mbdkit.Run:
    spec = {"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": 1.0}, "output": {"interval": 0.05}}
    return mbdkit.run(spec | sections)


@cache
def reference(name: str) -> np.ndarray:
    """Return the motion computed by Gauss-4, whose error is far below the tolerances tested here."""
    method = {"name": "gauss", "stages": 4}
    found = run(MODELS[name], method, time={"end": 1.0, "step": 0.0025}, output={"every": 20}).check()
    return found.array("trajectory/position")


@every_method
@pytest.mark.parametrize("name", MODELS)
def test_the_error_follows_the_tolerance_between_the_steps_as_well(method: dict[str, Any], name: str) -> None:
    # expected: rows lie at a fixed interval, so that they are interpolated; errors add up over some hundred steps
    for rtol in (1e-6, 1e-8, 1e-10):
        found = run(MODELS[name], method | {"rtol": rtol, "atol": rtol / 100}).check()
        np.testing.assert_allclose(found.array("trajectory/position"), reference(name), rtol=0, atol=300 * rtol)


@every_method
def test_the_energy_balance_closes_with_the_tolerance(method: dict[str, Any]) -> None:
    found = run(DRIVEN, method | {"rtol": 1e-10, "atol": 1e-12}).check()
    assert found.energy.dissipated[-1] > 1e-3
    np.testing.assert_allclose(found.energy.balance, 0.0, rtol=0, atol=1e-7)


@every_method
def test_a_run_ends_at_its_end_and_counts_its_work(method: dict[str, Any]) -> None:
    found = run(PENDULUM, method, output={"every": 1}, time={"end": 0.7, "step": 1e-4}).check()
    assert found.time[-1] == 0.7
    assert len(found.time) == found.stats["steps"] + 1
    assert found.stats["rhs_evaluations"] > found.stats["steps"]
    assert found.stats["jacobian_evaluations"] > 0


@every_method
def test_equal_runs_are_equal_to_the_bit(method: dict[str, Any]) -> None:
    first, second = (run(PENDULUM, method).array("trajectory/position") for _ in range(2))
    assert np.array_equal(first, second)


@every_method
def test_a_force_that_becomes_infinite_ends_the_run_with_a_sentence(method: dict[str, Any]) -> None:
    force = {"type": "force", "body": "b", "point": [0, 0], "value": [0, "1/(0.5 - t)**3"]}
    found = run(DRIVEN | {"forces": {"f": force}}, method)
    assert found.status == "failed"
    assert found.status_reason.startswith(("not-finite: ", "step-too-small: "))
    assert found.time[-1] < 0.51


@every_method
def test_a_solver_that_gives_up_says_so_in_the_status_alone(
    method: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    # The value of this torque becomes NaN at some time; the solver reduces its steps there until it stops.
    model = DRIVEN | {"forces": {"f": {"type": "torque", "body": "a", "value": "sqrt(0.5 - t)"}}}
    found = run(model, method)
    assert found.status == "failed"
    assert found.status_reason
    assert capsys.readouterr().out == ""


def test_bdf_takes_far_fewer_evaluations_of_a_stiff_damper_than_an_explicit_method() -> None:
    # expected: stability limits the steps of an explicit method to a few m/d = 1.4e-4 s; BDF follows the slow motion
    model = DRIVEN | {"forces": {"s": spring(stiffness=10.0, damping=5e3, free_length=0.5)}}
    explicit, implicit = (
        run(model, {"name": name, "rtol": 1e-5, "atol": 1e-7}).check() for name in ("scipy-dop853", "sundials-cvode")
    )
    assert implicit.stats["rhs_evaluations"] < 0.1 * explicit.stats["rhs_evaluations"]


@pytest.mark.parametrize("wrong", [{"rtol": 0.0}, {"max_order": 6}, {"family": "Euler"}])
def test_wrong_options_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(mbdkit.SpecError, match=next(iter(wrong))):
        run(PENDULUM, {"name": "sundials-cvode"} | wrong)


def test_both_solvers_are_offered() -> None:
    assert [item.name for item in mbdkit_integrators()] == ["sundials-cvode", "sundials-ida"]
