"""Tests of the measure."""

import pytest

import mbdkit
from mbdkit.testing import conformance


@conformance(measure="path-length:path-length", quick=True)
def test_it_conforms(case):
    case()


def test_a_ball_that_flies_straight_covers_speed_times_time():
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("ball", mass=1.0, velocity=(3.0, 4.0))
    measures = {"way": {"name": "path-length"}}
    run = mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 2.0, "step": 0.1}, measures=measures).check()
    assert run.measures["way"] == pytest.approx(10.0)
