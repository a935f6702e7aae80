"""Beams in large deflection, by `equilibrium`: published cases, extrapolated over meshes, beside their exact solutions.

Two cases are those of J. Gerstmayr's Exudyn (`geometricallyExactBeam2Dtest.py` and the example of `ObjectANCFCable2D`),
with the deflections that Exudyn publishes for one mesh; the third one is Mattiasson's table of the elastica.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

import mbdkit

from .extrapolation import limit
from .reissner import Cantilever

DIAGONAL = np.sqrt(0.5)


def clamped(
    end: tuple[float, float],
    elements: int,
    nodes: Literal[2, 3],
    stiffness: tuple[float, float, float],
    gravity: float = 0.0,
    **more: Any,
) -> tuple[mbdkit.Mechanism, str]:
    """Return a beam of 78 kg/m that is clamped at the origin, and the name of the node at its free end."""
    m = mbdkit.Mechanism(gravity=(0.0, -gravity))
    given = dict(zip(("axial", "shear", "bending"), stiffness, strict=True))
    names = m.beam(
        "link", a=(0, 0), b=end, elements=elements, nodes=nodes, stiffness=given, mass_per_length=78.0, **more
    )
    m.weld("clamp", m.ground, names[0], at=(0, 0))
    return m, names[-1]


def moved(m: mbdkit.Mechanism, node: str) -> np.ndarray:
    """Return displacement and rotation of a node in equilibrium."""
    body = m.bodies[node]
    return np.asarray(mbdkit.equilibrium(m)[node] - (*body.position, body.angle))


DEEP = Cantilever(2.0, 2.07e11 * 0.05, 10 * 1.3 / (12 + 11 * 0.3) * 7.9615e10 * 0.05, 2.07e11 * 0.1 * 0.5**3 / 12)
"""A beam of steel, 2 m x 0.1 m x 0.5 m, with the shear factor of Cowper for Poisson's ratio 0.3."""


def deep(elements: int, nodes: Literal[2, 3]) -> np.ndarray:
    """Return the displacement of the deep beam, 45 degrees steep, under a force across it and a moment."""
    m, end = clamped((2 * DIAGONAL, 2 * DIAGONAL), elements, nodes, (DEEP.axial, DEEP.shear, DEEP.bending))
    force = 5e8 * 0.5**3 * DIAGONAL
    m.force("load", end, value=(force, -force))
    m.torque("moment", end, value=-5e8)
    return moved(m, end)


def test_exudyns_deep_beam_on_its_own_mesh() -> None:
    # expected: the deflection published with Exudyn's test, on 16 two-node elements
    assert deep(16, 2)[1] == pytest.approx(-2.211502835379855, abs=1e-9)


STRIP = Cantilever(2.0, 1e6, np.inf, 2500 / 3)
"""A soft strip without shear, which its weight of 78 kg/m bends far."""


def sagging(sizes: tuple[int, ...], nodes: Literal[2, 3], shear: float) -> np.ndarray:
    """Return the displacement of the strip under its weight, without error of the mesh."""
    strips = (clamped((2.0, 0.0), n, nodes, (STRIP.axial, shear, STRIP.bending), gravity=9.81) for n in sizes)
    return limit([moved(*one) for one in strips], 2 * (nodes - 1))


def test_a_strip_under_its_weight_is_an_extensible_elastica() -> None:
    # expected: the boundary value problem, which Exudyn's published deflection of 32 cable elements confirms
    exact = STRIP.under((0.0, 0.0), load=(0.0, -78.0 * 9.81))
    # margin: digits of the publication
    np.testing.assert_allclose(exact[:2], [-0.501305847, -1.2325100631], rtol=0, atol=1e-10)
    assert exact[0] == pytest.approx(-0.5013058140308901, abs=5e-8)  # margin: error of Exudyn's elements
    values = [sagging((8, 16, 32), 3, factor * STRIP.axial) for factor in (20.0, 40.0)]  # proportional to 1/GA
    np.testing.assert_allclose(limit(values, 1), exact, rtol=0, atol=9e-10)


def elastica(load: float) -> np.ndarray:
    """Return deflection, shortening and angle of the tip of an inextensible cantilever under a load across it.

    In units of the length and the bending stiffness; by elliptic integrals, K. E. Bisshopp and D. C. Drucker, Large
    deflection of cantilever beams, Quarterly of Applied Mathematics 3 (1945).
    """

    def modulus(angle: float) -> tuple[float, float]:
        square = (1 + np.sin(angle)) / 2
        return square, np.arcsin(np.sqrt(0.5 / square))

    def excess(angle: float) -> float:
        square, start = modulus(angle)
        return float(ellipk(square) - ellipkinc(start, square) - np.sqrt(load))

    angle = brentq(excess, 1e-6, np.pi / 2 - 1e-9, xtol=1e-15)
    square, start = modulus(angle)
    deflection = 1 - 2 * (ellipe(square) - ellipeinc(start, square)) / np.sqrt(load)
    return np.array([deflection, 1 - np.sqrt(2 * np.sin(angle) / load), angle])


MATTIASSON = {
    1.0: (0.30172, 0.05643, 0.46135),
    2.0: (0.49346, 0.16064, 0.78175),
    5.0: (0.71379, 0.38763, 1.21537),
    10.0: (0.81061, 0.55500, 1.43029),
}
"""Deflection, shortening and angle of the tip by the load P L^2 / EI: K. Mattiasson, Numerical results from large
deflection beam and frame problems analysed by means of elliptic integrals, Int. J. Numer. Meth. Eng. 17 (1981)."""

EQUAL = 1e3
"""Axial and shear stiffness in EI / L^2. If they are equal, the angles are those of the elastica, and the tip moves in
the direction of the load by P L / EA more."""


@pytest.mark.parametrize("load", MATTIASSON)
def test_a_load_across_a_cantilever_bends_it_into_the_elastica(load: float) -> None:
    # expected: elliptic integrals, printed in Mattiasson's table
    exact = elastica(load)
    np.testing.assert_allclose(exact, MATTIASSON[load], rtol=0, atol=6e-6)  # margin: digits of the publication
    found = []
    for elements in (4, 8, 16, 32):
        m, end = clamped((1.0, 0.0), elements, 3, (EQUAL, EQUAL, 1.0))
        m.force("load", end, value=(0.0, load))
        x, y, angle = moved(m, end)
        found.append(np.array([y - load / EQUAL, -x, angle]))
    np.testing.assert_allclose(limit(found, 4), exact, rtol=0, atol=1e-10)
