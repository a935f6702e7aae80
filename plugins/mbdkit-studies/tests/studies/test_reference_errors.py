"""Errors against a reference; the expected values are distances chosen by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.base.errors import MbdkitError
from mbdkit_studies.spec.reference_errors import LAST_ROW, offsets


def falling(start: float, angle: float = 0.0, end: float = 1.0, step: float = 0.1, **sections: Any) -> mbdkit.Run:
    """Return a body that falls freely from the height `start`: a method of order 4 has no error there."""
    bodies = {"stone": {"mass": 1.0, "inertia": 1.0, "position": [0.0, start], "angle": angle}}
    run = {"integrator": {"name": "rk4"}, "time": {"end": end, "step": step}}
    spec = {"mbdkit": 1, "model": {"name": "mechanism", "bodies": bodies}, **run}
    return mbdkit.run(spec | sections)


def test_bodies_at_a_constant_distance_are_at_that_distance() -> None:
    # expected: 3 m and 0.25 rad apart at all times
    found = offsets(falling(3.0, 0.25), falling(0.0))
    np.testing.assert_allclose(found, np.tile([0.0, 3.0, 0.25], (11, 1, 1)), rtol=0, atol=1e-12)
    assert np.array_equal(offsets(falling(3.0, 0.25), falling(0.0), LAST_ROW), found[-1:])


def test_a_reference_of_other_rows_is_read_between_them() -> None:
    # expected: steps of 0.1 s and of 0.15 s; a fall is a parabola, which the polynomial between two rows is exactly
    found = offsets(falling(1.0, end=0.9), falling(0.0, end=0.9, step=0.15))
    np.testing.assert_allclose(found, np.tile([0.0, 1.0, 0.0], (10, 1, 1)), rtol=0, atol=1e-12)


def test_runs_of_other_bodies_or_lengths_are_refused() -> None:
    other = mbdkit.run("pendulum", time={"end": 1.0, "step": 0.1})
    with pytest.raises(MbdkitError, match="the reference has the bodies"):
        offsets(falling(0.0), other)
    with pytest.raises(MbdkitError, match=r"the reference ends at 2 s, but the run at 1 s"):
        offsets(falling(0.0), falling(0.0, end=2.0))
