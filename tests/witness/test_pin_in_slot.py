"""A pin in a slot against closed forms and a differential equation in one angle: Scotch yoke and quick return.

Scotch yoke: a crank of radius R at the angle theta moves a yoke of mass M along x by a pin in a slot along y, so that
x = R cos(theta). At constant speed, the slot pushes the pin by R M w^2 cos(theta) along x and not along the slot. If
the crank turns freely, with the inertia J about its pivot, (J + M R^2 sin^2(theta)) theta'^2 is constant.

Quick return: the pin of a crank at the origin slides along a lever that turns about (0, -D), so that the angle of the
lever is atan2(D + R sin(theta), R cos(theta)).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from .running import gauss, run

R, D, M, SPEED, START = 0.2, 0.5, 1.7, 4.0, 0.3
CRANK = {"mass": 1.1, "inertia": 0.01}
J = CRANK["inertia"] + CRANK["mass"] * (R / 2) ** 2
"""Inertia of the crank about its pivot [kg m^2]."""
PIN = [R * math.cos(START), R * math.sin(START)]
RK4 = {"name": "rk4"}


def crank(rate: float = 0.0) -> dict[str, Any]:
    """Return the crank at its start."""
    velocity = [-rate * PIN[1] / 2, rate * PIN[0] / 2]
    start = {"position": [PIN[0] / 2, PIN[1] / 2], "angle": START, "velocity": velocity, "angular_velocity": rate}
    return {**CRANK, **start}


def scotch_yoke(*, driven: bool) -> dict[str, Any]:
    yoke = {"mass": M, "inertia": 0.02, "position": [PIN[0], 0.0], "velocity": [-SPEED * PIN[1], 0.0]}
    joints: dict[str, Any] = {
        "pivot": {"type": "revolute", "bodies": ["ground", "crank"], "at": [0.0, 0.0]},
        "guide": {"type": "prismatic", "bodies": ["ground", "yoke"], "at": [PIN[0], 0.0], "axis": [1, 0]},
        "slot": {"type": "point-on-line", "bodies": ["yoke", "crank"], "at": PIN, "axis": [0, 3]},
    }
    if driven:
        motion = f"{START} + {SPEED}*t"
        joints["motor"] = {"type": "driver", "bodies": ["ground", "crank"], "coordinate": "angle", "motion": motion}
    bodies = {"crank": crank(SPEED), "yoke": yoke}
    return {"name": "mechanism", "gravity": [0, 0], "bodies": bodies, "joints": joints}


def quick_return() -> dict[str, Any]:
    lever = {"mass": 2.0, "inertia": 0.1, "position": [0.0, -D], "angle": math.atan2(D + PIN[1], PIN[0])}
    return {
        "name": "mechanism",
        "bodies": {"crank": crank(SPEED), "lever": lever},
        "joints": {
            "pivot": {"type": "revolute", "bodies": ["ground", "crank"], "at": [0.0, 0.0]},
            "hinge": {"type": "revolute", "bodies": ["ground", "lever"], "at": [0.0, -D]},
            "pin": {
                "type": "point-on-line",
                "bodies": ["lever", "crank"],
                "points": [[0, 0], [R / 2, 0]],
                "axis": [1, 0],
            },
            "motor": {
                "type": "driver",
                "bodies": ["ground", "crank"],
                "coordinate": "angle",
                "motion": f"{START} + {SPEED}*t",
            },
        },
    }


def test_a_driven_scotch_yoke_moves_and_pushes_as_its_cosine() -> None:
    with run(scotch_yoke(driven=True), gauss(3), 2.0, 0.01) as there:
        angle = START + SPEED * there.time
        slot = there.joints["slot"]
        assert there["yoke"].position[:, 0] == pytest.approx(R * np.cos(angle), abs=1e-9)
        assert there["yoke"].velocity[:, 0] == pytest.approx(-R * SPEED * np.sin(angle), abs=1e-9)
        push = M * R * SPEED**2 * np.cos(angle)
        assert slot.reaction_force == pytest.approx(np.column_stack([push, 0.0 * push]), abs=1e-8)
        assert slot.reaction_torque == pytest.approx(0.0, abs=1e-12)
        # the torque of the motor makes the kinetic energy change
        torque = M * R**2 * SPEED**2 * np.sin(angle) * np.cos(angle)
        assert there.joints["motor"].reaction_torque == pytest.approx(torque, abs=1e-8)


def test_the_lever_of_a_quick_return_has_the_angle_of_the_pin() -> None:
    with run(quick_return(), gauss(3), 2.0, 0.005) as there:
        angle = START + SPEED * there.time
        square = R**2 + D**2 + 2 * R * D * np.sin(angle)
        lever = np.arctan2(D + R * np.sin(angle), R * np.cos(angle))
        assert there["lever"].angle == pytest.approx(lever, abs=1e-9)
        rate = SPEED * R * (R + D * np.sin(angle)) / square
        assert there["lever"].angular_velocity == pytest.approx(rate, abs=1e-8)
        # the pin is pushed across the lever: by the moment that turns the lever, over the distance of pin and hinge
        acceleration = SPEED**2 * R * D * np.cos(angle) * (D**2 - R**2) / square**2
        push = there.joints["pin"].reaction_force
        across = np.column_stack([-np.sin(lever), np.cos(lever)])
        along = np.column_stack([np.cos(lever), np.sin(lever)])
        assert np.sum(push * across, axis=1) == pytest.approx(-0.1 * acceleration / np.sqrt(square), abs=1e-7)
        assert np.sum(push * along, axis=1) == pytest.approx(0.0, abs=1e-10)


def free_angle(times: np.ndarray) -> np.ndarray:
    """Return the angle of the crank of the free yoke, to 13 digits."""
    moment = (J + M * R**2 * math.sin(START) ** 2) * SPEED**2

    def rate(t: float, angle: np.ndarray) -> np.ndarray:
        speed: np.ndarray = np.sqrt(moment / (J + M * R**2 * np.sin(angle) ** 2))
        return speed

    found = solve_ivp(rate, (0.0, times[-1]), [START], "DOP853", times, rtol=1e-13, atol=1e-14)
    angles: np.ndarray = found.y[0]
    return angles


@pytest.mark.parametrize(("integrator", "order"), [(gauss(2), 4), (gauss(3), 6), (RK4, 4)])
def test_a_free_yoke_is_integrated_with_the_order_of_the_method(integrator: dict[str, Any], order: int) -> None:
    errors = []
    for step in (0.05, 0.025):
        with run(scotch_yoke(driven=False), integrator, 1.0, step) as there:
            errors.append(np.max(np.abs(there["crank"].angle - free_angle(there.time))))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.7)
