"""Tests of the method."""

import mbdkit
from mbdkit.testing import conformance


@conformance(integrator="backward-euler:backward-euler", quick=True)
def test_it_conforms(case):
    case()


def test_joints_stay_closed():
    run = mbdkit.run(
        "double-pendulum", integrator={"name": "backward-euler"}, formulation="ggl", time={"end": 0.5, "step": 0.01}
    )
    assert max(joint.misalignment_max for joint in run.check().joints.values()) < 1e-12
