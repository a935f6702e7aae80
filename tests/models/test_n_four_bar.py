"""The N-four-bar model: names, equal rods, and a start whose joints meet."""

import math

import pytest

import mbdkit
from mbdkit.models.n_four_bar import NFourBarOptions, build
from tests.margins import assert_within


def test_defaults_are_those_of_the_benchmark():
    # expected: problem A02: rods of 1 m and 1 kg, upright, the tops at 1 m/s to the right
    m = build(NFourBarOptions())
    assert list(m.bodies) == ["crank0", "crank1", "crank2", "coupler1", "coupler2"]
    assert list(m.joints) == ["A0", "A1", "A2", "B0", "B1", "C1", "B2"]
    assert m.gravity == (0.0, -9.81)
    for body in m.bodies.values():
        assert (body.mass, body.inertia) == (1.0, pytest.approx(1 / 12))
    assert m.bodies["crank1"].position == pytest.approx((1.0, 0.5))
    assert m.bodies["crank1"].angular_velocity == -1.0
    assert m.bodies["coupler2"].position == pytest.approx((1.5, 1.0))
    assert m.bodies["coupler2"].velocity == pytest.approx((1.0, 0.0))


@pytest.mark.parametrize("n", [1, 2, 7])
def test_n_windows_have_two_n_plus_one_rods_and_one_degree_of_freedom(n):
    m = build(NFourBarOptions(n=n))
    assert len(m.bodies) == 2 * n + 1
    assert len(m.joints) == 3 * n + 1
    assert 3 * len(m.bodies) - 2 * len(m.joints) == 1


def test_start_needs_no_assembly_whatever_its_size_angle_and_speed():
    model = {"name": "n-four-bar", "n": 9, "length": 0.37, "angle": 2.2, "speed": 3.0, "inertia": 0.01}
    with mbdkit.run(
        {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"steps": 1, "step": 1e-4}}
    ) as r:
        assert_within(r.check().misalignment_max, 1e-15 * 9)
        assert "left untouched" in str(r.provenance["assembly"])
        assert r["coupler9"].velocity[0] == pytest.approx((3.0 * math.sin(2.2), -3.0 * math.cos(2.2)))
