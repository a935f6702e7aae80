"""Buckling and snap-through of beams, against Euler's loads, the elastica, and an arch as a boundary value problem."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import PPoly, make_interp_spline
from scipy.optimize import brentq
from scipy.special import ellipk

import mbdkit

from .reissner import Arch

EQUAL = 1e3
"""Axial and shear stiffness in EI / L^2. If they are equal, they do not change Euler's loads: a force then stretches
the column along itself only, whatever the angle of a cross-section, and the moment depends on the angles alone."""


def column(elements: int = 16, **more: Any) -> mbdkit.Mechanism:
    """Return a column of unit length and bending stiffness along the x axis, clamped at the origin."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": EQUAL, "shear": EQUAL, "bending": 1.0}
    m.beam("column", a=(0, 0), b=(1, 0), elements=elements, nodes=3, stiffness=stiffness, mass_per_length=1.0, **more)
    m.weld("foot", m.ground, "column.0", at=(0, 0))
    return m


def top(m: mbdkit.Mechanism) -> str:
    """Return the name of the last node."""
    return m.beams["column"].node_names("column")[-1]


def test_a_column_buckles_at_eulers_load() -> None:
    # expected: pi^2 EI / (2 L)^2; the lateral stiffness vanishes there, and the column bends at its free end
    m = column()
    m.force("load", top(m), value=("-3*t", 0.0))
    path = mbdkit.equilibrium_path(m)
    assert [point.kind for point in path.critical] == ["bifurcation"]
    assert 3 * path.critical[0].time == pytest.approx(np.pi**2 / 4, rel=1e-6)
    assert path.critical[0].body == top(m)
    assert path.stiffness[0] > 0 > path.stiffness[-1]


@pytest.mark.parametrize("angle", [60.0, 120.0])
def test_a_buckled_column_carries_the_load_of_the_elastica(angle: float) -> None:
    # expected: P L^2 / EI = K(sin(angle/2))^2 where the top is turned by `angle` (Euler 1744); the load is found at
    # which no torque is needed to hold that angle
    turn = np.radians(angle)

    def torque(load: float) -> float:
        at = np.linspace(0, turn, 33)[1:]
        arc = np.column_stack([np.sin(at), 1 - np.cos(at), turn * at]) / turn
        m = column(start=[(0, 0, 0), *arc.tolist()])
        m.driver("turn", m.ground, top(m), coordinate="angle", motion=turn)
        m.force("load", top(m), value=(-load, 0.0))
        found = mbdkit.equilibrium(m)
        return float(found.reaction_torque[found.joints.index("turn")])

    exact = ellipk(np.sin(turn / 2) ** 2) ** 2
    assert brentq(torque, 0.98 * exact, 1.02 * exact, xtol=1e-8) == pytest.approx(exact, rel=1e-6)


ARCH = Arch(span=2.0, rise=0.06, axial=1e6, shear=4e5, bending=50.0)


def arch(elements: int) -> mbdkit.Mechanism:
    """Return the arch between its clamps."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    angles = ARCH.half_angle * np.linspace(1, -1, 41)
    points = ARCH.radius * np.column_stack([-np.sin(angles), np.cos(angles) - np.cos(ARCH.half_angle)])
    stiffness = {"axial": ARCH.axial, "shear": ARCH.shear, "bending": ARCH.bending}
    nodes = m.beam("arch", points=points, elements=elements, nodes=3, stiffness=stiffness, mass_per_length=1.0)
    for side, node, x in (("left", nodes[0], -1.0), ("right", nodes[-1], 1.0)):
        m.weld(side, m.ground, node, at=(x, 0.0))
    return m


def test_a_shallow_arch_snaps_through_at_its_limit_point_and_is_followed_beyond() -> None:
    # expected: the extremes of the load as a function of the depth of its crown, by the boundary value problem
    depths = np.linspace(0.003, 0.13, 40)
    load = PPoly.from_spline(make_interp_spline(depths, ARCH.load(depths), k=5))
    highest, lowest = np.sort([load(x) for x in load.derivative().roots(extrapolate=False)])[::-1]
    limits = []
    for elements in (12, 24):
        m = arch(elements)
        m.force("load", f"arch.{elements}", value=(0.0, "-100*t"))
        path = mbdkit.equilibrium_path(m)
        assert [(point.kind, point.body) for point in path.critical] == [("limit point", f"arch.{elements}")] * 2
        assert path.time[-1] == 1.0
        assert load(ARCH.rise - path[f"arch.{elements}"][-1, 1]) == pytest.approx(100.0, rel=2e-3)
        np.testing.assert_allclose(path.reaction_force[-1].sum(axis=0), [0.0, 100.0], rtol=0, atol=1e-6)
        limits.append([100 * point.time for point in path.critical])
    coarse, fine = np.array(limits)
    np.testing.assert_allclose(fine, [highest, lowest], rtol=1e-4)
    np.testing.assert_allclose(fine + (fine - coarse) / 15, [highest, lowest], rtol=5e-6)  # errors have order 4
