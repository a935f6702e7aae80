"""Buckling and snap-through of beams, against Euler's loads, the elastica, and an arch as a boundary value problem."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PPoly, make_interp_spline
from scipy.optimize import brentq
from scipy.special import ellipj, ellipk

import mbdkit
from tests.slow_cases import slow, slow_but

from .extrapolation import limit
from .reissner import Arch

EQUAL = 1e3
"""Axial and shear stiffness in EI / L^2. If they are equal, they do not change Euler's loads: a force then stretches
the column along itself only, whatever the angle of a cross-section, and the moment depends on the angles alone."""


def column(elements: int = 16, *, is_clamped: bool = True, **more: Any) -> mbdkit.Mechanism:
    """Return a column of unit length and bending stiffness along the x axis, clamped at the origin by default."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": EQUAL, "shear": EQUAL, "bending": 1.0}
    m.beam("column", a=(0, 0), b=(1, 0), elements=elements, nodes=3, stiffness=stiffness, mass_per_length=1.0, **more)
    if is_clamped:
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


def _tangent(share: float) -> list[float]:
    """Return the lowest loads P with tan(x) = x (1 - P/EQUAL) where x = share sqrt(P), in (k pi, (k + 1/2) pi)."""
    found = []
    for k in (1, 2, 3):
        root = brentq(
            lambda x: np.sin(x) - x * (1 - (x / share) ** 2 / EQUAL) * np.cos(x), k * np.pi, (k + 0.5) * np.pi
        )
        found.append((root / share) ** 2)
    return found


PINNED = [(k * np.pi) ** 2 for k in (1, 2, 3)]
BUCKLING = {
    "free": [((2 * k - 1) * np.pi / 2) ** 2 for k in (1, 2, 3)],
    "pinned": PINNED,
    # the force across the column shears and stretches it: y(L) = integral of theta + F / EQUAL = 0
    "clamped and pinned": _tangent(1.0),
    "clamped": [4 * PINNED[0], _tangent(0.5)[0], 4 * PINNED[1]],
}
"""Euler's first three loads in EI / L^2, by the ends of the column."""


def loaded(ends: str, elements: int, load: float) -> mbdkit.Mechanism:
    """Return a column whose axial load grows to `load`."""
    m = column(elements, is_clamped=ends != "pinned")
    if ends == "pinned":
        m.revolute("foot", m.ground, "column.0", at=(0, 0))
    if ends in ("pinned", "clamped and pinned"):
        m.point_on_line("guide", m.ground, top(m), at=(1, 0), axis=(1, 0))
    if ends == "clamped":
        m.prismatic("guide", m.ground, top(m), at=(1, 0), axis=(1, 0))
    m.force("load", top(m), value=(f"-{load}*t", 0.0))
    return m


@pytest.mark.parametrize("ends", slow_but(BUCKLING, "clamped"))
def test_the_first_three_bifurcations_are_eulers_loads(ends: str) -> None:
    found, load = [], 1.1 * BUCKLING[ends][-1]
    for elements in (8, 16, 32):
        path = mbdkit.equilibrium_path(loaded(ends, elements, load))
        assert [point.kind for point in path.critical] == ["bifurcation"] * 3
        np.testing.assert_array_equal(np.unique(path.unstable), [0, 1, 2, 3])
        found.append(np.array([load * point.time for point in path.critical]))
    np.testing.assert_allclose(found[-1], BUCKLING[ends], rtol=1e-4)  # margin: error of these elements
    np.testing.assert_allclose(limit(found, 4), BUCKLING[ends], rtol=2e-6)


@pytest.mark.parametrize(("share", "count"), [(1.0, 1), *slow((1.001, 2))])
def test_columns_that_buckle_together_are_found_one_by_one(share: float, count: int) -> None:
    # two columns side by side, one of them stiffer by `share`; both lie within one step along the path
    m = column(8)
    stiffness = {"axial": EQUAL * share, "shear": EQUAL * share, "bending": share}
    other = m.beam("other", a=(0, 1), b=(1, 1), elements=8, nodes=3, stiffness=stiffness, mass_per_length=1.0)
    m.weld("base", m.ground, other[0], at=(0, 1))
    for name, node in (("load", top(m)), ("more", other[-1])):
        m.force(name, node, value=("-5*t", 0.0))
    path = mbdkit.equilibrium_path(m)
    assert path.unstable[-1] == 2
    np.testing.assert_allclose(
        [5 * one.time for one in path.critical], np.pi**2 / 4 * np.array([1, share][:count]), rtol=2e-5
    )
    assert [one.body.partition(".")[0] for one in path.critical][:count] in (["column", "other"], ["column"], ["other"])


@pytest.mark.parametrize(("mode", "angle"), [(1, 120.0), *slow((1, 60.0), (2, 60.0), (3, 40.0))])
def test_a_buckled_column_carries_the_load_of_the_elastica(mode: int, angle: float) -> None:
    # expected: P L^2 / EI = ((2 n - 1) K(sin(angle/2)))^2 where the top is turned by `angle` (Euler 1744), on the
    # branch of the n-th of Euler's loads; the load is found at which no torque is needed to hold that angle
    turn, quarters = np.radians(angle), 2 * mode - 1
    square = np.sin(turn / 2) ** 2
    exact = (quarters * ellipk(square)) ** 2
    elements = 16 * quarters
    lengths = np.linspace(0, 1, 2 * elements + 1)
    sn = ellipj((lengths - 1) * np.sqrt(exact) + ellipk(square), square)[0]  # theta''  = -P sin(theta), theta'(L) = 0
    theta = 2 * np.arcsin(np.sin(turn / 2) * sn)
    cosine, sine = CubicSpline(lengths, np.cos(theta)), CubicSpline(lengths, np.sin(theta))
    start = [
        (cosine.integrate(0, s) - exact * s / EQUAL, sine.integrate(0, s), angle)
        for s, angle in zip(lengths, theta, strict=True)
    ]

    def torque(load: float) -> float:
        m = column(elements, start=[(0.0, 0.0, 0.0), *start[1:]])
        for node in range(2 * elements, 0, -64):  # inflections, the top first; the branches n > 1 are unstable else
            m.driver(f"turn {node}", m.ground, f"column.{node}", coordinate="angle", motion=float(theta[node]))
        m.force("load", top(m), value=(-load, 0.0))
        found = mbdkit.equilibrium(m)
        return float(found.reaction_torque[found.joints.index(f"turn {2 * elements}")])

    assert brentq(torque, 0.999 * exact, 1.001 * exact, xtol=1e-8) == pytest.approx(exact, rel=1e-6)


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


@pytest.mark.slow
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
