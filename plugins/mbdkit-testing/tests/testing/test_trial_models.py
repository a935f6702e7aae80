"""Reference states of the kit against SciPy in minimal coordinates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbdkit_testing.order_checks import reference
from tests.margins import assert_within

MASSES, LENGTHS, GRAVITY, ARM = (1.0, 0.7), (1.0, 0.8), 1.0, 0.3 * 0.1


def slopes(t: float, y: np.ndarray) -> list[float]:
    """Return the rates of two rods in their angles; the reaction of the first joint is found by iteration."""
    (m1, m2), (l1, l2), (a, b, rate_a, rate_b) = MASSES, LENGTHS, y
    along_a, along_b = np.array([np.cos(a), np.sin(a)]), np.array([np.cos(b), np.sin(b)])
    across_a, across_b = along_a[::-1] * (-1, 1), along_b[::-1] * (-1, 1)
    coupling, swirl = m2 * l1 * l2 / 2 * np.cos(b - a), m2 * l1 * l2 / 2 * np.sin(b - a)
    matrix = np.array([[m1 * l1**2 / 3 + m2 * l1**2, coupling], [coupling, m2 * l2**2 / 3]])
    weight = GRAVITY * np.array([(m1 / 2 + m2) * l1 * along_a[0], m2 * l2 / 2 * along_b[0]])
    reaction = before = 0.0
    turn = np.zeros(2)
    for _ in range(100):
        friction = np.array([-ARM * reaction * np.sign(rate_a), 0.0])
        turn = np.linalg.solve(matrix, friction - weight + swirl * np.array([rate_b**2, -(rate_a**2)]))
        elbow = l1 * (turn[0] * across_a - rate_a**2 * along_a)
        end = elbow + l2 / 2 * (turn[1] * across_b - rate_b**2 * along_b)
        before, reaction = reaction, float(np.hypot(*(m1 * elbow / 2 + m2 * end + [0.0, (m1 + m2) * GRAVITY])))
        if abs(reaction - before) < 1e-15 * reaction:
            break
    return [rate_a, rate_b, *turn]


def test_the_reference_with_friction_in_a_joint_is_the_motion_that_scipy_integrates() -> None:
    end = solve_ivp(slopes, (0.0, 1.0), [-0.6, 0.1, 4.0, 0.0], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    state, _, rounding = reference("joint-friction")
    assert state[[2, 5, 8, 11]] == pytest.approx(end, abs=1e-9)
    assert_within(rounding, 1e-12)
