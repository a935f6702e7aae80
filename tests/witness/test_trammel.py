"""The elliptic trammel with a crank to the middle of its rod: which rows are redundant changes during the motion.

Two slides guide the ends of a rod along the axes. Its middle then moves on a circle, so that the crank is redundant.
Whenever the rod lies along an axis, one of the slides has no part in the self-stress; without the row of that slide,
the accelerations of the rest are not unique.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbdkit
from tests.margins import assert_within

from .running import gauss

ANGLE, RATE, END, GRAVITY = 0.6, 2.0, 2.0, 9.81
ROD, CRANK, SLIDE = (1.0, 1 / 3), (0.5, 0.05), (0.1, 0.01)  # mass and inertia


def trammel(order: str) -> mbdkit.Mechanism:
    """Return the mechanism with its joints in the given order: pins O and P of the crank, slides X and Y."""
    c, s = math.cos(ANGLE), math.sin(ANGLE)
    to, turn = np.array([c, s]), RATE * np.array([-s, c])  # the rod's middle and its velocity
    m = mbdkit.Mechanism()
    for name, (mass, inertia), part, angle, rate in (
        ("rod", ROD, (1.0, 1.0), -ANGLE, -RATE),
        ("crank", CRANK, (0.5, 0.5), ANGLE, RATE),
        ("x", SLIDE, (2.0, 0.0), 0.0, 0.0),
        ("y", SLIDE, (0.0, 2.0), 0.0, 0.0),
    ):
        m.body(
            name,
            mass=mass,
            inertia=inertia,
            position=part * to,
            velocity=part * turn,
            angle=angle,
            angular_velocity=rate,
        )
    for joint in order:
        if joint == "O":
            m.revolute("O", m.ground, "crank", at=(0.0, 0.0))
        elif joint == "P":
            m.revolute("P", "crank", "rod", at=to)
        else:
            end = to * ((2.0, 0.0) if joint == "X" else (0.0, 2.0))
            m.prismatic(joint, m.ground, joint.lower(), at=end, axis=end)
            m.revolute(f"{joint}R", joint.lower(), "rod", at=end)
    return m


@cache
def angle_at_end() -> float:
    """Return the crank's angle at the end: all bodies move as one pendulum of constant inertia."""
    inertia = ROD[0] + ROD[1] + CRANK[0] / 4 + CRANK[1] + 4 * SLIDE[0]
    weight = GRAVITY * (ROD[0] + CRANK[0] / 2 + 2 * SLIDE[0])
    solution = solve_ivp(
        lambda t, y: [y[1], -weight / inertia * math.cos(y[0])],
        (0, END),
        [ANGLE, RATE],
        "DOP853",
        rtol=1e-13,
        atol=1e-13,
    )
    return float(solution.y[0, -1])


@pytest.mark.parametrize("order", ["OPXY", "OPYX", "XOPY", "XYOP"])
@pytest.mark.parametrize("integrator", [gauss(3), {"name": "rk4"}], ids=lambda x: x["name"])
def test_a_row_that_is_needed_on_the_way_is_not_left_out(order: str, integrator: dict[str, object]) -> None:
    # expected: the pendulum's equation in the crank's angle by DOP853; it turns through both axes
    run = mbdkit.run(trammel(order), integrator=integrator, time={"end": END, "step": 0.002}).check()
    assert run.redundancy.startswith("1 redundant row: joints")
    angle = angle_at_end()
    assert np.ptp(run["crank"].angle) > np.pi
    np.testing.assert_allclose(run["rod"].position[-1], [math.cos(angle), math.sin(angle)], rtol=0, atol=2e-8)
    assert_within(run.misalignment_max, 1e-9)
