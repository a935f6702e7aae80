"""The limit of the iterations in a step: fixed steps go on while they contract steadily, unless the user gives a limit.

The expected motion is that of the other stage solver, which solves the same equations.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit

from .running import spec_run

TWO = {"name": "double-pendulum", "angles": [1.0, 0.3]}
FIVE = {"name": "n-pendulum", "n": 5}
SPRING = {
    "name": "mechanism",
    "bodies": {
        "a": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]},
        "b": {"mass": 1.0, "inertia": 0.1, "position": [1.5, 0.2]},
    },
    "joints": {"A": {"type": "revolute", "bodies": ["ground", "a"], "points": [[0, 0], [-0.5, 0]]}},
    "forces": {
        "s": {"type": "spring-damper", "bodies": ["a", "b"], "points": [[0.5, 0], [-0.5, 0]], "stiffness": 100.0,
              "damping": 1.0, "free_length": 0.1},
    },
}  # fmt: skip

SLOW: list[tuple[Any, dict[str, Any], str, float, float]] = [
    (FIVE, {"name": "radau-iia", "stages": 3, "stage_solver": "fixed-point"}, "index-1", 0.1, 1.2),
    (SPRING, {"name": "gauss", "stages": 3, "stage_solver": "fixed-point"}, "index-1", 0.15, 0.6),
    (TWO, {"name": "radau-iia", "stages": 5}, "index-2", 0.1, 1.5),
    (FIVE, {"name": "radau-iia", "stages": 5}, "index-3", 0.1, 1.2),
    (TWO, {"name": "lobatto-pair", "stages": 3}, "index-3", 0.1, 3.0),
]
"""Model, method, formulation, step and end of runs of which one step takes 60 to 150 iterations."""


def slow(case: tuple[Any, dict[str, Any], str, float, float], **options: Any) -> mbdkit.Run:
    """Return one of these runs, with other options of its method."""
    model, integrator, formulation, step, end = case
    return spec_run(model, integrator | options, {"end": end, "step": step}, formulation=formulation)


@pytest.mark.parametrize("case", SLOW, ids=lambda case: f"{case[1]['name']} {case[2]}")
def test_a_fixed_step_that_contracts_steadily_goes_on_beyond_50_iterations(case: Any) -> None:
    with slow(case) as there, slow(case, max_iterations=50) as limited:
        assert there.status == "complete", there.status_reason
        assert 50 < int(there.steps.iterations_max.max()) < 500
        assert limited.status_reason.startswith("newton-failed")
        assert "did not converge in 50 iterations" in limited.status_reason
        before = len(limited.time) - 1  # steps that succeed anyway are not affected
        assert np.array_equal(
            there.array("trajectory/position")[:before], limited.array("trajectory/position")[:before]
        )


@pytest.mark.parametrize("case", SLOW[:2], ids=lambda case: case[1]["name"])
def test_these_steps_have_the_solution_that_newton_finds(case: Any) -> None:
    with slow(case) as there, slow(case, stage_solver="newton") as expected:
        for name in ("position", "velocity"):
            path = f"trajectory/{name}"
            np.testing.assert_allclose(there.array(path), expected.check().array(path), rtol=0, atol=1e-8)


def test_the_limit_is_extended_for_one_step_whatever_the_stretches_of_the_run() -> None:
    # under events the run advances by single steps
    case = SLOW[-1]
    events = {"up": {"when": "rod1.angle - 100"}}
    model, integrator, formulation, step, end = case
    time = {"end": end, "step": step}
    with slow(case) as there, spec_run(model, integrator, time, formulation=formulation, events=events) as watched:
        for path in ("trajectory/position", "trajectory/velocity"):
            assert np.array_equal(there.array(path), watched.array(path))


def test_steps_that_can_be_made_smaller_keep_the_limit() -> None:
    integrator = {"name": "gauss", "stages": 2, "adaptive": True, "rtol": 1e-3, "stage_solver": "fixed-point"}
    with spec_run(SPRING, integrator, {"end": 2.0, "step": 0.5}) as there:
        assert there.status == "complete"
        assert there.stats["rejected"] > 0
        assert int(there.steps.iterations_max.max()) <= 50
