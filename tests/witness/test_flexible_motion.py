"""Vibrations and large motions of beams, against Timoshenko's beam, rotating bars, and conservation laws."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest

import mbdkit
from tests.margins import assert_within

from .timoshenko import TimoshenkoBeam

#: A rectangular bar of steel, 1 m x 20 mm x 40 mm; its axial vibrations are faster than those looked at.
BAR = TimoshenkoBeam(1.0, 5.0e7, 2.2e4, 6.3, 8.4e-4)


#: A slender strip, of which shear and rotary inertia hardly matter.
STRIP = TimoshenkoBeam(1.0, 1e6, 1.0, 1.0, 1e-8)


def bar(
    elements: int, nodes: Literal[2, 3], ends: tuple[str, str], beam: TimoshenkoBeam = BAR, **more: Any
) -> mbdkit.Mechanism:
    """Return a bar on its supports."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": 3.4 * beam.shear, "shear": beam.shear, "bending": beam.bending}
    names = m.beam(
        "bar", a=(0, 0), b=(beam.length, 0), elements=elements, nodes=nodes, stiffness=stiffness,
        mass_per_length=beam.mass, rotary_inertia=beam.inertia, **more,
    )  # fmt: skip
    for side, node, x, end in zip("ab", (names[0], names[-1]), (0.0, beam.length), ends, strict=True):
        if end == "clamped":
            m.weld(f"end {side}", m.ground, node, at=(x, 0))
        elif end == "pinned":
            m.driver(f"end {side}", m.ground, node, coordinate="y", motion=0.0)
    if ends == ("pinned", "pinned"):
        m.driver("along", m.ground, names[0], coordinate="x", motion=0.0)
    return m


def bending(elements: int, nodes: Literal[2, 3], ends: tuple[str, str], count: int, **more: Any) -> np.ndarray:
    """Return the lowest frequencies of bending [rad/s], without motions of the bar as a whole."""
    found = mbdkit.modes(bar(elements, nodes, ends, **more), at="start", time={"end": 1.0, "step": 0.1})
    is_across = np.max(np.abs(found.shapes[:, :, 1]), axis=1) > 1e-3 * np.max(np.abs(found.shapes[:, :, 0]), axis=1)
    frequencies = found.natural_frequency[is_across]
    return np.asarray(frequencies[frequencies > 1.0][:count])


SUPPORTS = [("clamped", "free"), ("free", "free"), ("pinned", "pinned"), ("clamped", "clamped")]


@pytest.mark.parametrize("ends", SUPPORTS)
@pytest.mark.parametrize(("nodes", "sizes", "order", "most"), [(2, (16, 32), 2, 6e-3), (3, (8, 16), 4, 1e-4)])
def test_frequencies_converge_to_those_of_timoshenkos_beam(
    ends: tuple[str, str], nodes: Literal[2, 3], sizes: tuple[int, int], order: int, most: float
) -> None:
    # expected: roots of the determinant of the boundary value problem
    exact = BAR.frequencies(ends, 2)
    coarse, fine = (bending(n, nodes, ends, 2) / exact - 1 for n in sizes)
    # margin: order, from errors of mbdkit alone
    np.testing.assert_allclose(np.log2(coarse / fine), order, rtol=0, atol=0.13)
    assert_within(fine, most)  # margin: error of these elements


@pytest.mark.parametrize("ends", SUPPORTS)
def test_frequencies_of_corrected_elements_converge_with_order_four(ends: tuple[str, str]) -> None:
    # expected: roots of the determinant of the boundary value problem; without correction, the order is 2
    strip, plain = (beam.frequencies(ends, 2) for beam in (STRIP, BAR))
    coarse, fine = (bending(n, 2, ends, 2, beam=STRIP, corrected=True) / strip - 1 for n in (16, 32))
    assert np.max(np.abs(coarse)) > 12 * np.max(np.abs(fine))
    assert_within(fine, 5e-5)  # margin: error of these elements
    thick = bending(16, 2, ends, 2, corrected=True) / plain - 1
    assert_within(thick, 0.12 * np.max(np.abs(bending(16, 2, ends, 2) / plain - 1)))  # margin: error of these elements


