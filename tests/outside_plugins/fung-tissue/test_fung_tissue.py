"""Tests of the law."""

import math

import pytest

import mbdkit
from mbdkit.testing import conformance


@conformance(force_law="fung-tissue:fung", quick=True)
def test_it_conforms(case):
    case()


def test_a_hanging_mass_starts_with_the_acceleration_of_the_formula():
    m = mbdkit.Mechanism(gravity=(0.0, -9.81))
    m.body("ball", mass=2.0, position=(0.0, -0.3))
    m.law(
        "tissue",
        "ground",
        "ball",
        law="fung",
        from_=(0.0, 0.0),
        to=(0.0, -0.3),
        force=4.0,
        exponent=8.0,
        free_length=0.1,
    )
    run = mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.001}).check()
    expected = 4.0 * (math.exp(8.0 * 0.2) - 1) / 2.0 - 9.81
    assert run["ball"].acceleration[0, 1] == pytest.approx(expected)
