"""Orders of methods that solve for constraints themselves, against the pendulum in closed form and against DOP853."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit

from .pendulum import Pendulum
from .problems import DRIVEN_PENDULUM, FORCED_PENDULUM, Problem

RATTLE = {"name": "rattle"}


def radau(stages: int) -> dict[str, Any]:
    return {"name": "radau-iia", "stages": stages}


def pair(stages: int) -> dict[str, Any]:
    return {"name": "lobatto-pair", "stages": stages}


def end_of(model: dict[str, Any], integrator: dict[str, Any], formulation: str, steps: int) -> mbdkit.Run:
    """Return a complete run of 1 s in so many steps."""
    spec = {
        "mbdkit": 1,
        "model": model,
        "formulation": formulation,
        "integrator": integrator,
        "time": {"end": 1.0, "step": 1.0 / steps},
        "output": {"every": 10**9},
    }
    return mbdkit.run(spec).check()


def errors_on_the_pendulum(integrator: dict[str, Any], formulation: str, steps: int) -> np.ndarray:
    """Return the errors of positions, velocities and the method's own multipliers after 1 s from rest."""
    result = end_of({"name": "single-pendulum"}, integrator, formulation, steps)
    exact = Pendulum.rod()
    (angle,), (rate,) = exact.motion([1.0])
    place, force = exact.position([1.0])[0], exact.pin_force([1.0])[0]
    q = np.append(place, angle)
    v = rate * np.array([-place[1], place[0], 1.0])
    found = [np.ravel(result.array(path)[-1]) for path in ("trajectory/position", "trajectory/velocity")]
    # M q'' + Phi_q^T lam = Q with Phi = p_rod - p_ground: the pin pushes the rod by -lam
    own = result.array("constraints/method_multiplier")[-1]
    return np.array([np.max(np.abs(x - y)) for x, y in zip([*found, own], [q, v, -force], strict=True)])


CASES = [
    (radau(2), "index-3", (400, 800), (3, 2, 1)),
    (radau(3), "index-3", (160, 320), (5, 3, 2)),
    (radau(5), "index-3", (20, 28), (9, 5, 4)),
    (radau(2), "index-2", (200, 400), (3, 3, 2)),
    (radau(3), "index-2", (160, 320), (5, 5, 3)),
    (radau(5), "index-2", (20, 28), (9, 9, None)),
    (radau(2), "ggl", (200, 400), (3, 3, 2)),
    (radau(3), "ggl", (160, 320), (5, 5, 3)),
    (radau(5), "ggl", (20, 28), (9, 9, None)),
    (RATTLE, "index-3", (400, 800), (2, 2, 1)),
    (pair(2), "index-3", (400, 800), (2, 2, 1)),
    (pair(3), "index-3", (80, 160), (4, 4, 2)),
]


@pytest.mark.parametrize(("integrator", "formulation", "steps", "orders"), CASES, ids=str)
def test_positions_velocities_and_multipliers_of_the_pendulum_have_the_orders_of_the_literature(
    integrator: dict[str, Any], formulation: str, steps: tuple[int, int], orders: tuple[int, int, int | None]
) -> None:
    # expected: Hairer, Lubich and Roche (1989) for Radau IIA of s stages, 2s-1 / s / s-1 on index 3 and 2s-1 / 2s-1 / s
    # on index 2; Jay (1996) for the pairs, 2s-2 / 2s-2, and s-1 seen for their last multiplier
    coarse, fine = (errors_on_the_pendulum(integrator, formulation, n) for n in steps)
    seen = np.log(coarse / fine) / math.log(steps[1] / steps[0])
    for order, slope in zip(orders, seen, strict=True):
        if order is not None:  # of 5 stages on index 2 the multipliers meet round-off before they show an order
            assert slope == pytest.approx(order, abs=0.2)  # margin: order, from errors of mbdkit alone


@pytest.mark.parametrize("problem", [FORCED_PENDULUM, DRIVEN_PENDULUM], ids=["forced", "driven"])
@pytest.mark.parametrize(
    ("integrator", "formulation", "orders"),
    [
        (radau(3), "index-3", (5, 3)),
        (radau(3), "index-2", (5, 5)),
        (radau(3), "ggl", (5, 5)),
        (RATTLE, "index-3", (2, 2)),
        (pair(3), "index-3", (4, 4)),
    ],
    ids=str,
)
def test_orders_hold_with_damping_drivers_and_forces_that_depend_on_time(
    problem: Problem, integrator: dict[str, Any], formulation: str, orders: tuple[int, int]
) -> None:
    # expected: DOP853 in the rods' angles; the same orders as on the pendulum
    solution = problem.solve(np.array([1.0]))[0]
    exact = np.split(problem.state(solution[:2], solution[2:4]), 2)
    errors = []
    for steps in (60, 120):
        result = end_of(problem.model(), integrator, formulation, steps)
        found = (np.ravel(result.array(f"trajectory/{name}")[-1]) for name in ("position", "velocity"))
        errors.append([np.max(np.abs(x - y)) for x, y in zip(found, exact, strict=True)])
    seen = np.log2(np.array(errors[0]) / errors[1])
    np.testing.assert_allclose(seen, orders, rtol=0, atol=0.2)
