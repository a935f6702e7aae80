"""The distance to singularity: against dense singular value decompositions of the same Jacobians."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.singularity import describe_nearness, nearest_singularity
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import load_spec
from tests.engine.random_mechanisms import chain, driven_frame, ladder, loop, slides, tree

ACCURATE = 0.01


def singular_values(p: EquationsOfMotion, t: float, q: np.ndarray) -> np.ndarray:
    """Return the singular values of the scaled Jacobian at a position (n,), largest first, by LAPACK."""
    jacobian = p.constraint_jacobian(t, q).toarray() / np.sqrt(p.mass)
    blocks: dict[str, list[int]] = {}
    for i, name in enumerate(p.constraint_names):
        joint, row = name.rsplit(".", 1)
        blocks.setdefault(joint if row in ("x", "y") else name, []).append(i)
    for rows in blocks.values():
        factor = np.linalg.cholesky(jacobian[rows] @ jacobian[rows].T)
        jacobian[rows] = np.linalg.solve(factor, jacobian[rows])
    return np.linalg.svd(jacobian, compute_uv=False)


def positions(run: Any, p: EquationsOfMotion) -> np.ndarray:
    """Return the recorded positions (T, n)."""
    parts = [np.column_stack([run[name].position, run[name].angle]) for name in p.bodies]
    return np.stack(parts, axis=1).reshape(len(run.time), p.n)


def recorded_and_expected(mechanism: Mechanism, **sections: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the recorded distances (T,) and the two smallest singular values (T, 2), smallest first."""
    p = EquationsOfMotion.of(mechanism)
    with mbdkit.run(mechanism, **sections) as run:
        expected = [singular_values(p, t, q) for t, q in zip(run.time, positions(run, p), strict=True)]
        return np.asarray(run.singularity_distance), np.array(expected)[:, :-3:-1]


def windows(n: int, angle: float = math.pi / 2, speed: float = 1.0) -> Mechanism:
    """Return n four-bar windows in a row, all rods 1 m and 1 kg: cranks A_i B_i, couplers B_i B_i+1."""
    m = Mechanism()
    c, s = math.cos(angle), math.sin(angle)
    cranks = []
    for i in range(n + 1):
        cranks.append(
            m.body(
                f"crank{i}", mass=1, inertia=1 / 12, position=(i + c / 2, s / 2), angle=angle,
                velocity=(speed * s / 2, -speed * c / 2), angular_velocity=-speed,
            )
        )  # fmt: skip
        m.revolute(f"A{i}", m.ground, cranks[-1], points=((i, 0), (-0.5, 0)))
    for i in range(n):
        position, velocity = (i + c + 0.5, s), (speed * s, -speed * c)
        coupler = m.body(f"coupler{i}", mass=1, inertia=1 / 12, position=position, velocity=velocity)
        m.revolute(f"B{i}", cranks[i], coupler, points=((0.5, 0), (-0.5, 0)))
        m.revolute(f"C{i}", cranks[i + 1], coupler, points=((0.5, 0), (0.5, 0)))
    return m


def two_apart() -> Mechanism:
    """Return two four-bars that share nothing and pass their singular positions one after the other."""
    m = Mechanism(gravity=(0, 0))
    for k, (angle, speed) in enumerate(((0.4, 1.0), (0.9, 1.3))):
        c, s = math.cos(angle), math.sin(angle)
        at = 10 * k
        rods = {
            "left": ((at + c / 2, s / 2), angle, (speed * s / 2, -speed * c / 2), -speed),
            "right": ((at + 2 + c / 2, s / 2), angle, (speed * s / 2, -speed * c / 2), -speed),
            "top": ((at + 1 + c, s), 0.0, (speed * s, -speed * c), 0.0),
        }
        held = {
            name + str(k): m.body(
                name + str(k), mass=1 + k, inertia=0.1, position=p, angle=a, velocity=v, angular_velocity=w
            )
            for name, (p, a, v, w) in rods.items()
        }
        left, right, top = held.values()
        m.revolute(f"A{k}", m.ground, left, points=((at, 0), (-0.5, 0)))
        m.revolute(f"B{k}", left, top, points=((0.5, 0), (-1, 0)))
        m.revolute(f"C{k}", top, right, points=((1, 0), (0.5, 0)))
        m.revolute(f"D{k}", m.ground, right, points=((at + 2, 0), (-0.5, 0)))
    return m


