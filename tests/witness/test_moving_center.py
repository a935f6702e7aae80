"""Revolute joints with a moving center against wheels that roll: on a line, and in a bowl.

Eccentric wheel: radius R, centre of mass at the distance E from the axle, angle phi. Rolling on a line, the axle is at
(-R phi, 0), and (J + m (R^2 + E^2 + 2 R E sin(phi))) phi'' + m R E cos(phi) phi'^2 + m g E cos(phi) = 0. The ground
pushes at the point of contact, R below the axle, so that the moment about the axle is R times the friction force.

Disc in a bowl: a disc of radius R rolls in a bowl of radius B; its centre is at (B - R) (cos(psi), sin(psi)) with
phi = -psi (B - R) / R, and psi'' = -g cos(psi) / ((B - R) (1 + J / (m R^2))).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit.base.errors import SpecError
from tests.margins import assert_within
from tests.witness.eccentric_wheel import SPEED, START, E, G, J, M, R, wheel

from .running import gauss, run

B = 1.1
RADAU = {"name": "radau-iia", "stages": 3}


def of_angle(phi: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the angular acceleration of the wheel, and the acceleration (..., 2) of its centre of mass."""
    c, s = np.cos(phi), np.sin(phi)
    inertia = J + M * (R**2 + E**2 + 2 * R * E * s)
    angular = -(M * R * E * c * rate**2 + M * G * E * c) / inertia
    x = -R * angular - E * (s * angular + c * rate**2)
    return angular, np.stack([x, E * (c * angular - s * rate**2)], axis=-1)


def rolled(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = solve_ivp(
        lambda _, y: [y[1], of_angle(y[0], y[1])[0]], (0, t[-1]), [START, SPEED], "DOP853", t, rtol=1e-13, atol=1e-13
    )
    return found.y[0], found.y[1]


def bowl(*, table: bool = False, turned: bool = False, driven: bool = False) -> dict[str, Any]:
    """Return a disc in a bowl, released at psi = -0.4; with `turned`, the disc is the first body of the joint."""
    arm, psi = B - R, -0.4
    phi = -psi * arm / R
    share = R / arm
    if table:
        angles = np.linspace(-1.0, 9.0, 201)
        center = {
            key: {"table": [angles.tolist(), (arm * f(-share * angles)).tolist()], "interpolation": "quintic"}
            for key, f in (("x", np.cos), ("y", np.sin))
        }
    else:
        center = {"x": f"{arm}*cos({share}*angle)", "y": f"-{arm}*sin({share}*angle)"}
    place = [arm * math.cos(psi), arm * math.sin(psi)]
    joint = {"type": "revolute", "bodies": ["ground", "disc"], "points": [[0, 0], [0, 0]], "center": center}
    bodies = {"disc": {"mass": M, "inertia": J, "position": place, "angle": phi}}
    if turned:  # the ground turns by -phi against the disc, and its origin moves in the disc's frame by -R(-phi) c(phi)
        both = share + 1.0
        joint["bodies"] = ["disc", "ground"]
        joint["center"] = {"x": f"-{arm}*cos({both}*angle)", "y": f"-{arm}*sin({both}*angle)"}
    joints = {"rolls": joint}
    if driven:
        motion = f"{phi} + 2*sin(t)"
        joints["motor"] = {"type": "driver", "bodies": ["ground", "disc"], "coordinate": "angle", "motion": motion}
    return {"name": "mechanism", "bodies": bodies, "joints": joints}


def swung(t: np.ndarray) -> np.ndarray:
    factor = G / ((B - R) * (1 + J / (M * R**2)))
    found = solve_ivp(
        lambda _, y: [y[1], -factor * math.cos(y[0])], (0, t[-1]), [-0.4, 0.0], "DOP853", t, rtol=1e-13, atol=1e-13
    )
    psi: np.ndarray = found.y[0]
    return psi


def test_an_eccentric_wheel_rolls_as_its_equation_says_and_the_ground_pushes_at_the_contact() -> None:
    found = run(wheel(), gauss(3), 2.0, 0.005, every=8)
    phi, rate = rolled(found.time)
    np.testing.assert_allclose(found["wheel"].angle, phi, rtol=0, atol=2e-11)
    _, acceleration = of_angle(phi, rate)
    force = M * (acceleration + np.array([0.0, G]))
    joint = found.joints["rolls"]
    np.testing.assert_allclose(joint.reaction_force, force, rtol=0, atol=1e-8)
    np.testing.assert_allclose(joint.reaction_torque, R * force[:, 0], rtol=0, atol=1e-8)
    assert_within(joint.misalignment, 1e-11)
    assert_within(found.energy.balance, 1e-10)
    assert np.ptp(found.energy.work) == 0.0


@pytest.mark.parametrize(
    ("integrator", "formulation", "stabilization", "step", "error"),
    [
        ({"name": "rk4"}, "index-1", "none", 0.002, 1e-8),
        ({"name": "rk4"}, "index-1", {"name": "baumgarte", "alpha": 5, "beta": 5}, 0.002, 1e-8),
        ({"name": "rk4"}, "index-1", {"name": "projection"}, 0.002, 1e-8),
        ({"name": "scipy-dop853", "rtol": 1e-10, "atol": 1e-10}, "index-1", "none", None, 1e-7),
        ({"name": "scipy-radau", "rtol": 1e-8, "atol": 1e-8}, "index-1", "none", None, 1e-5),
        *((RADAU, one, "none", 0.01, 1e-8) for one in ("index-1", "index-2", "index-3", "ggl")),
    ],
)
def test_every_formulation_rolls_a_disc_in_a_bowl(
    integrator: dict[str, Any], formulation: str, stabilization: Any, step: float | None, error: float
) -> None:
    spec = {"mbdkit": 1, "model": bowl(), "integrator": integrator, "formulation": formulation}
    time = {"end": 1.0} | ({} if step is None else {"step": step})
    found = mbdkit.run(spec | {"stabilization": stabilization, "time": time}).check()
    psi = swung(found.time)
    expected = (B - R) * np.stack([np.cos(psi), np.sin(psi)], axis=-1)
    np.testing.assert_allclose(found["disc"].position, expected, rtol=0, atol=error)


def test_a_table_and_a_disc_as_first_body_move_alike() -> None:
    plain, table, turned = (run(model, gauss(3), 1.5, 0.01) for model in (bowl(), bowl(table=True), bowl(turned=True)))
    np.testing.assert_allclose(table["disc"].position, plain["disc"].position, rtol=0, atol=1e-7)
    np.testing.assert_allclose(turned["disc"].position, plain["disc"].position, rtol=0, atol=1e-9)
    assert_within(table.energy.balance, 1e-9)  # the spline's own motion conserves energy


@pytest.mark.parametrize(("integrator", "order"), [(gauss(2), 4), ({"name": "rk4"}, 4), (gauss(3), 6)])
def test_methods_keep_their_order(integrator: dict[str, Any], order: int) -> None:
    steps = [0.04, 0.02] if order == 6 else [0.01, 0.005]
    errors = []
    for step in steps:
        found = run(wheel(), integrator, 2.0, step)
        errors.append(abs(found["wheel"].angle[-1] - rolled(found.time)[0][-1]))
    # margin: order, from errors of mbdkit alone
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25)


