"""Rigid contacts beside other elements, and methods for rigid contacts on mechanisms without them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.margins import assert_within

EVENT_DRIVEN = ("dop853", "radau-iia", "scipy-dop853")
TIME_STEPPING = {"moreau-jean": 1, "nonsmooth-generalized-alpha": 2}
"""Orders of these methods without contacts."""
PATH = [{"body": "ground", "point": [0.04, 0.3]}, {"body": "arm", "point": [-0.1, 0.0]}]
ELEMENTS: dict[str, dict[str, Any]] = {
    "muscles": {
        "muscles": {
            "biceps": {"path": PATH, "max_force": 30, "optimal_length": 0.12, "tendon_length": 0.18, "excitation": 0.3}
        }
    },
    "states": {
        "states": {"lag": {"rate": "-3*states.lag + arm.vy", "initial": 0.2}},
        "forces": {"motor": {"type": "torque", "body": "arm", "value": "states.lag"}},
    },
    "controllers": {
        "controllers": {"hold": {"period": 0.01, "delay": 0.003, "outputs": {"u": "-2*arm.angle"}}},
        "forces": {"motor": {"type": "torque", "body": "arm", "value": "controllers.hold.u"}},
    },
    "drivers": {
        "bodies": {"cam": {"mass": 1.0, "inertia": 0.01, "position": [0.0, 2.0]}},
        "joints": {
            "C": {"type": "revolute", "bodies": ["ground", "cam"], "points": [[0.0, 2.0], [0.0, 0.0]]},
            "D": {"type": "driver", "bodies": ["ground", "cam"], "coordinate": "angle", "motion": "max(-0.2, -2*t)"},
        },
    },
}


def dropped(height: float, more: dict[str, Any]) -> dict[str, Any]:
    """Return an arm that falls about a pin, with ground at `height` [m] below the pin, which its end may touch."""
    model: dict[str, Any] = {
        "name": "mechanism",
        "bodies": {"arm": {"mass": 1.0, "inertia": 0.02, "position": [0.2, 0.0]}},
        "joints": {"J": {"type": "revolute", "bodies": ["ground", "arm"], "points": [[0.0, 0.0], [-0.2, 0.0]]}},
    }
    for key, elements in more.items():
        model[key] = model.get(key, {}) | elements
    if np.isfinite(height):
        line = {"line": {"point": [0.0, -height], "normal": [0.0, 1.0]}}
        end = {"circle": {"center": [0.2, 0.0], "radius": 0.03}}
        model["contacts"] = {"k": {"bodies": ["ground", "arm"], "shapes": [line, end], "restitution": 0.5}}
    return model


def run(model: dict[str, Any], name: str, treatment: str = "compliant", **more: Any) -> mbdkit.Run:
    step = {} if name.startswith("scipy") else {"step": 1e-3}
    treated = {"contact": {"treatment": treatment}} if "contacts" in model else {}
    spec = {"mbdkit": 1, "model": model, "integrator": {"name": name}, "time": {"end": 0.3, **step}, "impacts": "allow"}
    return mbdkit.run(spec | treated | more)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("name", EVENT_DRIVEN)
def test_contacts_that_do_not_touch_change_no_motion(name: str, element: str) -> None:
    # expected: the same mechanism without contacts
    beside, alone = (
        run(
            dropped(height, ELEMENTS[element]),
            name,
            "event-driven",
            output={"interval": 0.05} if name != "dop853" else {},
        )
        for height in (5.0, np.inf)
    )
    np.testing.assert_allclose(beside["arm"].position, alone["arm"].position, atol=1e-9)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("name", EVENT_DRIVEN)
def test_the_end_of_an_arm_rebounds_by_the_law_of_impact_beside_other_elements(name: str, element: str) -> None:
    # expected: Newton's law for the velocity of the end along the normal, and no gap below zero
    result = run(dropped(0.1, ELEMENTS[element]), name, "event-driven")
    assert result.status == "complete"
    assert np.min(result.contacts["k"].gap) > -1e-9
    if element in ("muscles", "states", "drivers"):
        assert len(result.impacts.time) > 0
        energy = result.energy
        assert_within(energy.balance, 1e-6 * np.max(energy.kinetic))


@pytest.mark.parametrize("name", TIME_STEPPING)
def test_a_method_for_rigid_contacts_integrates_a_mechanism_without_contacts(name: str) -> None:
    # expected: dop853; the error falls by 2^order as the steps are halved
    model = dropped(np.inf, {})
    end = run(model, "dop853")["arm"].angle[-1]
    coarse, fine = (
        abs(run(model, name, time={"end": 0.3, "step": step})["arm"].angle[-1] - end) for step in (2e-3, 1e-3)
    )
    assert np.log2(coarse / fine) > TIME_STEPPING[name] - 0.2


@pytest.mark.parametrize("name", TIME_STEPPING)
def test_compliant_contacts_stay_compliant_with_a_method_for_rigid_contacts(name: str) -> None:
    # expected: a ball at rest overlaps the ground by its weight over the stiffness
    stiffness, weight = 2e3, 0.5 * 9.81
    shapes = [{"line": {"point": [0, 0], "normal": [0, 1]}}, {"circle": {"center": [0, 0], "radius": 0.1}}]
    model = {
        "name": "mechanism",
        "bodies": {"ball": {"mass": 0.5, "inertia": 1e-3, "position": [0.0, 0.1 - weight / stiffness]}},
        "contacts": {
            "k": {
                "bodies": ["ground", "ball"], "shapes": shapes, "compliance": {"law": "linear", "stiffness": stiffness},
            },
        },
    }  # fmt: skip
    result = run(model, name)
    np.testing.assert_allclose(result.contacts["k"].gap, -weight / stiffness, rtol=1e-6)