@pytest.mark.parametrize("name", ["knee", "watt-six-bar", "double-wishbone", "chain", "double-pendulum"])
def test_distance_on_the_way_is_the_smallest_singular_value_of_packaged_examples(name):
    found, expected = recorded_and_expected(
        load_spec(name).mechanism(), integrator={"name": "gauss", "stages": 2}, time={"steps": 60, "step": 0.005}
    )
    np.testing.assert_allclose(found, expected[:, 0], rtol=ACCURATE)


@pytest.mark.parametrize("n", [2, 8])
def test_distance_follows_through_singular_positions_where_as_many_values_vanish_as_there_are_windows(n):
    found, expected = recorded_and_expected(
        windows(n), integrator={"name": "gauss", "stages": 1}, time={"end": 0.9, "step": 0.001}
    )
    assert expected[:, 0].min() < 1e-3 < 0.05 < expected[:, 0].max()
    np.testing.assert_allclose(found, expected[:, 0], rtol=ACCURATE)


def test_distance_changes_over_from_one_loop_to_another_that_shares_no_body_with_it():
    found, expected = recorded_and_expected(
        two_apart(), integrator={"name": "gauss", "stages": 1}, time={"end": 0.85, "step": 0.005}
    )
    nearest = np.argsort(expected[:, 0])[:1]
    assert expected[nearest, 0] < 0.01
    np.testing.assert_allclose(found, expected[:, 0], rtol=ACCURATE)


def test_distance_of_the_pivoted_system_agrees_where_masses_are_far_apart():
    m = Mechanism()
    cart = m.body("cart", mass=1e-8, inertia=1e-9, velocity=(1, 0))
    pole = m.body("pole", mass=1.0, inertia=0.1, position=(0.0, 0.5), angle=1.4, velocity=(1, 0))
    m.prismatic("rail", m.ground, cart, points=((0, 0), (0, 0)), axis=(1, 0))
    m.revolute("pin", cart, pole, points=((0, 0), (-0.5, 0)))
    found, expected = recorded_and_expected(
        m, integrator={"name": "gauss", "stages": 2}, time={"end": 0.4, "step": 0.002}
    )
    np.testing.assert_allclose(found, expected[:, 0], rtol=ACCURATE)


def test_distance_of_a_redundant_mechanism_is_that_of_its_independent_rows():
    m = windows(1)
    m.body(
        "spare", mass=1, inertia=1 / 12, position=(0.5, 0.5), angle=math.pi / 2, velocity=(0.5, 0), angular_velocity=-1
    )
    m.revolute("A", m.ground, "spare", points=((0.5, 0), (-0.5, 0)))
    m.revolute("B", "coupler0", "spare", points=((0, 0), (0.5, 0)))
    found, expected = recorded_and_expected(
        m, integrator={"name": "gauss", "stages": 1}, time={"end": 0.8, "step": 0.005}
    )
    assert expected[:, 0].min() < 0.05
    np.testing.assert_allclose(found, expected[:, 0], rtol=ACCURATE)  # margin: accuracy that the estimate promises


def test_distance_of_one_joint_is_one_and_without_joints_there_is_none():
    with mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01}) as run:
        np.testing.assert_allclose(run.singularity_distance, 1.0, rtol=1e-12)
    m = Mechanism()
    m.body("ball", mass=1, inertia=1)
    with mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.01}) as run:
        assert not run.records("constraints/singularity_distance")


