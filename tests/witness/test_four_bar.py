"""Closed loops: four-bar linkages in absolute coordinates against the same linkages in one coordinate."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import pytest

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


def _closed(linkage: FourBar, phi: Any) -> tuple[list[Any], list[Any]]:
    """Return the links' centres and their frames' directions as complex numbers, from two intersecting circles."""
    fixed_a, fixed_d = (mpmath.mpc(*point) for point in linkage.ground)
    lines = [mpmath.mpc(*link.pins[1]) - mpmath.mpc(*link.pins[0]) for link in linkage.links]
    crank, coupler, follower = (abs(line) for line in lines)
    pin_b = fixed_a + crank * mpmath.expj(phi)
    gap = abs(fixed_d - pin_b)
    along = (gap**2 + coupler**2 - follower**2) / (2 * gap)
    across = linkage.branch * mpmath.sqrt(coupler**2 - along**2)
    pin_c = pin_b + (fixed_d - pin_b) / gap * mpmath.mpc(along, across)
    ends = [(fixed_a, pin_b), (pin_b, pin_c), (fixed_d, pin_c)]
    turns = [(end - start) / line for (start, end), line in zip(ends, lines, strict=True)]
    centres = [
        start - turn * mpmath.mpc(*link.pins[0])
        for (start, _), turn, link in zip(ends, turns, linkage.links, strict=True)
    ]
    return centres, turns


def _inertia_and_potential(linkage: FourBar, phi: Any) -> tuple[Any, Any]:
    """Return I(phi) and the potential of gravity and springs; derivatives by mpmath's differences in 25 digits."""

    def slope(k: int, which: int) -> Any:
        real = mpmath.diff(lambda angle: _closed(linkage, angle)[which][k].real, phi)
        return mpmath.mpc(real, mpmath.diff(lambda angle: _closed(linkage, angle)[which][k].imag, phi))

    centres, turns = _closed(linkage, phi)
    inertia = sum(
        link.mass * abs(slope(k, 0)) ** 2 + link.inertia * abs(slope(k, 1)) ** 2 for k, link in enumerate(linkage.links)
    )
    potential = sum(
        link.mass * linkage.gravity * centre.imag for link, centre in zip(linkage.links, centres, strict=True)
    )
    for spring in linkage.springs:
        end = centres[1] + turns[1] * mpmath.mpc(*spring.coupler)
        length = abs(end - mpmath.mpc(*spring.ground))
        potential += spring.stiffness * (length - spring.free_length) ** 2 / 2
    return inertia, potential


@linkages
@pytest.mark.parametrize("phi", [0.3, -0.5, -1.0])
def test_yardstick_equation_of_motion_agrees_with_25_digit_differences(linkage: FourBar, phi: float) -> None:
    # expected: I, dI/dphi and -dV/dphi by numerical differentiation of the closed loop in complex numbers
    with mpmath.workdps(25):
        inertia = _inertia_and_potential(linkage, phi)[0]
        slope = mpmath.diff(lambda angle: _inertia_and_potential(linkage, angle)[0], phi)
        force = -mpmath.diff(lambda angle: _inertia_and_potential(linkage, angle)[1], phi)
    np.testing.assert_allclose(
        linkage.equation(phi), [float(inertia), float(slope), float(force)], rtol=1e-13, atol=1e-13
    )


def test_yardstick_motion_agrees_with_the_quadrature_of_the_energy_integral_to_1e_13() -> None:
    # expected: t = int sqrt(I / (2 (E - V))) dphi in 25 digits, phi = phi0 - u^2 to take the singular start out
    state = LIGHT.solve(START, 0.0, np.array([0.5]))[0]
    with mpmath.workdps(25):
        energy = _inertia_and_potential(LIGHT, mpmath.mpf(START))[1]

        def integrand(u: Any) -> Any:
            inertia, potential = _inertia_and_potential(LIGHT, START - u**2)
            return 2 * u * mpmath.sqrt(inertia / (2 * (energy - potential)))

        last = mpmath.sqrt(mpmath.mpf(START) - mpmath.mpf(float(state[0])))
        time = mpmath.quad(integrand, [0, last / 2, last], maxdegree=4, method="gauss-legendre")
    assert float(time.real) == pytest.approx(0.5, rel=0, abs=1e-13)


@linkages
def test_yardstick_energy_is_constant_but_for_the_dampers(linkage: FourBar) -> None:
    # expected: conservation of energy; the dissipated energy is integrated beside the motion
    solution = linkage.solve(START, 0.0, TIMES)
    energies = np.array([linkage.energy(phi, rate) for phi, rate, _ in solution])
    np.testing.assert_allclose(energies + solution[:, 2], energies[0], rtol=1e-12)
    assert (np.ptp(energies) > 0.5) == bool(linkage.damping)


@linkages
def test_yardstick_motion_keeps_clear_of_dead_centres_and_its_pin_forces_are_consistent(linkage: FourBar) -> None:
    # expected: nine equations of Newton and Euler in eight unknown forces have a solution, or `pin_forces` raises
    for phi, rate, _ in linkage.solve(START, 0.0, TIMES):
        assert linkage.transmission(phi) > 0.3
        assert np.isfinite(linkage.pin_forces(phi, rate)).all()


METHODS: dict[str, tuple[dict[str, Any], float]] = {
    "rk4": ({"name": "rk4"}, 0.00025),
    "rk-gill": ({"name": "rk-gill"}, 0.00025),
    "gauss3": (gauss(3), 0.002),
    "gauss4": (gauss(4), 0.005),
    "gauss4-fixed-point": (gauss(4) | {"stage_solver": "fixed-point"}, 0.005),
}


@linkages
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in ("rk-gill", "gauss4") else []) for name in METHODS]
)
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
