"""Runs say if the ends of a force meet, where its direction is undefined."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import mbdkit
from tests.runs.coincident_ends import SPEED, G, K, passing


def height(time: Any, free_length: float) -> Any:
    """Return the height of the mass below the anchor: an oscillation about its equilibrium."""
    rate, rest = np.sqrt(K), -free_length - G / K
    return rest + (-0.5 - rest) * np.cos(rate * time) + SPEED / rate * np.sin(rate * time)


def test_a_spring_whose_ends_meet_is_named_with_the_time() -> None:
    free_lengths = 0.1, 0.0
    specs = [passing(free_length) for free_length in free_lengths]
    meeting, smooth = (mbdkit.run(spec) for spec in specs)
    (told,) = meeting.warnings
    assert told.startswith("the two ends of force 'spring' meet at t = 0.0")
    time = float(told.partition("t = ")[2].partition(" s")[0])
    assert time == pytest.approx(brentq(height, 0.05, 0.12, args=(0.1,)), abs=1e-4)
    assert meeting.verdict_reasons[-1] == told
    # the force of a spring with free length 0 is proportional to the vector between its ends
    assert smooth.warnings == []
    np.testing.assert_allclose(smooth["mass"].position[:, 1], height(smooth.time, 0.0), atol=1e-9)


def test_ends_that_pass_each_other_in_many_steps_do_not_meet() -> None:
    assert mbdkit.run(passing(0.1, x=0.02)).warnings == []
