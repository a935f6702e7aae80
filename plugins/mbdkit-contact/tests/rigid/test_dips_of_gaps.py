"""Gaps that close and open again within one step, and runs that stop in the step of an impact."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.rigid import scenes
from tests.rigid.scenes import FLOOR, G

import mbdkit

METHODS: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "dopri5": ({"name": "dopri5", "adaptive": True}, {}), "rk4": ({"name": "rk4"}, {"step": 0.1}),
    "gauss": ({"name": "gauss", "stages": 2, "adaptive": True}, {}), "scipy-dop853": ({"name": "scipy-dop853"}, {}),
}  # fmt: skip


def run(method: str, bodies: dict[str, Any], contacts: dict[str, Any], end: float, **more: Any) -> mbdkit.Run:
    integrator, time = METHODS[method]
    model = {"gravity": more.pop("gravity", [0.0, 0.0]), "bodies": bodies, "contacts": contacts}
    return scenes.run(model, end, **time, method=integrator, **more)


def rod(height: float, angle: float, rate: float, rise: float, points: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a rod of 1 m, and contacts of points along it with the floor, its ends last."""
    bodies = {
        "rod": {
            "mass": 1.0, "inertia": 1.0 / 12.0, "position": [0.0, height], "velocity": [0.0, rise],
            "angle": angle, "angular_velocity": rate,
        }
    }  # fmt: skip
    places = [*np.linspace(-0.3, 0.3, points - 2).tolist(), -0.5, 0.5]
    contacts = {
        f"c{i}": {"bodies": ["ground", "rod"], "shapes": [FLOOR, {"point": [x, 0.0]}], "restitution": 0.5}
        for i, x in enumerate(places)
    }
    return bodies, contacts


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("points", [2, 10])  # more than eight contacts are only examined in the neighbourhood
def test_an_end_of_a_turning_rod_that_dips_into_the_floor_strikes_it(method: str, points: int) -> None:
    # expected: the first zero of h + u t - |sin(a + w t)| / 2 in free flight without gravity. The first dip is the
    # deepest. Near misses of 1e-7 m have no impact.
    random = np.random.default_rng(53)
    rise, end = 0.2, 1.0
    for depth in (1e-3, 1e-6, -1e-7):
        angle, rate = random.uniform(0.2, 1.0), random.uniform(8.0, 25.0)
        bottom = (math.acos(2.0 * rise / rate) - angle) / rate  # where u = w cos(a + w t) / 2
        height = 0.5 * math.sin(angle + rate * bottom) - rise * bottom - depth

        def lowest(t: float, height: float = height, angle: float = angle, rate: float = rate) -> float:
            return height + rise * t - 0.5 * abs(math.sin(angle + rate * t))

        output = {} if "step" in METHODS[method][1] else {"interval": 0.02}
        found = run(method, *rod(height, angle, rate, rise, points), end, output=output)
        gaps = np.array([found.contacts[name].gap for name in found.contacts])
        assert found.status == "complete"
        assert np.min(gaps) > -1e-9
        if depth < 0.0:
            assert len(found.impacts.time) == 0
        else:
            first = brentq(lowest, 0.0, bottom, xtol=1e-15)
            assert found.impacts.time[0] == pytest.approx(first, abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("depth", [0.1, 1e-4, 1e-8, -1e-8])
def test_a_ball_that_is_pulled_back_from_the_floor_touches_it_if_its_parabola_does(method: str, depth: float) -> None:
    # expected: y = h - v t + a t^2 / 2 has its minimum -depth at v / a; a plastic impact at the first zero, and then
    # a t^2 / 2. The whole dip is within a step of an adaptive method.
    pull, speed = 8.0, 2.0
    height = 0.5 * speed**2 / pull - depth
    bodies = {"b": {"mass": 1.0, "position": [0.0, height], "velocity": [0.0, -speed]}}
    contacts = {"floor": {"bodies": ["ground", "b"], "shapes": [FLOOR, {"point": [0.0, 0.0]}], "restitution": 0.0}}
    found = run(method, bodies, contacts, 1.0, gravity=[0.0, pull])
    expected = height - speed + 0.5 * pull
    if depth > 0.0:
        touch = 2.0 * height / (speed + math.sqrt(2.0 * pull * depth))
        assert found.impacts.time == pytest.approx([touch], abs=1e-9)
        assert found.impacts.normal_impulse == pytest.approx([speed - pull * touch], abs=1e-9)
        expected = 0.5 * pull * (1.0 - touch) ** 2
    else:
        assert len(found.impacts.time) == 0
    assert found["b"].position[-1, 1] == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_a_run_that_stops_in_the_step_of_an_impact_before_it_has_no_impact(method: str) -> None:
    # expected: free fall from 1 m to 0.002 m
    bodies = {"b": {"mass": 1.0, "position": [0.0, 1.0]}}
    contacts = {"floor": {"bodies": ["ground", "b"], "shapes": [FLOOR, {"point": [0.0, 0.0]}]}}
    events = {"low": {"when": "b.y - 0.002", "direction": "falling", "action": "stop"}}
    found = run(method, bodies, contacts, 1.0, gravity=[0.0, -G], events=events)
    assert found.time[-1] == pytest.approx(math.sqrt(2.0 * 0.998 / G), abs=1e-9)
    assert found["b"].velocity[-1, 1] == pytest.approx(-math.sqrt(2.0 * G * 0.998), rel=1e-9)
    assert len(found.impacts.time) == 0
