"""There and back: the defect of reversal, where it tells something and where it does not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.spec import load_spec
from mbdkit_studies.spec.second_run_measures import Reversal, reverse, second_run
from tests.margins import assert_within

WHEEL = {
    "name": "mechanism", "gravity": [0.0, 0.0],
    "bodies": {"wheel": {"mass": 1.0, "inertia": 1.0, "position": [0, 0], "angle": 0.3, "angular_velocity": 0.7}},
    "joints": {}, "forces": {"spring": {"type": "torsion-spring", "bodies": ["ground", "wheel"], "stiffness": 4.0}},
}  # fmt: skip
SWING = {"name": "double-pendulum", "angles": [-1.0, -0.4], "rates": [0.5, -0.5]}


def there_and_back(model: Any, integrator: Any, time: Any = None, **sections: Any) -> Reversal:
    spec = {"mbdkit": 1, "model": model, "integrator": integrator, "time": time or {"steps": 200, "step": 0.05}}
    return reverse(load_spec(spec | sections))


def rk4(z: complex) -> complex:
    """Return RK4's stability function."""
    return sum(z**k / math.factorial(k) for k in range(5))


def radau5(z: complex) -> complex:
    """Return the stability function of Radau IIA with three stages: the Pade approximation (2, 3) of exp."""
    return (1 + 2 * z / 5 + z**2 / 20) / (1 - 3 * z / 5 + 3 * z**2 / 20 - z**3 / 60)


@pytest.mark.parametrize(
    ("integrator", "stability"), [({"name": "rk4"}, rk4), ({"name": "radau-iia", "stages": 3}, radau5)]
)
def test_the_defect_of_an_oscillator_is_that_of_the_stability_function(integrator: Any, stability: Any) -> None:
    # expected: with z = theta + i theta'/omega a step is a factor R(-i omega h) and reversal the conjugate, so that N
    # steps there and back are a factor |R|^(2 N); the mass metric of m = 1, I = 1 is that of the angle
    omega, h, steps = 2.0, 0.05, 200
    found = there_and_back(WHEEL, integrator)
    lost = 1 - abs(stability(-1j * omega * h)) ** (2 * steps)
    assert found.defect == pytest.approx(abs(lost) * 0.3, rel=1e-6)
    assert found.velocity_defect == pytest.approx(abs(lost) * 0.7, rel=1e-6)
    assert found.note == ""


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_gauss_comes_back_to_round_off_and_radau_does_not(stages: int) -> None:
    # expected: symmetric methods are reversible (Hairer, Lubich, Wanner, Geometric Numerical Integration, V.1)
    time = {"steps": 400, "step": 0.02}
    gauss = there_and_back(SWING, {"name": "gauss", "stages": stages}, time)
    assert_within(gauss.defect, 1e-12)
    assert_within(gauss.velocity_defect, 1e-11)
    radau = there_and_back(SWING, {"name": "radau-iia", "stages": 3}, time)
    assert radau.defect > 1e-9


def test_the_way_back_begins_where_the_way_there_ended_with_its_joints_apart() -> None:
    # a start that assembly repaired would be off by the drift, which is far larger than the defect
    time = {"steps": 200, "step": 0.1}
    spec = {"mbdkit": 1, "model": SWING, "integrator": {"name": "gauss", "stages": 2}, "time": time}
    assert mbdkit.run(spec).misalignment_max > 1e-6
    assert_within(there_and_back(SWING, spec["integrator"], time).defect, 1e-11)


def with_force(**force: Any) -> dict[str, Any]:
    return WHEEL | {"forces": {"f": {"bodies": ["ground", "wheel"]} | force}}


@pytest.mark.parametrize(
    "model",
    [
        with_force(type="torsion-spring", stiffness=4.0, damping=0.1),
        WHEEL | {"forces": {"f": {"type": "torque", "body": "wheel", "value": "0.1*sin(t)"}}},
        WHEEL
        | {
            "joints": {"d": {"type": "driver", "bodies": ["ground", "wheel"], "coordinate": "angle", "motion": "0.3*t"}}
        },
    ],
    ids=["damper", "load of time", "driver of constant speed"],
)
def test_a_mechanism_with_a_direction_of_time_has_no_defect(model: Any) -> None:
    found = there_and_back(model, {"name": "gauss", "stages": 2})
    assert math.isnan(found.defect)
    assert found.note.startswith("not-reversible: ")


def test_a_run_that_stops_has_no_defect_and_says_why() -> None:
    found = there_and_back(SWING, {"name": "rk4"}, {"steps": 100, "step": 0.01}, limits={"max_steps": 50})
    assert np.isnan([found.defect, found.velocity_defect]).all()
    assert found.note.startswith("max-steps: ")


def test_a_shorter_last_step_is_left_out() -> None:
    found = there_and_back(SWING, {"name": "gauss", "stages": 2}, {"end": 1.005, "step": 0.01})
    assert_within(found.defect, 1e-13)
    none = there_and_back(SWING, {"name": "gauss", "stages": 2}, {"end": 0.005, "step": 0.01})
    assert none.note.startswith("too-short: ")


def test_adaptive_methods_go_there_and_back_too() -> None:
    found = there_and_back(SWING, {"name": "scipy-dop853", "rtol": 1e-8, "atol": 1e-8}, {"end": 5.0})
    assert 1e-14 < found.defect < 1e-5


def test_velocity_misalignment_is_that_of_every_step_though_few_are_recorded() -> None:
    spec = {"mbdkit": 1, "model": SWING, "integrator": {"name": "rk4"}, "time": {"steps": 300, "step": 0.02}}
    every = mbdkit.run(spec).array("joints/velocity_misalignment").max()
    thin = load_spec(spec | {"output": {"every": 97, "quantities": []}})
    values, note = second_run(thin, ["velocity_misalignment_every_step"])
    assert values == {"velocity_misalignment_every_step": every}
    assert note == ""
