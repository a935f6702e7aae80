"""Closed loops: four-bar linkages in absolute coordinates against the same linkages in one coordinate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.slow_cases import slow_but

from .four_bar import FourBar, Link, Spring
from .running import gauss, run

#: Links with almost no inertia about their own centre: the mass matrix spans thirteen decades.
LIGHT = FourBar(
    ground=((0.0, 0.0), (1.0, 0.2)),
    crank=Link.uniform(0.5, 1.0, 1e-13),
    coupler=Link.uniform(1.1, 1.5, 1e-13),
    follower=Link.uniform(0.9, 1.2, 1e-13),
)
#: Centres of mass off the lines of the pins, body frames turned, a spring-damper and a damped coupler.
SPRUNG = FourBar(
    ground=((0.1, -0.1), (1.1, 0.2)),
    crank=Link(1.0, 0.03, ((-0.2, 0.05), (0.3, 0.1))),
    coupler=Link(1.5, 0.2, ((-0.4, 0.1), (0.7, -0.05))),
    follower=Link(1.2, 0.08, ((0.1, -0.4), (-0.05, 0.5))),
    springs=(Spring((0.2, 0.9), (0.1, 0.2), stiffness=40.0, damping=1.5, free_length=0.3),),
    damping=0.3,
)
START, END = 0.3, 2.0
TIMES = np.linspace(0.0, END, 21)
linkages = pytest.mark.parametrize("linkage", [LIGHT, SPRUNG], ids=["inertias of 1e-13", "sprung"])


METHODS: dict[str, tuple[dict[str, Any], float]] = {
    "rk4": ({"name": "rk4"}, 0.00025),
    "rk-gill": ({"name": "rk-gill"}, 0.00025),
    "gauss3": (gauss(3), 0.002),
    "gauss4": (gauss(4), 0.005),
    "gauss4-fixed-point": (gauss(4) | {"stage_solver": "fixed-point"}, 0.005),
}


@linkages
@pytest.mark.parametrize("name", slow_but(METHODS, *(name for name in METHODS if name not in ("rk-gill", "gauss4"))))
def test_a_four_bar_linkage_moves_as_in_its_minimal_coordinate_to_1e_9(linkage: FourBar, name: str) -> None:
    # expected: Eksergian's equation in the crank's angle by DOP853 at rtol 1e-13
    integrator, step = METHODS[name]
    result = run(linkage.model(START, 0.0), integrator, end=END, step=step, every=round(0.1 / step))
    np.testing.assert_allclose(result.time, TIMES, rtol=0, atol=1e-12)
    states = [linkage.state(phi, rate) for phi, rate, _ in linkage.solve(START, 0.0, TIMES)]
    for k, body in enumerate(("crank", "coupler", "follower")):
        expected = np.array([state.position[k] for state in states])
        np.testing.assert_allclose(result[body].position, expected, rtol=0, atol=1e-9)
        expected = np.unwrap([state.angle[k] for state in states])
        np.testing.assert_allclose(np.exp(1j * result[body].angle), np.exp(1j * expected), rtol=0, atol=1e-8)
        expected = np.array([state.angular_velocity[k] for state in states])
        np.testing.assert_allclose(result[body].angular_velocity, expected, rtol=0, atol=1e-7)


@linkages
def test_pin_forces_in_a_closed_loop_follow_newton_and_euler(linkage: FourBar) -> None:
    # expected: the nine equations of the three links, from the accelerations of the minimal coordinate
    result = run(linkage.model(START, 0.0), gauss(4), end=END, step=0.005, every=20)
    solution = linkage.solve(START, 0.0, TIMES)
    expected = np.array([linkage.pin_forces(phi, rate) for phi, rate, _ in solution])
    for k, joint in enumerate("ABCD"):
        np.testing.assert_allclose(result.joints[joint].reaction_force, expected[:, k], rtol=0, atol=1e-6)
        np.testing.assert_allclose(result.joints[joint].reaction_torque, 0.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("inertia", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-10, 1e-13])
def test_pin_forces_keep_ten_digits_however_small_the_inertias_are(inertia: float) -> None:
    # expected: the nine equations of the three links; the Schur complement alone would lose digits here
    links = (Link.uniform(0.5, 1.0, inertia), Link.uniform(1.1, 1.5, inertia), Link.uniform(0.9, 1.2, inertia))
    linkage = FourBar(LIGHT.ground, *links)
    result = run(linkage.model(START, 0.0), {"name": "rk4"}, end=1e-3, step=1e-3)
    expected = linkage.pin_forces(START, 0.0)
    for k, joint in enumerate("ABCD"):
        np.testing.assert_allclose(result.joints[joint].reaction_force[0], expected[k], rtol=0, atol=1e-9)


def test_energy_lost_in_the_dampers_of_a_linkage_is_booked() -> None:
    # expected: the dissipated energy, integrated by DOP853 beside the minimal coordinate
    result = run(SPRUNG.model(START, 0.0), gauss(4), end=END, step=0.005, every=20)
    lost = SPRUNG.solve(START, 0.0, TIMES)[:, 2]
    np.testing.assert_allclose(result.energy.dissipated, lost, rtol=0, atol=1e-8)
    np.testing.assert_allclose(result.energy.balance, 0.0, rtol=0, atol=1e-8)
