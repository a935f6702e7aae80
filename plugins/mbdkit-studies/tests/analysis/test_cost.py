"""Cost of runs, and accuracy at equal cost: expected values from power laws."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mbdkit
from mbdkit_studies.results.cost import at_equal_work, work_for

WORK = np.array([100.0, 200.0, 400.0, 800.0])
ERROR = 1e6 * WORK**-4.0


def test_cost_of_an_explicit_method_is_four_evaluations_a_step() -> None:
    # expected: Gill's method has four stages, each one evaluation and one factorization
    run = mbdkit.run("pendulum", integrator={"name": "rk-gill"}, time={"steps": 50, "step": 0.01})
    counters = ("steps", "rhs_evaluations", "factorizations", "newton_iterations")
    assert [run.stats[name] for name in counters] == [50, 200, 200, 0]
    assert run.stats["wall_s"] > 0


def test_result_at_equal_work_follows_a_power_law_exactly() -> None:
    assert at_equal_work(WORK, ERROR, 300.0) == pytest.approx(1e6 * 300.0**-4, rel=1e-12)


def test_nothing_is_extrapolated() -> None:
    assert math.isnan(at_equal_work(WORK, ERROR, 1000.0))
    assert math.isnan(at_equal_work(WORK, ERROR, 50.0))
    assert math.isnan(work_for(WORK, ERROR, 1e-8))


def test_work_for_a_result_follows_a_power_law_exactly() -> None:
    assert work_for(WORK, ERROR, 1e6 * 300.0**-4) == pytest.approx(300.0, rel=1e-12)
    assert work_for(WORK, ERROR, 1.0) <= 100.0


def test_work_for_a_result_is_that_from_which_on_it_stays_good() -> None:
    # An accurate run does not count if finer runs are less accurate.
    assert work_for(WORK, [1e-9, 1e-2, 1e-4, 1e-8], 1e-5) > 400.0


def test_runs_that_failed_count_as_too_large() -> None:
    assert work_for(WORK, [math.nan, 1e-5, 1e-6, 1e-7], 1e-4) == 200.0