@pytest.mark.parametrize(
    ("ends", "roots"),
    [
        (("clamped", "free"), (1.8751040687, 4.6940911330)),
        (("free", "free"), (4.7300407449, 7.8532046241)),
        (("pinned", "pinned"), (np.pi, 2 * np.pi)),
    ],
)
def test_the_witness_has_the_frequencies_of_slender_beams(ends: tuple[str, str], roots: tuple[float, float]) -> None:
    # expected: (root / L)^2 sqrt(EI / rho A) of the Euler-Bernoulli beam, with the roots of the textbooks
    slender = TimoshenkoBeam(2.0, 1e12, 3.0, 5.0, 1e-12)
    found = slender.frequencies(ends, 2)
    np.testing.assert_allclose(found, (np.array(roots) / 2.0) ** 2 * np.sqrt(3.0 / 5.0), rtol=1e-8)


def test_a_strip_of_spring_steel_is_stable_and_has_a_first_frequency() -> None:
    # expected: (1.8751/L)^2 sqrt(EI / rho A) of the Euler-Bernoulli beam, 1e-12 of the highest one of the mesh, squared
    length, width, thickness, young, density = 0.2, 20e-3, 0.3e-3, 2.07e11, 7850.0
    area, second = width * thickness, width * thickness**3 / 12
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.beam(
        "strip", a=(0, 0), b=(length, 0), elements=16, nodes=3, E=young, A=area, I=second, density=density,
        stiffness={"shear": "none"},
    )  # fmt: skip
    m.weld("clamp", m.ground, "strip.0", at=(0, 0))
    first = (1.8751040687 / length) ** 2 * np.sqrt(young * second / (density * area))
    assert mbdkit.modes(m).natural_frequency[0] == pytest.approx(first, rel=1e-4)
    found = mbdkit.equilibrium(m)
    assert found.stability == "stable"
    assert found.stiffness == pytest.approx(first**2, rel=1e-4)


AXIAL, OMEGA, LENGTH, MASS = 2.8e7, 6.0, 10.0, 1.2
"""Of the beam of Simo and Vu-Quoc (1986)."""


def stretched(s: np.ndarray) -> np.ndarray:
    """Return where the cross-sections of the beam are at constant speed: EA x'' = -rho A omega^2 x, x'(L) = 1."""
    k = OMEGA * np.sqrt(MASS / AXIAL)
    return np.asarray(np.sin(k * s) / (k * np.cos(k * LENGTH)))


STRETCH = float(stretched(np.array(LENGTH))) - LENGTH
"""Extension of the beam at constant speed, published as 5.14e-4 m."""


def spun(elements: int, angle: str, nodes: Literal[2, 3] = 3, damping: float = 1e-3, **more: Any) -> mbdkit.Mechanism:
    """Return the beam on its hub, which is driven."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.beam(
        "arm", a=(0, 0), b=(LENGTH, 0), elements=elements, nodes=nodes, mass_per_length=MASS, rotary_inertia=6e-4,
        stiffness={"axial": AXIAL, "shear": 1e7, "bending": 1.4e4}, damping=damping, **more,
    )  # fmt: skip
    m.revolute("hub", m.ground, "arm.0", at=(0, 0))
    m.driver("motor", m.ground, "arm.0", coordinate="angle", motion=angle)
    return m


def tip_of(run: mbdkit.Run) -> np.ndarray:
    """Return the displacement of the tip along and across the hub's direction, (T, 2)."""
    tip, root = run[run.beams["arm"].nodes[-1]].position, run["arm.0"].angle
    along = np.cos(root) * tip[:, 0] + np.sin(root) * tip[:, 1] - LENGTH
    return np.column_stack([along, np.cos(root) * tip[:, 1] - np.sin(root) * tip[:, 0]])


def extension_error(elements: int, nodes: Literal[2, 3], step: float, turns: int = 0) -> float:
    """Return the relative error of the extension after 0.4 s, after a start at constant speed, without vibration."""
    phase = 2 * np.pi * turns
    places = stretched(np.linspace(0, LENGTH, elements * (nodes - 1) + 1))
    start = [(x, 0.0, phase) for x in places.tolist()]
    m = spun(elements, f"{phase!r} + {OMEGA}*t", nodes, start=start, angular_velocity=OMEGA)
    run = mbdkit.run(m, integrator={"name": "gauss", "stages": 2}, time={"end": 0.4, "step": step})
    run.check()
    return float(tip_of(run)[-1, 0] / STRETCH - 1)


@pytest.mark.parametrize("turns", [0, 300])
def test_rotation_stretches_a_beam_after_any_number_of_turns(turns: int) -> None:
    # expected: the closed form, approached with the order of the method
    coarse, fine = (extension_error(4, 3, step, turns) for step in (0.005, 0.0025))
    assert np.log2(coarse / fine) == pytest.approx(4.0, abs=0.15)
    assert_within(fine, 5e-6)  # margin: error of mbdkit's method at these steps


