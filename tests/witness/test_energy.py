"""Energy, work and dissipation: correct values, and a balance that closes with the order of the method."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from .problems import DRIVEN_PENDULUM, FORCED_PENDULUM, Problem
from .running import gauss, run

problems = pytest.mark.parametrize("problem", [FORCED_PENDULUM, DRIVEN_PENDULUM], ids=["forced", "driven"])
END = 1.0


@problems
def test_work_and_dissipated_energy_are_those_of_the_minimal_coordinates(problem: Problem) -> None:
    # expected: both integrated by DOP853 as extra states beside the angles; work includes the driver's power
    result = run(problem.model(), gauss(4), end=2.0, step=0.01, every=10)
    solution = problem.solve(np.linspace(0.0, 2.0, 21))
    np.testing.assert_allclose(result.energy.dissipated, solution[:, 4], rtol=0, atol=1e-10)
    np.testing.assert_allclose(result.energy.work, solution[:, 5], rtol=0, atol=1e-10)
    total = np.asarray(result.energy.total)
    np.testing.assert_allclose(total - total[0], solution[:, 5] - solution[:, 4], rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.energy.balance, 0.0, rtol=0, atol=1e-9)


METHODS: dict[str, tuple[dict[str, Any], float, tuple[int, ...]]] = {
    "rk4": ({"name": "rk4"}, 4.0, (100, 200, 400)),
    "rk-gill": ({"name": "rk-gill"}, 4.0, (100, 200, 400)),
    "gauss1": (gauss(1), 2.0, (100, 200, 400)),
    "gauss2": (gauss(2), 4.0, (50, 100, 200)),
    "gauss3": (gauss(3), 6.0, (28, 40, 56)),
}


@problems
@pytest.mark.parametrize("name", METHODS)
def test_energy_balance_closes_with_the_order_of_the_method(problem: Problem, name: str) -> None:
    # expected: total + dissipated - work is constant on the exact motion (damping, a torque, a force, a driver)
    integrator, order, numbers = METHODS[name]
    largest = []
    for number in numbers:
        result = run(problem.model(), integrator, end=END, step=END / number)
        largest.append(np.abs(result.energy.balance).max())
    seen = np.diff(np.log(largest)) / -np.diff(np.log(numbers))
    assert seen.min() > order - 0.3
    assert 0.01 > largest[0] > largest[-1] > 0.0
