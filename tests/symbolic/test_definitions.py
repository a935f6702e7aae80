"""Every element's position-level function against a formula with rotation matrices, written here by hand."""

from __future__ import annotations

import numpy as np
import pytest

from .kernels import GROUND, Element, assert_close


def turn(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def point(e: Element, body: int, place: int) -> np.ndarray:
    """Return where a point of a body is: r + R(theta) s."""
    x, y, angle = e.q[3 * body : 3 * body + 3]
    return np.array([x, y]) + turn(angle) @ e.p[0, place : place + 2]


ends = pytest.mark.parametrize("ends", [(0, 1), (GROUND, 1), (0, GROUND)])


@ends
@pytest.mark.parametrize("seed", range(3))
def test_a_revolute_is_the_gap_between_its_points(ends: tuple[int, int], seed: int) -> None:
    e = Element("revolute", *ends, seed)
    phi, phi_t = e.position(e.q, e.u)
    assert_close(phi, point(e, ends[1], 2) - point(e, ends[0], 0))
    assert not np.any(phi_t)


@ends
@pytest.mark.parametrize("seed", range(3))
def test_a_distance_is_the_length_of_the_gap_less_its_own(ends: tuple[int, int], seed: int) -> None:
    e = Element("distance", *ends, seed)
    phi, _ = e.position(e.q, e.u)
    assert_close(phi, [np.hypot(*(point(e, ends[1], 2) - point(e, ends[0], 0))) - e.p[0, 4]], size=1.0)


@ends
def test_an_angle_driver_prescribes_the_second_angle_less_the_first(ends: tuple[int, int]) -> None:
    e = Element("driver_angle", *ends, 0)
    phi, phi_t = e.position(e.q, e.u)
    assert_close(phi, [e.q[3 * ends[1] + 2] - e.q[3 * ends[0] + 2] - e.u[0, 0]])
    assert_close(phi_t, [-e.u[0, 1]])


@ends
@pytest.mark.parametrize("seed", range(3))
def test_a_coordinate_driver_prescribes_the_point_of_the_second_body_in_the_frame_of_the_first(
    ends: tuple[int, int], seed: int
) -> None:
    e = Element("driver_travel", *ends, seed)
    phi, phi_t = e.position(e.q, e.u)
    origin = e.q[3 * ends[0] : 3 * ends[0] + 2]
    seen = turn(e.q[3 * ends[0] + 2]).T @ (point(e, ends[1], 2) - origin)
    assert_close(phi, [e.p[0, 4:6] @ seen - e.u[0, 0]], size=1.0)
    assert_close(phi_t, [-e.u[0, 1]])


@ends
@pytest.mark.parametrize("seed", range(3))
def test_a_point_on_a_line_is_as_far_from_it_as_the_gap_goes_along_its_normal(ends: tuple[int, int], seed: int) -> None:
    e = Element("point_on_line", *ends, seed)
    phi, phi_t = e.position(e.q, e.u)
    axis = turn(e.q[3 * ends[0] + 2]) @ e.p[0, 4:6]
    gap = point(e, ends[1], 2) - point(e, ends[0], 0)
    assert_close(phi, [axis[0] * gap[1] - axis[1] * gap[0]], size=1.0)
    assert not np.any(phi_t)


@ends
def test_a_fixed_angle_holds_the_second_angle_less_the_first(ends: tuple[int, int]) -> None:
    e = Element("fixed_angle", *ends, 0)
    phi, phi_t = e.position(e.q, e.u)
    assert_close(phi, [e.q[3 * ends[1] + 2] - e.q[3 * ends[0] + 2] - e.p[0, 4]])
    assert not np.any(phi_t)


@ends
def test_pathways_measure_the_distance_of_two_points_and_the_relative_angle(ends: tuple[int, int]) -> None:
    e = Element("two_points", *ends, 0)
    assert_close(e.gradient(e.q)[0], np.hypot(*(point(e, ends[1], 2) - point(e, ends[0], 0))))
    e = Element("relative_angle", *ends, 0)
    assert_close(e.gradient(e.q)[0], e.q[3 * ends[1] + 2] - e.q[3 * ends[0] + 2])


def test_a_point_pendulum_needs_the_centripetal_acceleration() -> None:
    # expected: a rod pinned at s from its centre and turning at rate w has Phi_q a = w^2 R s
    e = Element("revolute", GROUND, 0, 7)
    _, gamma = e.acceleration(e.q, e.v, e.u)
    assert_close(gamma, e.v[2] ** 2 * turn(e.q[2]) @ e.p[0, 2:4])


@ends
@pytest.mark.parametrize("seed", range(3))
def test_a_moving_center_is_the_gap_to_a_point_displaced_with_the_first_body(ends: tuple[int, int], seed: int) -> None:
    e = Element("moving_center", *ends, seed)
    phi, phi_t = e.position(e.q, e.u)
    first, second = (e.q[3 * body + 2] for body in ends)
    c = [np.polyval(coefficients, second - first) for coefficients in e.center]
    assert_close(phi, point(e, ends[1], 2) - point(e, ends[0], 0) - turn(first) @ c)
    assert not np.any(phi_t)