@pytest.mark.parametrize("grown", [chain, driven_frame, ladder, loop, slides, tree])
def test_nearest_singularity_is_the_smallest_singular_value_of_random_mechanisms(grown):
    m = grown(np.random.default_rng(1))
    p = EquationsOfMotion.of(m)
    distance, joint = nearest_singularity(p._workspace, p.t0, p.q0)
    assert distance == pytest.approx(singular_values(p, p.t0, p.q0)[-1], rel=1e-9, abs=1e-13)
    assert joint in m.joints


def test_nearest_singularity_of_many_rows_is_that_of_the_dense_decomposition():
    p = EquationsOfMotion.of(load_spec("chain", ("model.n=200",)).mechanism())
    distance, _ = nearest_singularity(p._workspace, p.t0, p.q0)
    assert distance == pytest.approx(singular_values(p, p.t0, p.q0)[-1], rel=1e-6)


def test_nearness_names_a_joint_of_the_loop_that_is_singular_and_keeps_quiet_elsewhere():
    m = two_apart()
    p = EquationsOfMotion.of(m)
    assert describe_nearness(p._workspace, 0.0, p.q0) == ""
    q = p.q0.reshape(-1, 3).copy()
    angle = 1e-7
    for name, x in (("left1", 10.0), ("right1", 12.0)):
        q[p.bodies.index(name)] = (x + math.cos(angle) / 2, math.sin(angle) / 2, angle)
    q[p.bodies.index("top1")] = (11 + math.cos(angle), math.sin(angle), 0.0)
    distance, joint = nearest_singularity(p._workspace, 0.0, q.ravel())
    assert distance == pytest.approx(singular_values(p, 0.0, q.ravel())[-1], rel=1e-6)
    assert joint.endswith("1")
    assert f"joint '{joint}'" in describe_nearness(p._workspace, 0.0, q.ravel())


@pytest.mark.parametrize("method", ["gauss", "dopri5", "scipy-radau"])
def test_a_dead_centre_is_named_by_the_angle_of_its_driver_and_not_blamed_on_the_step(method: str) -> None:
    # expected: coupler and rocker, 0.9 m each, are in line where the end of the crank of 1 m is 1.8 m from the pin at
    # 2 m: cos(angle) = (1 + 4 - 1.8^2) / 4
    dead = math.acos((1.0 + 4.0 - 1.8**2) / 4.0)
    link = {"mass": 1.0, "inertia": 0.1}
    places = {"a": [0.5, 0], "b": [1.2, 0.4], "c": [1.7, 0.4]}
    bodies = {name: {**link, "position": place} for name, place in places.items()}
    pins = {"A": ("ground", "a", [0, 0], [-0.5, 0]), "B": ("a", "b", [0.5, 0], [-0.45, 0]),
            "C": ("b", "c", [0.45, 0], [-0.45, 0]), "D": ("ground", "c", [2, 0], [0.45, 0])}  # fmt: skip
    joints: dict[str, Any] = {
        name: {"type": "revolute", "bodies": [a, b], "points": [p, q]} for name, (a, b, p, q) in pins.items()
    }
    joints["M"] = {"type": "driver", "bodies": ["ground", "a"], "coordinate": "angle", "motion": "0.5*t"}
    options = {"dopri5": {"adaptive": True}, "gauss": {"stages": 2}}.get(method, {})
    run = mbdkit.run(
        {
            "mbdkit": 1,
            "model": {"name": "mechanism", "gravity": [0, 0], "bodies": bodies, "joints": joints},
            "integrator": {"name": method, **options},
            "time": {"end": 6.0, "step": 0.01},
        }
    )
    assert run.status == "failed"
    assert "may help" not in run.status_reason
    angle = float(run.status_reason.partition("driver 'M' at ")[2].partition(" rad")[0])
    assert angle == pytest.approx(dead, abs=2 * 0.5 * 0.01)  # two steps
