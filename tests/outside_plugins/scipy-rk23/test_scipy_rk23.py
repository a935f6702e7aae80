"""Tests of the method."""

import numpy as np

import mbdkit
from mbdkit.testing import conformance


@conformance(integrator="scipy-rk23:scipy-rk23", quick=True)
def test_it_conforms(case):
    case()


def test_it_goes_where_dop853_goes():
    ends = [
        mbdkit.run("pendulum", integrator={"name": name, "rtol": 1e-9, "atol": 1e-9} | more, time={"end": 1.0})
        for name, more in (("scipy-rk23:scipy-rk23", {}), ("dop853", {"adaptive": True}))
    ]
    np.testing.assert_allclose(*(run.check()["rod1"].position[-1] for run in ends), atol=1e-6)
