"""Motions and forces of transmissions against closed forms, and against equations in coordinates of their own."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import EquationsOfMotion, Mechanism
from tests.margins import assert_within

from .drawn_transmissions import drawn
from .geared_arm import coupled, crossed, exact, geared, links

END = 0.5
GAUSS = {"name": "gauss", "stages": 3}
RADAU = {"name": "radau-iia", "stages": 3}


def run(m: Mechanism, end: float = END, step: float = 0.005, **sections: Any) -> mbdkit.Run:
    """Return a run, with gauss by default."""
    return mbdkit.run(m, **({"integrator": GAUSS, "time": {"end": end, "step": step}} | sections))  # type: ignore[arg-type]


def angles(found: mbdkit.Run) -> np.ndarray:
    """Return the final angles of the bodies a and b."""
    return np.array([found.bodies[name].angle[-1] for name in "ab"])


@pytest.mark.parametrize("model", [geared, coupled, crossed])
def test_a_geared_arm_moves_as_in_its_own_coordinates(model: Callable[[], Mechanism]) -> None:
    found, (expected, torque) = run(model()), exact(END)
    np.testing.assert_allclose(angles(found), expected, rtol=0, atol=1e-11)
    if model is not geared:  # the torque of a gear is that of a force at the pitch point
        assert found.joints["G"].reaction_torque[-1] == pytest.approx(torque, abs=1e-9)


@pytest.mark.parametrize(
    ("formulation", "integrator", "accuracy"),
    [
        ("index-1", RADAU, 1e-10),
        ("index-2", RADAU, 1e-10),
        ("index-3", RADAU, 1e-10),
        ("ggl", RADAU, 1e-10),
        ("joint-coordinates", GAUSS, 1e-11),
        ("joint-coordinates", RADAU, 1e-10),
        ("joint-coordinates", {"name": "rk4"}, 1e-7),
        ("index-1", {"name": "rk4"}, 1e-7),
        ("index-1", {"name": "dopri5"}, 1e-10),
        ("index-1", {"name": "dop853"}, 1e-11),
        ("index-1", {"name": "scipy-dop853"}, 1e-6),
        ("index-3", {"name": "rattle"}, 1e-3),
        ("index-3", {"name": "lobatto-pair", "stages": 3}, 1e-8),
    ],
)
def test_formulations_and_methods_agree(formulation: str, integrator: dict[str, Any], accuracy: float) -> None:
    found = run(coupled(), formulation=formulation, integrator=integrator)
    np.testing.assert_allclose(angles(found), exact(END)[0], rtol=0, atol=accuracy)


def test_radial_forces_that_do_work_are_the_same_in_all_formulations() -> None:
    """The distance of the centres changes, and the force on the teeth keeps its sign."""
    m = links()
    m.gear("G", m.ground, "b", radii=(0.6, 0.9))
    found = [
        run(m, end=0.3, formulation=formulation, integrator=integrator)
        for formulation, integrator in (("index-1", GAUSS), ("index-2", RADAU), ("index-3", RADAU), ("ggl", RADAU))
    ]
    assert_within(found[0].joints["G"].misalignment, 1e-12)
    for other in found[1:]:
        np.testing.assert_allclose(angles(other), angles(found[0]), rtol=0, atol=1e-11)


@pytest.mark.parametrize("stabilization", ["baumgarte", "projection"])
def test_stabilization_keeps_gears_in_mesh(stabilization: str) -> None:
    found = run(geared(), integrator={"name": "rk4"}, stabilization=stabilization)
    np.testing.assert_allclose(angles(found), exact(END)[0], rtol=0, atol=1e-7)
    assert_within(found.joints["G"].misalignment, 1e-7)


@pytest.mark.parametrize(
    ("integrator", "order"),
    [({"name": "rk4"}, 4), ({"name": "gauss", "stages": 2}, 4), ({"name": "radau-iia", "stages": 2}, 3)],
)
def test_orders_of_methods(integrator: dict[str, Any], order: int) -> None:
    expected = exact(END)[0]
    errors = [np.max(np.abs(angles(run(geared(), step=h, integrator=integrator)) - expected)) for h in (0.02, 0.01)]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.2)


def test_gears_on_the_ground_have_the_inertia_of_both() -> None:
    m = Mechanism()
    m.body("a", mass=1.0, inertia=0.02, position=(0.0, 0.0))
    m.body("b", mass=1.0, inertia=0.05, position=(0.3, 0.0))
    m.revolute("A", m.ground, "a", at=(0.0, 0.0))
    m.revolute("B", m.ground, "b", at=(0.3, 0.0))
    m.gear("G", "a", "b", teeth=(20, 40), module=0.01)
    m.torque("T", "a", value=1.0)
    turned = 0.5 * END**2 / (0.02 + 0.05 / 4)
    np.testing.assert_allclose(angles(run(m)), [turned, -turned / 2], rtol=1e-12)


def test_a_planetary_gear_has_the_ratio_of_its_teeth() -> None:
    """Expected: with the ring held, the carrier turns by s / (s + r) of the sun, by Willis' equation."""
    m = Mechanism(gravity=(0.0, 0.0))
    m.body("sun", mass=2.0, inertia=0.02)
    m.body("carrier", mass=1.0, inertia=0.03, position=(0.075, 0.0))
    m.body("planet", mass=0.5, inertia=0.001, position=(0.15, 0.0))
    m.revolute("S", m.ground, "sun", at=(0.0, 0.0))
    m.revolute("C", m.ground, "carrier", at=(0.0, 0.0))
    m.revolute("P", "carrier", "planet", at=(0.15, 0.0))
    m.gear("inner", "sun", "planet", teeth=(40, 20), module=0.005)
    m.gear("outer", m.ground, "planet", teeth=(80, 20), module=0.005, internal=True)
    m.torque("T", "sun", value=0.25)
    found = run(m, end=3.0, step=0.01)
    sun, carrier, planet = (found.bodies[name].angle[-1] for name in ("sun", "carrier", "planet"))
    assert abs(sun) > 4 * math.pi
    assert carrier == pytest.approx(sun * 40 / (40 + 80), rel=1e-10)
    assert planet == pytest.approx(-carrier * (80 - 20) / 20, rel=1e-10)


