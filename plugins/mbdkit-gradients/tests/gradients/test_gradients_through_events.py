"""Gradients of the times of events, and of runs that end at an event."""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipk
from tests.gradients.checks import assert_passed

import mbdkit
from mbdkit import SpecError

ANGLE, LENGTH, INERTIA, GRAVITY = 1.0, 1.3, 1e-3, 9.81


def pendulum(action: str) -> dict[str, Any]:
    """Return a pendulum that is released at an angle, and an event at its lowest position."""
    return {
        "mbdkit": 1, "parameters": {"L": LENGTH},
        "model": {
            "name": "mechanism",
            "bodies": {
                "bob": {
                    "mass": 1.0, "inertia": INERTIA, "angle": ANGLE,
                    "position": [f"L*{sin(ANGLE)!r}", f"-L*{cos(ANGLE)!r}"],
                },
            },
            "joints": {"A": {"type": "revolute", "bodies": ["ground", "bob"], "points": [[0, 0], [0, "L"]]}},
        },
        "integrator": {"name": "gauss", "stages": 4}, "time": {"end": 1.0, "step": 0.01},
        "events": {"low": {"when": "bob.angle", "action": action}},
    }  # fmt: skip


def quarter(length: float) -> float:
    """Return a quarter of the period."""
    return float(sqrt((length + INERTIA / length) / GRAVITY) * ellipk(sin(ANGLE / 2) ** 2))


def quarter_by_length(length: float) -> float:
    return quarter(length) * 0.5 * (1.0 - INERTIA / length**2) / (length + INERTIA / length)


@pytest.mark.parametrize(("action", "measure"), [("note", "events.low.time"), ("stop", "final(t)")])
def test_derivative_of_the_period_of_a_pendulum_by_its_length(action: str, measure: str) -> None:
    # expected: the period by the complete elliptic integral; a physical pendulum with the length L + I / (m L)
    found = mbdkit.gradient(pendulum(action), measure, "L", check=False)
    assert found.value[0] == pytest.approx(quarter(LENGTH), rel=0, abs=1e-11)
    assert found.jacobian[0, 0] == pytest.approx(quarter_by_length(LENGTH), rel=0, abs=1e-10)


def test_state_and_integrals_at_an_event_that_ends_the_run_move_with_its_time() -> None:
    # expected: by the balance of energy, the angular velocity there is sqrt(2 m g L (1 - cos) / (m L^2 + I)); the
    # horizontal velocity of the bob integrates to the distance L sin
    found = mbdkit.gradient(
        pendulum("stop"),
        ["final(bodies.bob.angular_velocity)", "integral(bodies.bob.vx)", "final(bodies.bob.angle)"],
        "L",
    )
    inertia = LENGTH**2 + INERTIA
    rate = -sqrt(2.0 * GRAVITY * LENGTH * (1.0 - cos(ANGLE)) / inertia)
    by_length = rate * (0.5 / LENGTH - LENGTH / inertia)
    np.testing.assert_allclose(found.value, [rate, -LENGTH * sin(ANGLE), 0.0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.jacobian[:, 0], [by_length, -sin(ANGLE), 0.0], rtol=0, atol=1e-9)
    assert_passed(found)


def test_functions_of_a_moving_end_move_with_it() -> None:
    # expected: the angle at the moving end is zero, and `at` of the end is `final`; the check compares with differences
    # of runs, and of runs of another method
    measures = ["at(bodies.bob.angular_velocity, final(t))", "final(bodies.bob.angular_velocity)"]
    found = mbdkit.gradient(pendulum("stop"), measures, "L", check=False)
    assert found.jacobian[0, 0] == pytest.approx(found.jacobian[1, 0], rel=1e-12)
    loaded = pendulum("stop")
    loaded["model"]["forces"] = {"load": {"type": "torque", "body": "bob", "value": 0.3}}
    before = mbdkit.gradient(loaded, ["integral(energy.potential)", "at(bodies.bob.angle, final(t) - 0.002)"], "L")
    check = before.check
    assert check is not None
    np.testing.assert_allclose(check.derivative, check.extrapolated, rtol=1e-7)
    assert check.is_passed, str(before)
    np.testing.assert_allclose(check.derivative, check.reference, rtol=1e-5)
    assert not before.doubts


def test_an_event_that_is_noted_leaves_integrals_as_they_are() -> None:
    # expected: the integral without events
    measures = ["integral(bodies.bob.angular_velocity**2)"]
    noted = mbdkit.gradient(pendulum("note"), measures, "L", check=False)
    spec = pendulum("note")
    del spec["events"]
    alone = mbdkit.gradient(spec, measures, "L", check=False)
    assert noted.value == pytest.approx(alone.value, rel=1e-14)
    np.testing.assert_allclose(noted.jacobian, alone.jacobian, rtol=1e-12)


def test_parameters_and_forces_in_the_expression_of_an_event() -> None:
    # expected: the angular velocity at the angle, by the balance of energy; for the pull, differences of runs
    spec = pendulum("note")
    spec["parameters"]["limit"] = 0.2
    spec["events"] = {
        "turned": {"when": "bob.angle - 0.5*limit", "action": "note"},
        "pulled": {"when": "A.force - 20*limit", "action": "note"},
    }
    found = mbdkit.gradient(spec, ["events.turned.time", "events.pulled.time"], ["L", "limit"])
    inertia = LENGTH**2 + INERTIA
    rate = -sqrt(2.0 * GRAVITY * LENGTH * (cos(0.1) - cos(ANGLE)) / inertia)
    assert found["events.turned.time", "limit"] == pytest.approx(0.5 / rate, rel=1e-9)
    assert_passed(found)


def test_an_event_that_does_not_happen_has_no_derivative() -> None:
    spec = pendulum("note")
    spec["events"]["low"]["when"] = "bob.angle + 20"
    found = mbdkit.gradient(spec, "events.low.time", "L", check=False)
    assert np.isnan(found.jacobian[0, 0])
    assert "does not happen" in found.doubts[0]


def test_an_event_without_a_derivative_is_named_and_not_the_measures() -> None:
    spec = pendulum("stop") | {"events": {"low": {"when": "bob.angle + joints.A.misalignment", "action": "stop"}}}
    with pytest.raises(
        SpecError, match=r"^events\.low\.when: the time of this event has no derivative: joints\.A\.mis"
    ):
        mbdkit.gradient(spec, "final(bob.angular_velocity)", "L")
