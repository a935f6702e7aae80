"""Forces between two convex polygons in compliant contact: which corners act, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_contact.acting_contacts import contact_values

G = 9.81
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
    assert np.ptp(sizes) < 1e-9


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
    assert np.abs(done.energy.balance).max() < 1e-6


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
