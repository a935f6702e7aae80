"""Runs say if the ends of a force meet, where its direction is undefined."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import mbdkit
from mbdkit.spec import load_spec
from mbdkit_studies.compute.batch import simulate_batch
from mbdkit_studies.lanes.lane_runs import why_alone

G, K, SPEED = 9.81, 40.0, 6.0


def passing(free_length: float, x: float = 0.0) -> dict[str, Any]:
    """Return the spec of a mass of 1 kg that is thrown up past the anchor of its spring, at the distance `x`."""
    m = mbdkit.Mechanism()
    m.body("mass", mass=1.0, position=(x, -0.5), velocity=(0.0, SPEED))
    m.spring_damper("spring", m.ground, "mass", points=((0, 0), (0, 0)), stiffness=K, free_length=free_length)
    method = {"name": "gauss", "stages": 2}
    return {"mbdkit": 1, "model": m.to_spec(), "integrator": method, "time": {"end": 0.3, "step": 0.002}}


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
    assert not why_alone(load_spec(specs[0]))
    assert [one.warnings for one in simulate_batch([load_spec(spec) for spec in specs])] == [(told,), ()]


def test_ends_that_pass_each_other_in_many_steps_do_not_meet() -> None:
    assert mbdkit.run(passing(0.1, x=0.02)).warnings == []
