"""Tests of the method, which are too weak to see what is wrong with it."""

import pytest

import mbdkit
from mbdkit.testing import conformance


@conformance(integrator="wrong-weight:three-eighths", quick=True)
def test_it_conforms(case):
    case()


def test_the_pendulum_swings_through_its_lowest_point():
    run = mbdkit.run("pendulum", integrator={"name": "three-eighths"}, time={"end": 1.0, "step": 0.01}).check()
    assert run["rod1"].position[:, 1].min() == pytest.approx(-0.5, abs=0.01)
