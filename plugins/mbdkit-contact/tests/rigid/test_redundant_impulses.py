"""Impulses of redundant joints at impacts of rigid contacts: those of least norm.

Several sets of impulses have the same effect on the motion. The recorded set has the smallest sum of squares, so that
equal joints have equal shares of what the momenta leave open.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.rigid.scenes import FLOOR, G, run

import mbdkit

TILT = np.radians(30.0)


def impulses_of(found: mbdkit.Run) -> dict[str, np.ndarray]:
    """Return the impulses (2,) of all joints on their second bodies at the first impact [N s]."""
    impacts = found.impacts
    return {str(name): impacts.reaction_impulse[0, i] for i, name in enumerate(impacts.joint)}


def test_two_pins_in_one_place_share_the_impulse_of_a_rod_that_strikes() -> None:
    # expected: a rod that is released from the horizontal and strikes the floor at 30 degrees, by its angular momentum
    # about the pins; each pin has half of what its linear momentum asks of both
    mass, length, e = 2.0, 0.6, 0.5
    about_pins, rate = mass * length**2 / 3.0, np.sqrt(3.0 * G * np.sin(TILT) / length)
    pin: dict[str, Any] = {"type": "revolute", "bodies": ["ground", "rod"], "at": [0.0, length * np.sin(TILT)]}
    model = {
        "bodies": {
            "rod": {"mass": mass, "inertia": mass * length**2 / 12.0, "position": [length / 2, length * np.sin(TILT)]}
        },
        "joints": {"first": pin, "second": pin},
        "contacts": {
            "tip": {"bodies": ["ground", "rod"], "shapes": [FLOOR, {"point": [length / 2, 0.0]}], "restitution": e}
        },
    }
    found = run(model, 0.5, 0.01)
    push = about_pins * (1.0 + e) * rate / (length * np.cos(TILT))
    gain = mass * (1.0 + e) * rate * length / 2 * np.array([np.sin(TILT), np.cos(TILT)])
    assert found.impacts.normal_impulse[0] == pytest.approx(push, rel=1e-9)
    for impulse in impulses_of(found).values():
        assert impulse == pytest.approx(0.5 * (gain - [0.0, push]), rel=1e-9)


def test_pins_at_both_ends_of_a_bar_share_the_impulse_along_it_equally() -> None:
    # expected: a disc that falls on a bar at 30 degrees and rolls on from there. The lever rule determines the impulses
    # of both pins across the bar. Along it, momenta determine only their sum
    half, place, radius, drop = 0.5, 0.2, 0.1, 0.3
    along, across = np.array([np.cos(TILT), np.sin(TILT)]), np.array([-np.sin(TILT), np.cos(TILT)])
    start = place * along + radius * across + np.array([0.0, drop])
    model = {
        "bodies": {
            "bar": {"mass": 1.0, "inertia": 0.1, "angle": float(TILT)},
            "disc": {"mass": 3.0, "inertia": 1.5 * radius**2, "position": start.tolist()},
        },
        "joints": {
            "low": {"type": "revolute", "bodies": ["ground", "bar"], "at": (-half * along).tolist()},
            "high": {"type": "revolute", "bodies": ["ground", "bar"], "at": (half * along).tolist()},
        },
        "contacts": {
            "top": {"bodies": ["bar", "disc"], "shapes": [FLOOR, {"circle": {"radius": radius}}], "friction": 5.0}
        },
    }
    found = run(model, 0.5, 0.01)
    momentum = 3.0 * np.sqrt(2.0 * G * drop)
    push, rub = momentum * np.cos(TILT), momentum * np.sin(TILT) / 3.0  # a disc keeps 2/3 of its speed
    shares = {"low": 0.5 * (1.0 - place / half), "high": 0.5 * (1.0 + place / half)}
    for name, impulse in impulses_of(found).items():
        assert impulse == pytest.approx(shares[name] * push * across + 0.5 * rub * along, rel=1e-9)
