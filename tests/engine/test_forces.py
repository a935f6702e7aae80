"""Applied forces, their tangents, powers and potentials, against potentials and rates written here by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mbdkit.engine.kernels.table_rows import BODIES
from mbdkit.mechanism.mechanism import Mechanism

from .compiled import Compiled, assert_close, gradient, place

STIFFNESS, DAMPING, FREE = 70.0, 3.0, 0.8
POINT_A, POINT_B = (0.3, -0.2), (-0.4, 0.5)
T = 0.37


def two_bodies(seed: int = 0) -> Mechanism:
    rng = np.random.default_rng(seed)
    m = Mechanism()
    for i, name in enumerate("ab"):
        place = {"position": rng.normal(size=2), "angle": rng.normal()}
        speed = {"velocity": rng.normal(size=2), "angular_velocity": rng.normal()}
        m.body(name, mass=1.0 + i, inertia=0.3 + i, **place, **speed)
    return m


def spring(m: Mechanism, a: str = "a", b: str = "b") -> None:
    m.spring_damper("s", a, b, points=(POINT_A, POINT_B), stiffness=STIFFNESS, damping=DAMPING, free_length=FREE)


def torsion(m: Mechanism, a: str = "a", b: str = "b") -> None:
    m.torsion_spring("s", a, b, stiffness=STIFFNESS, damping=DAMPING, free_angle=FREE)


def law_on(along: str) -> Callable[..., None]:
    """Return a function that puts the linear law on a coordinate of b's point in a's frame."""

    def add(m: Mechanism, a: str = "a", b: str = "b") -> None:
        points = ((0.0, 0.0), POINT_B)
        m.law("s", a, b, law="linear", along=along, points=points,
              stiffness=STIFFNESS, damping=DAMPING, free_length=FREE)  # fmt: skip

    return add


NUMBER = {"a": 0, "b": 1, "ground": 2}


def spring_length(a: str, b: str) -> Callable[[Any], Any]:
    def length(q: Any) -> Any:
        gap = place(q, NUMBER[b], POINT_B) - place(q, NUMBER[a], POINT_A)
        return np.sqrt(gap[0] ** 2 + gap[1] ** 2)

    return length


def torsion_angle(a: str, b: str) -> Callable[[Any], Any]:
    return lambda q: q[3 * NUMBER[b] + 2] - q[3 * NUMBER[a] + 2]


def coordinate(column: int) -> Callable[[str, str], Callable[[Any], Any]]:
    """Return the length of a pathway along x or y: R(theta_a)^T (p_b - r_a)."""

    def length_of(a: str, b: str) -> Callable[[Any], Any]:
        def length(q: Any) -> Any:
            first = q[3 * NUMBER[a] : 3 * NUMBER[a] + 3]
            x, y = place(q, NUMBER[b], POINT_B) - first[:2]
            c, s = np.cos(first[2]), np.sin(first[2])
            return (c * x + s * y, c * y - s * x)[column]

        return length

    return length_of


springs = pytest.mark.parametrize(
    ("add", "length"),
    [
        pytest.param(spring, spring_length, id="spring-damper"),
        pytest.param(torsion, torsion_angle, id="torsion"),
        pytest.param(law_on("x"), coordinate(0), id="x"),
        pytest.param(law_on("y"), coordinate(1), id="y"),
    ],
)
ends = pytest.mark.parametrize("ends", [("a", "b"), ("b", "a"), ("ground", "b"), ("a", "ground")], ids="-".join)
seeds = pytest.mark.parametrize("seed", range(3))


@springs
@ends
@seeds
def test_a_spring_pulls_by_the_gradient_of_its_potential_and_of_its_dissipation(
    add: Any, length: Any, ends: tuple[str, str], seed: int
) -> None:
    # expected: Q = -d/dq [k (s - s0)^2 / 2] - d/dv [c s'^2 / 2], derivatives by complex step
    m = two_bodies(seed)
    add(m, *ends)
    c = Compiled(m)
    s = length(*ends)
    slope = gradient(s, c.q)
    slope[6:] = 0.0
    expected = -gradient(lambda q: STIFFNESS / 2 * (s(q) - FREE) ** 2, c.q) - DAMPING * (slope @ c.v) * slope
    c.tangents()
    assert_close(c.scratch.force[:6], expected[:6])


@springs
@ends
@seeds
def test_tangents_of_a_spring_are_the_derivatives_of_its_force(
    add: Any, length: Any, ends: tuple[str, str], seed: int
) -> None:
    # expected: K = -dQ/dq and C = -dQ/dv; central differences of the compiled force, step 1e-5: error 1e-9 relative
    m = two_bodies(seed)
    add(m, *ends)
    c = Compiled(m)

    def force(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        c.q, c.v = q, v
        c.tangents()
        return c.scratch.force[:6].copy()

    q, v, h = c.q.copy(), c.v.copy(), 1e-5
    units = np.eye(9)[:6] * h
    stiffness = -np.array([(force(q + e, v) - force(q - e, v)) / (2 * h) for e in units]).T
    damping = -np.array([(force(q, v + e) - force(q, v - e)) / (2 * h) for e in units]).T
    c.q, c.v = q, v
    c.tangents()
    for found, expected in ((c.scratch.spring_stiff, stiffness), (c.scratch.spring_damp, damping)):
        assert_close(assembled(c, found[0]), expected, tolerance=1e-8)


def assembled(c: Compiled, entries: np.ndarray) -> np.ndarray:
    """Return the (6, 6) matrix of bodies a and b from the 36 entries of the one spring."""
    full = np.zeros((9, 9))
    first, second = c.top.springs[0, BODIES]
    places = [3 * body + i for body in (first, second) for i in range(3)]
    full[np.ix_(places, places)] += entries.reshape(6, 6)
    return full[:6, :6]


def loads(m: Mechanism) -> None:
    m.torque("t", "a", value="1 + 2*t", reaction_body="b")
    m.torque("alone", "b", value=-0.7)
    m.force("f", "b", value=[3.0, "2*cos(t)"], point=POINT_B)


def test_loads_act_where_and_how_they_say() -> None:
    # expected: written by hand; a torque has its reaction on reaction_body, a force its arm R s
    c = Compiled(two_bodies(), T)
    loads(c.mechanism)
    c = Compiled(c.mechanism, T)
    fx, fy, torque = 3.0, 2 * np.cos(T), 1 + 2 * T
    arm = place(c.q, 1, POINT_B) - c.q[3:5]
    c.tangents()
    expected = [0.0, 0.0, torque, fx, fy, -torque - 0.7 + arm[0] * fy - arm[1] * fx]
    assert_close(c.scratch.force[:6], expected)


def test_a_force_in_the_frame_of_its_body_turns_with_it() -> None:
    # expected: R(theta) F at the point, written by hand, its derivatives with respect to theta by complex step
    m = two_bodies()
    m.force("f", "b", value=[3.0, "2*cos(t)"], point=POINT_B, frame="body")
    c = Compiled(m, T)
    local = (3.0, 2 * np.cos(T))

    def force(q: Any) -> Any:
        turned = place(q, 1, local) - q[3:5]
        arm = place(q, 1, POINT_B) - q[3:5]
        return np.array([*turned, arm[0] * turned[1] - arm[1] * turned[0]])

    c.tangents()
    assert_close(c.scratch.force[3:6], force(c.q))
    by_angle = -gradient(force, c.q)[:, 5]
    assert_close(c.scratch.load_stiff, [[by_angle[0], by_angle[1], 0.0]])
    assert_close(by_angle[2], 0.0, size=1.0)
    work, lost = c.powers()
    speed = gradient(lambda q: place(q, 1, POINT_B), c.q)[:, :6] @ c.v[:6]
    assert_close(work, force(c.q)[:2] @ speed)
    assert lost == 0.0


@seeds
def test_powers_are_force_times_velocity(seed: int) -> None:
    # expected: loads' work rate F.v of the point and torque times relative rate; dissipation c s'^2
    m = two_bodies(seed)
    loads(m)
    spring(m)
    m.torsion_spring("twist", "a", "b", stiffness=4.0, damping=0.6)
    c = Compiled(m, T)
    work, lost = c.powers()
    q, v = c.q, c.v
    speed = gradient(lambda q: place(q, 1, POINT_B), q)[:, :6] @ v[:6]
    expected = 3.0 * speed[0] + 2 * np.cos(T) * speed[1] + (1 + 2 * T) * (v[2] - v[5]) - 0.7 * v[5]
    rate = gradient(spring_length("a", "b"), q)[:6] @ v[:6]
    assert_close(work, expected)
    assert_close(lost, DAMPING * rate**2 + 0.6 * (v[5] - v[2]) ** 2)


@seeds
def test_energies_are_those_of_masses_heights_and_springs(seed: int) -> None:
    # expected: by hand; gravity's potential is zero at the global origin, a spring's at its free length
    m = two_bodies(seed)
    m.gravity = (1.5, -9.0)
    spring(m)
    m.torsion_spring("twist", "ground", "b", stiffness=4.0, free_angle=-0.3)
    c = Compiled(m)
    (kinetic, potential), *_ = c.observed()
    q, v = c.q, c.v
    assert_close(kinetic, (v[0] ** 2 + v[1] ** 2 + 0.3 * v[2] ** 2) / 2 + v[3] ** 2 + v[4] ** 2 + 0.65 * v[5] ** 2)
    height = -1.5 * q[0] + 9.0 * q[1] + 2 * (-1.5 * q[3] + 9.0 * q[4])
    stretch = spring_length("a", "b")(q) - FREE
    assert_close(potential, height + STIFFNESS / 2 * stretch**2 + 2.0 * (q[5] + 0.3) ** 2)


@pytest.mark.parametrize("free", [0.0, 0.5])
def test_a_spring_through_coincident_points_has_no_direction_and_no_force(free: float) -> None:
    m = Mechanism()
    m.body("a", mass=1.0, inertia=1.0, position=(0.2, 0.1), velocity=(1.0, 0.0))
    m.spring_damper("s", "ground", "a", points=((0.2, 0.1), (0, 0)), stiffness=9.0, damping=2.0, free_length=free)
    c = Compiled(m)
    c.tangents()
    assert not np.any(c.scratch.force)
    assert np.all(np.isfinite(c.scratch.source))
    assert_close(c.accelerations()[0], [0.0, -9.81, 0.0])
    assert np.all(np.isfinite(c.powers()))
