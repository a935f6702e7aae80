"""Forces of contacts, of polygons too: against OpenSim, closed forms, and differences of the forces themselves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from tests.compliant.pairs_of_bodies import PAIRS, PULL, SQUARE, two_bodies

import mbdkit
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_contact.acting_contacts import contact_values
from tests.margins import assert_within

FLOOR = {"line": {"normal": (0.0, 1.0)}}
G = 9.81

OPENSIM = {
    ((0.1, 0.105, 0.3), (0.7, -0.4, 1.5)): (-73.59119821241933, 118.62478796558794, 1.1594088369045803),
    ((0.1, 0.1, 0.3), (0.01, 0.3, 0.2)): (-0.9032327575058823, 5.832170243416482, 0.35485183349097404),
    ((0.0, 0.15, -0.2), (-0.05, -1.0, 0.0)): (0.212698261161018, 0.8713731105820715, 0.056223551992586364),
    ((0.0, 0.115, -0.2), (-2.0, -1.0, 3.0)): (761.3991516304059, 1256.38953943373, 133.66226010407124),
}
"""Force (x, y) and torque at the centre of mass by position and velocity (x, y, angle): the record values of
SmoothSphereHalfSpaceForce of OpenSim 4.6 (its Python package, on a planar joint) with radius 0.032, center
(0.05, -0.1), stiffness 1e6, dissipation 2, friction 0.8 and 0.6, transition velocity 0.2, and its default constants of
smoothing."""


def forces_of(m: Mechanism) -> np.ndarray:
    """Return the forces at the start (B, 3) without gravity."""
    p = EquationsOfMotion.of(m)
    found = p.forces(0.0, p.q0, p.v0).reshape(-1, 3).copy()
    for force, body in zip(found, m.bodies.values(), strict=True):
        force[:2] -= body.mass * np.array(m.gravity)
    return found


def one_body(
    shape: Mapping[str, Any], position: tuple[float, ...], velocity: tuple[float, ...], **contact: Any
) -> Mechanism:
    m = Mechanism(gravity=(0.0, -PULL))
    x, y, angle = position
    vx, vy, spin = velocity
    m.body("b", mass=1.0, inertia=0.1, position=(x, y), angle=angle, velocity=(vx, vy), angular_velocity=spin)
    m.contact("floor", "ground", "b", shapes=[FLOOR, shape], **contact)
    return m


@pytest.mark.parametrize(("at", "wanted"), OPENSIM.items())
def test_smooth_sphere_half_space_is_the_force_of_opensim(at: Any, wanted: Any) -> None:
    sphere = {"circle": {"center": (0.05, -0.1), "radius": 0.032}}
    law = {"law": "smooth-sphere-half-space", "stiffness": 1e6, "dissipation": 2.0, "transition_speed": 0.2}
    m = one_body(sphere, *at, friction={"static": 0.8, "kinetic": 0.6}, compliance=law)
    np.testing.assert_allclose(forces_of(m)[0], wanted, rtol=1e-10)


@pytest.mark.parametrize(
    ("law", "factor"),
    [
        ({"law": "hunt-crossley", "dissipation": 0.2}, 1.0 + 1.5 * 0.2 * 0.4),
        ({"law": "hunt-crossley", "impact_speed": 2.0}, 1.0 + 1.5 * (1.0 - 0.6) * 0.4 / 2.0),
        ({"law": "lankarani-nikravesh", "impact_speed": 2.0}, 1.0 + 0.75 * (1.0 - 0.6**2) * 0.4 / 2.0),
        ({"law": "flores", "impact_speed": 2.0}, 1.0 + 1.6 * (1.0 - 0.6) / 0.6 * 0.4 / 2.0),
    ],
)
def test_normal_forces_are_those_of_the_published_laws(law: dict[str, Any], factor: float) -> None:
    """Hunt and Crossley 1975; Lankarani and Nikravesh 1990; Flores et al. 2011, with indentation 0.01 at 0.4 m/s."""
    ball = {"circle": {"radius": 0.1}}
    m = one_body(
        ball, (0, 0.09, 0), (1.0, -0.4, 0), restitution=0.6, friction=0.3, compliance={"stiffness": 3e4, **law}
    )
    normal = 3e4 * 0.01**1.5 * factor
    np.testing.assert_allclose(forces_of(m)[0], (-0.3 * normal, normal, -0.095 * 0.3 * normal), rtol=1e-12)


def test_a_linear_contact_never_pulls() -> None:
    law = {"law": "linear", "stiffness": 100.0, "dissipation": 50.0}
    point = {"point": (0.0, -0.1)}
    assert forces_of(one_body(point, (0, 0.09, 0), (0, 0.1, 0), compliance=law))[0, 1] == 0.0
    pushed = forces_of(one_body(point, (0, 0.09, 0), (0, -0.1, 0), compliance=law))[0, 1]
    assert pushed == pytest.approx(100.0 * 0.01 + 50.0 * 0.1, rel=1e-12)


@pytest.mark.parametrize("slip", [0.01, 0.05, 0.2, -3.0])
def test_friction_is_the_static_force_at_the_transition_speed_and_the_kinetic_one_beyond(slip: float) -> None:
    """M. A. Sherman, A. Seth and S. L. Delp, Procedia IUTAM 2:241-261, 2011: the curve of Hollars without viscosity."""
    law = {"law": "linear", "stiffness": 1000.0, "transition_speed": 0.05}
    m = one_body(
        {"point": (0, 0)}, (0, -0.01, 0), (slip, 0, 0), friction={"static": 0.9, "kinetic": 0.5}, compliance=law
    )
    w = abs(slip) / 0.05
    share = min(w, 1.0) * (0.5 + 0.8 / (1.0 + w * w))
    assert forces_of(m)[0, 0] == pytest.approx(-math.copysign(share * 10.0, slip), rel=1e-12)


@pytest.mark.parametrize("name", PAIRS)
def test_contact_forces_balance_each_other_and_tangents_are_their_derivatives(name: str) -> None:
    shapes, at, angle = PAIRS[name]
    m = two_bodies(*shapes, at, angle)
    p = EquationsOfMotion.of(m)
    forces = forces_of(m)
    assert np.abs(forces).max() > 1.0
    (ax, ay), (bx, by) = (body.position for body in m.bodies.values())
    moment = forces[:, 2].sum() + ax * forces[0, 1] - ay * forces[0, 0] + bx * forces[1, 1] - by * forces[1, 0]
    np.testing.assert_allclose([*forces[:, :2].sum(axis=0), moment], 0.0, atol=1e-11 * np.abs(forces).max())

    tangents = p.tangents(0.0, p.q0, p.v0, p.v0, np.zeros(p.m))
    step = 1e-6
    for i in range(p.n):
        d = np.zeros(p.n)
        d[i] = step
        by_q = (p.forces(0.0, p.q0 + d, p.v0) - p.forces(0.0, p.q0 - d, p.v0)) / (2 * step)
        by_v = (p.forces(0.0, p.q0, p.v0 + d) - p.forces(0.0, p.q0, p.v0 - d)) / (2 * step)
        k, c = (x.toarray()[:, i] for x in (tangents.stiffness, tangents.damping))
        np.testing.assert_allclose(k, -by_q, atol=2e-6 * np.abs(by_q).max() + 1e-4)
        np.testing.assert_allclose(c, -by_v, atol=2e-6 * np.abs(by_v).max() + 1e-4)


def test_a_circle_that_rolls_around_a_polygon_has_one_force_without_jumps() -> None:
    """Its distance from the square is constant along the outline, so that the force has a constant size."""
    sizes = []
    for s in np.linspace(0.0, 1.0, 9):
        corner = np.array([0.2, 0.1])
        if s < 0.3:
            at = np.array([0.2 - 0.1 * (0.3 - s) / 0.3, 0.1 + 0.045])
        elif s < 0.7:
            turn = 0.5 * math.pi * (0.7 - s) / 0.4
            at = corner + 0.045 * np.array([math.cos(turn), math.sin(turn)])
        else:
            at = np.array([0.2 + 0.045, 0.1 - 0.1 * (s - 0.7) / 0.3])
        m = Mechanism(gravity=(0.0, -PULL))
        m.body("b", mass=1.0, inertia=0.1, position=tuple(at))
        m.contact("c", "ground", "b", shapes=[SQUARE, {"circle": {"radius": 0.05}}], compliance={"stiffness": 1e4})
        sizes.append(np.hypot(*forces_of(m)[0, :2]))
    np.testing.assert_allclose(sizes, 1e4 * 0.005**1.5, rtol=1e-9)


def test_a_wheel_rolls_to_rest() -> None:
    """Deceleration e g / (R (1 + I / (m R^2))) while it rolls: I alpha = -e m g - R F, m a = F, and a = R alpha."""
    radius, mass, inertia, arm = 0.2, 3.0, 0.06, 0.01
    k = 1e7
    m = Mechanism(gravity=(0.0, -G))
    m.body(
        "wheel", mass=mass, inertia=inertia, position=(0.0, radius - mass * G / k), velocity=(1.0, 0.0),
        angular_velocity=-1.0 / radius,
    )  # fmt: skip
    law = {"law": "linear", "stiffness": k, "dissipation": 2e3, "transition_speed": 1e-3}
    shapes = [{"line": {"normal": (0, 1)}}, {"circle": {"radius": radius}}]
    m.contact("road", "ground", "wheel", shapes=shapes, friction=0.6, rolling_resistance=arm, compliance=law)
    done = mbdkit.run(m, integrator={"name": "radau-iia"}, time={"end": 4.0, "step": 1e-3})
    slows = arm * G / (radius * (1.0 + inertia / (mass * radius**2)))
    velocity = done["wheel"].velocity[:, 0]
    at = int(np.searchsorted(done.time, 2.0))
    assert velocity[at] == pytest.approx(1.0 - slows * done.time[at], rel=2e-4)
    assert 1.0 / slows < 3.9
    assert_within(velocity[-1], 1e-3)  # below the transition speed
    assert done["wheel"].position[-1, 0] == pytest.approx(0.5 / slows, rel=1e-3)


K = 1e4
LINEAR = {"law": "linear", "stiffness": K}


def rectangle(half_width: float, half_height: float) -> list[tuple[float, float]]:
    a, b = half_width, half_height
    return [(-a, -b), (a, -b), (a, b), (-a, b)]


def regular(count: int, radius: float) -> list[tuple[float, float]]:
    """Return a regular polygon with a horizontal edge at the bottom."""
    turns = [2.0 * math.pi * (k + 0.5) / count - 0.5 * math.pi for k in range(count)]
    return [(radius * math.cos(turn), radius * math.sin(turn)) for turn in turns]


def pair(
    below: list[tuple[float, float]],
    above: list[tuple[float, float]],
    at: tuple[float, float],
    *,
    angle: float = 0.0,
    swapped: bool = False,
    law: dict[str, Any] = LINEAR,
    **more: Any,
) -> Mechanism:
    """Return a polygon that moves above one of the ground; `swapped` exchanges the order of the two in the contact."""
    m = Mechanism(gravity=(0.0, -G))
    m.body("box", mass=2.0, inertia=0.05, position=at, angle=angle)
    bodies, shapes = ["ground", "box"], [{"polygon": below}, {"polygon": above}]
    if swapped:
        bodies, shapes = bodies[::-1], shapes[::-1]
    m.contact("c", *bodies, shapes=shapes, compliance=law, **more)
    return m


def force_on(m: Mechanism) -> np.ndarray:
    """Return force and torque of the contact on the body at the start."""
    p = EquationsOfMotion.of(m)
    return p.forces(0.0, p.q0, p.v0)[:3] - [0.0, -2.0 * G, 0.0]


def rows_of(m: Mechanism) -> dict[str, np.ndarray]:
    """Return the quantities of the rows of the contact at the start."""
    box = m.bodies["box"]
    q = np.array([[*box.position, box.angle, 0.0, 0.0, 0.0]])
    values = contact_values(compile_mechanism(m).extensions["contacts"], q, 0.0 * q, np.zeros((1, 0)))
    return {name: value[0] for name, value in values.items()}


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("offset", [0.0, 1e-5, -1e-5, 1e-3, -1e-3, 0.1, -0.1])
def test_two_corners_carry_a_box_on_an_equal_one(offset: float, swapped: bool) -> None:
    """Also where corners coincide, and where the offset is smaller than the overlap."""
    depth = 2e-3
    m = pair(rectangle(0.3, 0.1), rectangle(0.3, 0.1), (offset, 0.2 - depth), swapped=swapped)
    lever = 0.5 * offset  # the force acts in the middle of the common part of both edges
    np.testing.assert_allclose(force_on(m), [0.0, 2.0 * K * depth, -2.0 * K * depth * lever], rtol=1e-10, atol=1e-10)
    rows = rows_of(m)
    acting = rows["normal_force"] > 0.0
    assert np.count_nonzero(acting) == 2
    np.testing.assert_allclose(rows["normal_force"][acting], K * depth, rtol=1e-10)
    np.testing.assert_allclose(np.sort(rows["point"][acting, 0]), [max(offset, 0.0) - 0.3, min(offset, 0.0) + 0.3])
    assert np.all(rows["gap"][~acting] >= 0.0)


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("dissipation", [0.0, 50.0])
def test_the_force_is_continuous_where_another_corner_takes_over(dissipation: float, swapped: bool) -> None:
    """A box slides over the end of a wider one, at which a corner of the lower box takes over."""
    depth, sizes = 1e-3, []
    for x in (0.1, 0.2 - 1e-12, 0.2, 0.2 + 1e-12, 0.3):  # the right end of the lower box is at 0.5
        law = {**LINEAR, "dissipation": dissipation}
        m = pair(rectangle(0.5, 0.1), rectangle(0.3, 0.1), (x, 0.2 - depth), swapped=swapped, law=law)
        force = force_on(m)
        middle = 0.5 * (x - 0.3 + min(x + 0.3, 0.5)) - x
        np.testing.assert_allclose(force, [0.0, 2.0 * K * depth, 2.0 * K * depth * middle], rtol=1e-10, atol=1e-10)
        sizes.append(force[1])
    assert_within(np.ptp(sizes), 1e-9)


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("count", [3, 5, 8, 16])
def test_polygons_with_many_corners_rest_on_an_edge(count: int, swapped: bool) -> None:
    above = regular(count, 0.2)
    height, half = 0.2 * math.cos(math.pi / count), 0.2 * math.sin(math.pi / count)
    m = pair(rectangle(1.0, 0.1), above, (0.3, 0.1 + height - 1e-3), swapped=swapped)
    np.testing.assert_allclose(force_on(m), [0.0, 2.0 * K * 1e-3, 0.0], rtol=1e-9, atol=1e-9)
    turned = pair(rectangle(1.0, 0.1), above, (0.3, 0.1 + 0.2 - 1e-3), angle=math.pi / count, swapped=swapped)
    np.testing.assert_allclose(force_on(turned), [0.0, K * 1e-3, 0.0], rtol=1e-9, atol=1e-9)  # on a corner
    both = pair(regular(count, 0.2), above, (0.1 * half, 2.0 * height - 1e-3), angle=0.0, swapped=swapped)
    if count % 2 == 0:
        wanted = [0.0, 2.0 * K * 1e-3, -2.0 * K * 1e-3 * 0.05 * half]
        np.testing.assert_allclose(force_on(both), wanted, rtol=1e-9, atol=1e-9)


def random_polygon(random: np.random.Generator) -> list[tuple[float, float]]:
    count = int(random.integers(3, 9))
    turns = 2.0 * math.pi * (np.arange(count) + random.uniform(0.0, 0.7, count)) / count
    return [(0.2 * math.cos(turn), 0.2 * math.sin(turn)) for turn in turns]


def test_polygons_that_overlap_are_pushed_apart_along_the_axis_of_least_overlap() -> None:
    """The largest force belongs to the least overlap along the normal of an edge, and no overlap is without force."""
    random = np.random.default_rng(5)
    found = 0
    for _ in range(300):
        shapes = random_polygon(random), random_polygon(random)
        at, angle = random.uniform(-0.35, 0.35, 2), random.uniform(-3.0, 3.0)
        c, s = math.cos(angle), math.sin(angle)
        below, above = np.array(shapes[0]), np.array(shapes[1]) @ [[c, s], [-s, c]] + at
        axes = []
        for one, other, sign in ((below, above, 1.0), (above, below, -1.0)):
            for begin, end in zip(one, np.roll(one, -1, axis=0), strict=True):
                n = np.array([end[1] - begin[1], begin[0] - end[0]]) / np.linalg.norm(end - begin)
                axes.append((float(np.min((other - begin) @ n)), sign * n))
        apart, axis = max(axes, key=lambda one: one[0])
        m = pair(*shapes, (float(at[0]), float(at[1])), angle=angle)
        rows = rows_of(m)
        if apart > 0.0:
            assert np.all(rows["normal_force"] == 0.0)
            assert np.min(rows["gap"]) >= 0.0
        elif apart > -0.03:
            found += 1
            signs = np.array(
                [1.0 if one.pair.bodies[1] == "box" else -1.0 for one in compile_mechanism(m).extensions["contacts"]]
            )
            force = np.sum((signs * rows["normal_force"])[:, None] * rows["normal"], axis=0)
            assert np.count_nonzero(rows["normal_force"]) <= 2
            np.testing.assert_allclose(np.max(rows["normal_force"]), -K * apart, rtol=1e-9)
            assert force @ axis >= -K * apart * (1.0 - 1e-9)
    assert found > 20


def test_what_a_sliding_box_loses_is_the_work_of_the_contact() -> None:
    """A box that is thrown on another one, bounces, slides with friction and tips over its end."""
    law = {**LINEAR, "dissipation": 20.0}
    m = pair(rectangle(0.5, 0.1), rectangle(0.3, 0.1), (0.0, 0.25), angle=0.1, law=law, friction=0.3)
    m.bodies["box"] = m.bodies["box"].model_copy(update={"velocity": (2.0, 0.0)})
    integrator = {"name": "dopri5", "adaptive": True, "rtol": 1e-9, "atol": 1e-11}
    done = mbdkit.run({"mbdkit": 1, "model": m.to_spec(), "time": {"end": 0.6}, "integrator": integrator})
    assert done["box"].position[-1, 0] > 0.5
    assert done.contacts["c.0"].normal_force.max() > 10.0
    assert done.energy.total[-1] < done.energy.total[0] - 0.5
    assert_within(done.energy.balance, 1e-6)


@pytest.mark.parametrize("integrator", [{"name": "gauss", "stages": 3}, {"name": "rk4"}])
def test_gradients_of_a_box_that_oscillates_on_another_one(integrator: dict[str, Any]) -> None:
    """Its two corners are springs: y = -g/w^2 + (y0 + g/w^2) cos(w t) with w^2 = 2 k / m; y is minus the overlap."""
    m = pair(rectangle(0.5, 0.1), rectangle(0.3, 0.1), (0.0, 0.2 - 1.2 * 2.0 * G / (2.0 * K)))
    spec = {"mbdkit": 1, "parameters": {"k": K}, "model": m.to_spec(), "time": {"end": 0.2, "step": 2e-4}}
    spec["model"]["contacts"]["c"]["compliance"]["stiffness"] = "k"
    found = mbdkit.gradient(spec, "final(bodies.box.y)", ["k"], check=False, integrator=integrator)

    def height(k: complex) -> complex:
        square, begin = k, -1.2 * G / K
        return -G / square + (begin + G / square) * np.cos(np.sqrt(square) * 0.2)

    assert found.value[0] == pytest.approx(0.2 + height(K).real, abs=1e-10)
    np.testing.assert_allclose(found.jacobian, [[height(K + 1e-20j).imag / 1e-20]], rtol=1e-6)
