"""Default tolerances do not depend on the unit of length: a pendulum of 1 um is as accurate as one of 1 m.

A pendulum of length L under gravity g moves as one of 1 m under 9.81 m/s^2 in times scaled by sqrt(9.81 L / g).
Expected: the angle of the pendulum of 1 m by Gauss with six stages in small steps.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.integrators.step_methods import RungeKutta, run_with
from tests.margins import assert_within
from tests.slow_cases import slow, slow_but

SMALL = 1e-6
END = 3.0
METHODS: list[dict[str, Any]] = [
    {"name": "dopri5", "adaptive": True},
    {"name": "dop853", "adaptive": True, "rtol": 1e-8},
    {"name": "gauss", "stages": 3, "adaptive": True, "rtol": 1e-8},
    {"name": "radau-iia", "adaptive": True, "rtol": 1e-8},
    {"name": "scipy-radau"},
]


def spec_of(length: float, gravity: float, integrator: dict[str, Any], step: float | None = None) -> dict[str, Any]:
    """Return a swing of a rod of `length` [m] with a damper, so that there is work."""
    rate = math.sqrt(9.81 * length / gravity)
    rod = {"mass": 1.0, "inertia": length**2 / 12, "position": [0.5 * length, 0.0]}
    damper = {"type": "torsion-spring", "bodies": ["ground", "rod"], "stiffness": 0.0,
              "damping": 0.1 * length**2 / rate}  # fmt: skip
    model = {
        "name": "mechanism",
        "gravity": [0.0, -gravity],
        "bodies": {"rod": rod},
        "joints": {"A": {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0, 0], [-0.5 * length, 0]]}},
        "forces": {"d": damper},
    }
    time = {"end": END * rate} | ({} if step is None else {"step": step * rate})
    return {"mbdkit": 1, "model": model, "integrator": integrator, "time": time}


@cache
def exact() -> tuple[float, float]:
    """Return the angle [rad] and angular velocity [rad/s] of the pendulum of 1 m at the end."""
    with mbdkit.run(spec_of(1.0, 9.81, {"name": "gauss", "stages": 6}, 0.001)) as there:
        rod = there.check()["rod"]
        return float(rod.angle[-1]), float(rod.angular_velocity[-1])


def measured(length: float, gravity: float, integrator: dict[str, Any], **rest: Any) -> tuple[float, int]:
    """Return the largest relative error at the end, and the number of steps."""
    rate = math.sqrt(9.81 * length / gravity)
    angle, velocity = exact()
    with mbdkit.run(spec_of(length, gravity, integrator) | rest) as there:
        rod = there.check()["rod"]
        x, y = rod.position[-1, :2] / (0.5 * length)
        errors = (
            rod.angle[-1] - angle,
            rod.angular_velocity[-1] * rate - velocity,
            x - math.cos(angle),
            y - math.sin(angle),
        )
        return float(np.max(np.abs(errors))), int(there.stats["accepted"])


@pytest.mark.parametrize("gravity", [9.81e-6, 9.81], ids=["same time scale", "same gravity"])
@pytest.mark.parametrize("integrator", slow_but(METHODS, *METHODS[:4]), ids=lambda x: x["name"])
def test_a_pendulum_of_a_micrometre_is_as_accurate_as_one_of_a_metre(
    integrator: dict[str, Any], gravity: float
) -> None:
    large, steps = measured(1.0, 9.81, integrator)
    small, more = measured(SMALL, gravity, integrator)
    assert small <= 2 * large + 1e-11
    assert more == pytest.approx(steps, rel=0.02 if gravity < 1 else 0.5)  # margin: numbers of steps of mbdkit


@pytest.mark.parametrize("integrator", [METHODS[1], METHODS[3], *slow(METHODS[4])], ids=lambda x: x["name"])
def test_errors_of_a_small_mechanism_are_known(integrator: dict[str, Any]) -> None:
    with mbdkit.run(spec_of(SMALL, 9.81, integrator) | {"check": True}) as there:
        accuracy = there.check().accuracy
        assert accuracy is not None
        assert accuracy.is_complete, accuracy.method
        assert accuracy.position_error_max < 1e-5 * SMALL
    error, _ = measured(SMALL, 9.81, integrator)
    assert_within(error, 1e-5)


@pytest.mark.parametrize("symmetric", [False, True])
@pytest.mark.parametrize("method", ["gauss", "python"])
def test_projection_closes_the_joints_of_a_small_mechanism(method: str, symmetric: bool) -> None:
    # expected: the same motion as of 1 m, in times scaled by the root of the length
    ends = []
    for length in (1.0, 1e-9):
        rate = math.sqrt(length)
        model = {"name": "double-pendulum", "lengths": [length] * 2, "masses": [1.0, 1.0], "angles": [0.3, 0.2]}
        time = {"end": 2 * rate, "step": 0.02 * rate}
        rest: dict[str, Any] = {"stabilization": {"name": "projection", "symmetric": symmetric}}
        if method == "python":
            made = run_with(RungeKutta(), model, time, **rest)
        else:
            integrator = {"name": "gauss", "stages": 2}
            made = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": time, **rest})
        with made as there:
            assert_within(there.check().misalignment_max, 1e-14 * length)
            ends.append(there["rod2"].position[-1, :2] / length)
    assert ends[1] == pytest.approx(ends[0], abs=1e-10)


def test_an_asked_accuracy_is_that_of_the_small_mechanism() -> None:
    spec = spec_of(SMALL, 9.81, {}) | {"accuracy": 1e-7}
    del spec["integrator"]
    rate = math.sqrt(SMALL)
    with mbdkit.run(spec) as there:
        angle, _ = exact()
        assert_within(there.check()["rod"].angle[-1] - angle, 1e-7)
        assert there.time[-1] == pytest.approx(END * rate)


def test_a_given_absolute_tolerance_is_taken_as_it_is() -> None:
    # expected: with atol = rtol of a metre, the pendulum of a micrometre is far less accurate
    for integrator in (METHODS[1], METHODS[4]):
        small, _ = measured(SMALL, 9.81e-6, integrator)
        loose, _ = measured(SMALL, 9.81e-6, integrator | {"atol": 1e-5})
        assert loose > 100 * small
