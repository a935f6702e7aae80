"""Tests of the joint."""

import math

import pytest

import mbdkit
from mbdkit.testing import conformance


@conformance(joint="parabola-pin:parabola-pin", quick=True)
def test_it_conforms(case):
    case()


def test_a_bead_passes_the_vertex_with_the_speed_of_free_fall():
    # expected: sqrt(2 g h), since the curve does no work
    m = mbdkit.Mechanism(gravity=(0.0, -9.81))
    m.body("bead", mass=0.2, position=(0.5, 0.5))
    m.parabola_pin("wire", "ground", "bead", curvature=2.0)
    run = mbdkit.run(m, integrator={"name": "gauss", "stages": 3}, time={"end": 1.0, "step": 0.002}).check()
    fastest = max(math.hypot(*velocity[:2]) for velocity in run["bead"].velocity)
    assert fastest == pytest.approx(math.sqrt(2 * 9.81 * 0.5), rel=1e-4)
