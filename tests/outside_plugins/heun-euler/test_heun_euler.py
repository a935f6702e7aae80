"""Tests of the method."""

import mbdkit
from mbdkit.testing import conformance


@conformance(integrator="heun-euler:heun-euler", quick=True)
def test_it_conforms(case):
    case()


def test_smaller_tolerances_lose_less_energy():
    lost = []
    for rtol in (1e-4, 1e-6):
        run = mbdkit.run("pendulum", integrator={"name": "heun-euler", "rtol": rtol, "atol": rtol}, time={"end": 1.0})
        lost.append(abs(run.check().energy.total[-1] - run.energy.total[0]))
    assert lost[1] < 0.2 * lost[0]
