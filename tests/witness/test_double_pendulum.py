"""The double pendulum against reference digits: a regular motion for 150 s, and the release from the horizontal."""

from __future__ import annotations

import numpy as np
import pytest

from tests.slow_cases import slow

from . import ode
from .double_pendulum import HORIZONTAL, MODERATE, Reference
from .rods import TwoRods
from .running import gauss, run


@pytest.mark.parametrize(
    ("reference", "until"), [(MODERATE, 40.0), *slow((MODERATE, 150.0)), (HORIZONTAL, 5.0)], ids=str
)
def test_yardstick_reference_digits_agree_with_dop853_in_two_angles_to_2e_11(
    reference: Reference, until: float
) -> None:
    # expected: SciPy's DOP853 on the two angles' Lagrange equations (other equations, other method, other code)
    rows = reference.times <= until
    solution = TwoRods().solve((reference.start_angle,) * 2, (0.0, 0.0), reference.times[rows])
    # margin: error of DOP853, of which rounding moves 4 %
    np.testing.assert_allclose(solution[:, :2], reference.angles[rows], rtol=0, atol=2e-11)
    np.testing.assert_allclose(solution[:, 2:4], reference.rates[rows], rtol=0, atol=2e-11)


def test_yardstick_horizontal_digits_agree_with_extended_precision_to_1e_12() -> None:
    # expected: Gragg-Bulirsch-Stoer extrapolation in long double of the two angles' Lagrange equations
    start = np.zeros(6, dtype=np.longdouble)
    end = ode.extrapolate(TwoRods().right_side, start, 5.0, 250).astype(float)
    row = HORIZONTAL.at(5.0)
    np.testing.assert_allclose(end[:2], HORIZONTAL.angles[row], rtol=0, atol=1e-12)
    np.testing.assert_allclose(end[2:4], HORIZONTAL.rates[row], rtol=0, atol=1e-12)


def compare(integrator: dict[str, object], step: float, reference: Reference, until: float, tolerance: float) -> None:
    """Run the double pendulum and hold both rods at every reference time until `until` [s] against the digits."""
    model = {"name": "double-pendulum", "angles": [reference.start_angle] * 2}
    result = run(model, integrator, end=until, step=step, every=round(0.5 / step))
    rows = reference.times <= until
    at = np.searchsorted(result.time, reference.times[rows] - 1e-9)
    np.testing.assert_allclose(np.asarray(result.time)[at], reference.times[rows], rtol=0, atol=1e-12)
    for rod in range(2):
        body = result[f"rod{rod + 1}"]
        np.testing.assert_allclose(body.position[at], reference.positions[rows][:, rod], rtol=0, atol=tolerance)
        np.testing.assert_allclose(body.angle[at], reference.angles[rows][:, rod], rtol=0, atol=10 * tolerance)
        np.testing.assert_allclose(
            body.angular_velocity[at], reference.rates[rows][:, rod], rtol=0, atol=100 * tolerance
        )


@pytest.mark.parametrize(("stages", "step"), [(3, 0.005), (4, 0.01), (6, 0.02)])
def test_gauss_keeps_the_regular_double_pendulum_to_1e_9_for_150_s(stages: int, step: float) -> None:
    # expected: 30 reference digits
    compare(gauss(stages), step, MODERATE, 150.0, 1e-9)


@pytest.mark.parametrize(("stages", "step"), [(3, 0.00125), (4, 0.0025), (6, 0.005)])
def test_gauss_follows_the_release_from_the_horizontal_to_1e_11_at_5_s(stages: int, step: float) -> None:
    # expected: 26 reference digits
    compare(gauss(stages), step, HORIZONTAL, 5.0, 1e-11)


@pytest.mark.parametrize("name", ["rk4", "rk-gill"])
def test_explicit_methods_follow_the_release_from_the_horizontal_to_1e_8_at_5_s(name: str) -> None:
    # expected: 26 reference digits
    compare({"name": name}, 0.0005, HORIZONTAL, 5.0, 1e-8)