@pytest.mark.parametrize(
    ("follower", "height"),
    [
        ("point", lambda s: 0.02 * np.sin(s) + np.sqrt(0.06**2 - (0.02 * np.cos(s)) ** 2)),
        ({"roller": 0.01}, lambda s: 0.02 * np.sin(s) + np.sqrt(0.07**2 - (0.02 * np.cos(s)) ** 2)),
        ({"flat": [0, 1]}, lambda s: 0.06 + 0.02 * np.sin(s)),
    ],
)
def test_followers_of_an_eccentric_circle(follower: Any, height: Callable[[Any], Any]) -> None:
    m = Mechanism()
    m.body("a", mass=1.0, inertia=0.01)
    m.body("b", mass=0.5, inertia=0.01, position=(0.0, float(height(0.0))))
    m.revolute("A", m.ground, "a", at=(0.0, 0.0))
    m.prismatic("B", m.ground, "b", at=(0.0, float(height(0.0))), axis=(0.0, 1.0))
    m.cam("C", "a", "b", profile="0.02*cos(angle) + sqrt(0.06**2 - (0.02*sin(angle))**2)", follower=follower)
    m.driver("turn", m.ground, "a", coordinate="angle", motion="10*t")
    found = run(m)
    np.testing.assert_allclose(found.bodies["b"].position[:, 1], height(10 * found.time), rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("lobes", "share"), [(2, 0.75), (3, 0.85), (5, 0.95), (8, 0.95), (4, 0.99), (2, None), (3, None), (7, None)]
)
def test_followers_that_hardly_fit_into_hollows_touch_the_profile(lobes: int, share: float | None) -> None:
    """Rollers, of a share of the radius of a hollow, are on the curve at the distance of their radius from the profile.

    Flat faces, without a share, are on tangents of a profile that is almost straight between its lobes.
    """
    depth = 0.95 / (lobes**2 + 1) if share is None else 0.3
    s = np.linspace(-np.pi, np.pi, 2001)
    r, slope = 0.1 * (1 + depth * np.cos(lobes * s)), -0.1 * depth * lobes * np.sin(lobes * s)
    bend = -0.1 * depth * lobes**2 * np.cos(lobes * s)
    curvature = (r * r + 2 * slope * slope - r * bend) / (r * r + slope * slope) ** 1.5
    normal = (r + 1j * -slope) * np.exp(1j * s) / np.hypot(r, slope)
    roller = 0.0 if share is None else share / -curvature.min()
    follower = {"flat": [1, 0]} if share is None else {"roller": roller}
    centre = r * np.exp(1j * s) + roller * normal
    m = Mechanism()
    m.body("cam", mass=1, inertia=1)
    place = float(centre[0].real), float(centre[0].imag)
    m.body("follower", mass=1, inertia=1, position=place, angle=float(np.angle(normal[0])))
    m.cam("C", "cam", "follower", profile=f"0.1*(1 + {depth}*cos({lobes}*angle))", follower=follower)
    equations = EquationsOfMotion.of(m)
    for offset in (0.0, 1e-3):
        places = centre + offset * normal
        states = [[0, 0, 0, z.real, z.imag, np.angle(n)] for z, n in zip(places, normal, strict=True)]
        distances = [equations.constraints(0.0, np.array(q))[0] for q in states[::7]]
        np.testing.assert_allclose(distances, offset, rtol=0, atol=1e-12 if offset == 0.0 else 3e-4)


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(4, 60))])
def test_drawn_mechanisms_move_alike_in_all_formulations(seed: int) -> None:
    m = drawn(np.random.default_rng(seed))
    found = [
        run(m, end=0.2, step=0.001, formulation=formulation, integrator=integrator)
        for formulation, integrator in (
            ("index-1", GAUSS), ("joint-coordinates", {"name": "dop853"}), ("index-3", RADAU), ("ggl", RADAU),
        )
    ]  # fmt: skip
    last = [np.array([[*body.position[-1], body.angle[-1]] for body in one.bodies.values()]) for one in found]
    assert [one.time[-1] for one in found] == [0.2] * len(found)
    for other, accuracy in zip(last[1:], (1e-9, 1e-10, 1e-10), strict=True):
        np.testing.assert_allclose(other, last[0], rtol=0, atol=accuracy)
    assert_within(max(np.max(np.abs(joint.misalignment)) for joint in found[0].joints.values()), 1e-9)


