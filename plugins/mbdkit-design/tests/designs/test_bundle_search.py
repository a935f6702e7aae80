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
    np.testing.assert_allclose(found.x, [0.6, 0.5], rtol=0, atol=2e-6)


def test_a_search_that_stopped_at_a_kink_goes_on_and_one_at_a_smooth_minimum_does_not() -> None:
    stopped = OptimizeResult(x=np.array([0.617, 0.617]), message="Optimization terminated successfully.")
    found = beyond_kink(cast("Problem", LargestOf()), stopped, 1e-9, 100)
    np.testing.assert_allclose(found.x, 0.65, rtol=0, atol=1e-4)
    assert found.message.startswith("Optimization terminated successfully at a kink; from there, no linearization")
    inside = OptimizeResult(x=np.array([0.6, 0.5]), message="done")
    assert beyond_kink(cast("Problem", WithinDiamond()), inside, 1e-9, 100) is inside


@pytest.mark.slow
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