def test_kinematics_and_equilibrium_roll_as_well() -> None:
    moved = mbdkit.kinematics(mbdkit.Mechanism.from_spec(bowl(driven=True)), time={"end": 2.0, "step": 0.05})
    phi = 0.4 * (B - R) / R + 2 * np.sin(moved.time)
    psi = -phi * R / (B - R)
    expected = (B - R) * np.stack([np.cos(psi), np.sin(psi)], axis=-1)
    np.testing.assert_allclose(moved["disc"].position[:, :2], expected, rtol=0, atol=1e-13)
    found = mbdkit.equilibrium(mbdkit.Mechanism.from_spec(bowl()))
    np.testing.assert_allclose(found["disc"][:2], [0.0, -(B - R)], rtol=0, atol=1e-12)
    assert found.stability == "stable"
    assert found.stiffness == pytest.approx(G / ((B - R) * (1 + J / (M * R**2))), rel=1e-9)


def test_at_places_the_displaced_point() -> None:
    m = mbdkit.Mechanism()
    base = m.body("base", mass=1.0, inertia=0.1, position=(0.3, -0.2), angle=0.7)
    disc = m.body("disc", mass=1.0, inertia=0.1, position=(1.0, 2.0), angle=1.2)
    m.revolute("roll", base, disc, at=(0.5, 0.4), center={"x": "0.2*sin(angle)", "y": 0.1})
    joint = m.joints["roll"]
    (x, y), other = joint.points
    first = m.bodies["base"].to_global((x + 0.2 * math.sin(0.5), y + 0.1))
    assert first == pytest.approx((0.5, 0.4), abs=1e-15)
    assert m.bodies["disc"].to_global(other) == pytest.approx((0.5, 0.4), abs=1e-15)
    assert mbdkit.Mechanism.from_spec(m.to_spec()).joints["roll"] == joint


def test_a_point_mass_has_no_angle_to_move_a_center() -> None:
    m = mbdkit.Mechanism()
    m.revolute("j", m.ground, m.body("p", mass=1.0), points=((0, 0), (0, 0)), center={"x": "angle"})
    with pytest.raises(SpecError, match="'p' is a point mass"):
        m.validate()


def test_a_run_that_leaves_the_table_says_so() -> None:
    model = wheel()
    model["joints"]["rolls"]["center"]["x"] = {"table": [[0.0, 1.2], [0.0, -1.2 * R]]}
    found = run(model, gauss(3), 2.0, 0.005)
    phi, _ = rolled(found.time)
    assert phi.max() > 1.2
    np.testing.assert_allclose(found["wheel"].angle, phi, rtol=0, atol=2e-11)  # two points make a line, which goes on
    (warning,) = found.warnings
    assert "joint 'rolls' turned to" in warning
    assert "model.joints.rolls.center.x, which covers 0 rad to 1.2 rad" in warning


@pytest.mark.parametrize(
    "text",
    [
        "angle**3 - 2*angle", "sin(2*angle)/(2 + cos(angle))", "exp(-angle)*sqrt(1 + angle**2)",
        "tanh(angle) + tan(angle/3)", "atan(angle) + asin(angle/3) - acos(angle/4)", "log(3 + angle)**2.5",
        "2**angle + (2 + angle)**angle", "-angle/(3 - angle)",
    ],
)  # fmt: skip
def test_three_derivatives_of_an_expression_are_those_of_sympy(text: str) -> None:
    import sympy as sp

    from mbdkit.expressions.jets import jet_and_switches
    from mbdkit.expressions.program import derivative_of
    from mbdkit.mechanism.angle_function import expression_of

    at = np.array([-0.7, 0.2, 1.3])
    program = expression_of(text).program
    value, slope = (jet_and_switches(one, at)[0].derivatives.T for one in (program, derivative_of(program)))
    x = sp.Symbol("angle")
    expected = [
        np.array([float(sp.sympify(text).diff(x, order).evalf(30, {x: one})) for one in at]) for order in range(4)
    ]
    np.testing.assert_allclose(value, expected[:3], rtol=1e-12)
    np.testing.assert_allclose(slope, expected[1:], rtol=1e-12)
