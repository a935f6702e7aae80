"""A four-bar and a Watt six-bar that a motor torque drives, in absolute coordinates against one coordinate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.slow_cases import slow_but
from tests.witness.six_bar import END, FOUR_BAR, PHI, RATE, SIX_BAR

from .dyads import Linkage
from .running import gauss, run

TIMES = np.linspace(0.0, END, 21)
linkages = pytest.mark.parametrize("linkage", [FOUR_BAR, SIX_BAR], ids=["four-bar", "six-bar"])


METHODS: dict[str, tuple[dict[str, Any], float]] = {
    "rk4": ({"name": "rk4"}, 0.00005),
    "rk-gill": ({"name": "rk-gill"}, 0.00005),
    "gauss4": (gauss(4), 0.0025),
    "gauss5": (gauss(5), 0.005),
    "gauss6": (gauss(6), 0.005),
}


@linkages
@pytest.mark.parametrize("name", slow_but(METHODS, "rk4", "gauss4", "gauss6"))
def test_a_linkage_driven_by_a_motor_torque_moves_as_in_its_crank_angle_to_1e_9(linkage: Linkage, name: str) -> None:
    # expected: Eksergian's equation in the crank's angle by DOP853 at rtol 1e-13
    integrator, step = METHODS[name]
    result = run(linkage.model(PHI, RATE), integrator, end=END, step=step, every=round(0.1 / step))
    np.testing.assert_allclose(result.time, TIMES, rtol=0, atol=1e-12)
    solution = linkage.solve(PHI, RATE, TIMES)
    placed = [linkage.poses(phi) for phi in solution[:, 0]]
    rates = solution[:, 1]
    for body in linkage.links:
        centre, slope, _ = np.array([poses[body].centre for poses in placed]).T
        angle, turning, _ = np.array([poses[body].angle for poses in placed]).T
        seen = np.asarray(result[body].position) @ [1, 1j]
        np.testing.assert_allclose(seen, centre, rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.exp(1j * result[body].angle), np.exp(1j * angle), rtol=0, atol=1e-9)
        velocity = np.asarray(result[body].velocity) @ [1, 1j]
        np.testing.assert_allclose(velocity, slope * rates, rtol=0, atol=1e-8)
        np.testing.assert_allclose(result[body].angular_velocity, turning * rates, rtol=0, atol=1e-8)
    np.testing.assert_allclose(result.energy.work, solution[:, 2], rtol=0, atol=1e-8)