def pinned_pair(torque: float) -> Mechanism:
    """Two gears on pins, 0.3 m apart, of which a torque turns the first."""
    m = Mechanism(gravity=(0, 0))
    a = m.body("a", mass=1, inertia=0.01)
    b = m.body("b", mass=1, inertia=0.01, position=(0.3, 0))
    m.revolute("A", m.ground, a, at=(0, 0))
    m.revolute("B", m.ground, b, at=(0.3, 0))
    m.gear("G", a, b, radii=(0.1, 0.2))
    m.torque("T", a, value=torque)
    return m


@pytest.mark.parametrize(("torque", "ship"), [(1.0, None), (0.01, 1e7), (1e-8, None), (1e-8, 1e7)])
def test_the_radial_force_of_teeth_does_not_depend_on_its_size_or_on_other_bodies(
    torque: float, ship: float | None
) -> None:
    m = pinned_pair(torque)
    if ship is not None:
        m.body("ship", mass=ship, inertia=ship, position=(5, 0))
    found = run(m, 0.05)
    # the gear turns 0.01 and 0.01 / 4 kg m^2, so that the teeth carry what accelerates the second one
    tangential = torque * 0.5 * 0.01 / (0.01 * 1.25) / 0.2
    np.testing.assert_allclose(found.joints["G"].reaction_force[-1], [0.0, tangential], rtol=0, atol=1e-9 * tangential)
    radial = tangential * math.tan(math.radians(20.0))
    np.testing.assert_allclose(found.joints["B"].reaction_force[-1], [-radial, -tangential], rtol=1e-9)
