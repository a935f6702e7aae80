"""Times of events against closed forms and against an independent integration in minimal coordinates."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import mbdkit

from .rods import TwoRods
from .running import gauss

G = 9.81
TIGHT = {"name": "scipy-dop853", "rtol": 1e-13, "atol": 1e-14}
METHODS = {"gauss-3": (gauss(3), 0.01), "rk4": ({"name": "rk4"}, 0.0005), "scipy-dop853": (TIGHT, None)}
methods = pytest.mark.parametrize(("integrator", "step"), METHODS.values(), ids=METHODS.keys())


def watched(
    model: dict[str, Any], integrator: dict[str, Any], end: float, step: float | None, events: dict[str, Any]
) -> mbdkit.Run:
    """Return a complete run that watches for events; an event without `direction` and `action` is its expression."""
    time = {"end": end} if step is None else {"end": end, "step": step}
    spec = {"mbdkit": 1, "model": model, "integrator": integrator, "time": time, "output": {"every": 1000}}
    named = {name: event if isinstance(event, dict) else {"when": event} for name, event in events.items()}
    run: mbdkit.Run = mbdkit.run(spec, events=named)
    return run.check()


def passing_times(tilt: float, count: int) -> list[float]:
    """Return when a rod of 1 m, released from the horizontal, is first tilted by `tilt` from the vertical, and later.

    sin(phi / 2) = k sn(w0 t + K, k^2) with k = sin(45 degrees) and w0^2 = 3 g / 2 L: it passes -tilt and tilt in turn.
    """
    with mpmath.workdps(30):
        k2, frequency = mpmath.mpf(1) / 2, mpmath.sqrt(mpmath.mpf(3) * mpmath.mpf(G) / 2)
        quarter = mpmath.ellipk(k2)
        arc = mpmath.ellipf(mpmath.asin(mpmath.sin(mpmath.mpf(tilt) / 2) / mpmath.sqrt(k2)), k2)
        return [float(((2 * number + 1) * quarter - arc) / frequency) for number in range(count)]


@methods
def test_pendulum_passes_the_vertical_when_the_elliptic_integral_says(
    integrator: dict[str, Any], step: float | None
) -> None:
    # expected: odd multiples of K(k) / w0
    model = {"name": "single-pendulum", "angle": 0.0}
    with watched(model, integrator, 3.0, step, {"down": "rod1.angle + pi/2"}) as run:
        expected = passing_times(0.0, 3)
        np.testing.assert_allclose(run.events.time, expected, rtol=0, atol=1e-10)
        assert run.events.direction.tolist() == [-1, 1, -1]
        np.testing.assert_allclose(run.events.position[:, 0, 2], -math.pi / 2, rtol=0, atol=1e-10)


ANGLES, END = (-0.9, -0.3), 3.0
SCALARS: dict[str, tuple[str, Callable[[TwoRods, float, np.ndarray], float]]] = {
    "kinetic energy": ("energy.kinetic - 5", lambda rods, t, y: kinetic(y) - 5.0),
    "angle of a joint": ("J2.angle - 0.3*sin(t)", lambda rods, t, y: y[1] - y[0] - 0.3 * math.sin(t)),
    "height of a body": ("rod2.y + 1.2", lambda rods, t, y: math.sin(y[0]) + math.sin(y[1]) / 2 + 1.2),
    "force in the outer joint": ("J2.force_y - 12", lambda rods, t, y: outer_force(rods, t, y)[1] - 12.0),
    "magnitude of that force": ("J2.force - 15", lambda rods, t, y: math.hypot(*outer_force(rods, t, y)) - 15.0),
    "acceleration of a body": ("rod2.ay - 4", lambda rods, t, y: outer_force(rods, t, y)[1] - G - 4.0),
}


def kinetic(y: np.ndarray) -> float:
    """Return the kinetic energy [J] of two rods of 1 m and 1 kg."""
    a, b = y[2], y[3]
    return float(a * a * (1 / 3 + 1) / 2 + b * b / 6 + a * b * math.cos(y[0] - y[1]) / 2)


def outer_force(rods: TwoRods, t: float, y: np.ndarray) -> tuple[float, float]:
    """Return the force [N] of the inner rod on the outer one: mass times acceleration, less gravity."""
    (one, two), (a, b) = rods.accelerations(t, y[:2], y[2:4]), y[2:4]
    x = -math.sin(y[0]) * one - math.cos(y[0]) * a * a - (math.sin(y[1]) * two + math.cos(y[1]) * b * b) / 2
    z = math.cos(y[0]) * one - math.sin(y[0]) * a * a + (math.cos(y[1]) * two - math.sin(y[1]) * b * b) / 2
    return float(x), float(z + G)


@pytest.fixture(scope="module")
def solution() -> Any:
    """The double pendulum in its two angles, by SciPy's DOP853 in small steps with dense output."""
    rods = TwoRods()
    return solve_ivp(
        rods.right_side, (0.0, END), [*ANGLES, 0.0, 0.0, 0.0, 0.0], method="DOP853", rtol=1e-13, atol=1e-15,
        max_step=0.005, dense_output=True,
    ).sol  # fmt: skip


