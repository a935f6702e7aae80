"""The chain models start where they say, with joints and velocities that fit."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.models import pendulums
from tests.margins import assert_within
from tests.slow_cases import slow

EPSILON = np.finfo(float).eps


def gaps(m: Mechanism) -> tuple[float, float]:
    """Return the largest gap and the largest relative velocity at the revolute joints, from the bodies' data alone."""

    def point(name, local):
        if name == m.ground:
            return np.array(local), np.zeros(2)
        body = m.bodies[name]
        c, s = math.cos(body.angle), math.sin(body.angle)
        arm = np.array([c * local[0] - s * local[1], s * local[0] + c * local[1]])
        return np.array(body.position) + arm, np.array(body.velocity) + body.angular_velocity * np.array(
            [-arm[1], arm[0]]
        )

    ends = [[point(*held) for held in zip(j.bodies, j.points, strict=True)] for j in m.joints.values()]
    return tuple(max(float(np.abs(b[k] - a[k]).max()) for a, b in ends) for k in (0, 1))


def test_single_pendulum_is_a_uniform_rod_unless_told_otherwise():
    m = pendulums.build_single(pendulums.SinglePendulumOptions(length=2, mass=3, angle=-math.pi / 2, rate=0.5))
    assert list(m.bodies) == ["rod1"]
    assert list(m.joints) == ["J1"]
    rod = m.bodies["rod1"]
    assert rod.inertia == pytest.approx(3 * 2**2 / 12, rel=1e-15)  # uniform rod, m L^2 / 12
    assert rod.position == pytest.approx((0, -1), abs=1e-15)
    assert rod.velocity == pytest.approx((0.5, 0), abs=1e-15)
    assert m.joints["J1"].bodies == ("ground", "rod1")
    assert m.gravity == (0.0, -9.81)
    assert pendulums.build_single(pendulums.SinglePendulumOptions(inertia=0.7)).bodies["rod1"].inertia == 0.7


def test_defaults_are_one_metre_one_kilogram_level_and_at_rest():
    m = pendulums.build_double(pendulums.DoublePendulumOptions())
    assert [body.position for body in m.bodies.values()] == [(0.5, 0.0), (1.5, 0.0)]
    assert all(body.mass == 1 and body.angle == 0 and body.angular_velocity == 0 for body in m.bodies.values())
    assert m.description() == "2 bodies, 2 joints, 0 drivers, 0 forces; 4 constraint rows"


def test_angles_and_rates_of_a_chain_are_absolute():
    options = pendulums.DoublePendulumOptions(lengths=[1, 2], angles=[0.3, -0.4], rates=[2, -3], masses=[1, 5])
    m = pendulums.build_double(options)
    second = m.bodies["rod2"]
    assert second.angle == -0.4
    assert second.angular_velocity == -3
    assert second.position == pytest.approx((math.cos(0.3) + math.cos(-0.4), math.sin(0.3) + math.sin(-0.4)))
    assert second.velocity == pytest.approx(
        (-2 * math.sin(0.3) + 3 * math.sin(-0.4), 2 * math.cos(0.3) - 3 * math.cos(0.4))
    )
    assert_within(max(gaps(m)), 1e-15)


@pytest.mark.parametrize("n", [1, 3, 1000])
def test_chain_starts_with_joints_that_meet_to_round_off(n):
    generator = np.random.default_rng(2)
    options = pendulums.NPendulumOptions(
        lengths=generator.uniform(0.1, 2, n), angles=generator.uniform(-4, 4, n), rates=generator.uniform(-3, 3, n)
    )
    m = pendulums.build_n(options)
    assert list(m.bodies) == [f"rod{k + 1}" for k in range(n)]
    assert list(m.joints) == [f"J{k + 1}" for k in range(n)]
    largest = max(max(map(abs, (*body.position, *body.velocity, 1))) for body in m.bodies.values())
    assert max(gaps(m)) <= 4 * EPSILON * largest
    assert max(gaps(m)) < m.assembly.tolerance


@pytest.mark.parametrize("n", [1_000, *slow(10_000)])
def test_a_straight_chain_of_thousands_of_rods_is_placed_to_the_last_bits(n):
    angle = -math.radians(40)
    m = pendulums.build_n(pendulums.NPendulumOptions(n=n, angle=angle, length=0.3))
    m.validate()
    x, y = m.bodies[f"rod{n}"].position
    assert x == pytest.approx(0.3 * math.cos(angle) * (n - 0.5), rel=4 * EPSILON)
    assert y == pytest.approx(0.3 * math.sin(angle) * (n - 0.5), rel=4 * EPSILON)
    assert max(gaps(m)) < m.assembly.tolerance


def test_equal_rods_and_lists_of_equal_numbers_are_the_same_chain():
    one = pendulums.NPendulumOptions(n=3, length=0.5, mass=2, inertia=0.1, angle=0.2, rate=1)
    many = pendulums.NPendulumOptions(
        lengths=[0.5] * 3, masses=[2] * 3, inertias=[0.1] * 3, angles=[0.2] * 3, rates=[1] * 3
    )
    assert pendulums.build_n(one).to_spec() == pendulums.build_n(many).to_spec()


def test_two_rods_of_a_chain_are_the_double_pendulum():
    values = {"lengths": [1, 2], "masses": [3, 4], "angles": [0.1, 0.2], "rates": [0.3, 0.4]}
    double = pendulums.build_double(pendulums.DoublePendulumOptions(**values))
    assert double.to_spec() == pendulums.build_n(pendulums.NPendulumOptions(n=2, **values)).to_spec()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, "'n', the number of rods, is missing"),
        ({"n": 0}, "greater than or equal to 1"),
        ({"n": 2.5}, "integer"),
        ({"n": True}, "integer"),
        ({"n": 3, "lengths": [1, 1]}, "has 2 numbers, but 'n' says 3"),
        ({"lengths": [1, 1], "angles": [0, 0, 0]}, "has 3 numbers, but 'lengths' says 2"),
        ({"lengths": [1], "length": 1}, "not both"),
        ({"n": 2, "mass": -1}, "greater than 0"),
        ({"masses": [1, 0]}, "greater than 0"),
        ({"angles": []}, "at least 1 item"),
        ({"angles": "12"}, "tuple"),
        ({"n": 2, "lenght": 1}, "Extra inputs"),
    ],
)
def test_wrong_chains_are_refused(values, words):
    with pytest.raises(ValidationError, match=words):
        pendulums.NPendulumOptions(**values)


@pytest.mark.parametrize("values", [{"lengths": [1]}, {"masses": [1, 2, 3]}, {"angles": [0, math.nan]}, {"rates": 1}])
def test_wrong_double_pendulums_are_refused(values):
    with pytest.raises(ValidationError):
        pendulums.DoublePendulumOptions(**values)
