"""Loads on bodies at rest that exceed friction or weight between the steps of the motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tests.benchmarks.drawn_contacts import rigid

from .scenes import FLOOR, G, outline, run

METHODS: list[Any] = [
    {"name": "dop853", "adaptive": True},
    {"name": "dopri5", "adaptive": True},
    {"name": "radau-iia", "stages": 3, "adaptive": True},
    {"name": "gauss", "stages": 3, "adaptive": True},
    "scipy-dop853",
]
FRICTION, SIZE, RATE = 0.15, 2.2, 31.0


def slipped(end: float) -> float:
    """Return where a block of 1 kg is that the force `SIZE` sin(`RATE` t) pushes: SciPy, from one rest to the next."""
    x = t = 0.0
    first = np.arcsin(FRICTION * G / SIZE) / RATE

    def stops(_t: float, y: np.ndarray) -> float:
        return float(y[1] - 1e-13)

    stops.terminal, stops.direction = True, -1.0  # type: ignore[attr-defined]
    k = 0
    while (t := first + k * np.pi / RATE) < end:
        sign = (-1.0) ** k
        solved = solve_ivp(
            lambda s, y, sign=sign: [y[1], sign * SIZE * np.sin(RATE * s) - FRICTION * G], (t, end), [0.0, 1e-12],
            method="DOP853", rtol=1e-11, atol=1e-15, events=stops, max_step=1e-3,
        )  # fmt: skip
        x += sign * solved.y[0, -1]
        k += 1
    return x


@pytest.mark.parametrize("load", [f"{SIZE}*sin({RATE}*t)", f"{SIZE}*sin(states.phase)"], ids=["time", "state"])
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_a_resting_block_slips_whenever_the_load_exceeds_friction(method: Any, load: str) -> None:
    contact = {"bodies": ["ground", "b"], "friction": FRICTION, "shapes": [FLOOR, outline(0.2, 0.1)]}
    model = {
        "bodies": {"b": {"mass": 1.0, "inertia": 0.1, "position": [0, 0.1]}}, "contacts": {"c": contact},
        "forces": {"F": {"type": "force", "body": "b", "value": [load, 0.0]}},
        "states": {"phase": {"rate": f"{RATE}", "initial": 0.0}},
    }  # fmt: skip
    done = run(model, 1.0, method=method)
    assert done["b"].position[-1, 0] == pytest.approx(slipped(1.0), abs=1e-6)


@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("load", ["30*t", "9.81*exp(t - 0.2)", "200*t**3"])
def test_a_growing_load_lifts_a_ball_from_rest(method: Any, load: str) -> None:
    def force(t: float) -> float:
        return float(eval(load, {"exp": np.exp, "t": t}))

    contact = {"bodies": ["ground", "b"], "shapes": [FLOOR, {"circle": {"radius": 0.1}}]}
    model = {
        "bodies": {"b": {"mass": 1.0, "inertia": 0.1, "position": [0, 0.1]}}, "contacts": {"c": contact},
        "forces": {"F": {"type": "force", "body": "b", "value": [0.0, load]}},
    }  # fmt: skip
    begin = brentq(lambda t: force(t) - G, 0.01, 0.69, xtol=1e-14)
    height = solve_ivp(lambda t, y: [y[1], force(t) - G], (begin, 0.7), [0.1, 0.0], rtol=1e-11, atol=1e-13).y[0, -1]
    done = run(model, 0.7, method=method)
    assert done.status == "complete"
    assert done["b"].position[-1, 1] == pytest.approx(height, abs=3e-6)


def test_slip_is_found_behind_a_place_where_redundant_contacts_only_seem_to_slip() -> None:
    """Both corners of a block carry the load; with forces of least norm, one of them slips before both do."""
    is_right, _, what = rigid(np.random.default_rng([1, 783]))
    assert is_right, what


@pytest.mark.parametrize("size", [1e-2, 1e-4, 1e-7])
def test_the_same_scene_in_another_size_has_the_same_impacts(size: float) -> None:
    """By Froude's law: lengths in proportion to `size`, times and speeds to its root."""

    def scene(s: float) -> Any:
        t = np.sqrt(s)
        contact = {
            "bodies": ["ground", "b"],
            "restitution": 0.5,
            "friction": 0.3,
            "shapes": [FLOOR, outline(0.2 * s, 0.1 * s)],
        }
        body = {"mass": s**3, "inertia": 0.02 * s**5, "position": [0, 0.8 * s], "angle": 0.4, "velocity": [0.3 * t, 0]}
        model = {"bodies": {"b": body | {"angular_velocity": 1.0 / t}}, "contacts": {"c": contact}}
        return run(model, 3.0 * t, method={"name": "dop853", "adaptive": True})

    one, other = scene(1.0), scene(size)
    assert len(other.impacts.time) == len(one.impacts.time)
    np.testing.assert_allclose(other["b"].position[-1] / size, one["b"].position[-1], atol=1e-6)
