"""A four-bar and a Watt six-bar that a motor torque drives, in absolute coordinates against one coordinate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.witness.six_bar import END, FOUR_BAR, PHI, RATE, SIX_BAR

from .dyads import Link, Linkage
from .four_bar import FourBar
from .four_bar import Link as FourBarLink
from .running import gauss, run

TIMES = np.linspace(0.0, END, 21)
linkages = pytest.mark.parametrize("linkage", [FOUR_BAR, SIX_BAR], ids=["four-bar", "six-bar"])


@linkages
def test_yardstick_derivatives_are_those_of_the_closed_loops(linkage: Linkage) -> None:
    # expected: central differences of order 8 of the closed loops, for both derivatives
    step = 0.01
    for phi in (0.5, 2.0, 4.0):
        around = [linkage.poses(phi + k * step) for k in range(-4, 5)]
        for name, pose in linkage.poses(phi).items():
            for seen in (pose.centre, pose.angle):
                which = "centre" if seen is pose.centre else "angle"
                at = np.array([getattr(poses[name], which)[0] for poses in around])
                at = np.unwrap(at) if which == "angle" else at
                first = [1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280]
                second = [-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560]
                np.testing.assert_allclose(seen[1], at @ first / step, rtol=0, atol=1e-11)
                np.testing.assert_allclose(seen[2], at @ second / step**2, rtol=0, atol=1e-9)


@linkages
def test_yardstick_energy_is_what_the_motor_puts_in(linkage: Linkage) -> None:
    # expected: conservation of energy; the work is integrated beside the motion
    solution = linkage.solve(PHI, RATE, TIMES)
    energies = np.array([linkage.energy(phi, rate) for phi, rate, _ in solution])
    np.testing.assert_allclose(energies - solution[:, 2], energies[0], rtol=5e-12)  # DOP853's own error, over 2 s
    assert np.ptp(energies) > 5.0


def test_yardstick_four_bar_has_the_equation_of_the_other_witness() -> None:
    # expected: Eksergian's equation as written for one four-bar linkage, and checked in 25 digits, in four_bar.py
    def pins(link: Link) -> tuple[Any, Any]:
        first, second = link.pins.values()
        return (first.real, first.imag), (second.real, second.imag)

    crank, coupler, follower = (FourBarLink(link.mass, link.inertia, pins(link)) for link in FOUR_BAR.links.values())
    other = FourBar(((0.0, 0.0), (1.0, 0.1)), crank, coupler, follower)
    for phi in np.linspace(0.0, 6.0, 13):
        np.testing.assert_allclose(FOUR_BAR.equation(phi), other.equation(phi), rtol=0, atol=1e-13)


@linkages
def test_yardstick_crank_goes_round_and_keeps_clear_of_dead_centres(linkage: Linkage) -> None:
    # The tests below need this, to compare motions and not the growth of round-off.
    solution = linkage.solve(PHI, RATE, TIMES)
    assert np.all(solution[:, 1] > 1.0)
    assert np.ptp(solution[:, 0]) > 4 * np.pi
    assert min(linkage.transmission(phi) for phi in np.linspace(0.0, 2 * np.pi, 61)) > 0.6


METHODS: dict[str, tuple[dict[str, Any], float]] = {
    "rk4": ({"name": "rk4"}, 0.00005),
    "rk-gill": ({"name": "rk-gill"}, 0.00005),
    "gauss4": (gauss(4), 0.0025),
    "gauss5": (gauss(5), 0.005),
    "gauss6": (gauss(6), 0.005),
}


@linkages
@pytest.mark.parametrize("name", METHODS)
def test_a_linkage_driven_by_a_motor_torque_moves_as_in_its_crank_angle_to_1e_9(linkage: Linkage, name: str) -> None:
    # expected: Eksergian's equation in the crank's angle by DOP853 at rtol 1e-13
    integrator, step = METHODS[name]
    result = run(linkage.model(PHI, RATE), integrator, end=END, step=step, every=round(0.1 / step))
    np.testing.assert_allclose(result.time, TIMES, rtol=0, atol=1e-12)
    solution = linkage.solve(PHI, RATE, TIMES)
    placed = [linkage.poses(phi) for phi in solution[:, 0]]
    rates = solution[:, 1]
    for body in linkage.links:
        centre, slope, _ = np.array([poses[body].centre for poses in placed]).T
        angle, turning, _ = np.array([poses[body].angle for poses in placed]).T
        seen = np.asarray(result[body].position) @ [1, 1j]
        np.testing.assert_allclose(seen, centre, rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.exp(1j * result[body].angle), np.exp(1j * angle), rtol=0, atol=1e-9)
        velocity = np.asarray(result[body].velocity) @ [1, 1j]
        np.testing.assert_allclose(velocity, slope * rates, rtol=0, atol=1e-8)
        np.testing.assert_allclose(result[body].angular_velocity, turning * rates, rtol=0, atol=1e-8)
    np.testing.assert_allclose(result.energy.work, solution[:, 2], rtol=0, atol=1e-8)


@linkages
def test_accelerations_of_a_linkage_follow_eksergians_equation(linkage: Linkage) -> None:
    # expected: phi'' from Eksergian's equation, and c'' phi'^2 + c' phi'' of every link's centre
    result = run(linkage.model(PHI, RATE), gauss(6), end=END, step=0.005, every=20)
    for row, (time, (phi, rate, _)) in enumerate(zip(TIMES, linkage.solve(PHI, RATE, TIMES), strict=True)):
        push = linkage.acceleration(time, phi, rate)
        for body, pose in linkage.poses(phi).items():
            expected = pose.centre[2] * rate**2 + pose.centre[1] * push
            assert result[body].acceleration[row] @ [1, 1j] == pytest.approx(expected, rel=0, abs=1e-7)
            expected = pose.angle[2] * rate**2 + pose.angle[1] * push
            assert result[body].angular_acceleration[row] == pytest.approx(expected, rel=0, abs=1e-7)
