"""The estimate of errors from arrays: made-up runs whose errors are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.runs.accuracy.check_run import why_unknown
from mbdkit.runs.accuracy.companion import Companion, CompanionRows, Comparison
from mbdkit.runs.accuracy.error_estimate import LARGEST_ERROR, ErrorEstimate, Units, estimate_errors
from mbdkit.runs.recorded_states import ObservedRows

TIME = np.linspace(0.0, 10.0, 201)
UNITS = Units(length=1.0, speed=0.1, force=0.01)


def rows(error: np.ndarray | float, until: float = math.inf) -> ObservedRows:
    """Return two bodies and two joints that move in circles, with an error in all quantities; nan after `until`."""
    wave = np.sin(TIME)[:, None, None] + np.zeros((1, 2, 3))
    late = np.where(until < TIME, np.nan, 0.0)
    off = (np.broadcast_to(error, TIME.shape) + late)[:, None, None]
    force = 10.0 * wave[..., :2] + 10.0 * off
    return ObservedRows(TIME, wave + off, 2.0 * wave + off, force, wave[..., 0] + off[..., 0])


def power_law(error: np.ndarray, order: float, *, guard: np.ndarray | float = 0.0) -> ErrorEstimate:
    """Return the estimate of a run with this error, if that of its companions falls with this order."""
    first, second, third = (rows(error * 2.0 ** (-order * k)) for k in range(3))
    return estimate_errors((first, second, third), rows(guard), UNITS)


@pytest.mark.parametrize("order", [1, 2, 4, 8])
def test_an_error_that_falls_with_the_order_is_found_exactly(order):
    # expected: Richardson's extrapolation is exact for C h^p
    error = 1e-4 * TIME**2
    found = power_law(error, order)
    np.testing.assert_allclose(found.position[:, 0, 0], error, rtol=1e-8, atol=1e-15)
    np.testing.assert_allclose(found.reaction[:, 1], 10.0 * math.sqrt(2.0) * error, rtol=1e-8, atol=1e-14)
    np.testing.assert_allclose(found.torque[:, 1], error, rtol=1e-8, atol=1e-15)
    assert found.known_until == TIME[-1]
    assert found.order == pytest.approx(order, abs=1e-6)


def test_an_estimate_has_no_dip_where_the_error_changes_its_sign():
    error = 1e-5 * TIME * np.sin(5 * TIME)
    found = power_law(error, 4)
    np.testing.assert_allclose(found.velocity[:, 1, 2], np.maximum.accumulate(np.abs(error)), rtol=1e-6, atol=1e-15)


def test_differences_that_stop_falling_end_the_estimate():
    # expected: the three runs and the guard have diverged from t = 6 on
    chaos = 1e-3 * np.maximum(TIME - 6.0, 0.0)
    runs = [rows(1e-6 * TIME * 16.0**-k + chaos * (-1) ** k) for k in range(3)]
    found = estimate_errors((runs[0], runs[1], runs[2]), rows(0.5 * chaos), UNITS)
    assert 5.9 < found.known_until < 6.1
    after = found.known_until < TIME
    assert np.all(np.isnan(found.position[after]))
    assert np.all(np.isfinite(found.reaction[~after]))


def test_a_guard_that_disagrees_ends_the_estimate():
    # expected: an error that all runs of the method share
    found = power_law(1e-6 * TIME, 4, guard=np.where(TIME > 4.0, 1e-3, 0.0))
    assert found.known_until == pytest.approx(4.0)


def test_a_guard_confirms_what_the_order_does_not_show():
    # expected: the finer runs approach the guard, though not in the ratio of an order
    first, second, third = (rows(share * 1e-4 * TIME) for share in (1.0, 0.6, 0.02))
    found = estimate_errors((first, second, third), rows(0.0), UNITS)
    assert found.known_until == TIME[-1]
    np.testing.assert_allclose(found.position[:, 0, 0], 1e-4 * TIME, rtol=0.05)


@pytest.mark.parametrize("size", [1e-13, 1e-7])
def test_rounding_errors_need_not_fall_even_where_chaos_has_multiplied_them(size):
    noise = np.random.default_rng(1).normal(size=(4, len(TIME))) * size
    runs = [rows(x) for x in noise]
    found = estimate_errors((runs[0], runs[1], runs[2]), runs[3], UNITS)
    assert found.known_until == TIME[-1]
    assert size < found.position[-1, 0, 0] < 10 * size


def test_equal_runs_are_known_to_their_distance_from_the_guard():
    same = rows(1e-12 * TIME)
    found = estimate_errors((same, same, same), rows(0.0), UNITS)
    np.testing.assert_allclose(found.position[:, 0, 0], 1e-12 * TIME, rtol=0, atol=1e-15)


def test_an_error_as_large_as_the_motion_is_unknown():
    found = power_law(0.02 * TIME, 4)
    assert found.known_until == pytest.approx(LARGEST_ERROR / 0.02, rel=0.5)
    assert np.isnan(found.position[-1, 0, 0])


@pytest.mark.parametrize("which", [2, 3])
def test_a_companion_that_stops_ends_the_estimate(which):
    runs = [rows(1e-6 * TIME * 16.0**-k, until=3.0 if k == which else math.inf) for k in range(4)]
    found = estimate_errors((runs[0], runs[1], runs[2]), runs[3], UNITS)
    assert found.known_until == pytest.approx(3.0)
    assert np.all(np.isnan(found.torque[TIME > 3.0]))


def test_a_joint_may_be_known_longer_than_another():
    runs = [rows(1e-6 * TIME * 16.0**-k) for k in range(4)]
    bad = runs[1].force.copy()
    bad[TIME > 5.0, 1] += 0.5
    second = ObservedRows(TIME, runs[1].position, runs[1].velocity, bad, runs[1].torque)
    worse = runs[3].force.copy()
    worse[TIME > 5.0, 1] -= 0.4
    guard = ObservedRows(TIME, runs[3].position, runs[3].velocity, worse, runs[3].torque)
    found = estimate_errors((runs[0], second, runs[2]), guard, UNITS)
    assert found.known_until == pytest.approx(5.0)
    assert np.all(np.isfinite(found.reaction[:, 0]))
    assert np.all(np.isnan(found.reaction[TIME > 5.0, 1]))
    assert np.all(np.isfinite(found.position))


def test_the_reason_is_a_comparison_run_that_ended_early_or_quantities_that_do_not_converge():
    first, second, third = (rows(1e-6 * TIME * 16.0**-k) for k in range(3))
    ended = CompanionRows(rows(0.0, until=6.0), "it needs more than 9 steps")
    found = estimate_errors((first, second, third), ended.rows, UNITS)
    guard = Companion(Comparison("dop853", None, None), None, within_steps=False)
    why = why_unknown(found, TIME, Mechanism(), [(guard, ended)])
    assert why == "the comparison run with dop853 ended at 6 s: it needs more than 9 steps"
    chaos = replace(rows(0.0), force=rows(TIME > 7.0).force)
    found = estimate_errors((first, second, third), chaos, UNITS)
    assert found.unknown == ("reactions",)
    assert why_unknown(found, TIME, Mechanism()).startswith("reactions of the comparison runs do not converge")
    assert why_unknown(estimate_errors((first, second, third), rows(0.0), UNITS), TIME, Mechanism()) == ""
