"""Adaptive implicit steps at stiff springs find the solution that belongs to the start of the step.

Expected: a body on a spring or bushing of stiffness k moves as a rigid pendulum, up to its weight over k. The pendulum
is integrated by DOP853 of SciPy.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.margins import assert_within
from tests.trust.stiff_rods import HOLDS, METHODS, tilt_after_a_second

from .mechanisms import spec


def error_at_the_end(hold: str, stiffness: float, damping: float, integrator: dict[str, Any]) -> float | None:
    """Return the error of the body's position after a second [m]; None if the run stopped early."""
    build, length, pull = HOLDS[hold]
    run = mbdkit.run(spec(build(stiffness, damping), integrator, 1.0, limits={"wall_time": 20.0}))
    if run.status != "complete":
        return None
    tilt = tilt_after_a_second(pull)
    x, y = run["m"].position[-1, :2]
    return math.hypot(x - length * math.cos(tilt), y - length * math.sin(tilt))


@pytest.mark.parametrize("integrator", [("radau-iia", 3), ("radau-iia", 5), ("gauss", 3)], ids=str)
@pytest.mark.parametrize(
    ("hold", "stiffness", "damping"),
    [("spring", 1e9, 100.0), ("spring", 1e9, 1e4), ("spring", 1e10, 1e4), ("bushing", 1e8, 1e5), ("bushing", 1e8, 1e4)],
)
def test_a_stiff_spring_is_not_turned_over(
    hold: str, stiffness: float, damping: float, integrator: tuple[str, int]
) -> None:
    name, stages = integrator
    error = error_at_the_end(hold, stiffness, damping, {"name": name, "stages": stages, "adaptive": True})
    assert error is not None
    assert_within(error, 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_no_stiff_run_is_wrong(seed: int) -> None:
    # 100 draws of stiffness, damping, tolerance and method; a run may be stopped by its limit of time, not be wrong
    random = np.random.default_rng(seed)
    wrong = []
    for _ in range(100):
        stiffness = 10 ** random.uniform(6, 11)
        damping = 0.0 if random.random() < 0.3 else 10 ** random.uniform(0, 5)
        (name, stages), hold = METHODS[random.integers(len(METHODS))], ("spring", "bushing")[random.integers(2)]
        tolerance = 10 ** random.uniform(-8, -3)
        integrator = {"name": name, "stages": stages, "adaptive": True, "rtol": tolerance}
        build, length, pull = HOLDS[hold]
        run = mbdkit.run(spec(build(stiffness, damping), integrator, 1.0, limits={"wall_time": 2.0}))
        tilt = tilt_after_a_second(pull)
        x, y = run["m"].position[-1, :2]
        error = math.hypot(x - length * math.cos(tilt), y - length * math.sin(tilt))
        if run.status == "complete" and run.verdict == "unknown" and error > 1e-3 + 20 * tolerance + 1e3 / stiffness:
            wrong.append((hold, stiffness, damping, name, stages, tolerance, error))
        assert run.status == "complete" or run.status_reason.startswith("wall-time"), run.status_reason
    assert not wrong


@pytest.mark.parametrize(("hold", "step"), list(itertools.product(HOLDS, (0.02, 0.05))))
def test_fixed_steps_at_a_stiff_spring_are_right_or_flagged_or_stopped(hold: str, step: float) -> None:
    for name, stages in METHODS:
        build, length, pull = HOLDS[hold]
        run = mbdkit.run(spec(build(1e8, 1e3), {"name": name, "stages": stages}, 1.0, step))
        tilt = tilt_after_a_second(pull)
        x, y = run["m"].position[-1, :2]
        error = math.hypot(x - length * math.cos(tilt), y - length * math.sin(tilt))
        assert run.status != "complete" or run.verdict in ("doubtful", "bad") or error < 0.05, (name, stages, error)
