"""Assembly: a consistent start is left alone, an approximate one is moved by the least amount in the mass metric."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import null_space

from mbdkit.base.errors import SpecError
from mbdkit.engine.assembly import AssembledState, assemble
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.least_change import LeastChange
from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.mechanism import Mechanism
from tests.margins import assert_within

from .compiled import Compiled
from .random_mechanisms import add_rod


def four_bar(noise: float, seed: int = 0) -> Mechanism:
    """Return a four-bar linkage with a slider driven along its coupler, its bodies displaced by `noise`."""
    rng = np.random.default_rng(seed)
    m = Mechanism()
    corners = [np.array(p) for p in ((0.0, 0.0), (0.3, 1.0), (2.0, 1.4), (2.4, 0.1))]
    names = ["crank", "coupler", "rocker"]
    for name, p, r in zip(names, corners, corners[1:], strict=False):
        along = r - p
        place = {"position": (p + r) / 2, "angle": math.atan2(along[1], along[0])}
        m.body(name, mass=1.0 + rng.random(), inertia=0.1 + rng.random(), **place)
    m.body("slider", mass=0.4, position=(corners[1] + corners[2]) / 2)
    for i, (a, b) in enumerate(pairwise(["ground", *names, "ground"])):
        m.revolute(f"J{i}", a, b, at=corners[i])
    m.driver("x", "coupler", "slider", coordinate="x", motion="0.2*sin(3*t)")
    m.driver("y", "coupler", "slider", coordinate="y", motion="0.1*t")
    for name, body in m.bodies.items():
        values = {
            "position": tuple(body.position + noise * rng.normal(size=2)),
            "angle": body.angle + noise * rng.normal() * (body.inertia is not None),
            "velocity": tuple(rng.normal(size=2)),
            "angular_velocity": rng.normal() * (body.inertia is not None),
        }
        m.bodies[name] = body.model_copy(update=values)
    return m


def test_a_slide_and_a_weld_keep_the_angle_as_given_and_not_as_assembled() -> None:
    # expected: the bodies' own angles in the spec, although assembly turns the first of them
    m = Mechanism()
    m.body("frame", mass=1.0, inertia=1.0, position=(0.1, 0.0), angle=0.4)
    m.body("block", mass=2.0, inertia=1.0, position=(1.0, 0.7), angle=0.5)
    m.body("fin", mass=0.5, inertia=0.2, position=(1.4, 1.0), angle=-0.3)
    m.driver("tilt", m.ground, "frame", coordinate="angle", motion=1.0)
    m.prismatic("P", "frame", "block", points=((0.0, 0.1), (0.2, 0.0)), axis=(1.0, 1.0))
    m.weld("W", "block", "fin", points=((0.3, 0.0), (0.0, 0.0)))
    start = assemble(m)
    np.testing.assert_allclose(start.q[:, 2], (1.0, 1.1, 0.3), rtol=0, atol=1e-12)
    c = Compiled(m)
    assert_within(c.constraints(with_ground(start.q))[0], 1e-12)


def test_a_slide_that_cannot_meet_its_angle_is_named() -> None:
    m = Mechanism()
    m.body("block", mass=1.0, inertia=1.0, position=(0.0, 0.0))
    m.prismatic("P", m.ground, "block", at=(0.0, 0.0), axis=(1.0, 0.0), angle=0.2)
    m.driver("turn", m.ground, "block", coordinate="angle", motion=0.0)
    with pytest.raises(SpecError, match=r"these joints cannot be assembled at t = 0 s: .*P \(0\.1 rad\)"):
        assemble(m)


def given(m: Mechanism) -> tuple[np.ndarray, np.ndarray]:
    q = np.array([(*body.position, body.angle) for body in m.bodies.values()])
    v = np.array([(*body.velocity, body.angular_velocity) for body in m.bodies.values()])
    return q, v


def masses(m: Mechanism) -> np.ndarray:
    return np.array([(b.mass, b.mass, b.inertia or 1.0) for b in m.bodies.values()]).ravel()


def placed(m: Mechanism, state: AssembledState, t: float = 0.0) -> Compiled:
    """Return the mechanism compiled, at the assembled state."""
    c = Compiled(m, t)
    c.q, c.v = with_ground(state.q), with_ground(state.v)
    return c


@pytest.mark.parametrize("seed", range(4))
def test_the_change_is_the_least_one_in_the_mass_metric(seed: int) -> None:
    # expected: optimality; M (q - q0) and M (v - v0) are constraint forces, without a part along the free motions
    m = four_bar(0.05, seed)
    q, v = given(m)
    state = assemble(m, 0.3)
    c = placed(m, state, 0.3)
    _, _, jacobian, _ = c.constraints(c.q)
    free = null_space(jacobian)
    assert free.shape[1] == 2  # the linkage's freedom, and the idle turning of the point mass
    for change in (state.q - q, state.v - v):
        pull = masses(m) * change.ravel()
        assert_within(free.T @ pull, 1e-8 * np.abs(pull).max())


@pytest.mark.parametrize("fix", [(), ("crank",)])
def test_the_system_of_each_step_is_that_of_dense_matrices(fix: tuple[str, ...]) -> None:
    # expected: [M + K, J^T; J, -e] [step, mu] = [-gradient, -gap] by NumPy, with e of 1e-13
    m, rng = four_bar(0.05), np.random.default_rng(4)
    fixed = np.repeat([name in fix for name in m.bodies], 3)
    search = LeastChange(compile_mechanism(m), 0.0, fixed)
    q = given(m)[0].ravel()
    phi, (row, column, value), _ = search.evaluate(q)
    n, rows = len(q), len(phi)
    jacobian, hessian = np.zeros((rows, n)), np.diag(search.mass)
    np.add.at(jacobian, (row, column), value)
    entries = search.stiffness(q, rng.standard_normal(rows))
    gradient = rng.standard_normal(n)
    for stiffness in (None, entries):
        if stiffness is not None:
            np.add.at(hessian, (stiffness[0], stiffness[1]), stiffness[2])
        j, free = jacobian[:, ~fixed], ~fixed
        small = -1e-13 * np.diag(j**2 @ (1 / search.mass[free]))
        dense = np.block([[hessian[np.ix_(free, free)], j.T], [j, small]])
        step, mu = search.kkt((row, column, value), stiffness)(gradient, phi)
        assert not np.any(step[fixed])
        expected = np.linalg.lstsq(dense, np.concatenate([-gradient[free], -phi]))[0]
        np.testing.assert_allclose(step[free], expected[: len(j.T)], rtol=1e-9, atol=1e-9)
        if not fix:
            np.testing.assert_allclose(mu, expected[len(j.T) :], rtol=1e-9, atol=1e-9)


def test_a_consistent_start_is_left_untouched_to_the_bit() -> None:
    m = four_bar(0.05)
    first = assemble(m, 0.3)
    for i, (name, body) in enumerate(m.bodies.items()):
        x, y, angle = (float(z) for z in first.q[i])
        vx, vy, rate = (float(z) for z in first.v[i])
        found = {"position": (x, y), "angle": angle, "velocity": (vx, vy), "angular_velocity": rate}
        m.bodies[name] = body.model_copy(update=found)
    again = assemble(m, 0.3)
    assert not again.changed
    assert again.q.tobytes() == first.q.tobytes()
    assert again.v.tobytes() == first.v.tobytes()
    assert "left untouched" in again.describe()


def test_a_start_within_the_tolerance_is_left_untouched_to_the_bit() -> None:
    m = Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, position=(0.5 + 4e-4, 0.0))
    m.revolute("A", m.ground, "rod", points=((0, 0), (-0.5, 0)))
    m.hold(tolerance=1e-3)
    state = assemble(m)
    assert not state.changed
    assert state.q.tolist() == [[0.5 + 4e-4, 0.0, 0.0]]
    assert state.residual == pytest.approx(4e-4)


def test_fixed_bodies_stay_where_they_are() -> None:
    m = four_bar(0.05)
    m.hold("crank")
    m.bodies["crank"] = Body(mass=1.0, inertia=1.0, position=(0.15, 0.5), angle=math.atan2(1.0, 0.3))
    q, v = given(m)
    state = assemble(m, 0.3)
    np.testing.assert_array_equal(state.q[0], q[0])
    np.testing.assert_array_equal(state.v[0], v[0])
    assert state.moved_position["crank"] == state.moved_angle["crank"] == 0.0
    assert state.moved_position["coupler"] > 0.0
    assert_within(state.residual, 1e-12)
    assert_within(state.velocity_residual, 1e-12)


def test_the_report_says_what_moved_by_how_much() -> None:
    m = four_bar(0.05)
    q, v = given(m)
    state = assemble(m, 0.3)
    for i, name in enumerate(m.bodies):
        assert state.moved_position[name] == pytest.approx(np.hypot(*(state.q[i] - q[i])[:2]))
        assert state.moved_angle[name] == pytest.approx(abs(state.q[i, 2] - q[i, 2]))
        assert state.changed_velocity[name] == pytest.approx(np.hypot(*(state.v[i] - v[i])[:2]))
        assert state.changed_rate[name] == pytest.approx(abs(state.v[i, 2] - v[i, 2]))
    most = max(state.moved_position, key=lambda name: state.moved_position[name])
    assert f"{most} {state.moved_position[most]:.3g} m" in state.describe()


def apart(kind: str) -> tuple[Mechanism, set[str]]:
    """Return a mechanism that cannot be assembled, and the joints that are to be named."""
    m = Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("A", m.ground, "rod", points=((0.0, 0.0), (-0.5, 0.0)))
    if kind == "too far":
        m.revolute("B", "rod", m.ground, points=((0.5, 0.0), (2.0, 0.0)))
        return m, {"A", "B"}
    if kind == "too long":
        m.distance("B", "rod", m.ground, points=((0.5, 0.0), (0.5, 0.0)), length=3.0)
        return m, {"A", "B"}
    if kind == "held":
        m.bodies["rod"] = m.bodies["rod"].model_copy(update={"position": (0.7, 0.0)})
        m.hold("rod")
        return m, {"A"}
    m.driver("D", m.ground, "rod", coordinate="angle", motion="0.3 + t")
    m.driver("E", m.ground, "rod", coordinate="angle", motion="0.3 + 2*t")
    return m, {"D", "E"}


@pytest.mark.parametrize("kind", ["too far", "too long", "held", "driven apart"])
def test_joints_that_cannot_meet_are_named(kind: str) -> None:
    m, names = apart(kind)
    with pytest.raises(SpecError) as caught:
        assemble(m)
    message = str(caught.value)
    assert any(f"{name} (" in message for name in names)
    assert ("have consistent velocities" if kind == "driven apart" else "be assembled") in message
    if kind == "held":
        assert "while rod stay fixed" in message or "while rod stays fixed" in message


def test_a_driver_at_a_later_start_sets_position_and_rate() -> None:
    # expected: the motion and its derivative at t0 = 2
    m = Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("A", m.ground, "rod", at=(0.0, 0.0))
    m.driver("D", m.ground, "rod", coordinate="angle", motion="0.1*t**2")
    state = assemble(m, 2.0)
    angle, rate = 0.4, 0.4
    c, s = 0.5 * math.cos(angle), 0.5 * math.sin(angle)
    np.testing.assert_allclose(state.q, [[c, s, angle]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(state.v, [[-s * rate, c * rate, rate]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("n", [10, 200])
def test_a_long_chain_of_rods_put_down_roughly_is_assembled(n: int) -> None:
    rng = np.random.default_rng(n)
    m = Mechanism()
    end, before = np.zeros(2), m.ground
    for i in range(n):
        start, end = end, add_rod(m, rng, f"r{i}", end, rng.uniform(-0.5, 0.5))
        m.revolute(f"J{i}", before, f"r{i}", at=start)
        before = f"r{i}"
    for name, body in m.bodies.items():
        moved = tuple(body.position + 0.02 * rng.normal(size=2))
        m.bodies[name] = body.model_copy(update={"position": moved, "angle": body.angle + 0.02 * rng.normal()})
    state = assemble(m)
    assert_within(state.residual, 1e-12)
    assert_within(state.velocity_residual, 1e-10)
    assert max(state.moved_position.values()) < 0.5


def test_a_mechanism_far_from_the_origin_is_assembled_to_its_round_off() -> None:
    m = Mechanism()
    m.body("rod", mass=1.0, inertia=0.1, position=(1e6 + 0.52, 3e5), angle=0.01)
    m.revolute("A", m.ground, "rod", points=((1e6, 3e5), (-0.5, 0.0)))
    assert_within(assemble(m).residual, 1e-9)


def test_a_rod_that_lies_opposite_to_its_pin_is_assembled() -> None:
    # the matrix of Newton's method is singular. Expected: turned by phi, with the centre at 0.5 (cos phi, sin phi), the
    # squared distance is 0.5 (1 + cos phi) + 0.25 phi^2, least at phi = 0
    m = Mechanism()
    m.body("rod", mass=1.0, inertia=0.25, position=(-0.5, 0.0))
    m.revolute("A", m.ground, "rod", points=((0.0, 0.0), (-0.5, 0.0)))
    state = assemble(m)
    assert_within(state.residual, 1e-12)
    np.testing.assert_allclose(state.q, [[0.5, 0.0, 0.0]], rtol=0, atol=1e-9)