STATE = [(6.0 - 0.6 * s + 0.02 * s * (10 - s), 0.8 * s, 2.2 - 0.03 * s) for s in range(11)]
"""A bent rod at rest."""


def momenta(run: mbdkit.Run, m: mbdkit.Mechanism) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the masses of the nodes (B,), and the linear (T, 2) and the angular momentum (T,) about the origin."""
    mass, inertia = (np.array([getattr(x, what) for x in m.bodies.values()]) for what in ("mass", "inertia"))
    q, v = (run.array(f"trajectory/{what}") for what in ("position", "velocity"))
    angular = np.sum(mass * (q[:, :, 0] * v[:, :, 1] - q[:, :, 1] * v[:, :, 0]) + inertia * v[:, :, 2], axis=1)
    return mass, np.einsum("b,tbx->tx", mass, v[:, :, :2]), angular


def until_2_5(value: float) -> dict[str, Any]:
    """Return a value that falls to zero at 2.5 s, within a nanosecond."""
    return {"table": [[0, 2.5 - 5e-10, 2.5 + 5e-10, 100], [value, value, 0, 0]], "interpolation": "linear"}


@pytest.mark.parametrize("stages", [2, 3])
def test_a_beam_in_free_flight_keeps_its_momenta_and_energy(stages: int) -> None:
    # expected: linear and angular momentum, quadratic in the state, to rounding; the energy with the order 2 s of Gauss
    loss = []
    for step in (0.005, 0.0025):
        m = mbdkit.Mechanism(gravity=(0.0, 0.0))
        m.beam(
            "rod", a=(6, 0), b=(0, 8), elements=10, mass_per_length=1.0, rotary_inertia=10.0, start=STATE,
            stiffness={"axial": 1e4, "shear": 1e4, "bending": 500.0}, velocity=(2.0, 1.0), angular_velocity=1.0,
        )  # fmt: skip
        run = mbdkit.run(m, integrator={"name": "gauss", "stages": stages}, time={"end": 1.0, "step": step})
        run.check()
        _, momentum, angular = momenta(run, m)
        np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(momentum), 1)), rtol=0, atol=1e-11)
        np.testing.assert_allclose(angular, angular[0], rtol=1e-12)
        total = run.energy.total
        loss.append(np.max(np.abs(total - total[0])) / total[0])
        assert np.ptp(run.beams["rod"].strain_energy) > 0.1 * total[0]
    assert np.log2(loss[0] / loss[1]) == pytest.approx(2 * stages, abs=0.2)


@pytest.mark.parametrize("bending", [500.0, 100.0])
def test_the_flying_spaghetti_keeps_what_its_loads_gave_it(bending: float) -> None:
    # expected: 8 N for 2.5 s on 10 kg from (3, 4): the path of the centre of mass, and all of the motion afterwards
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.beam(
        "rod", a=(6, 0), b=(0, 8), elements=16, mass_per_length=1.0, rotary_inertia=10.0,
        stiffness={"axial": 1e4, "shear": 1e4, "bending": bending},
    )  # fmt: skip
    m.force("push", "rod.0", value=(until_2_5(8.0), 0.0))
    m.torque("twist", "rod.0", value=until_2_5(-80.0))
    loss = []
    for step in (0.002, 0.001):
        run = mbdkit.run(m, integrator={"name": "gauss", "stages": 2}, time={"end": 7.5, "step": step})
        run.check()
        t, after = run.time, run.time > 2.5 + step / 2
        mass, momentum, angular = momenta(run, m)
        path = np.where(t < 2.5, 3 + 0.4 * t**2, 5.5 + 2 * (t - 2.5))
        np.testing.assert_allclose(mass @ run.array("trajectory/position")[:, :, 0].T / 10, path, rtol=0, atol=1e-9)
        np.testing.assert_allclose(mass @ run.array("trajectory/position")[:, :, 1].T / 10, 4.0, rtol=0, atol=1e-9)
        np.testing.assert_allclose(momentum, np.outer(np.minimum(8 * t, 20), (1, 0)), rtol=0, atol=4e-9)
        np.testing.assert_allclose(angular[after], angular[after][0], rtol=1e-11)
        loss.append(np.ptp(run.energy.total[after]) / run.energy.total[-1])
    assert np.log2(loss[0] / loss[1]) == pytest.approx(4.0, abs=0.3)
