"""Baumgarte's terms make the constraint errors a damped oscillator, in the accelerations and in every derivative."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.stabilization import NONE, Stabilization
from mbdkit.engine.workspace import Workspace
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec
from tests.engine.linkages_in_sympy import parallelogram, slider_crank
from tests.integrators.running import driven_chain

ALPHA, BETA = 3.0, 4.0
MASS, INERTIA, ARM = 2.0, 0.3, 0.5
BAUMGARTE = Stabilization("baumgarte", alpha=ALPHA, beta=BETA)


def swung_pendulum() -> mbdkit.Mechanism:
    """Return a rod whose end is moved along x by a driver, (0.3 sin 2t, 0)."""
    m = mbdkit.Mechanism()
    m.body("rod", mass=MASS, inertia=INERTIA, position=(ARM, 0.0), velocity=(0.6, 0.0))
    m.driver("X", m.ground, "rod", coordinate="x", motion="0.3*sin(2*t)", points=((0.0, 0.0), (-ARM, 0.0)))
    m.driver("Y", m.ground, "rod", coordinate="y", motion=0.0, points=((0.0, 0.0), (-ARM, 0.0)))
    return m


def by_hand(t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return accelerations and multipliers of the swung pendulum, stabilized, written down by hand."""
    s, c, w = math.sin(q[2]), math.cos(q[2]), v[2]
    phi = np.array([q[0] - ARM * c - 0.3 * math.sin(2 * t), q[1] - ARM * s])
    rate = np.array([v[0] + ARM * s * w - 0.6 * math.cos(2 * t), v[1] - ARM * c * w])
    jacobian = np.array([[1.0, 0.0, ARM * s], [0.0, 1.0, -ARM * c]])
    gamma = np.array([-ARM * c * w**2 - 1.2 * math.sin(2 * t), -ARM * s * w**2]) - 2 * ALPHA * rate - BETA**2 * phi
    matrix = np.zeros((5, 5))
    matrix[:3, :3] = np.diag([MASS, MASS, INERTIA])
    matrix[3:, :3], matrix[:3, 3:] = jacobian, jacobian.T
    solution = np.linalg.solve(matrix, [0.0, -9.81 * MASS, 0.0, *gamma])
    return solution[:3], solution[3:]


def workspace_of(model: Any, stabilization: Stabilization) -> Workspace:
    """Return the workspace of a mechanism without its redundant rows, as a run steps it."""
    sections = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}}
    return replace(build(load_spec(model, (), **sections))[0], stabilization=stabilization)


