"""Every generated kernel against complex step of the level below it, run uncompiled, to 1e-12 relative."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from itertools import product

import numpy as np
import pytest

from mbdkit.engine.kernels import element_kernels

from .kernels import GROUND, STEP, Element, assert_close, partials

pytestmark = pytest.mark.usefixtures("complex_kernels")

ENDS = ((0, 1), (1, 0), (GROUND, 0), (1, GROUND))


def on_elements_of(kinds: Iterable[str], test: Callable[[Element], None]) -> Callable[[str], None]:
    """Return a test for each kind of element, which calls `test` for three elements between all pairs of ends."""

    @pytest.mark.parametrize("kind", kinds)
    def test_of_kind(kind: str) -> None:
        for ends, seed in product(ENDS, range(3)):
            test(Element(kind, *ends, seed))

    return test_of_kind


every_constraint = partial(on_elements_of, element_kernels.CONSTRAINT_KINDS)
every_pathway = partial(on_elements_of, element_kernels.PATHWAY_KINDS)


@every_constraint
def test_the_jacobian_is_the_derivative_of_phi(e: Element) -> None:
    jacobian, _ = e.acceleration(e.q, e.v, e.u)
    assert_close(jacobian, partials(lambda q: e.position(q, e.u)[0], e.q, e.columns))


@every_constraint
def test_phi_t_is_the_derivative_of_phi_by_time_through_the_motion(e: Element) -> None:
    moved = e.u + 1j * STEP * np.array([e.u[0, 1], e.u[0, 2], 0.0])
    assert_close(e.position(e.q, e.u)[1], e.position(e.q, moved)[0].imag / STEP)


@every_constraint
def test_gamma_is_minus_the_derivative_of_the_rate_along_the_motion_at_constant_velocity(e: Element) -> None:
    # expected: Phi_q a = gamma = -(d/dt)(Phi_q v + Phi_t) with v held, t moving q along v and u along its jet
    _, gamma = e.acceleration(e.q, e.v, e.u)
    moved = e.u + 1j * STEP * np.array([e.u[0, 1], e.u[0, 2], 0.0])
    assert_close(gamma, -e.rate(e.q + 1j * STEP * e.v, e.v, moved).imag / STEP)


@every_constraint
def test_the_stiffness_is_the_derivative_of_the_constraint_forces(e: Element) -> None:
    lam = e.lam[0, : e.rows]
    expected = partials(lambda q: e.acceleration(q, e.v, e.u)[0].T @ lam, e.q, e.columns)
    assert_close(e.tangent()[0], expected)


@every_constraint
def test_the_stiffness_is_symmetric(e: Element) -> None:
    stiffness = e.tangent()[0]
    assert_close(stiffness, stiffness.T)


@every_constraint
def test_gamma_v_is_the_derivative_of_gamma_by_velocities(e: Element) -> None:
    assert_close(e.tangent()[1], partials(lambda v: e.acceleration(e.q, v, e.u)[1], e.v, e.columns))


@every_constraint
def test_residual_q_is_the_derivative_of_the_acceleration_residual_by_positions(e: Element) -> None:
    def residual(q: np.ndarray) -> np.ndarray:
        jacobian, gamma = e.acceleration(q, e.v, e.u)
        return jacobian @ e.acc[e.columns] - gamma

    assert_close(e.tangent()[2], partials(residual, e.q, e.columns))


@every_pathway
def test_a_gradient_is_the_derivative_of_its_length(e: Element) -> None:
    def length(q: np.ndarray) -> complex:
        length, gradient = e.gradient(q)
        if e.kind != "tangent":
            return length
        # a tangent has the gradient of a string that also winds around its circle: r times the tangent's direction
        return length + e.p[0, 4] * np.arctan(gradient[4] / gradient[3])

    assert_close(e.gradient(e.q)[1], partials(length, e.q, e.columns))


@every_pathway
def test_a_hessian_is_the_derivative_of_its_gradient(e: Element) -> None:
    assert_close(e.hessian(), partials(lambda q: e.gradient(q)[1], e.q, e.columns), size=1e-3)
