"""Gradients of runs with compliant contacts: closed forms of a bouncing ball, and differences of accurate runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.gradients.bouncing_ball import GAUSS, MEASURES, PAD, expected
from tests.gradients.bouncing_ball import ball as ball_on_pad

import mbdkit
from tests.margins import assert_within

ADAPTIVE = {"name": "dopri5", "adaptive": True, "rtol": 1e-9, "atol": 1e-11}
LINEAR = {"law": "linear", "stiffness": "k", "dissipation": "c"}


def ball(end: float, integrator: dict[str, Any] = GAUSS, **compliance: Any) -> dict[str, Any]:
    """Return a circle of radius PAD that falls on the floor."""
    spec = ball_on_pad(end, 0.01, integrator)
    model = {key: value for key, value in spec["model"].items() if key != "forces"}
    floor = {
        "bodies": ["ground", "ball"], "shapes": [{"line": {"normal": [0, 1]}}, {"circle": {"radius": PAD}}],
        "friction": 0.0, "compliance": compliance,
    }  # fmt: skip
    times = {"end": end} if integrator.get("adaptive") else spec["time"]
    return {**spec, "model": {**model, "contacts": {"floor": floor}}, "time": times}


def differences(spec: dict[str, Any], measures: list[str]) -> np.ndarray:
    """Return the derivatives with respect to all parameters by extrapolated central differences of accurate runs."""
    accurate = {"name": "dop853", "adaptive": True, "rtol": 1e-12, "atol": 1e-13}
    spec = {**spec, "integrator": accurate, "time": {"end": spec["time"]["end"]}}
    texts = {f"m{i}": text for i, text in enumerate(measures)}

    def values(**changed: float) -> np.ndarray:
        run = mbdkit.run(spec, parameters=spec["parameters"] | changed, measures=texts)
        return np.array([run.measures[name] for name in texts])

    columns = []
    for name, value in spec["parameters"].items():
        near, far = (
            (values(**{name: value * (1.0 + h)}) - values(**{name: value * (1.0 - h)})) / (2.0 * h * value)
            for h in (5e-5, 1e-4)
        )
        columns.append((4.0 * near - far) / 3.0)
    return np.array(columns).T


@pytest.mark.parametrize("end", [pytest.param(0.45, id="in contact"), pytest.param(0.9, id="after it")])
@pytest.mark.parametrize("method", [GAUSS, ADAPTIVE], ids=lambda one: str(one["name"]))
def test_gradients_through_the_jump_of_a_linear_contact_are_those_of_the_motion(
    end: float, method: dict[str, Any]
) -> None:
    # expected: the closed form; the force jumps at the beginning of contact, and has a corner at its end
    sections = {"output": {"every": 1}} if method is ADAPTIVE else {}
    found = mbdkit.gradient(ball(end, method, **LINEAR) | sections, MEASURES, ["y", "k", "c"])
    np.testing.assert_allclose(found.jacobian, expected(end), rtol=1e-6 if method is ADAPTIVE else 2e-7, atol=1e-12)
    assert found.check is not None
    assert found.check.is_passed, str(found)
    assert not found.doubts


def test_linear_contacts_of_polygons_are_doubted_by_name() -> None:
    spec = ball(0.45, **LINEAR)
    table = {"polygon": [[-1.0, -0.1], [1.0, -0.1], [1.0, 0.0], [-1.0, 0.0]]}
    spec["model"]["contacts"]["floor"]["shapes"][0] = table
    found = mbdkit.gradient(spec, MEASURES, ["y"], check=False)
    assert any("the contact 'floor'" in doubt and "use another law than `linear`" in doubt for doubt in found.doubts)


def test_gradients_of_a_ball_on_a_floor_of_hunt_and_crossley() -> None:
    spec = ball(0.7, ADAPTIVE, stiffness="k", dissipation="c")
    spec["parameters"] = {"y": 1.0, "k": 2000.0, "c": 0.2}
    _compare(spec, MEASURES)


def test_gradients_of_a_box_that_slides_tips_and_sticks() -> None:
    box = {"mass": 1.0, "inertia": 0.005, "position": [0.0, 0.1], "velocity": ["v", 0.0], "angular_velocity": -2.0}
    corners = [["-half", -0.1], ["half", -0.1], ["half", 0.1], ["-half", 0.1]]
    floor = {
        "bodies": ["ground", "box"], "shapes": [{"line": {"normal": [0.0, 1.0]}}, {"polygon": corners}],
        "friction": "mu", "compliance": {"stiffness": "k", "dissipation": 0.5},
    }  # fmt: skip
    spec = {
        "mbdkit": 1, "parameters": {"v": 0.8, "mu": 0.6, "k": 2e4, "half": 0.05},
        "model": {"name": "mechanism", "bodies": {"box": box}, "contacts": {"floor": floor}}, "integrator": ADAPTIVE,
        "time": {"end": 0.3},
    }  # fmt: skip
    _compare(spec, ["final(bodies.box.x)", "final(bodies.box.angle)"])


def _compare(spec: dict[str, Any], measures: list[str]) -> None:
    """The check is passed, so that the stated errors are at most 1 %, and these cover the distance from differences."""
    found, reference = mbdkit.gradient(spec, measures, list(spec["parameters"])), differences(spec, measures)
    assert found.check is not None
    assert found.check.is_passed, str(found)
    # margin: an error bar of mbdkit
    assert_within(found.jacobian - reference, 3.5 * found.error + 1e-6 * np.abs(reference))


def test_errors_are_true_if_steps_pass_the_beginning_of_a_contact_of_hunt_and_crossley() -> None:
    # expected: own runs between the beginning and the end of the contact, by SciPy
    values = {"m": 1.0, "k": 1e5, "h": 0.2}
    dissipation, gravity, end = 0.3, 9.81, 0.35

    def height(m: float, k: float, h: float) -> float:
        def rates(_: float, y: np.ndarray) -> list[float]:
            depth = -y[0]
            return [y[1], k * np.sign(depth) * abs(depth) ** 1.5 * (1 - 1.5 * dissipation * y[1]) / m - gravity]

        def leaves(_: float, y: np.ndarray) -> float:
            return float(y[0])

        leaves.terminal, leaves.direction = True, 1.0  # type: ignore[attr-defined]
        fall = np.sqrt(2.0 * h / gravity)
        solved = solve_ivp(rates, (fall, end), [0.0, -gravity * fall], "DOP853", rtol=1e-12, atol=1e-15, events=leaves)
        rest = end - solved.t[-1]
        return float(solved.y[1, -1] * rest - gravity * rest**2 / 2)

    changes = [(name, 1e-4 * value) for name, value in values.items()]
    right = np.array(
        [
            (height(**{**values, name: values[name] + x}) - height(**{**values, name: values[name] - x})) / (2.0 * x)
            for name, x in changes
        ]
    )
    spec = ball(end, stiffness="k", dissipation=dissipation)
    spec["parameters"] = values
    spec["model"]["bodies"]["ball"] = {"mass": "m", "inertia": 0.01, "position": [0, f"{PAD} + h"]}
    spec |= {"integrator": {"name": "rk4"}, "time": {"end": end, "step": 5e-4}}
    found = mbdkit.gradient(spec, "final(bodies.ball.y)", [*values])
    true, stated = np.abs(found.jacobian[0] - right), found.error[0]
    assert np.all(true <= 2.0 * stated)
    assert np.all(stated <= 4.0 * true)
