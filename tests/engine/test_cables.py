"""Cables over pulleys at joints: length, torque on each body, tangents and energy against formulas written by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.engine.kernels.table_rows import BODIES
from mbdkit.mechanism.mechanism import Mechanism
from tests.margins import assert_within

from .compiled import Compiled, assert_close, gradient

RADII = {"hip": 0.05, "knee": -0.03, "ankle": 0.08}
LENGTH, STIFFNESS, DAMPING, FREE = 1.1, 4e3, 60.0, 1.05


def leg(*, ground_first: bool = True) -> Mechanism:
    """Return thigh, shank and foot, hinged to the ground and to each other, at random angles and rates."""
    rng = np.random.default_rng(3)
    m = Mechanism()
    names = ["ground", "thigh", "shank", "foot"]
    places = [(0.0, 0.0), (0.1, -0.4), (0.0, -0.8), (0.1, -0.9)]
    for name, start, end in zip(names[1:], places, places[1:], strict=False):
        middle = tuple((np.array(start) + end) / 2)
        angle, spin = rng.normal(size=2)
        m.body(name, mass=2.0, inertia=0.1, position=middle, angle=angle, angular_velocity=spin)
    for name, first, second, place in zip(RADII, names, names[1:], places, strict=False):
        pair = (first, second) if ground_first else (second, first)
        m.revolute(name, *pair, at=place)
    return m


def cable(m: Mechanism, **options: Any) -> None:
    values = {"stiffness": STIFFNESS, "damping": DAMPING, "free_length": FREE, **options}
    m.cable("cable", RADII, law="linear", length=LENGTH, **values)


def weights(m: Mechanism) -> np.ndarray:
    """Return ds/dq (3 B + 3,): minus the sum of radius times change of joint angle, by hand."""
    row, number = np.zeros(3 * len(m.bodies) + 3), {name: i for i, name in enumerate([*m.bodies, "ground"])}
    for name, radius in RADII.items():
        a, b = m.joints[name].bodies
        row[3 * number[a] + 2] += radius
        row[3 * number[b] + 2] -= radius
    return row


@pytest.mark.parametrize("ground_first", [True, False])
def test_a_cable_turns_every_body_by_radius_times_tension(ground_first: bool) -> None:
    m = leg(ground_first=ground_first)
    cable(m)
    c, s_q = Compiled(m), weights(m)
    c.tangents()

    def stored(q: Any) -> Any:
        return STIFFNESS / 2 * (LENGTH + s_q @ q - FREE) ** 2

    expected = -gradient(stored, c.q) - DAMPING * (s_q @ c.v) * s_q
    assert_close(c.scratch.force[: c.n], expected[: c.n])
    work, lost = c.powers()
    assert_close(work, 0.0, size=1.0)
    assert_close(lost, DAMPING * (s_q @ c.v) ** 2)


def test_tangents_of_a_cable_couple_all_bodies_that_it_passes() -> None:
    # expected: K = k s_q^T s_q and C = c s_q^T s_q of the whole length
    m = leg()
    cable(m)
    c, s_q = Compiled(m), weights(m)
    c.tangents()
    for own, coupled, factor in (
        (c.scratch.spring_stiff, c.scratch.coupled_stiff, STIFFNESS),
        (c.scratch.spring_damp, c.scratch.coupled_damp, DAMPING),
    ):
        full = np.zeros((len(c.q), len(c.q)))
        blocks = [(k, k, one) for k, one in enumerate(own)]
        blocks += [(*pair, one) for pair, one in zip(c.top.couplings, coupled, strict=True)]
        for k, other, entries in blocks:
            rows, columns = ([3 * body + i for body in c.top.springs[x, BODIES] for i in range(3)] for x in (k, other))
            full[np.ix_(rows, columns)] += entries.reshape(6, 6)
        assert_close(full[: c.n, : c.n], factor * np.outer(s_q, s_q)[: c.n, : c.n])


@pytest.mark.parametrize(
    "method", [{"name": "gauss", "stages": 2}, {"name": "radau-iia", "stages": 3}, {"name": "rk4"}]
)
def test_the_recorded_cable_is_that_of_its_joint_angles_and_its_energy_balances(method: dict[str, Any]) -> None:
    m = leg()
    cable(m, damping=5.0)
    run = mbdkit.run(m, integrator=method, time={"end": 0.4, "step": 0.001}).check()
    force = run.forces["cable"]
    length = LENGTH - sum(radius * run.joints[name].angle for name, radius in RADII.items())
    assert force.units == "N"
    assert force.bodies == ("ground", "foot")
    np.testing.assert_allclose(force.length, length, rtol=1e-13)
    tension = STIFFNESS * (length - FREE) + 5.0 * force.rate
    np.testing.assert_allclose(force.value, tension, rtol=0, atol=1e-11 * np.max(abs(tension)))
    np.testing.assert_allclose(force.potential, STIFFNESS / 2 * (length - FREE) ** 2, rtol=1e-9, atol=1e-12)
    assert_within(run.energy.balance, 1e-7 * np.max(run.energy.kinetic))


def test_newton_converges_with_a_stiff_cable() -> None:
    # about 10 iterations a step; without the coupling terms it diverges. With 1e8 N/m, rounding errors of the matrix
    # decide how many there are (11 to 18 a step).
    m = leg()
    m.cable("cable", RADII, law="linear", length=LENGTH, stiffness=1e7, damping=1e4, free_length=LENGTH + 1e-3)
    run = mbdkit.run(m, integrator={"name": "radau-iia", "stages": 2}, time={"end": 0.02, "step": 1e-3}).check()
    assert run.stats["newton_iterations"] <= 15 * run.stats["steps"]


def test_the_symbolic_equations_contain_the_cable() -> None:
    m = leg()
    m.cable("cable", RADII, stiffness=STIFFNESS, length=LENGTH, free_length=FREE, acts="tension")
    c = Compiled(m)
    acc, _ = c.accelerations()
    for numbers in (True, False):
        found = m.to_sympy(numbers=numbers).evaluate(0.0, c.q[: c.n], c.v[: c.n])
        assert_close(found["accelerations"], acc, tolerance=1e-10)
