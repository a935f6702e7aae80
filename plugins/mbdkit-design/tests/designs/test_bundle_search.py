"""The bundle method, on goals and limits whose minima at kinks are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import OptimizeResult, linprog
from tests.designs.swinging_shank import ANGLE, BRACE, design_of, moments, swing

import mbdkit
from mbdkit_design.bundle_search import STUCK, beyond_kink, bundle_search
from mbdkit_design.design import Design
from mbdkit_design.problem import Problem


class LargestOf:
    """The largest of two peaks, both of which fall along their kink x = y, towards (0.65, 0.65)."""

    def _pieces(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away = x - np.array([0.7, 0.6])
        slope = np.array([[10.0, -10.0], [-8.0, 8.0]])
        return slope @ x + away @ away + 1.0, slope + 2 * away

    def cost(self, x: np.ndarray) -> float:
        return float(np.max(self._pieces(x)[0]))

    def slope(self, x: np.ndarray) -> np.ndarray:
        values, slopes = self._pieces(x)
        return np.asarray(slopes[np.argmax(values)])

    def margins(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0)

    def margin_slopes(self, x: np.ndarray) -> np.ndarray:
        return np.zeros((0, 2))


class WithinDiamond:
    """The squared distance from (0.9, 0.5), within x + |y - 0.5| <= 0.6, which has a corner at (0.6, 0.5)."""

    def cost(self, x: np.ndarray) -> float:
        return float((x[0] - 0.9) ** 2 + (x[1] - 0.5) ** 2)

    def slope(self, x: np.ndarray) -> np.ndarray:
        return 2 * (x - np.array([0.9, 0.5]))

    def margins(self, x: np.ndarray) -> np.ndarray:
        return np.array([0.6 - x[0] - abs(x[1] - 0.5)])

    def margin_slopes(self, x: np.ndarray) -> np.ndarray:
        return np.array([[-1.0, -np.sign(x[1] - 0.5)]])


def searched(problem: Any, start: tuple[float, float]) -> OptimizeResult:
    found = bundle_search(cast("Problem", problem), np.array(start), tolerance=1e-9, most=100)
    assert found.is_least
    return found


@pytest.mark.parametrize("start", [(0.2, 0.3), (1.0, 0.0), (0.0, 1.0)])
def test_it_follows_a_kink_to_the_minimum(start: tuple[float, float]) -> None:
    np.testing.assert_allclose(searched(LargestOf(), start).x, 0.65, rtol=0, atol=1e-4)


@pytest.mark.parametrize("start", [(0.2, 0.3), (1.0, 0.9), (0.1, 0.5)])
def test_it_finds_the_corner_of_a_limit(start: tuple[float, float]) -> None:
    found = searched(WithinDiamond(), start)
    np.testing.assert_allclose(found.x, [0.6, 0.5], rtol=0, atol=1e-6)


def test_a_search_that_stopped_at_a_kink_goes_on_and_one_at_a_smooth_minimum_does_not() -> None:
    stopped = OptimizeResult(x=np.array([0.617, 0.617]), message="Optimization terminated successfully.")
    found = beyond_kink(cast("Problem", LargestOf()), stopped, 1e-9, 100)
    np.testing.assert_allclose(found.x, 0.65, rtol=0, atol=1e-4)
    assert found.message.startswith("Optimization terminated successfully at a kink; from there, no linearization")
    inside = OptimizeResult(x=np.array([0.6, 0.5]), message="done")
    assert beyond_kink(cast("Problem", WithinDiamond()), inside, 1e-9, 100) is inside


def test_the_spring_of_the_least_peak_of_a_torque_is_the_chebyshev_fit_of_the_moment() -> None:
    # expected: the line k phi - k phi_0 with the smallest largest distance from the moment, a linear program
    angle, moment = moments(at=np.linspace(0.0, 2.0, 4001))
    ones = np.ones_like(angle)
    rows = np.block(
        [[angle[:, None], ones[:, None], -ones[:, None]], [-angle[:, None], -ones[:, None], -ones[:, None]]]
    )
    line = linprog([0, 0, 1], rows, np.r_[-moment, moment], bounds=[(None, None)] * 3)
    k, offset, least = line.x
    found = mbdkit.design(
        design_of(swing(), minimize="max(abs(joints.motor.torque))", optimizer={"name": "bundle", "tolerance": 1e-6})
    )
    assert found.best.goals["goal"] == pytest.approx(least, rel=1e-4)
    assert found.best.variables[f"{BRACE}.stiffness"] == pytest.approx(k, rel=1e-4)
    assert found.best.variables[f"{BRACE}.free_angle"] == pytest.approx(-offset / k, rel=1e-2, abs=1e-4 * ANGLE)
    assert not found.doubt


def test_a_search_that_is_cut_short_says_first_that_its_result_may_not_be_an_optimum() -> None:
    found = mbdkit.design(design_of(swing(), optimizer={"name": "bundle", "max_iterations": 3}))
    assert not found.is_converged
    assert found.summary().startswith("This point may not be an optimum: the search ended early (the bundle method")
    assert not Design.from_dict(found.spec, found.to_dict()).is_converged
    assert "Raise `optimizer.max_iterations`" in found.doubt
    for message in (STUCK, "Positive directional derivative for linesearch"):
        assert "max_iterations" not in replace(found, message=message).doubt


class RaisedArm(LargestOf):
    """The largest torque that holds an arm with a spring from 0.4 m above its pivot to 0.25 m along the arm.

    The variables are the stiffness, 50 to 1000 N/m, and the free length, 0.1 to 0.4 m. The torque is linear in the
    stiffness and in its product with the free length, but the cost is not convex in the variables.
    """

    low, span = np.array([50.0, 0.1]), np.array([950.0, 0.3])

    def __init__(self) -> None:
        angle = np.linspace(0.0, np.pi / 2, 2001)
        self.weight = 4 * 9.81 * 0.3 * np.cos(angle)
        self.stretch = 0.4 * 0.25 * np.cos(angle)  # moment of a spring of 1 N/m and free length 0
        self.shape = self.stretch / np.sqrt(0.4**2 + 0.25**2 - 2 * 0.4 * 0.25 * np.sin(angle))

    def _largest(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        k, length = self.low + self.span * x
        torque = self.weight - k * (self.stretch - length * self.shape)
        at = int(np.argmax(np.abs(torque)))
        slope = np.array([length * self.shape[at] - self.stretch[at], k * self.shape[at]])
        return float(abs(torque[at])), np.sign(torque[at]) * slope * self.span

    def cost(self, x: np.ndarray) -> float:
        return self._largest(x)[0]

    def slope(self, x: np.ndarray) -> np.ndarray:
        return self._largest(x)[1]

    def least(self) -> tuple[float, float, float]:
        """Return the stiffness, the free length and the least cost, by a linear program."""
        columns = np.column_stack([self.stretch, -self.shape])  # of k and of k times the free length
        ones = np.ones((len(columns), 1))
        rows = np.block([[-columns, -ones], [columns, -ones]])
        rows = np.vstack([rows, [[0.1, -1.0, 0.0], [-0.4, 1.0, 0.0]]])
        limits = np.r_[-self.weight, self.weight, 0.0, 0.0]
        k, product, cost = linprog([0, 0, 1], rows, limits, bounds=[(50, 1000), (None, None), (None, None)]).x
        return k, product / k, cost


@pytest.mark.parametrize("start", [(300, 0.2), (600, 0.2), (900, 0.4)])
def test_it_finds_the_minimum_at_a_bound_of_a_cost_that_is_not_convex(start: tuple[float, float]) -> None:
    arm = RaisedArm()
    k, length, least = arm.least()
    first = (np.array(start) - arm.low) / arm.span
    found = searched(arm, (first[0], first[1]))
    np.testing.assert_allclose(arm.low + arm.span * found.x, [k, length], rtol=1e-5)
    assert arm.cost(found.x) == pytest.approx(least, rel=1e-6)


class OfWrongSign(LargestOf):
    """A smooth cost whose derivatives have the wrong sign."""

    def cost(self, x: np.ndarray) -> float:
        return 1.0 + float(x @ x)

    def slope(self, x: np.ndarray) -> np.ndarray:
        return -2 * x


def test_a_search_that_wrong_derivatives_stop_does_not_count_as_a_minimum() -> None:
    found = bundle_search(cast("Problem", OfWrongSign()), np.array([0.5, 0.5]), tolerance=1e-9, most=100)
    assert not found.is_least
    assert not found.success
    assert found.message == "no nearby point has the lower cost that the derivatives promise"
