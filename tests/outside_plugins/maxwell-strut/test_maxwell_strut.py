"""Tests of the elements."""

import numpy as np

import mbdkit
from mbdkit.testing import conformance


@conformance(element="maxwell-strut:maxwell-strut", quick=True)
def test_it_conforms(case):
    case()


def test_the_force_at_constant_length_relaxes_exponentially():
    # expected: k x0 exp(-k t/c)
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("end", mass=1.0, inertia=0.1, position=(1.1, 0.0))
    m.weld("hold", "ground", "end", at=(1.1, 0.0))
    m.maxwell_strut(
        "strut", bodies=("ground", "end"), points=((0.0, 0.0), (0.0, 0.0)), stiffness=200.0, viscosity=50.0, free=1.0
    )
    run = mbdkit.run(m, integrator={"name": "gauss", "stages": 3}, time={"end": 1.0, "step": 0.01}).check()
    stretch = 0.1 - run.maxwell_struts["strut"].extension
    np.testing.assert_allclose(200.0 * stretch, 20.0 * np.exp(-4.0 * run.time), rtol=1e-8)