def somewhere(p: EquationsOfMotion) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a state off the constraints, with accelerations and multipliers that solve nothing."""
    rng = np.random.default_rng(4)
    return p.q0 + 0.05 * rng.standard_normal(p.n), *rng.standard_normal((2, p.n)), rng.standard_normal(p.m)


def test_accelerations_and_multipliers_are_those_written_down_by_hand() -> None:
    p = EquationsOfMotion(workspace_of(swung_pendulum(), BAUMGARTE))
    for t in (0.0, 0.7):
        q, v, _, _ = somewhere(p)
        a, lam = p.accelerations(t, q, v)
        there = by_hand(t, q, v)
        np.testing.assert_allclose(a, there[0], rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(lam, there[1], rtol=1e-13, atol=1e-13)


def test_constraint_errors_die_out_as_the_damped_oscillator_says() -> None:
    # expected: e'' + 2 alpha e' + beta^2 e = 0 in closed form, here with alpha = beta
    alpha = 5.0
    p = EquationsOfMotion(workspace_of(swung_pendulum(), Stabilization("baumgarte", alpha=alpha, beta=alpha)))
    q = p.q0 + np.array([0.01, -0.02, 0.0])
    e, rate = p.constraints(0.0, q), p.constraint_rates(0.0, q, p.v0)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:], p.accelerations(t, y[:3], y[3:])[0]])

    end = 1.5
    y = solve_ivp(rates, (0.0, end), [*q, *p.v0], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    there = (e + (rate + alpha * e) * end) * math.exp(-alpha * end)
    assert np.abs(there).max() > 1e-5
    np.testing.assert_allclose(p.constraints(end, y[:3]), there, atol=1e-11)


MODELS = {
    "swung pendulum": swung_pendulum,
    "driven chain": driven_chain,
    "slider-crank": slider_crank,
    "spare crank": lambda: parallelogram(1.0, 3),
}


@pytest.mark.parametrize("name", MODELS)
def test_gamma_is_the_plain_one_with_the_terms_taken_away(name: str) -> None:
    model = MODELS[name]()
    p, plain = (EquationsOfMotion(workspace_of(model, kind)) for kind in (BAUMGARTE, NONE))
    q, v, _, _ = somewhere(p)
    terms = 2 * ALPHA * plain.constraint_rates(0.3, q, v) + BETA**2 * plain.constraints(0.3, q)
    np.testing.assert_allclose(p.gamma(0.3, q, v), plain.gamma(0.3, q, v) - terms, rtol=1e-13, atol=1e-12)
    assert p.baumgarte_terms(0.3, q, v) >= 0.99 * np.abs(terms).max()
    assert plain.baumgarte_terms(0.3, q, v) == 0.0


@pytest.mark.parametrize("name", MODELS)
def test_tangents_are_the_derivatives_of_the_stabilized_equations(name: str) -> None:
    # expected: central differences of gamma and of the Jacobian
    p = EquationsOfMotion(workspace_of(MODELS[name](), BAUMGARTE))
    q, v, a, lam = somewhere(p)
    if name == "spare crank":  # whose rows turn with a body: derivatives hold where the rows meet
        q, v = p.q0, p.v0
        a, lam = p.accelerations(0.3, q, v)
    tangents, e = p.tangents(0.3, q, v, a, lam), 1e-6

    def missing(q: np.ndarray) -> np.ndarray:
        lacking: np.ndarray = p.constraint_jacobian(0.3, q) @ a - p.gamma(0.3, q, v)
        return lacking

    by_v = [(p.gamma(0.3, q, v + e * d) - p.gamma(0.3, q, v - e * d)) / (2 * e) for d in np.eye(p.n)]
    by_q = [(missing(q + e * d) - missing(q - e * d)) / (2 * e) for d in np.eye(p.n)]
    np.testing.assert_allclose(tangents.gamma_v.toarray(), np.transpose(by_v), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(tangents.residual_q.toarray(), np.transpose(by_q), rtol=1e-6, atol=1e-6)


def test_the_terms_of_a_held_angle_do_not_add_up_over_evaluations() -> None:
    # expected: -beta^2 Phi, whatever has been evaluated before; gamma of a held angle is zero without the terms
    m = mbdkit.Mechanism()
    m.body("block", mass=1.0, inertia=0.1, position=(0.0, 0.0))
    m.prismatic("P", m.ground, "block", at=(0.0, 0.0), axis=(1.0, 0.0))
    p = EquationsOfMotion(workspace_of(m, BAUMGARTE))
    tilted = np.array([0.0, 0.0, 0.01])
    for _ in range(3):
        assert p.gamma(0.0, tilted, p.v0)[1] == pytest.approx(-(BETA**2) * 0.01, rel=1e-14)
    assert p.gamma(0.0, p.q0, p.v0)[1] == 0.0


def test_the_jacobian_that_scipy_gets_is_exact() -> None:
    # expected: central differences of the right side
    p = EquationsOfMotion(workspace_of(driven_chain(), BAUMGARTE))
    rng = np.random.default_rng(2)
    y = np.concatenate([p.q0, p.v0]) + 0.02 * rng.standard_normal(2 * p.n)
    e = 1e-6

    def rates(y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[p.n :], p.derivatives(0.3, y[: p.n], y[p.n :], p.z0)[0]])

    there = [(rates(y + e * d) - rates(y - e * d)) / (2 * e) for d in np.eye(len(y))]
    np.testing.assert_allclose(
        p.jacobian(0.3, y[: p.n], y[p.n :], p.z0), np.transpose(there), rtol=1e-6, atol=3e-6
    )  # fmt: skip


def test_what_is_recorded_is_taken_without_the_terms() -> None:
    model = swung_pendulum().to_spec()
    spec = {"mbdkit": 1, "model": model, "integrator": {"name": "scipy-dop853"}, "time": {"end": 1.0}}
    run = mbdkit.run(spec, stabilization={"name": "baumgarte", "alpha": 20.0}).check()
    plain = EquationsOfMotion(workspace_of(swung_pendulum(), NONE))
    q, v = (run.array(f"trajectory/{name}")[-1].ravel() for name in ("position", "velocity"))
    a, lam = plain.accelerations(run.time[-1], q, v)
    np.testing.assert_allclose(run.array("trajectory/acceleration")[-1].ravel(), a, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(run.array("constraints/multiplier")[-1], lam, rtol=1e-13, atol=1e-13)
    assert run.steps.acceleration_correction.max() > 0
