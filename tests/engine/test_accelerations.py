"""Accelerations and multipliers of whole mechanisms against a dense system assembled in the tests."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.mechanism.mechanism import Mechanism

from .by_hand import ByHand, first_derivative
from .compiled import Compiled, assert_close
from .random_mechanisms import KINDS, add_rod

T = 0.7
kinds = pytest.mark.parametrize("kind", KINDS)
seeds = pytest.mark.parametrize("seed", range(3))


def dense_solution(c: Compiled) -> tuple[np.ndarray, np.ndarray]:
    """Return accelerations and multipliers of the dense index-1 system; gamma by differences of Phi_q v + Phi_t."""
    hand, n = ByHand(c.mechanism), c.n

    def rate(x: float) -> np.ndarray:
        q, t = c.q + x * c.v, c.t + x
        return hand.jacobian(q, t) @ c.v[:n] + hand.phi_t(q, t)

    h = 1e-3  # central differences of order 8: round-off 1e-13
    gamma = -first_derivative(rate, h)
    phi_q = hand.jacobian(c.q, c.t)
    kkt = np.block([[np.diag(hand.mass), phi_q.T], [phi_q, np.zeros((len(phi_q),) * 2)]])
    x = np.linalg.solve(kkt, np.concatenate([hand.forces(c.q, c.v, c.t), gamma]))
    return x[:n], x[n:]


@kinds
@seeds
def test_accelerations_and_multipliers_are_those_of_the_dense_system(kind: str, seed: int) -> None:
    # expected: numpy.linalg.solve of the KKT matrix, its Jacobian by complex step from Phi written by hand
    c = Compiled(KINDS[kind](np.random.default_rng(seed)), T)
    acc, lam = c.accelerations()
    expected_acc, expected_lam = dense_solution(c)
    assert_close(acc, expected_acc, tolerance=1e-9)
    assert_close(lam, expected_lam, tolerance=1e-9)


@kinds
@seeds
def test_the_schur_complement_and_the_pivoted_system_agree(kind: str, seed: int) -> None:
    c = Compiled(KINDS[kind](np.random.default_rng(seed)), T)
    acc, lam = c.accelerations()
    assert c.workspace.solver.pivoted[0] == 0
    pivoted_acc, pivoted_lam = c.accelerations(pivoted=True)
    assert c.workspace.solver.pivoted[0] == 1
    assert_close(acc, pivoted_acc)
    assert_close(lam, pivoted_lam)


@pytest.mark.parametrize("inertia", [1e-8, 1e8])
def test_bodies_of_very_different_inertia_that_do_not_turn_against_each_other_take_the_pivoted_system(
    inertia: float,
) -> None:
    # expected: welded at the centre of mass, they fall as one body and turn by the torque over both inertias
    m = Mechanism()
    m.body("one", mass=1.0, inertia=1.0)
    m.body("two", mass=1.0, inertia=inertia)
    m.weld("W", "one", "two", at=(0.0, 0.0))
    m.torque("spin", "two", value=3.0)
    c = Compiled(m, T)
    assert c.workspace.solver.pivoted[0] == 1
    acc, lam = c.accelerations()
    turning = 3.0 / (1.0 + inertia)
    np.testing.assert_allclose(acc, [0.0, -9.81, turning] * 2, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(lam[2], turning, rtol=1e-12)  # what turns the first is +lambda


def test_a_light_arm_with_a_slider_far_out_takes_the_pivoted_system() -> None:
    # expected: at rest and level, both turn by the slider's weight over their moment of inertia about the pin
    m = Mechanism()
    m.body("arm", mass=1.0, inertia=1e-9)
    m.body("slider", mass=1.0, inertia=1e-9, position=(1.0, 0.0))
    m.revolute("pin", m.ground, "arm", at=(0.0, 0.0))
    m.prismatic("slide", "arm", "slider", points=((0.0, 0.0), (0.0, 0.0)), axis=(1.0, 0.0))
    c = Compiled(m, T)
    assert c.workspace.solver.pivoted[0] == 1
    acc, _ = c.accelerations()
    turning = -9.81 / (1.0 + 2e-9)
    np.testing.assert_allclose(acc, [0.0, 0.0, turning, 0.0, turning, turning], rtol=1e-12, atol=1e-12)


def crowded(arms: int = 80) -> Mechanism:
    """Return a hub with many arms, where the Schur complement would be full."""
    rng = np.random.default_rng(0)
    m = Mechanism()
    m.body("hub", mass=3.0, inertia=2.0, velocity=(0.1, 0.2), angular_velocity=0.5)
    m.revolute("axle", m.ground, "hub", at=(0.0, 0.0))
    for i in range(arms):
        joint = np.array([np.cos(i), np.sin(i)])
        add_rod(m, rng, f"arm{i}", joint, float(i))
        m.revolute(f"J{i}", "hub", f"arm{i}", at=joint)
    return m


def test_a_hub_with_many_arms_takes_the_pivoted_system_and_is_right() -> None:
    c = Compiled(crowded(), T)
    acc, lam = c.accelerations()
    assert c.workspace.solver.pivoted[0] == 1
    expected_acc, expected_lam = dense_solution(c)
    assert_close(acc, expected_acc, tolerance=1e-9)
    assert_close(lam, expected_lam, tolerance=1e-9)


def tiny_rod(mass: float) -> Mechanism:
    m = Mechanism()
    rng = np.random.default_rng(4)
    end = add_rod(m, rng, "rod", np.zeros(2), 0.3)
    m.revolute("A", m.ground, "rod", at=(0.0, 0.0))
    m.body("tiny", mass=mass, inertia=mass / 12, position=(end[0] + 0.5, end[1]), angular_velocity=2.0)
    m.revolute("B", "rod", "tiny", at=end)
    return m


@pytest.mark.parametrize("mass", [1e-4, 1e-7, 1e-10, 1e-13])
def test_a_rod_that_weighs_next_to_nothing_falls_as_its_limit_does(mass: float) -> None:
    # expected: the motion of the other rod tends to a limit with the mass, at its rate
    c = Compiled(tiny_rod(mass), T)
    acc, _ = c.accelerations()
    limit, _ = Compiled(tiny_rod(1e-4), T).accelerations()
    assert_close(acc, limit, tolerance=1e-2)
    *_, jacobian, gamma = c.constraints(c.q, c.v)
    assert_close(jacobian @ acc, gamma, tolerance=1e-12, size=float(np.abs(acc).max()))


UNITS = [1e-12, 1e-9, 1e9, 1e12]


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("integrator", [{"name": "rk4"}, {"name": "gauss"}, {"name": "gauss", "stages": 3}], ids=str)
def test_the_unit_of_mass_does_not_matter(unit: float, integrator: dict[str, Any]) -> None:
    # expected: a pendulum's motion does not depend on its mass
    def angles(mass: float) -> np.ndarray:
        model = {"name": "double-pendulum", "masses": [mass, mass]}
        run = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": 0.5, "step": 0.01}})
        return np.array([run.check()["rod1"].angle, run["rod2"].angle])

    np.testing.assert_allclose(angles(unit), angles(1.0), rtol=0, atol=1e-10)