@pytest.mark.parametrize("name", SCALARS)
def test_double_pendulum_crosses_where_an_integration_in_two_angles_does(name: str, solution: Any) -> None:
    # expected: roots of the same scalar over DOP853 in minimal coordinates
    text, scalar = SCALARS[name]
    rods = TwoRods()
    times = np.linspace(0.0, END, 3001)
    values = [scalar(rods, t, solution(t)) for t in times]
    places = [i for i in range(3000) if values[i] * values[i + 1] < 0]
    expected = [brentq(lambda t: scalar(rods, t, solution(t)), times[i], times[i + 1], xtol=1e-14) for i in places]
    assert len(expected) >= 3
    with watched({"name": "double-pendulum", "angles": list(ANGLES)}, gauss(4), END, 0.005, {"it": text}) as run:
        np.testing.assert_allclose(run.events.time, expected, rtol=0, atol=1e-10)
        assert run.events.direction.tolist() == [1 if values[i] < 0 else -1 for i in places]
        for event, state in zip(run.events, run.events.position, strict=True):
            np.testing.assert_allclose(state[:, 2], solution(event.time)[:2], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("integrator", "order", "coarse"), [({"name": "rk4"}, 4, 0.02), (gauss(2), 4, 0.06), (gauss(3), 6, 0.06)]
)
def test_an_event_is_located_with_the_order_of_the_method(
    integrator: dict[str, Any], order: int, coarse: float
) -> None:
    # expected: errors against K(k) / w0 shrink by 2^order with half the step
    exact = passing_times(0.0, 3)[2]
    errors = []
    for step in (coarse, coarse / 2):
        with watched(
            {"name": "single-pendulum", "angle": 0.0}, integrator, 3.0, step, {"down": "rod1.angle + pi/2"}
        ) as run:
            errors.append(abs(run.events.time[2] - exact))
    # margin: order, from errors of mbdkit alone
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.2)


def test_a_pendulum_that_is_stopped_at_the_vertical_has_its_exact_state_there() -> None:
    # expected: K(k) / w0, and the rate from the energy: w^2 = 3 g / L
    stop = {"bottom": {"when": "rod1.angle + pi/2", "action": "stop"}}
    with watched({"name": "single-pendulum", "angle": 0.0}, gauss(4), 5.0, 0.01, stop) as run:
        assert run.time[-1] == pytest.approx(passing_times(0.0, 1)[0], abs=1e-12)
        assert run["rod1"].angular_velocity[-1] == pytest.approx(-math.sqrt(3 * G), abs=1e-11)
        assert run.status_reason.startswith("event: 'bottom' crossed zero downwards at t = 0.48333371")
