"""Cantilevers in large deflection, by `equilibrium`, against Reissner's equations solved by SciPy, and closed forms.

The first case is that of J. Gerstmayr's ANCF examples: length 2 m, a square section of 0.1 m, E = 2.07e11 Pa, and the
force 3 EI / L^2 at the tip, across the unloaded beam.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.slow_cases import slow_but

from .extrapolation import limit
from .reissner import Cantilever

LENGTH = 2.0
AXIAL, BENDING = 2.07e11 * 0.01, 2.07e11 * 0.1**4 / 12
SHEAR = 5 / 6 * 7.9615e10 * 0.01
FORCE = (0.0, -3 * BENDING / LENGTH**2)

#: Tip displacement without shear: extensible elastica, as published with Exudyn's `ANCFcantileverTest`, in 12 digits.
WITHOUT_SHEAR = (-0.508537304326, -1.207239854550)


def cantilever(elements: int, nodes: int, *, shear: float = SHEAR, **more: Any) -> mbdkit.Mechanism:
    """Return the cantilever without load."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": AXIAL, "shear": shear, "bending": BENDING}
    m.beam(
        "link",
        a=(0, 0),
        b=(LENGTH, 0),
        elements=elements,
        nodes=nodes,
        stiffness=stiffness,
        mass_per_length=78.0,
        **more,
    )
    m.weld("clamp", m.ground, "link.0", at=(0, 0))
    return m


def tip(m: mbdkit.Mechanism) -> np.ndarray:
    """Return displacement and rotation of the last node in equilibrium."""
    found = mbdkit.equilibrium(m)
    return found.position[-1] - (LENGTH, 0.0, 0.0)


@cache
def deflection(elements: int, nodes: int, shear: float = SHEAR) -> tuple[float, float, float]:
    """Return the deflection of the tip under the force."""
    m = cantilever(elements, nodes, shear=shear)
    m.force("load", f"link.{elements * (nodes - 1)}", value=FORCE)
    x, y, angle = tip(m).tolist()
    return x, y, angle


def extrapolated(nodes: int, sizes: tuple[int, ...], shear: float = SHEAR) -> np.ndarray:
    """Return the limit of the deflection on finer and finer meshes."""
    return limit([np.array(deflection(n, nodes, shear)) for n in sizes], 2 * (nodes - 1))


@cache
def reissner() -> np.ndarray:
    """Return the deflection by the boundary value problem."""
    return Cantilever(LENGTH, AXIAL, SHEAR, BENDING).under(FORCE)


MESHES = [(2, (8, 16, 32, 64)), (3, (4, 8, 16, 32))]
"""Nodes of an element, and numbers of elements."""


@pytest.mark.parametrize("elements", [2, 3, 5])
def test_small_deflections_of_corrected_elements_are_exact(elements: int) -> None:
    # expected: P L^3/3 EI + P L/GA and P L^2/2 EI under a load at the tip; w L^4/8 EI + w L^2/2 GA and w L^3/6 EI under
    # a distributed one; both so small that squares of angles are 1e-12
    shear, length, bending = 1e5, LENGTH, BENDING
    m = cantilever(elements, 2, shear=shear, corrected=True)
    point = 1e-6 * bending / length**2
    m.force("load", f"link.{elements}", value=(0.0, point))
    expected = point * length**3 / (3 * bending) + point * length / shear, point * length**2 / (2 * bending)
    np.testing.assert_allclose(tip(m)[1:], expected, rtol=1e-9)
    spread = point / length
    m = cantilever(elements, 2, shear=shear, corrected=True, load=(0.0, spread))
    expected = spread * length**4 / (8 * bending) + spread * length**2 / (2 * shear), spread * length**3 / (6 * bending)
    np.testing.assert_allclose(tip(m)[1:], expected, rtol=1e-9)


@pytest.mark.parametrize(("nodes", "sizes"), MESHES)
def test_the_deflection_converges_to_reissners_beam_with_the_order_of_the_element(
    nodes: int, sizes: tuple[int, ...]
) -> None:
    # expected: Reissner's equations as a boundary value problem
    exact = reissner()
    errors = [np.linalg.norm(np.array(deflection(n, nodes)) - exact) for n in sizes]
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2 * (nodes - 1), rtol=0, atol=0.1)
    np.testing.assert_allclose(extrapolated(nodes, sizes), exact, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("nodes", "sizes"), slow_but(MESHES, MESHES[1]))
def test_without_shear_it_converges_to_the_extensible_elastica(nodes: int, sizes: tuple[int, ...]) -> None:
    # expected: published digits; the effect of shear is proportional to 1/GA, and a second one about 2e-10
    without = limit([extrapolated(nodes, sizes, factor * AXIAL) for factor in (20.0, 40.0)], 1)
    np.testing.assert_allclose(without[:2], WITHOUT_SHEAR, rtol=0, atol=4e-10)  # margin: digits of the publication


def test_shear_none_is_a_stiffness_that_hardly_matters() -> None:
    # expected: 1e-6 of the deflection, as the reference of `shear` states
    m = cantilever(16, 3, shear="none")
    m.force("load", "link.32", value=FORCE)
    np.testing.assert_allclose(tip(m)[:2], WITHOUT_SHEAR, rtol=3e-6, atol=0)


@pytest.mark.parametrize("nodes", [2, 3])
def test_a_moment_bends_a_beam_into_a_closed_circle(nodes: int) -> None:
    # expected: a constant curvature, so that the angles of the nodes are even and their polygon is closed
    m = cantilever(8, nodes)
    m.torque("moment", list(m.bodies)[-1], value=2 * np.pi * BENDING / LENGTH)
    found = mbdkit.equilibrium(m)
    even = np.linspace(0, 2 * np.pi, len(found.bodies))
    np.testing.assert_allclose(found.position[:, 2], even, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.position[-1, :2], 0.0, rtol=0, atol=1e-10)
