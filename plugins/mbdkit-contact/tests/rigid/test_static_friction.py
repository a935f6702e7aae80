"""Static friction above kinetic friction in time-stepping, against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.rigid.scenes import FLOOR, G, outline, run

import mbdkit
from mbdkit_contact.kernels.pivoting import new_cones, solve_cones
from tests.margins import assert_within


def coulomb(
    response: np.ndarray, normal: np.ndarray, tangent: np.ndarray, friction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal and tangential forces (k,) of k contacts; see `mbdkit_contact.kernels.pivoting.Cones`."""
    cones = new_cones(len(normal))
    cones.response[:], cones.free[:] = response, np.concatenate([normal, tangent])
    cones.friction[:] = friction
    assert solve_cones(cones, len(normal))
    along, across = np.split(cones.forces, 2)
    return along, across


METHODS = ("moreau-jean", "nonsmooth-generalized-alpha")
STEP = 1e-2


def feet(count: int) -> list[dict[str, Any]]:
    """Return the shapes of a block of 0.4 m by 0.06 m: a polygon, or a number of points on its lower side."""
    if count == 2:
        return [outline(0.2, 0.03)]
    return [{"point": [float(x), -0.03]} for x in np.linspace(-0.2, 0.2, count)]


def slid(method: str, count: int, friction: tuple[float, float], body: dict[str, Any], **more: Any) -> mbdkit.Run:
    static, kinetic = friction
    contacts = {
        f"foot{i}": {
            "bodies": ["ground", "block"], "shapes": [FLOOR, shape], "friction": {"static": static, "kinetic": kinetic},
        }
        for i, shape in enumerate(feet(count))
    }  # fmt: skip
    bodies = {"block": {"mass": 1.0, "inertia": 0.02, "position": [0.0, 0.03]} | body}
    return run({"bodies": bodies, "contacts": contacts} | more, 1.0, STEP, "time-stepping", method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("count", "height"), [(2, -0.03), (2, 0.02), (10, -0.03)])
def test_a_block_slips_if_the_push_exceeds_the_static_friction_of_all_feet(
    method: str, count: int, height: float
) -> None:
    # expected: rest until 5 t = 0.4 g, then x'' = 5 t - 0.2 g
    push = {"type": "force", "body": "block", "point": [0.0, height], "value": ["5*t", 0.0]}
    found = slid(method, count, (0.4, 0.2), {}, forces={"push": push})
    begin = 0.4 * G / 5.0
    after = 1.0 - begin
    x = (5.0 * begin - 0.2 * G) * after**2 / 2.0 + 5.0 * after**3 / 6.0
    # margin: error of mbdkit's method at these steps
    assert found["block"].position[-1, 0] == pytest.approx(x, abs=0.3 * STEP)
    # at rest, generalized-alpha creeps by 1.5e-8 m in each step, an error of its third order under a growing load
    # margin: error of mbdkit's method at these steps
    assert_within(found["block"].position[found.time < begin - STEP, 0], 2e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_block_that_slides_up_an_incline_stays_at_its_highest_place(method: str) -> None:
    # expected: v^2 / (2 g (sin a + 0.2 cos a)), and rest since tan a = 0.3 is between the coefficients
    angle = np.arctan(0.3)
    gravity = [-G * np.sin(angle), -G * np.cos(angle)]
    found = slid(method, 2, (0.4, 0.2), {"velocity": [1.0, 0.0]}, gravity=gravity)
    highest = 1.0 / (2.0 * G * (np.sin(angle) + 0.2 * np.cos(angle)))
    assert found["block"].position[-1, 0] == pytest.approx(highest, abs=0.3 * STEP)
    assert [found.contacts[f"foot0.{i}"].mode[-1] for i in range(2)] == [1.0, 1.0]


def test_a_block_at_rest_stays_at_rest_where_a_load_is_discontinuous() -> None:
    # expected: rest, since tan a = 0.3 and the load are below static friction; the modes are determined anew at 0.3 s
    angle = np.arctan(0.3)
    gravity = [-G * np.sin(angle), -G * np.cos(angle)]
    table = {"table": [[0.0, 0.3, 1.0], [0.0, 0.1, 0.1]], "interpolation": "linear"}
    push = {"type": "force", "body": "block", "point": [0.0, 0.0], "value": [table, 0.0]}
    found = slid("moreau-jean", 2, (0.4, 0.2), {}, gravity=gravity, forces={"push": push})
    assert_within(found["block"].position[:, 0], 1e-12)


def test_forces_of_contacts_in_almost_one_line_satisfy_the_laws() -> None:
    # a block whose feet differ in height by 3e-11 m: the rows of their slips are equal to nearly all digits
    small = 1.495727e-9
    response = np.array(
        [
            [3.25 - small, -1.25, -0.375000004362536, -0.374999995388176],
            [-1.25, 3.25 + small, 0.375000004611824, 0.374999995637464],
            [-0.375000004362536, 0.375000004611824, 1.0625 + small, 1.0625],
            [-0.374999995388176, 0.374999995637464, 1.0625, 1.0625 - small],
        ]
    )
    normal, tangent = np.array([-0.01978125, -0.01945875]), np.array([0.000456875000322, 0.000456874999678])
    pressed, pushed = coulomb(response, normal, tangent, np.array([0.4, 0.4]))
    after = np.concatenate([normal, tangent]) + response @ np.concatenate([pressed, pushed])
    assert after == pytest.approx(np.zeros(4), abs=1e-12)
    assert np.all(np.abs(pushed) <= 0.4 * pressed)
