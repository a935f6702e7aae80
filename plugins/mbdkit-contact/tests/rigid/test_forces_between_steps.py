"""Forces of rigid contacts in rows between the ends of long steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.rigid.scenes import G, run

import mbdkit
from tests.margins import assert_within

RADIUS, MASS, START = 1.0, 0.7, 1.2  # m, kg, rad
METHODS = ("dop853", "dopri5", "radau-iia", "gauss", "scipy-dop853", "scipy-radau")


def slid(name: str, friction: float, every: float = 0.013) -> mbdkit.Run:
    """Return a run of a point mass that slides down in a hole of radius `RADIUS`, without a change of its mode."""
    model = {
        "bodies": {"bead": {"mass": MASS, "position": [RADIUS * np.sin(START), -RADIUS * np.cos(START)]}},
        "contacts": {
            "bowl": {
                "bodies": ["ground", "bead"],
                "shapes": [{"hole": {"center": [0.0, 0.0], "radius": RADIUS}}, {"point": [0.0, 0.0]}],
                "friction": friction,
                "restitution": 0.0,
            }
        },
    }
    options = {"name": name, "rtol": 1e-9} | ({} if name.startswith("scipy") else {"adaptive": True})
    return run(model, 0.45, method=options, output={"interval": every})


def angle(found: mbdkit.Run) -> np.ndarray:
    """Return the angle of the mass from the lowest point (T,) [rad]."""
    x, y = found["bead"].position.T
    return np.asarray(np.arctan2(x, -y))


@pytest.mark.parametrize("name", METHODS)
def test_normal_forces_follow_from_the_position_in_every_row(name: str) -> None:
    # expected: m v^2 / R = N - m g cos, and m v^2 / 2 = m g R (cos - cos at the start)
    found = slid(name, 0.0)
    expected = MASS * G * (3.0 * np.cos(angle(found)) - 2.0 * np.cos(START))
    np.testing.assert_allclose(found.contacts["bowl"].normal_force, expected, atol=2e-5)


@pytest.mark.parametrize("name", METHODS)
def test_friction_and_the_energy_it_dissipates_are_those_of_the_motion_in_every_row(name: str) -> None:
    # expected: u = m v^2 / 2 obeys du/ds = m g sin x - mu (m g cos x + 2 u / R) on the way s = R (start - x), where x
    # is the angle; this is linear in u, with the solution below
    mu = 0.2
    found = slid(name, mu)
    x, c = angle(found), 1.0 + 4.0 * mu**2

    def particular(x: np.ndarray | float) -> Any:
        """Return the solution A cos + B sin of du/dx = 2 mu u + m g R (mu cos - sin)."""
        scale = MASS * G * RADIUS / c
        return scale * ((1.0 - 2.0 * mu**2) * np.cos(x) + 3.0 * mu * np.sin(x))

    kinetic = particular(x) - particular(START) * np.exp(2.0 * mu * (x - START))
    normal = MASS * G * np.cos(x) + 2.0 * kinetic / RADIUS
    lost = MASS * G * RADIUS * (np.cos(x) - np.cos(START)) - kinetic
    np.testing.assert_allclose(found.energy.kinetic, kinetic, atol=1e-6)
    np.testing.assert_allclose(found.contacts["bowl"].normal_force, normal, atol=2e-5)
    np.testing.assert_allclose(np.abs(found.contacts["bowl"].friction_force[1:]), mu * normal[1:], atol=2e-5)
    np.testing.assert_allclose(found.energy.dissipated, lost, atol=1e-6)
    assert_within(found.energy.balance, 2e-6)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("seed", [1, 4])
def test_measures_of_forces_of_a_sticking_box_are_those_of_statics(name: str, seed: int) -> None:
    # expected: N = m g + Q sin(w t), whose integral is m g T + Q (1 - cos(w T)) / w, and H = h sin(u t); nothing moves,
    # so that the error of the motion does not limit the steps
    random = np.random.default_rng(seed)
    mass, end = random.uniform(0.5, 3.0), random.uniform(0.8, 1.5)
    weight, w, u = mass * G, random.uniform(5.0, 15.0), random.uniform(2.0, 8.0)
    q, h = 0.3 * weight, 0.2 * weight
    box = {"polygon": [[-0.3, -0.01], [0.3, -0.01], [0.3, 0.01], [-0.3, 0.01]]}
    floor = {"line": {"point": [0, 0], "normal": [0, 1]}}
    model = {
        "bodies": {"b": {"mass": mass, "inertia": 0.05, "position": [0, 0.01]}},
        "forces": {"load": {"type": "force", "body": "b", "value": [f"{h!r}*sin({u!r}*t)", f"-{q!r}*sin({w!r}*t)"]}},
        "contacts": {"c": {"bodies": ["ground", "b"], "friction": 0.6, "shapes": [floor, box]}},
    }
    measures = {
        "pressed": "integral(ground_reactions.b.normal_force)",
        "most": "max(ground_reactions.b.normal_force)",
        "rubbed": "integral(ground_reactions.b.force_x**2)",
    }
    method = {"name": name, "rtol": 1e-5} | ({} if name.startswith("scipy") else {"adaptive": True})
    found = run(model, end, method=method, measures=measures).measures
    pressed = weight * end + q / w * (1.0 - np.cos(w * end))
    rubbed = h**2 * (end / 2.0 - np.sin(2.0 * u * end) / (4.0 * u))
    assert_within(abs(found["pressed"] / pressed - 1.0), 1e-3)
    assert_within(abs(found["most"] / (weight + q) - 1.0), 1e-3)
    assert_within(abs(found["rubbed"] / rubbed - 1.0), 1e-3)
