"""A slider-crank whose guide is itself a moving body, against two coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from .moving_guide import NAMES, MovingGuide
from .running import gauss, run

MECHANISM = MovingGuide()
START, RATES = np.array([0.5, -0.2]), np.array([7.0, 0.3])
TIMES = np.linspace(0.0, 2.0, 21)


def test_yardstick_velocities_and_accelerations_are_those_of_the_closed_loop() -> None:
    # expected: central differences of order 8 of the closed loop, along phi(t) and psi(t) of second degree
    second, step = np.array([3.0, -5.0]), 0.005

    def at(time: float) -> Any:
        return np.array([*START]) + RATES * time + second * time**2 / 2

    around = [MECHANISM.place(at(k * step)) for k in range(-4, 5)]
    first = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280]) / step
    twice = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560]) / step**2
    v, omega, a, turning = MECHANISM.motion(START, RATES, second)
    for which, (rate, acceleration) in enumerate(((v, a), (omega, turning))):
        rows = np.array([place[which] for place in around])
        np.testing.assert_allclose(rate, first @ rows, rtol=0, atol=1e-10)
        np.testing.assert_allclose(acceleration, twice @ rows, rtol=0, atol=1e-8)


def test_yardstick_energy_is_what_the_motor_puts_in_and_the_damper_takes_out() -> None:
    # expected: conservation of energy; work and loss are integrated beside the motion
    solution = MECHANISM.solve(START, RATES, TIMES)
    energies = np.array([MECHANISM.energy(row[:2], row[2:4]) for row in solution])
    np.testing.assert_allclose(energies - solution[:, 4] + solution[:, 5], energies[0], rtol=0, atol=2e-11)
    assert np.ptp(solution[:, 0]) > 2 * np.pi
    assert np.ptp(solution[:, 1]) > 0.2


METHODS: dict[str, tuple[dict[str, Any], float]] = {
    "rk4": ({"name": "rk4"}, 0.0001),
    "gauss4": (gauss(4), 0.005),
    "gauss6": (gauss(6), 0.01),
}


@pytest.mark.parametrize("name", METHODS)
def test_a_slider_in_a_moving_guide_follows_the_two_coordinates_to_1e_9(name: str) -> None:
    # expected: Newton's and Euler's equations in phi and psi by DOP853 at rtol 1e-13
    integrator, step = METHODS[name]
    result = run(MECHANISM.model(START, RATES), integrator, end=2.0, step=step, every=round(0.1 / step))
    solution = MECHANISM.solve(START, RATES, TIMES)
    placed = [MECHANISM.place(row[:2]) for row in solution]
    moving = [MECHANISM.motion(row[:2], row[2:4], np.zeros(2)) for row in solution]
    for k, body in enumerate(NAMES):
        centre, angle = (np.array([place[which][k] for place in placed]) for which in (0, 1))
        np.testing.assert_allclose(np.asarray(result[body].position) @ [1, 1j], centre, rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.exp(1j * result[body].angle), np.exp(1j * angle), rtol=0, atol=1e-9)
        velocity, omega = (np.array([motion[which][k] for motion in moving]) for which in (0, 1))
        np.testing.assert_allclose(np.asarray(result[body].velocity) @ [1, 1j], velocity, rtol=0, atol=1e-8)
        np.testing.assert_allclose(result[body].angular_velocity, omega, rtol=0, atol=1e-8)
    np.testing.assert_allclose(result.energy.work, solution[:, 4], rtol=0, atol=1e-8)
    np.testing.assert_allclose(result.energy.dissipated, solution[:, 5], rtol=0, atol=1e-8)


def test_guide_presses_on_the_slider_as_its_equation_of_moments_says() -> None:
    # expected: moments about the guide's pivot, from the accelerations of the two coordinates
    result = run(MECHANISM.model(START, RATES), gauss(6), end=2.0, step=0.01, every=10)
    force = np.asarray(result.joints["line"].reaction_force) @ [1, 1j]
    torque = result.joints["turn"].reaction_torque
    for k, (time, row) in enumerate(zip(TIMES, MECHANISM.solve(START, RATES, TIMES), strict=True)):
        across, turn = MECHANISM.pressure(time, row[:2], row[2:4])
        assert force[k] == pytest.approx(across, rel=0, abs=1e-7)
        assert torque[k] == pytest.approx(turn, rel=0, abs=1e-8)
