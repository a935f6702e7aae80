"""Equilibria and modes of mechanisms with first-order states, against closed forms of the coupled equations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import mbdkit
from mbdkit import SpecError
from mbdkit_statics.equilibrium import equilibrium_of, spec_at
from mbdkit_statics.prepared_mechanism import PreparedMechanism

INERTIA, GRAVITY = 0.05 + 3.0 * 0.2**2, 3.0 * 9.81 * 0.2
STIFFNESS, DAMPING, LAG = 12.0, 0.4, 0.05


def leg(value: str, **states: Any) -> dict[str, Any]:
    """A leg of 3 kg on a hip 0.2 m above its centre of mass, under feedback."""
    model = {
        "name": "mechanism", "bodies": {"leg": {"mass": 3.0, "inertia": 0.05, "position": [0.0, -0.2]}},
        "joints": {"hip": {"type": "revolute", "bodies": ["ground", "leg"], "points": [[0, 0], [0, 0.2]]}},
        "forces": {"motor": {"type": "torque", "body": "leg", "value": value}}, "states": states,
    }  # fmt: skip
    return {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.01}}


def filtered(gain: float) -> dict[str, Any]:
    """Damping directly, and stiffness by the nonlinearly filtered difference from 0.5 rad."""
    rate = f"(0.5 - leg.angle - 0.2*leg.angular_velocity - states.e - states.e**3)/{LAG}"
    return leg(f"{gain}*states.e - {DAMPING}*leg.angular_velocity", e={"rate": rate})


def at_rest(gain: float) -> tuple[float, float]:
    """Return angle and state at rest: gain e = m g l sin(angle), 0.5 - angle = e + e^3."""

    def unbalanced(e: float) -> float:
        return float(gain * e - GRAVITY * np.sin(0.5 - e - e**3))

    e = float(brentq(unbalanced, 0.0, 0.5, xtol=1e-15))
    return 0.5 - e - e**3, e


def matrix(gain: float) -> np.ndarray:
    """The matrix of small motions of angle, angular velocity and state."""
    angle, e = at_rest(gain)
    return np.array(
        [
            [0, 1, 0],
            [-GRAVITY * np.cos(angle) / INERTIA, -DAMPING / INERTIA, gain / INERTIA],
            [-1 / LAG, -0.2 / LAG, -(1 + 3 * e**2) / LAG],
        ]
    )


def test_an_equilibrium_solves_for_the_states_with_the_mechanism() -> None:
    angle, e = at_rest(STIFFNESS)
    found = mbdkit.equilibrium(filtered(STIFFNESS))
    assert found["leg"][2] == pytest.approx(angle, abs=1e-13)
    assert found.states == ("e",)
    assert found.state[0] == pytest.approx(e, abs=1e-13)
    stiffness = GRAVITY * np.cos(angle) + STIFFNESS / (1 + 3 * e**2)  # the state follows the angle
    assert found.stiffness == pytest.approx(stiffness / INERTIA, rel=1e-10)
    assert found.stability == "stable"
    assert found.imbalance < 1e-10


@pytest.mark.parametrize("gain", [STIFFNESS, 40.0])
def test_modes_are_those_of_the_coupled_equations(gain: float) -> None:
    wanted = np.linalg.eigvals(matrix(gain))
    linear = mbdkit.linearize(filtered(gain))
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(linear.state_matrix())), np.sort_complex(wanted),
                               rtol=1e-9)  # fmt: skip
    found = mbdkit.modes(filtered(gain))
    once = np.sort_complex(wanted[wanted.imag >= 0])
    np.testing.assert_allclose(np.sort_complex(found.eigenvalues), once, rtol=1e-9)


def test_a_linearization_about_a_motion_includes_the_turning_of_the_basis() -> None:
    """About a moving state: the rate of the state contains the velocity of the centre of mass, which turns."""
    angle, speed, e = 0.7, 1.3, 0.2
    spec = leg(f"3*states.e - {DAMPING}*leg.angular_velocity",
               e={"rate": "leg.vx + leg.y - 2*states.e - states.e**3", "initial": e})  # fmt: skip
    c, s = 0.2 * np.cos(angle), 0.2 * np.sin(angle)
    spec["model"]["bodies"]["leg"] |= {
        "angle": angle, "position": [s, -c], "angular_velocity": speed, "velocity": [c * speed, s * speed],
    }  # fmt: skip
    found = mbdkit.linearize(spec, at="start")
    wanted = [
        [0, 1, 0],
        [-GRAVITY * np.cos(angle) / INERTIA, -DAMPING / INERTIA, 3 / INERTIA],
        [s - s * speed, c, -2 - 3 * e**2],
    ]
    scale = np.diag([found.basis[2, 0], found.basis[2, 0], 1.0])  # of a unit of the degree of freedom [rad]
    np.testing.assert_allclose(scale @ found.state_matrix() @ np.linalg.inv(scale), wanted, atol=1e-11)


def test_a_loop_that_oscillates_is_unstable_although_its_stiffness_is_positive() -> None:
    """The torque lags behind the angle: the stiffness is that of rest, but small motions grow."""
    model = leg("20*states.e", e={"rate": f"(-leg.angle - states.e)/{LAG}"})
    found = mbdkit.equilibrium(model)
    values = np.linalg.eigvals([[0, 1, 0], [-GRAVITY / INERTIA, 0, 20 / INERTIA], [-1 / LAG, 0, -1 / LAG]])
    assert values.real.max() > 0.1
    assert found.stiffness == pytest.approx((GRAVITY + 20) / INERTIA, rel=1e-10)
    assert found.stability == "unstable"


def test_the_spec_at_rest_stays_at_rest() -> None:
    """Written with the states of rest, the mechanism does not move."""
    prepared = PreparedMechanism.of(filtered(STIFFNESS))
    run = mbdkit.run(spec_at(prepared, equilibrium_of(prepared))).check()
    assert np.ptp(run["leg"].angle) < 1e-13
    assert np.ptp(run.states["e"].value) < 1e-13


@pytest.mark.parametrize(
    ("spec", "sentence"),
    [
        (leg("states.e", e={"rate": "0.1 - leg.angle"}), "values at rest that the position does not determine"),
        (leg("states.e", e={"rate": "1 + states.e**2"}), "values at rest that the position does not determine"),
    ],
)
def test_states_without_values_at_rest_are_refused(spec: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        mbdkit.equilibrium(spec)


def test_controllers_are_refused() -> None:
    spec = leg("controllers.c.u", e={"rate": "-states.e"})
    spec["model"]["controllers"] = {"c": {"period": 0.01, "outputs": {"u": "-leg.angle"}}}
    for analysis in (mbdkit.equilibrium, mbdkit.modes):
        with pytest.raises(SpecError, match="does not include sampled controllers \\(c\\)"):
            analysis(spec)
