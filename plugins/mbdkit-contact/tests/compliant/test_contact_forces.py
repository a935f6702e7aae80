"""Forces of contacts: against OpenSim, closed forms, and differences of the forces themselves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from tests.compliant.pairs_of_bodies import PAIRS, PULL, SQUARE, two_bodies

import mbdkit
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.mechanism.mechanism import Mechanism

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
    assert velocity[at] == pytest.approx(1.0 - slows * done.time[at], rel=1e-4)
    assert 1.0 / slows < 3.9
    assert abs(velocity[-1]) < 1e-3  # below the transition speed
    assert done["wheel"].position[-1, 0] == pytest.approx(0.5 / slows, rel=1e-3)
