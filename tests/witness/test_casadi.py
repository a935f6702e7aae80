"""Gauss collocation of the n-rod pendulum: the same equations, solved by CasADi."""

from __future__ import annotations

import math

import numpy as np
import pytest

from .running import gauss, run

casadi = pytest.importorskip("casadi", reason="CasADi, the outside witness of these tests, is not installed")

from .casadi_gauss import RodChain  # noqa: E402  # needs CasADi

ANGLE = math.radians(-40.0)


@pytest.mark.parametrize("stages", [2, 3])
def test_yardstick_our_collocation_equations_are_those_of_casadis_integrator(stages: int) -> None:
    # expected: CasADi's own fixed-step integrator "collocation" on the first-order index-1 equations
    chain = RodChain(3, length=20.0)
    q, v = chain.start(ANGLE)
    n, m, step, steps = 9, 6, 0.1, 50
    place, speed, push, multipliers = (
        casadi.MX.sym(name, size) for name, size in zip("qval", (n, n, n, m), strict=True)
    )
    dynamics, constraint = chain.equations()(place, speed, push, multipliers)
    problem = {
        "x": casadi.vertcat(place, speed),
        "z": casadi.vertcat(push, multipliers),
        "ode": casadi.vertcat(speed, push),
        "alg": casadi.vertcat(dynamics, constraint),
    }
    options = {
        "collocation_scheme": "legendre",
        "interpolation_order": stages,
        "number_of_finite_elements": steps,
        "rootfinder": "newton",
        "rootfinder_options": {"abstol": 1e-12},
    }
    integrator = casadi.integrator("integrator", "collocation", problem, 0.0, step * steps, options)
    expected = np.array(integrator(x0=casadi.vertcat(q, v), z0=0)["xf"]).ravel()
    history = chain.run(q, v, stages, step, steps)
    np.testing.assert_allclose(history.q[-1].ravel(), expected[:n], rtol=0, atol=1e-11)
    np.testing.assert_allclose(history.v[-1].ravel(), expected[n:], rtol=0, atol=1e-11)


@pytest.mark.parametrize("stages", [2, 3])
@pytest.mark.parametrize("solver", ["newton", "fixed-point"])
def test_gauss_on_the_three_rod_pendulum_ends_and_drifts_as_in_casadi(stages: int, solver: str) -> None:
    # expected: CasADi's collocation of the same index-1 equations with the same step, solved by its own Newton method
    chain = RodChain(3, length=20.0)
    history = chain.run(*chain.start(ANGLE), stages=stages, step=0.1, steps=150)
    model = {"name": "n-pendulum", "n": 3, "length": 20.0, "angle": ANGLE}
    result = run(model, gauss(stages) | {"stage_solver": solver}, end=15.0, step=0.1)
    for rod in range(3):
        body = result[f"rod{rod + 1}"]
        np.testing.assert_allclose(body.position, history.q[:, rod, :2], rtol=0, atol=1e-9)
        np.testing.assert_allclose(body.angle, history.q[:, rod, 2], rtol=0, atol=1e-9)
        np.testing.assert_allclose(body.velocity, history.v[:, rod, :2], rtol=0, atol=1e-9)
        np.testing.assert_allclose(body.angular_velocity, history.v[:, rod, 2], rtol=0, atol=1e-9)
        drift = result.joints[f"J{rod + 1}"].misalignment
        largest = history.misalignment[:, rod].max()
        assert np.max(drift) == pytest.approx(largest, rel=1e-3)
        late = history.misalignment[:, rod] > 0.1 * largest  # where it stands clear of the rounding
        np.testing.assert_allclose(np.asarray(drift)[late], history.misalignment[late, rod], rtol=1e-3)
