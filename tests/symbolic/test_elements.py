"""Every generated kernel against complex step of the level below it, run uncompiled, to 1e-12 relative."""

from __future__ import annotations

import numpy as np
import pytest

from mbdkit.engine.kernels import element_kernels

from .kernels import GROUND, STEP, Element, assert_close, partials

pytestmark = pytest.mark.usefixtures("complex_kernels")

every_constraint = pytest.mark.parametrize(
    "element",
    [
        pytest.param((kind, *ends, seed), id=f"{kind}-{ends[0]}{ends[1]}-{seed}")
        for kind in element_kernels.CONSTRAINT_KINDS
        for ends in ((0, 1), (1, 0), (GROUND, 0), (1, GROUND))
        for seed in range(3)
    ],
)
every_pathway = pytest.mark.parametrize(
    "element",
    [
        pytest.param((kind, *ends, seed), id=f"{kind}-{ends[0]}{ends[1]}-{seed}")
        for kind in element_kernels.PATHWAY_KINDS
        for ends in ((0, 1), (GROUND, 1), (1, GROUND))
        for seed in range(3)
    ],
)

Given = tuple[str, int, int, int]


@every_constraint
def test_the_jacobian_is_the_derivative_of_phi(element: Given) -> None:
    e = Element(*element)
    jacobian, _ = e.acceleration(e.q, e.v, e.u)
    assert_close(jacobian, partials(lambda q: e.position(q, e.u)[0], e.q, e.columns))


@every_constraint
def test_phi_t_is_the_derivative_of_phi_by_time_through_the_motion(element: Given) -> None:
    e = Element(*element)
    moved = e.u + 1j * STEP * np.array([e.u[0, 1], e.u[0, 2], 0.0])
    assert_close(e.position(e.q, e.u)[1], e.position(e.q, moved)[0].imag / STEP)


@every_constraint
def test_gamma_is_minus_the_derivative_of_the_rate_along_the_motion_at_constant_velocity(element: Given) -> None:
    # expected: Phi_q a = gamma = -(d/dt)(Phi_q v + Phi_t) with v held, t moving q along v and u along its jet
    e = Element(*element)
    _, gamma = e.acceleration(e.q, e.v, e.u)
    moved = e.u + 1j * STEP * np.array([e.u[0, 1], e.u[0, 2], 0.0])
    assert_close(gamma, -e.rate(e.q + 1j * STEP * e.v, e.v, moved).imag / STEP)


@every_constraint
def test_the_stiffness_is_the_derivative_of_the_constraint_forces(element: Given) -> None:
    e = Element(*element)
    lam = e.lam[0, : e.rows]
    expected = partials(lambda q: e.acceleration(q, e.v, e.u)[0].T @ lam, e.q, e.columns)
    assert_close(e.tangent()[0], expected)


@every_constraint
def test_the_stiffness_is_symmetric(element: Given) -> None:
    stiffness = Element(*element).tangent()[0]
    assert_close(stiffness, stiffness.T)


@every_constraint
def test_gamma_v_is_the_derivative_of_gamma_by_velocities(element: Given) -> None:
    e = Element(*element)
    assert_close(e.tangent()[1], partials(lambda v: e.acceleration(e.q, v, e.u)[1], e.v, e.columns))


@every_constraint
def test_residual_q_is_the_derivative_of_the_acceleration_residual_by_positions(element: Given) -> None:
    e = Element(*element)

    def residual(q: np.ndarray) -> np.ndarray:
        jacobian, gamma = e.acceleration(q, e.v, e.u)
        return jacobian @ e.acc[e.columns] - gamma

    assert_close(e.tangent()[2], partials(residual, e.q, e.columns))


@every_pathway
def test_a_gradient_is_the_derivative_of_its_length(element: Given) -> None:
    e = Element(*element)

    def length(q: np.ndarray) -> complex:
        length, gradient = e.gradient(q)
        if e.kind != "tangent":
            return length
        # a tangent has the gradient of a string that also winds around its circle: r times the tangent's direction
        return length + e.p[0, 4] * np.arctan(gradient[4] / gradient[3])

    assert_close(e.gradient(e.q)[1], partials(length, e.q, e.columns))


@every_pathway
def test_a_hessian_is_the_derivative_of_its_gradient(element: Given) -> None:
    e = Element(*element)
    assert_close(e.hessian(), partials(lambda q: e.gradient(q)[1], e.q, e.columns), size=1e-3)
