"""The equations that a method written in NumPy sees are those of the mechanism, solved, projected and counted."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp

from mbdkit import EquationsOfMotion, Mechanism, StepError
from tests.engine.linkages_in_sympy import MECHANISMS, RNG, parallelogram, somewhere, symbolic
from tests.integrators.running import driven_chain
from tests.margins import assert_within
from tests.slow_cases import slow

T = 0.7


both = pytest.mark.parametrize("name", MECHANISMS)


@cache
def equations_of(name: str) -> EquationsOfMotion:
    return EquationsOfMotion.of(MECHANISMS[name]())


@both
def test_the_equations_are_those_of_the_symbolic_system(name: str) -> None:
    # expected: SymPy, from the mechanism's elements
    p = equations_of(name)
    q, v, a, lam = somewhere(p)
    there = symbolic(name).evaluate(T, q, v)
    close: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-12}
    np.testing.assert_array_equal(np.diag(p.mass), there["mass_matrix"])
    np.testing.assert_allclose(p.forces(T, q, v), there["forces"], **close)
    np.testing.assert_allclose(p.constraints(T, q), there["constraints"], **close)
    np.testing.assert_allclose(p.constraint_jacobian(T, q).toarray(), there["constraint_jacobian"], **close)
    np.testing.assert_allclose(p.gamma(T, q, v), there["gamma"], **close)
    found_a, found_lam = p.accelerations(T, q, v)
    np.testing.assert_allclose(found_a, there["accelerations"], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found_lam, there["multipliers"], rtol=1e-10, atol=1e-10)
    jacobian = there["constraint_jacobian"]
    np.testing.assert_allclose(p.constraint_forces(T, q, lam), jacobian.T @ lam, **close)
    np.testing.assert_allclose(p.residual(T, q, v, a, lam), p.mass * a + jacobian.T @ lam - there["forces"], **close)
    force, rows = RNG.standard_normal(p.n), RNG.standard_normal(p.m)
    x, mu = p.solve(T, q, force, rows)
    np.testing.assert_allclose(p.mass * x + jacobian.T @ mu, force, rtol=0, atol=1e-11)
    np.testing.assert_allclose(jacobian @ x, rows, rtol=0, atol=1e-12)


@both
def test_rates_of_the_constraints_are_their_total_derivative(name: str) -> None:
    # expected: d/dt Phi(t, q(t)) in SymPy
    p, s = equations_of(name), symbolic(name)
    q, v, _, _ = somewhere(p)
    total = s.constraints.jacobian(s.q) * s.v + s.constraints.diff(s.t)
    there = np.array(sp.lambdify([s.t, list(s.q), list(s.v)], total, cse=True)(T, q, v), dtype=float).ravel()
    np.testing.assert_allclose(p.constraint_rates(T, q, v), there, rtol=1e-12, atol=1e-12)


def tangents(name: str, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> list[np.ndarray]:
    """Return K, C, gamma_v and residual_q, differentiated by SymPy."""
    s = symbolic(name)
    lam_s, a_s = sp.Matrix(s.multipliers), sp.Matrix(s.accelerations)
    upper = s.constraint_jacobian.T * lam_s - s.forces
    lower = s.constraint_jacobian * a_s - s.gamma
    parts = [upper.jacobian(s.q), upper.jacobian(s.v), s.gamma.jacobian(s.v), lower.jacobian(s.q)]
    function = sp.lambdify([s.t, list(s.q), list(s.v), list(a_s), list(lam_s)], parts, cse=True)
    return [np.array(x, dtype=float) for x in function(T, q, v, a, lam)]


@pytest.mark.parametrize("name", ["driven chain", *slow("moved slider-crank")])
def test_tangents_and_iteration_matrix_are_the_derivatives(name: str) -> None:
    # expected: SymPy's derivatives, and dense linear algebra
    p = equations_of(name)
    q, v, a, lam = somewhere(p)
    k, c, gamma_v, residual_q = tangents(name, q, v, a, lam)
    found = p.tangents(T, q, v, a, lam)
    for mine, there in (
        (found.stiffness, k),
        (found.damping, c),
        (found.gamma_v, gamma_v),
        (found.residual_q, residual_q),
    ):
        np.testing.assert_allclose(mine.toarray(), there, rtol=1e-12, atol=1e-12)
    jacobian, force, rows = p.constraint_jacobian(T, q).toarray(), RNG.standard_normal(p.n), RNG.standard_normal(p.m)
    for factors in (
        {"damping": 1e-2, "stiffness": 1e-4},
        {"mass": 0.6, "damping": 1e-2, "stiffness": 1e-4, "gamma_v": -1e-2, "residual_q": 1e-4},
        {"damping": 1e-2 + 2e-3j, "stiffness": 1e-4 - 3e-5j},
    ):
        f = {"mass": 1.0, "damping": 0.0, "stiffness": 0.0, "gamma_v": 0.0, "residual_q": 0.0} | factors
        upper = f["mass"] * np.diag(p.mass) + f["damping"] * c + f["stiffness"] * k
        lower = jacobian + f["gamma_v"] * gamma_v + f["residual_q"] * residual_q
        dense = np.block([[upper, jacobian.T], [lower, np.zeros((p.m, p.m))]])
        there = np.linalg.solve(dense, np.concatenate([force, rows]))
        x, mu = p.iteration_matrix(T, q, v, a, lam, **factors).solve(force, rows)
        np.testing.assert_allclose(np.concatenate([x, mu]), there, rtol=1e-9, atol=1e-9 * np.abs(there).max())


@both
def test_a_matrix_stays_valid_while_others_come_and_go(name: str) -> None:
    p = equations_of(name)
    q, v, a, lam = somewhere(p)
    right = RNG.standard_normal(p.n), RNG.standard_normal(p.m)
    first = p.iteration_matrix(T, q, v, a, lam, stiffness=1e-3)
    before = first.solve(*right)[0]
    others = [p.iteration_matrix(T, q, v, a, lam, stiffness=x) for x in (2e-3, 4e-3)]
    assert not np.array_equal(others[0].solve(*right)[0], before)
    p.accelerations(T, q + 1.0, v)
    assert np.array_equal(first.solve(*right)[0], before)


@both
def test_accelerations_between_two_positions_solve_the_equations_of_a_half_explicit_stage(name: str) -> None:
    # expected: dense linear algebra with the Jacobians and rates of SymPy at both positions
    p, s = equations_of(name), symbolic(name)
    (q, v, _, _), (q_end, v_end, _, _), force, h = somewhere(p), somewhere(p), RNG.standard_normal(p.n), 0.03
    first, last = (s.evaluate(t, at, v)["constraint_jacobian"] for t, at in ((T, q), (T + h, q_end)))
    rates = p.constraint_rates(T + h, q_end, v_end)
    dense = np.block([[np.diag(p.mass), first.T], [h * last, np.zeros((p.m, p.m))]])
    there = np.linalg.solve(dense, np.concatenate([force, -rates]))
    before = p.counters.factorizations, p.counters.newton_iterations
    found = p.solve_between(T, q, force, T + h, q_end, v_end, h)
    np.testing.assert_allclose(np.concatenate(found), there, rtol=1e-9, atol=1e-9 * np.abs(there).max())
    np.testing.assert_allclose(p.constraint_rates(T + h, q_end, v_end + h * found[0]), 0.0, atol=1e-12)
    p.solve_between(T, q, force, T + h, q_end, v_end, h)
    assert p.counters.factorizations >= before[0] + 2
    assert p.counters.newton_iterations == before[1]
    again = EquationsOfMotion.of(MECHANISMS[name]())
    again.restore_pivots(p.stored_pivots())
    for mine, theirs in zip(again.solve_between(T, q, force, T + h, q_end, v_end, h), found, strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_jacobians_of_two_positions_that_do_not_fit_are_an_error() -> None:
    # the reaction of a rod of constant length along x cannot change a velocity along y, where the rod points there
    m = Mechanism()
    m.body("mass", mass=1.0, inertia=1.0, position=(1.0, 0.0))
    m.distance("rod", m.ground, "mass", points=((0.0, 0.0), (0.0, 0.0)), length=1.0)
    p, none = EquationsOfMotion.of(m), np.zeros(3)
    v_end = np.array([0.0, 1.0, 0.0])
    for q_end, code in (([0.0, 1.0, 0.0], "singular"), ([np.nan, 1.0, 0.0], "not-finite")):
        with pytest.raises(StepError) as error:
            p.solve_between(0.0, p.q0, none, 0.1, np.array(q_end), v_end, 0.1)
        assert error.value.code == code
    x, _ = p.solve_between(0.0, p.q0, none, 0.1, np.array([0.6, 0.8, 0.0]), v_end, 0.1)
    np.testing.assert_allclose(x, [-0.8 / 0.6 / 0.1, 0.0, 0.0], rtol=1e-14)


@both
def test_projected_positions_are_the_nearest_that_meet_the_joints(name: str) -> None:
    # expected: the conditions of least change in the mass metric, M (p - q) = -Phi_q(p)^T mu for some mu
    p = equations_of(name)
    q = p.project_positions(p.t0, p.q0) + 0.01 * RNG.standard_normal(p.n)
    found = p.project_positions(p.t0, q)
    np.testing.assert_allclose(p.constraints(p.t0, found), 0.0, atol=1e-14)
    pull = p.mass * (found - q)
    jacobian = p.constraint_jacobian(p.t0, found).toarray()
    mu = np.linalg.lstsq(jacobian.T, -pull, rcond=None)[0]
    np.testing.assert_allclose(jacobian.T @ mu, -pull, rtol=0, atol=1e-11)


@both
def test_projected_velocities_are_the_nearest_under_which_the_joints_stay_closed(name: str) -> None:
    p = equations_of(name)
    v = RNG.standard_normal(p.n)
    found = p.project_velocities(T, p.q0, v)
    np.testing.assert_allclose(p.constraint_rates(T, p.q0, found), 0.0, atol=2e-14)
    jacobian = p.constraint_jacobian(T, p.q0).toarray()
    mu = np.linalg.lstsq(jacobian.T, p.mass * (found - v), rcond=None)[0]
    np.testing.assert_allclose(jacobian.T @ mu, p.mass * (found - v), rtol=0, atol=1e-12)


@both
def test_a_projected_state_has_the_projected_positions_and_the_velocities_projected_there(name: str) -> None:
    # expected: the two projections, which the tests above compare with their definitions
    p = equations_of(name)
    q = p.project_positions(p.t0, p.q0) + 0.01 * RNG.standard_normal(p.n)
    v, before = RNG.standard_normal(p.n), p.counters.projections
    found_q, found_v = p.project(p.t0, q, v)
    assert p.counters.projections == before + 1
    np.testing.assert_array_equal(found_q, p.project_positions(p.t0, q))
    np.testing.assert_array_equal(found_v, p.project_velocities(p.t0, found_q, v))
    p.accelerations(p.t0, q, v)  # whose gravity a projection must not feel
    np.testing.assert_array_equal(p.project(p.t0, q, v)[0], found_q)


def test_a_position_that_cannot_be_projected_is_an_error() -> None:
    p = EquationsOfMotion.of(driven_chain())
    with pytest.raises(StepError, match="no position that satisfies the joints") as error:
        p.project(T, p.q0 + 1e3 * np.arange(p.n), p.v0)
    assert error.value.code == "newton-failed"


def test_powers_are_forces_times_velocities() -> None:
    # expected: the driver's multiplier times its rate, the torque 0.5 cos(3 t) times the rate of r3, and c (s')^2
    p = equations_of("driven chain")
    q, v, _, lam = somewhere(p)
    work, lost = p.powers(T, q, v, lam)
    motor = p.constraint_names.index("motor.angle")
    assert work == pytest.approx(0.5 * math.cos(3 * T) * v[11] - lam[motor] * 1.6 * math.cos(2 * T), rel=1e-12)
    damping = -p.tangents(T, q, v, v, lam).damping.toarray()
    assert lost == pytest.approx(-v @ damping @ v, rel=1e-12)


def test_what_is_done_is_counted() -> None:
    p = EquationsOfMotion.of(driven_chain())
    q, v, a, lam = somewhere(p)
    p.accelerations(T, q, v)
    p.residual(T, q, v, a, lam)
    p.forces(T, q, v)
    p.constraints(T, q)
    p.tangents(T, q, v, a, lam)
    p.project_velocities(T, q, v)
    c = p.counters
    assert (c.rhs_evaluations, c.jacobian_evaluations, c.projections, c.factorizations) == (3, 1, 1, 2)
    p.iteration_matrix(T, q, v, a, lam)
    before = c.jacobian_evaluations, c.factorizations
    matrix = p.iteration_matrix(T, q, v, a, lam)
    assert (c.jacobian_evaluations, c.factorizations) == (before[0] + 1, before[1] + 1)
    for _ in range(3):
        matrix.solve(q, lam)
    assert c.newton_iterations == 3


def readonly(x: np.ndarray) -> np.ndarray:
    out = x.copy()
    out.flags.writeable = False
    return out


@pytest.mark.parametrize("given", [list, lambda x: x.astype(np.float32), lambda x: np.repeat(x, 2)[::2], readonly])
def test_any_vector_of_the_right_length_will_do(given: Any) -> None:
    p = equations_of("driven chain")
    q = np.round(somewhere(p)[0] * 64) / 64
    np.testing.assert_array_equal(p.constraints(T, given(q)), p.constraints(T, q))


def test_a_wrong_length_is_told() -> None:
    p = equations_of("driven chain")
    with pytest.raises(ValueError, match=r"expected an array of shape \(12,\), got shape \(3,\)"):
        p.constraints(T, np.zeros(3))


def test_numbers_that_overflow_are_told() -> None:
    p = equations_of("driven chain")
    q, v, a, lam = somewhere(p)
    for call in (
        lambda: p.accelerations(T, q, v * 1e200),
        lambda: p.residual(T, q * np.nan, v, a, lam),
        lambda: p.constraints(T, q * np.inf),
        lambda: p.iteration_matrix(T, q, v, a, lam * np.nan),
        lambda: p.iteration_matrix(T, q, v, a, lam).solve(q * np.nan, lam),
    ):
        with pytest.raises(StepError) as error:
            call()
        assert error.value.code == "not-finite"


def test_a_mechanism_without_a_unique_solution_is_told_by_name() -> None:
    # the parallelogram laid flat: its rods and the ground lie on one line
    p = EquationsOfMotion.of(parallelogram(1.0, cranks=2))
    flat = np.array([2.5, 0.0, 0.0, 0.5, 0.0, 0.0, 3.5, 0.0, 0.0])
    assert_within(p.constraints(0.0, flat), 1e-15)
    nothing = np.zeros(p.n), np.zeros(p.m)
    for call in (
        lambda: p.accelerations(0.0, flat, p.v0),
        lambda: p.iteration_matrix(0.0, flat, p.v0, *nothing, stiffness=1e-6).solve(np.ones(p.n), np.ones(p.m)),
    ):
        with pytest.raises(StepError, match=r"system of equations is singular|too close to singular") as error:
            call()
        assert error.value.code == "singular"


@pytest.mark.parametrize("angle", [1.0, 0.5 * math.pi, -2.5])
def test_of_a_redundant_mechanism_the_independent_equations_are_seen(angle: float) -> None:
    # expected: the equations of motion themselves; accelerations of the parallelogram without its spare crank cannot
    # be compared, as that crank has a mass
    p = EquationsOfMotion.of(parallelogram(angle, cranks=3))
    assert (p.n, p.m) == (12, 11)
    v = p.project_velocities(T, p.q0, np.random.default_rng(1).standard_normal(p.n))
    a, lam = p.accelerations(T, p.q0, v)
    np.testing.assert_allclose(p.residual(T, p.q0, v, a, lam), 0.0, atol=1e-12)
    np.testing.assert_allclose(p.constraint_jacobian(T, p.q0) @ a, p.gamma(T, p.q0, v), atol=1e-12)
    np.testing.assert_allclose(p.constraint_jacobian(T, p.q0) @ v, 0.0, atol=1e-13)
    # one angle for all: the cranks turn alike, and the coupler does not
    cranks = v.reshape(-1, 3)[1:, 2]
    np.testing.assert_allclose(cranks, cranks[0], atol=1e-13)
    assert_within(v[2], 1e-13)
    push = p.constraint_forces(T, p.q0, lam)
    np.testing.assert_allclose(p.mass * a + push, p.forces(T, p.q0, v), atol=1e-12)
    everywhere = p.recorded_multipliers(T, p.q0, lam).reshape(-1, 2)  # of pins, Phi = p_b - p_a
    assert everywhere.shape == (6, 2)
    np.testing.assert_allclose(push[:2], everywhere[1::2].sum(axis=0), atol=1e-12)


def test_a_redundant_mechanism_is_projected_and_its_matrix_is_regular() -> None:
    p = EquationsOfMotion.of(parallelogram(1.0, cranks=3))
    q = p.project_positions(T, p.q0 + 1e-3 * np.random.default_rng(2).standard_normal(p.n))
    np.testing.assert_allclose(p.constraints(T, q), 0.0, atol=1e-14)
    angles = q.reshape(-1, 3)[1:, 2]
    np.testing.assert_allclose(angles, angles[0], atol=1e-13)
    a, lam = p.accelerations(T, q, p.v0)
    matrix = p.iteration_matrix(T, q, p.v0, a, lam, damping=1e-3, stiffness=1e-6)
    force, rows = np.arange(1.0, p.n + 1), np.arange(1.0, p.m + 1)
    x, mu = matrix.solve(force, rows)
    tangents = p.tangents(T, q, p.v0, a, lam)
    upper = p.mass * x + 1e-3 * (tangents.damping @ x) + 1e-6 * (tangents.stiffness @ x)
    np.testing.assert_allclose(upper + p.constraint_forces(T, q, mu), force, atol=1e-10)
    np.testing.assert_allclose(p.constraint_jacobian(T, q) @ x, rows, atol=1e-10)
    x, mu = p.solve_between(T, p.q0, force, T, q, p.v0, 0.1)
    np.testing.assert_allclose(p.mass * x + p.constraint_forces(T, p.q0, mu), force, atol=1e-10)
    np.testing.assert_allclose(p.constraint_rates(T, q, p.v0 + 0.1 * x), 0.0, atol=1e-12)


@both
def test_a_solution_with_given_right_sides_leaves_later_accelerations_alone(name: str) -> None:
    # expected: the accelerations before it, to the last bit
    p = EquationsOfMotion.of(MECHANISMS[name]())
    before = p.accelerations(T, p.q0, p.v0)
    p.solve(T, p.q0, RNG.standard_normal(p.n), RNG.standard_normal(p.m))
    for ours, expected in zip(p.accelerations(T, p.q0, p.v0), before, strict=True):
        np.testing.assert_array_equal(ours, expected)
