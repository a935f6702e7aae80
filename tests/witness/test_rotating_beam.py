"""Vibrations of a beam that rotates with a driven hub, in its plane: frequencies from runs, beside published values."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

import mbdkit
from tests.margins import assert_within

from .rotating_beam import RotatingBeam

FLAPWISE = {2.0: 4.1373, 4.0: 5.5850, 6.0: 7.3603, 8.0: 9.2568, 10.0: 11.2023}
"""Lowest frequency of a slender beam out of its plane of rotation by the speed, both in sqrt(EI / rho A) / L^2."""

CHORDWISE = {2.0: 3.6195, 4.0: 3.8880, 6.0: 4.2393, 8.0: 4.6105, 10.0: 4.9700}
"""The same in its plane of rotation for EA L^2 / EI = 70^2; both as in table 2 of S. M. Hamza Cherif and A. Houmat,
Natural frequencies of rotating cantilever flexible beams by using the p-version of the finite element method, 24th
International Congress of the Aeronautical Sciences (2004)."""

STEP = 0.01
THICK = RotatingBeam(1.0, 70.0**2, 2000.0, 1.0, 1.0, 1 / 70.0**2)
SLENDER = RotatingBeam(1.0, 1e5, 1e5, 1.0, 1.0, 1e-5)


@pytest.mark.parametrize("omega", CHORDWISE)
def test_the_witness_has_the_published_frequencies(omega: float) -> None:
    # expected: the tables; in a slender beam, centrifugal forces lower the square by that of the speed in the plane
    hardly_shears = RotatingBeam(1.0, 70.0**2, 1e6, 1.0, 1.0, 1e-8)
    found = hardly_shears.frequencies(omega, 1, small_strains=True)
    # margin: digits of the publication; the rounding of eigenvalues is 1e-6
    np.testing.assert_allclose(found, CHORDWISE[omega], rtol=0, atol=8e-5)
    slender = SLENDER.frequencies(omega, 1) ** 2 + omega**2
    np.testing.assert_allclose(np.sqrt(slender), FLAPWISE[omega], rtol=5 * omega**2 / SLENDER.axial)


def swinging(beam: RotatingBeam, omega: float, elements: int, nodes: Literal[2, 3], end: float = 8.0) -> np.ndarray:
    """Return how the tip moves across the hub's direction after it has been let go of, slightly bent, (T,)."""
    count = elements * (nodes - 1) + 1
    s = np.linspace(0.0, 1.0, count)
    shape = np.array([6 * s**2 - 4 * s**3 + s**4, 12 * s - 12 * s**2 + 4 * s**3])  # of a constant load, and its slope
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.beam(
        "arm", a=(0, 0), b=(beam.length, 0), elements=elements, nodes=nodes, mass_per_length=beam.mass,
        rotary_inertia=beam.inertia, angular_velocity=omega,
        stiffness={"axial": beam.axial, "shear": beam.shear, "bending": beam.bending},
        start=np.column_stack([beam.radius(s, omega), *(3e-5 * shape)]).tolist(),
    )  # fmt: skip
    m.revolute("hub", m.ground, "arm.0", at=(0, 0))
    m.driver("motor", m.ground, "arm.0", coordinate="angle", motion=f"{omega}*t")
    run = mbdkit.run(m, integrator={"name": "gauss", "stages": 3}, time={"end": end, "step": STEP})
    run.check()
    tip, angle = run[f"arm.{count - 1}"].position, run["arm.0"].angle
    return np.asarray(np.cos(angle) * tip[:, 1] - np.sin(angle) * tip[:, 0])


def loudest(motion: np.ndarray, count: int) -> np.ndarray:
    """Return the frequencies of a sum of oscillations, that of the largest amplitude first [rad/s].

    By the matrix pencil: Y. Hua and T. K. Sarkar, IEEE Transactions on Acoustics, Speech and Signal Processing 38
    (1990). Four oscillations are fitted.
    """
    half = len(motion) // 2
    rows = np.lib.stride_tricks.sliding_window_view(motion, half + 1)
    space = np.linalg.svd(rows, full_matrices=False)[2][:8].T
    rates = np.log(np.linalg.eigvals(np.linalg.lstsq(space[:-1], space[1:], rcond=None)[0])) / STEP
    waves = np.exp(np.outer(STEP * np.arange(len(motion)), rates))
    size = np.where(rates.imag > 0, np.abs(np.linalg.lstsq(waves, motion, rcond=None)[0]), 0.0)
    return np.asarray(rates[np.argsort(-size)[:count]].imag)


@pytest.mark.parametrize(("nodes", "sizes", "most"), [(2, (8, 16), 2e-3), (3, (4, 8), 2e-4)])
def test_frequencies_of_a_rotating_beam_converge_with_the_order_of_the_element(
    nodes: Literal[2, 3], sizes: tuple[int, int], most: float
) -> None:
    # expected: Reissner's equations, linearised about the steady rotation, by Chebyshev collocation
    exact = THICK.frequencies(2.0, 2)
    coarse, fine = (loudest(swinging(THICK, 2.0, n, nodes), 2) / exact - 1 for n in sizes)
    # margin: order, from errors of mbdkit alone
    np.testing.assert_allclose(np.log2(coarse / fine), 2 * (nodes - 1), rtol=0, atol=0.18)
    assert_within(fine, most)  # margin: error of these elements


@pytest.mark.parametrize("omega", [pytest.param(2.0, marks=pytest.mark.slow), 10.0])
def test_a_slender_rotating_beam_has_the_published_frequency(omega: float) -> None:
    # expected: the table, in the plane of rotation; the stretch of this beam is of the order of omega^2 / EA
    found = loudest(swinging(SLENDER, omega, 8, 3), 1)
    np.testing.assert_allclose(np.hypot(found, omega), FLAPWISE[omega], rtol=5 * omega**2 / SLENDER.axial)
