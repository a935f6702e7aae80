"""Gauss methods are symmetric: a motion run backwards leads back to its start."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit

from .running import gauss, run


def chain(rods: list[Any], row: int, sign: float) -> dict[str, Any]:
    """Return a double pendulum as a free-form model that starts at row `row` of two rods, velocities times `sign`.

    The start carries the drift of the run before: the tolerance keeps the assembly from taking it out.
    """
    bodies = {
        f"rod{k + 1}": {
            "mass": 1.0,
            "inertia": 1.0 / 12.0,
            "position": np.asarray(rod.position)[row].tolist(),
            "angle": float(np.asarray(rod.angle)[row]),
            "velocity": (sign * np.asarray(rod.velocity)[row]).tolist(),
            "angular_velocity": float(sign * np.asarray(rod.angular_velocity)[row]),
        }
        for k, rod in enumerate(rods)
    }
    joints = {
        "J1": {"type": "revolute", "bodies": ["ground", "rod1"], "points": [[0.0, 0.0], [-0.5, 0.0]]},
        "J2": {"type": "revolute", "bodies": ["rod1", "rod2"], "points": [[0.5, 0.0], [-0.5, 0.0]]},
    }
    return {"name": "mechanism", "bodies": bodies, "joints": joints, "assembly": {"tolerance": 1e-3}}


def both(result: mbdkit.Run) -> list[Any]:
    return [result["rod1"], result["rod2"]]


@pytest.mark.parametrize("stages", [1, 2, 3, 4])
def test_gauss_leads_back_to_its_start_when_the_velocities_are_turned_round(stages: int) -> None:
    # expected: the start itself; symmetry of the Gauss methods (Hairer, Lubich and Wanner, section V.2)
    angle = 0.5 - math.pi / 2
    forward = run({"name": "double-pendulum", "angles": [angle, angle]}, gauss(stages), end=10.0, step=0.01)
    backward = run(chain(both(forward), -1, -1.0), gauss(stages), end=10.0, step=0.01)
    for there, back in zip(both(forward), both(backward), strict=True):
        np.testing.assert_array_equal(back.position[0], there.position[-1])  # the assembly left the start alone
        np.testing.assert_allclose(back.position[-1], there.position[0], rtol=0, atol=1e-10)
        np.testing.assert_allclose(back.angle[-1], there.angle[0], rtol=0, atol=1e-10)
        np.testing.assert_allclose(back.velocity[-1], -np.asarray(there.velocity[0]), rtol=0, atol=1e-10)
        np.testing.assert_allclose(back.angular_velocity[-1], -there.angular_velocity[0], rtol=0, atol=1e-10)


def test_rk4_does_not_lead_back_to_its_start_so_that_the_claim_is_not_empty() -> None:
    # expected: an explicit method is not symmetric; at h = 0.05 it misses its start by its own error
    angle = 0.5 - math.pi / 2
    forward = run({"name": "double-pendulum", "angles": [angle, angle]}, {"name": "rk4"}, end=10.0, step=0.05)
    backward = run(chain(both(forward), -1, -1.0), {"name": "rk4"}, end=10.0, step=0.05)
    assert abs(backward["rod2"].angle[-1] - forward["rod2"].angle[0]) > 1e-7
