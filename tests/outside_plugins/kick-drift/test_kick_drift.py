"""Tests of the method."""

import mbdkit
from mbdkit.testing import conformance


@conformance(integrator="kick-drift:kick-drift", quick=True)
def test_it_conforms(case):
    case()


def energy_lost(step):
    run = mbdkit.run(
        "pendulum", integrator={"name": "kick-drift:kick-drift", "first": "drift"}, time={"end": 1.0, "step": step}
    ).check()
    return abs(run.energy.total[-1] - run.energy.total[0])


def test_half_the_step_divides_the_error_of_energy():
    # expected: the error of a method of order 1 falls by at least 2^1 (less what longer steps hide)
    assert energy_lost(0.01) > 1.7 * energy_lost(0.005)
