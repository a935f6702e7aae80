"""Tests of the model."""

import numpy as np

import mbdkit
from mbdkit.testing import conformance


@conformance(model="trammel:trammel", quick=True)
def test_it_conforms(case):
    case()


def test_the_middle_of_the_rod_moves_on_a_circle():
    run = mbdkit.run({"mbdkit": 1, "model": {"name": "trammel", "length": 1.2}, "integrator": {"name": "gauss"},
                      "time": {"end": 0.3, "step": 0.001}}).check()  # fmt: skip
    np.testing.assert_allclose(np.hypot(*run["rod"].position[:, :2].T), 0.6, atol=1e-6)
