"""Tests of the method."""

import mbdkit
from mbdkit.testing import conformance


@conformance(integrator="ralston-kit:ralston3", quick=True)
def test_it_conforms(case):
    case()


def energy_lost(step):
    run = mbdkit.run("pendulum", integrator={"name": "ralston-kit:ralston3"}, time={"end": 1.0, "step": step}).check()
    return abs(run.energy.total[-1] - run.energy.total[0])


def test_half_the_step_divides_the_error_of_energy():
    # expected: the error of a method of order 3 falls by at least 2^3 (less what longer steps hide)
    assert energy_lost(0.01) > 6 * energy_lost(0.005)
