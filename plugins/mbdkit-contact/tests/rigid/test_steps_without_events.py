"""Event-driven steps in which nothing happens: forces at their ends are only computed where rows show them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.rigid.scenes import FLOOR, G, outline, run

import mbdkit

MASS, FRICTION, LIFT, PULL, END = 2.0, 0.4, 30.0, 12.0, 0.9
METHODS: dict[str, dict[str, Any]] = {
    "dopri5": {"name": "dopri5"}, "rk4": {"name": "rk4"}, "gauss": {"name": "gauss", "stages": 2},
    "adaptive": {"name": "dopri5", "adaptive": True, "rtol": 1e-8},
}  # fmt: skip

OUTPUTS: list[dict[str, Any]] = [{"every": 10**6}, {"every": 3}, {"interval": 0.05}]
CASES = [(method, output) for method in METHODS for output in OUTPUTS if (method, *output) != ("rk4", "interval")]
"""Methods and rows; rk4 has no values within a step."""


def lifted(integrator: dict[str, Any], output: dict[str, Any]) -> mbdkit.Run:
    """Return a run of a box at rest that forces in proportion to time pull aside and lift."""
    contact = {"bodies": ["ground", "box"], "shapes": [FLOOR, outline(0.3, 0.1)]}
    model = {
        "bodies": {"box": {"mass": MASS, "inertia": 0.1, "position": [0.0, 0.1]}},
        "forces": {"pull": {"type": "force", "body": "box", "point": [0, 0], "value": [f"{PULL}*t", f"{LIFT}*t"]}},
        "contacts": {"floor": contact | {"friction": FRICTION}},
    }  # fmt: skip
    step = None if integrator.get("adaptive") else 0.013
    return run(model, END, step, method=integrator, output=output).check()


@pytest.mark.parametrize(("method", "output"), CASES)
def test_a_box_slips_and_lifts_off_when_its_forces_reach_their_limits(method: str, output: dict[str, Any]) -> None:
    # expected: it slips from c t = mu (m g - k t) on, lifts off at m g = k t, and moves on polynomials of degree 3
    found = lifted(METHODS[method], output)
    slips, lifts = FRICTION * MASS * G / (PULL + FRICTION * LIFT), MASS * G / LIFT
    slope, slid, flown = (PULL + FRICTION * LIFT) / MASS, lifts - slips, END - lifts
    x = slope * slid**3 / 6.0 + slope * slid**2 / 2.0 * flown
    x += PULL / MASS * (lifts * flown**2 / 2.0 + flown**3 / 6.0)
    expected = [x, 0.1 + LIFT / MASS * flown**3 / 6.0]
    np.testing.assert_allclose(found["box"].position[-1], expected, rtol=0, atol=1e-9)
    normal, friction = (
        np.sum([getattr(found.contacts[name], kind) for name in found.contacts], axis=0)
        for kind in ("normal_force", "friction_force")
    )
    held = np.maximum(MASS * G - LIFT * found.time, 0.0)
    np.testing.assert_allclose(normal, held, rtol=0, atol=1e-7)
    np.testing.assert_allclose(np.abs(friction), np.minimum(PULL * found.time, FRICTION * held), rtol=0, atol=1e-7)
