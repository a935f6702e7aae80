"""Orders of convergence, seen on nonlinear non-autonomous problems: a forced and a driven double pendulum.

Every sequence of step numbers lies inside the asymptotic window (found with the dense NumPy chain of `absolute.py`)
and its smallest error well above the rounding, so that a failure means another order and not a bad window.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from .problems import DRIVEN_PENDULUM, FORCED_PENDULUM, Problem
from .running import gauss, run

END = 1.0
EXPLICIT = (100, 200, 400, 800)
WINDOWS = {1: (100, 200, 400, 800), 2: (50, 100, 200, 400), 3: (20, 28, 40, 56), 4: (14, 16, 20, 24, 28)}


def observed_order(
    problem: Problem, integrator: dict[str, Any], numbers: tuple[int, ...], end: float = END
) -> list[float]:
    """Return the order seen between each two neighbours of `numbers`, the numbers of steps to the end."""
    expected = problem.solve(np.array([end]))[0]
    reference = problem.state(expected[:2], expected[2:4]).reshape(2, 2, 3)
    errors = []
    for number in numbers:
        result = run(problem.model(), integrator, end=end, step=end / number, every=number)
        bodies = [result["rod1"], result["rod2"]]
        q = np.array([[*body.position[-1], body.angle[-1]] for body in bodies])
        v = np.array([[*body.velocity[-1], body.angular_velocity[-1]] for body in bodies])
        errors.append(max(np.abs(q - reference[0]).max(), np.abs(v - reference[1]).max()))
    return [float(slope) for slope in np.diff(np.log(errors)) / -np.diff(np.log(numbers))]


def radau(stages: int) -> dict[str, Any]:
    """Return the integrator section of Radau IIA."""
    return {"name": "radau-iia", "stages": stages}


METHODS: list[tuple[dict[str, Any], float, tuple[int, ...]]] = [
    ({"name": "rk4"}, 4.0, EXPLICIT),
    ({"name": "rk-gill"}, 4.0, EXPLICIT),
    *((gauss(stages), 2.0 * stages, WINDOWS[stages]) for stages in (1, 2, 3, 4)),
    (radau(2), 3.0, (100, 200, 400, 800)),
    (radau(3), 5.0, (40, 56, 80, 112)),
]


@pytest.mark.parametrize("problem", [FORCED_PENDULUM, DRIVEN_PENDULUM], ids=["forced", "driven"])
@pytest.mark.parametrize(("method", "order", "steps"), METHODS, ids=str)
def test_methods_have_their_order(
    problem: Problem, method: dict[str, Any], order: float, steps: tuple[int, ...]
) -> None:
    # margin: order, from errors of mbdkit alone
    assert observed_order(problem, method, steps) == pytest.approx([order] * (len(steps) - 1), abs=0.2)


def test_radau_iia_with_five_stages_has_order_nine() -> None:
    # margin: order, from errors of mbdkit alone
    assert observed_order(FORCED_PENDULUM, radau(5), (17, 20, 24)) == pytest.approx([9.0] * 2, abs=0.2)
    # margin: order, from errors of mbdkit alone
    assert observed_order(DRIVEN_PENDULUM, radau(5), (36, 42, 50, 60), end=3.0) == pytest.approx([9.0] * 3, abs=0.2)
