"""The first-order form of the equations of motion: rates with states of elements, their derivatives, and energies."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import sympy as sp

import mbdkit
from mbdkit import EquationsOfMotion, StepError
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.spec import load_spec
from tests.engine.linkages_in_sympy import MECHANISMS, parallelogram, slider_crank, somewhere, symbolic

T = 0.3
WEIGHTS = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
"""Distances and weights of central differences of order 6."""


def test_rates_and_energies_of_muscles_are_those_recorded() -> None:
    # expected: the archive; its rates and energies are compared with papers and closed forms in tests/runs
    run = mbdkit.run("elbow-curl", time={"end": 0.3, "step": 0.002})
    p = EquationsOfMotion.of(load_spec("elbow-curl").mechanism())
    at = run.file
    np.testing.assert_array_equal(p.z0, at["states/value"][0])
    for i in (0, 7, 15):
        t, z = float(at["trajectory/time"][i]), at["states/value"][i]
        q, v = (at[f"trajectory/{name}"][i].ravel() for name in ("position", "velocity"))
        a, lam, rates = p.derivatives(t, q, v, z)
        np.testing.assert_allclose(rates, at["states/rate"][i], rtol=1e-12)
        np.testing.assert_allclose(a, at["trajectory/acceleration"][i].ravel(), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(
            p.recorded_multipliers(t, q, lam), at["constraints/multiplier"][i], rtol=1e-12, atol=1e-11
        )
        assert p.potential(t, q, z) == pytest.approx(at["energy/potential"][i], rel=1e-13)
        assert p.kinetic(v) == pytest.approx(at["energy/kinetic"][i], rel=1e-13)
    assert p.counters.rhs_evaluations == 3


def test_the_potential_has_the_forces_as_its_gradient() -> None:
    # expected: the forces at rest of a mechanism without loads, by differences of order 6
    p = EquationsOfMotion.of(load_spec("spring-pendulum").mechanism())
    h = 1e-3
    slope = [
        sum(w / h * (p.potential(0.0, p.q0 + k * h * e) - p.potential(0.0, p.q0 - k * h * e)) for k, w in WEIGHTS)
        for e in np.eye(p.n)
    ]
    forces = p.forces(0.0, p.q0, np.zeros(p.n))
    np.testing.assert_allclose(slope, -forces, rtol=0, atol=1e-9 * np.abs(forces).max())


def muscle_on(m: mbdkit.Mechanism, first: str, second: str) -> mbdkit.Mechanism:
    """Return a mechanism with a muscle with an elastic tendon from one body to another."""
    path = [{"body": first, "point": (0.05, 0.1)}, {"body": second, "point": (0.02, -0.04)}]
    m.muscle(
        "muscle", path, max_force=300.0, optimal_length=0.9, tendon_length=0.4, tendon="elastic", pennation=0.1,
        excitation="0.3 + 0.2*sin(5*t)",
    )  # fmt: skip
    return m


def rubbing() -> mbdkit.Mechanism:
    """Return a double pendulum whose pins rub."""
    m = mbdkit.Mechanism()
    for i, before in enumerate((m.ground, "rod0")):
        m.body(f"rod{i}", mass=1.0, inertia=0.1, position=(0.5 + i, 0.0))
        m.revolute(f"pin{i}", before, f"rod{i}", at=(float(i), 0.0), friction={"coefficient": 0.3, "radius": 0.05})
    return m


def servo() -> mbdkit.Mechanism:
    """Return a rotor under a sampled controller, which holds its output between samples."""
    m = mbdkit.Mechanism()
    m.body("rotor", mass=1.0, inertia=0.5, position=(0.1, 0.2), angle=0.3)
    m.revolute("pin", m.ground, "rotor", at=(0, 0))
    m.controller("p", period=0.02, outputs={"u": "-6*rotor.angle"})
    m.torque("motor", "rotor", value="controllers.p.u*cos(rotor.angle)")
    return m


STATEFUL: dict[str, Callable[[], mbdkit.Mechanism]] = {
    "elbow": lambda: load_spec("elbow-curl").mechanism(),
    "loop with a muscle": lambda: muscle_on(slider_crank(), "crank", "block"),
    "redundant loop with a muscle": lambda: muscle_on(parallelogram(1.0, cranks=3), "crank0", "crank1"),
    "loop": slider_crank,
    "friction": rubbing,
    "controller": servo,
}


@pytest.mark.parametrize("name", STATEFUL)
def test_the_jacobian_is_the_derivative_of_the_rates(name: str) -> None:
    # expected: differences of order 6; those of the method have order 2, which shows where short tendons are stiff
    p = EquationsOfMotion.of(STATEFUL[name]())
    n = p.n
    q, v = p.q0, p.project_velocities(T, p.q0, np.random.default_rng(52).standard_normal(n))

    def rates(y: np.ndarray) -> np.ndarray:
        a, _, z_rates = p.derivatives(T, y[:n], y[n : 2 * n], y[2 * n :])
        return np.concatenate([y[n : 2 * n], a, z_rates])

    y, h = np.concatenate([q, v, p.z0]), 5e-6
    expected = np.array(
        [
            sum(w / h * (rates(y + k * h * unit) - rates(y - k * h * unit)) for k, w in WEIGHTS)
            for unit in np.eye(len(y))
        ]
    ).T
    evaluations = p.counters.rhs_evaluations
    found = p.jacobian(T, q, v, p.z0)
    assert (p.counters.rhs_evaluations, p.counters.jacobian_evaluations) == (evaluations, 1)
    scale = np.abs(expected).max(axis=1, keepdims=True) + 1.0
    tolerance = 1e-5 if name == "elbow" else 1e-8
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=tolerance)


@pytest.mark.parametrize("name", ["elbow", "loop with a muscle", "loop", "controller"])
def test_the_iteration_matrix_with_states_is_the_derivative_of_the_residuals(name: str) -> None:
    # expected: differences of order 6 of the residuals of index 3 with dv = c da, dq = c^2 da and dz = c dr
    p = EquationsOfMotion.of(STATEFUL[name]())
    n, m, c, rng = p.n, p.m, 0.02, np.random.default_rng(52)
    v = p.project_velocities(T, p.q0, rng.standard_normal(n))
    a, lam, r = p.derivatives(T, p.q0, v, p.z0)

    def residuals(x: np.ndarray) -> np.ndarray:
        da, dlam, dr = np.split(x, (n, n + m))
        q, vel, z = p.q0 + c * c * da, v + c * da, p.z0 + c * dr
        p.hold(z)
        upper = p.residual(T, q, vel, a + da, lam + dlam)
        return np.concatenate([upper, p.constraints(T, q) / c**2, r + dr - p.rates(T, q, vel, z)])

    unknowns = n + m + len(p.z0)
    right, h = rng.standard_normal(unknowns), 1e-3
    dense = np.array(
        [
            sum(w / h * (residuals(k * h * one) - residuals(-k * h * one)) for k, w in WEIGHTS)
            for one in np.eye(unknowns)
        ]
    ).T
    matrix = p.iteration_matrix(T, p.q0, v, a, lam, p.z0, damping=c, stiffness=c * c)
    iterations = p.counters.newton_iterations
    found = np.concatenate(matrix.solve(*np.split(right, (n, n + m))))
    assert p.counters.newton_iterations == iterations + 1
    expected = np.linalg.solve(dense, right)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-5 if name == "elbow" else 1e-7)
    states = p.tangents(T, p.q0, v, a, lam, p.z0).states
    np.testing.assert_allclose(c * states.force_z, dense[:n, n + m :], rtol=1e-5, atol=1e-7)
    assert states.rates_z.shape == (len(p.z0), len(p.z0))
    np.testing.assert_allclose(
        -c * states.rates_v - c * c * states.rates_q, dense[n + m :, :n], rtol=1e-5, atol=1e-5 * np.abs(dense).max()
    )
    assert p.tangents(T, p.q0, v, a, lam).states is None


@pytest.mark.parametrize("sides", [(-math.inf, math.inf), (T, math.inf), (-math.inf, T)])
@pytest.mark.parametrize("name", ["driven chain", "moved slider-crank"])
def test_the_time_derivative_is_that_of_the_symbolic_equations(name: str, sides: tuple[float, float]) -> None:
    # expected: M a + Phi_q^T lam = Q and Phi_q a = gamma, differentiated by SymPy; drivers do not enter Phi_q
    workspace = workspace_at_start(MECHANISMS[name]())[0]
    workspace.clamp_motions(*sides)
    p, s = EquationsOfMotion(workspace), symbolic(name)
    q, v, _, _ = somewhere(p)
    by_time = sp.lambdify([s.t, list(s.q), list(s.v)], [s.forces.diff(s.t), s.gamma.diff(s.t)], cse=True)(T, q, v)
    there = s.evaluate(T, q, v)
    jacobian = there["constraint_jacobian"]
    matrix = np.block([[there["mass_matrix"], jacobian.T], [jacobian, np.zeros((p.m, p.m))]])
    expected = np.linalg.solve(matrix, np.concatenate([np.ravel(x) for x in by_time]))
    found = np.concatenate(p.time_derivative(T, q, v, p.z0))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_without_anything_that_depends_on_time_its_derivative_costs_nothing() -> None:
    p = EquationsOfMotion.of(load_spec("double-pendulum").mechanism())
    assert not any(np.any(x) for x in p.time_derivative(T, p.q0, p.v0, p.z0))
    assert p.counters.rhs_evaluations == 0


@pytest.mark.parametrize("call", ["derivatives", "time_derivative", "jacobian"])
def test_states_for_which_there_are_no_rates_are_told(call: str) -> None:
    p = EquationsOfMotion.of(STATEFUL["elbow"]())
    with pytest.raises(ValueError, match=r"expected an array of shape \(6,\), got shape \(2,\)"):
        getattr(p, call)(T, p.q0, p.v0, np.zeros(2))
    with pytest.raises(StepError) as error:
        getattr(p, call)(T, p.q0, p.v0, np.full(6, np.nan))
    assert error.value.code == "not-finite"
