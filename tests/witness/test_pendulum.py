"""The compound pendulum at large angles against elliptic functions, its pin force against the energy integral."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from .pendulum import Pendulum
from .running import gauss, run

STARTS = {
    "released from the horizontal": (0.0, 0.0),
    "released 21 degrees below the upright": (1.2, 0.0),
    "pushed through the lowest point": (-1.5, 3.0),
    "swinging on the far side of a full turn": (-8.0, 0.5),
    "turning over forwards": (0.3, 9.0),
    "turning over backwards": (-1.5, -12.0),
}
starts = pytest.mark.parametrize(("angle", "rate"), STARTS.values(), ids=STARTS.keys())


@starts
def test_gauss4_follows_the_elliptic_functions_to_1e_12(angle: float, rate: float) -> None:
    # expected: closed form, Jacobi elliptic functions with 40 digits
    result = run({"name": "single-pendulum", "angle": angle, "rate": rate}, gauss(4), end=5.0, step=0.01, every=5)
    pendulum = Pendulum.rod(angle=angle, rate=rate)
    times = np.asarray(result.time)
    angles, rates = pendulum.motion(times)
    np.testing.assert_allclose(result["rod1"].position, pendulum.position(times), rtol=0, atol=1e-12)
    np.testing.assert_allclose(result["rod1"].angle, angles, rtol=0, atol=1e-12 * max(1.0, np.abs(angles).max()))
    np.testing.assert_allclose(result["rod1"].angular_velocity, rates, rtol=0, atol=1e-11)


@starts
def test_pin_force_follows_the_energy_integral_to_1e_10(angle: float, rate: float) -> None:
    # expected: closed form from the energy integral at the elliptic functions' angle
    model = {"name": "single-pendulum", "angle": angle, "rate": rate, "length": 1.0, "mass": 2.0}
    result = run(model, gauss(4), end=5.0, step=0.01, every=5)
    expected = Pendulum.rod(mass=2.0, angle=angle, rate=rate).pin_force(np.asarray(result.time))
    np.testing.assert_allclose(result.joints["J1"].reaction_force, expected, rtol=0, atol=1e-10)


def test_a_body_with_an_offset_pin_follows_the_elliptic_functions() -> None:
    # expected: closed form; the body is held at a point off both of its axes
    pendulum = Pendulum(mass=2.0, arm=math.hypot(0.3, 0.4), inertia=0.7, angle=-0.2)
    position = [pendulum.arm * math.cos(-0.2), pendulum.arm * math.sin(-0.2)]
    tilt = math.atan2(-0.4, 0.3)  # of the line from pin to centre in the body's frame
    model = {
        "name": "mechanism",
        "bodies": {"plate": {"mass": 2.0, "inertia": 0.7, "position": position, "angle": -0.2 - tilt}},
        "joints": {"pin": {"type": "revolute", "bodies": ["ground", "plate"], "points": [[0.0, 0.0], [-0.3, 0.4]]}},
    }
    result = run(model, gauss(4), end=5.0, step=0.01, every=5)
    times = np.asarray(result.time)
    np.testing.assert_allclose(result["plate"].position, pendulum.position(times), rtol=0, atol=1e-12)
    np.testing.assert_allclose(result["plate"].angle, pendulum.motion(times)[0] - tilt, rtol=0, atol=3e-12)
    np.testing.assert_allclose(result.joints["pin"].reaction_force, pendulum.pin_force(times), rtol=0, atol=1e-10)


def test_a_point_mass_on_a_distance_joint_is_the_simple_pendulum() -> None:
    # expected: closed form with w0^2 = g / L; the link's tension is its whole reaction
    pendulum = Pendulum(mass=1.5, arm=0.8, inertia=0.0, angle=0.0)
    model = {
        "name": "mechanism",
        "bodies": {"bob": {"mass": 1.5, "position": [0.8, 0.0]}},
        "joints": {
            "link": {
                "type": "distance",
                "bodies": ["ground", "bob"],
                "points": [[0.0, 0.0], [0.0, 0.0]],
                "length": 0.8,
            }
        },
    }
    result = run(model, gauss(4), end=5.0, step=0.01, every=5)
    times = np.asarray(result.time)
    np.testing.assert_allclose(result["bob"].position, pendulum.position(times), rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.joints["link"].reaction_force, pendulum.pin_force(times), rtol=0, atol=1e-10)


EXPLICIT_AND_ADAPTIVE: dict[str, tuple[dict[str, Any], float | None, float]] = {
    "rk4": ({"name": "rk4"}, 0.001, 1e-9),
    "rk-gill": ({"name": "rk-gill"}, 0.001, 1e-9),
    "scipy-dop853": ({"name": "scipy-dop853", "rtol": 1e-12, "atol": 1e-12}, None, 1e-9),
    "scipy-radau": ({"name": "scipy-radau", "rtol": 1e-9, "atol": 1e-9}, None, 1e-6),
    "scipy-lsoda": ({"name": "scipy-lsoda", "rtol": 1e-10, "atol": 1e-10}, None, 1e-6),
}


@pytest.mark.parametrize("name", EXPLICIT_AND_ADAPTIVE)
def test_the_other_methods_follow_the_elliptic_functions_as_far_as_step_or_tolerance_allow(name: str) -> None:
    # expected: closed form; 1e-9 is h^4 with a generous constant, and a thousand times the SciPy tolerances
    integrator, step, tolerance = EXPLICIT_AND_ADAPTIVE[name]
    result = run({"name": "single-pendulum"}, integrator, end=3.0, step=step)
    expected = Pendulum.rod().position(np.asarray(result.time)[-1:])
    np.testing.assert_allclose(result["rod1"].position[-1:], expected, rtol=0, atol=tolerance)
