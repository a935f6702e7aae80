"""Errors against a reference: whose expected values are distances put in by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.analysis.reference import common_times, error_against
from mbdkit.errors import MbdkitError, RunError


def falling(start: float, angle: float = 0.0, end: float = 1.0, step: float = 0.1, **sections: Any) -> mbdkit.Run:
    """Return a body that falls freely from the height `start`: a method of order 4 has no error there."""
    bodies = {"stone": {"mass": 1.0, "inertia": 1.0, "position": [0.0, start], "angle": angle}}
    spec = {
        "mbdkit": 1,
        "model": {"name": "mechanism", "bodies": bodies},
        "integrator": {"name": "rk4"},
        "time": {"end": end, "step": step},
    }
    return mbdkit.run(spec | sections)


def test_bodies_at_a_constant_distance_are_at_that_distance() -> None:
    # expected: 3 m and 0.25 rad apart at all times, at the same speed
    error = error_against(falling(3.0, 0.25), falling(0.0))
    for found in (error.end_position, error.rms_position, error.max_position):
        assert found == pytest.approx(3.0, rel=1e-12)
    for found in (error.end_angle, error.rms_angle, error.max_angle):
        assert found == pytest.approx(0.25, rel=1e-12)
    assert (error.end_velocity, error.end_angular_velocity, error.times) == (0.0, 0.0, 11)


def test_only_times_that_both_recorded_are_compared() -> None:
    # expected: steps of 0.1 s and of 0.15 s meet at 0, 0.3, 0.6 and 0.9 s
    assert error_against(falling(1.0, end=0.9), falling(0.0, end=0.9, step=0.15)).times == 4


def test_common_times_are_found_despite_rounding() -> None:
    first, second = np.arange(11) * 0.1, np.array([0.0, 0.3, 0.6, 0.65, 0.9])
    assert [rows.tolist() for rows in common_times(first, second)] == [[0, 3, 6, 9], [0, 1, 2, 4]]


def test_runs_of_other_bodies_or_lengths_are_refused() -> None:
    other = mbdkit.run("pendulum", time={"end": 1.0, "step": 0.1})
    with pytest.raises(MbdkitError, match="the reference has the bodies"):
        error_against(falling(0.0), other)
    with pytest.raises(MbdkitError, match=r"the reference ends at 2 s, but the run at 1 s"):
        error_against(falling(0.0), falling(0.0, end=2.0))


def test_incomplete_runs_are_refused() -> None:
    stopped = falling(0.0, limits={"max_steps": 5})
    with pytest.raises(RunError, match="max_steps"):
        error_against(stopped, falling(0.0))
