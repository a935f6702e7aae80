"""Gradients of runs with inputs, against closed forms: values of tables depend on no parameter, initial values may."""

from __future__ import annotations

from typing import Any

import pytest

import mbdkit
from tests.runs.rotor_with_inputs import INERTIA, exact_rotor, given, rotor

TABLE = ((0.1, 0.3, 0.55551), (1.0, -2.0, 0.5))


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize(
    "integrator", [{"name": "rk4"}, {"name": "gauss", "stages": 2}, {"name": "dop853", "adaptive": True}]
)
def test_derivatives_are_those_of_the_closed_form(hold: str, integrator: dict[str, Any]) -> None:
    model = rotor(hold).to_spec()
    model["inputs"]["torque"]["initial"] = "first"
    result = mbdkit.run(
        {"mbdkit": 1, "model": model, "parameters": {"first": 0.25}},
        inputs=given(TABLE),
        integrator=integrator,
        time={"end": 1.0, "step": 0.02},
        measures={"angle": "final(rotor.angle)"},
        gradients=["first", "model.bodies.rotor.inertia"],
    ).check()
    found = result.gradients["angle"]
    assert found["check"]["agrees"]
    # the first torque acts for 0.1 s, and the rotor coasts at the speed that it gives
    assert found["derivatives"]["first"] == pytest.approx((0.1**2 / 2 + 0.1 * 0.9) / INERTIA, rel=1e-11)
    angle = exact_rotor(TABLE, hold)[0]
    assert found["derivatives"]["model.bodies.rotor.inertia"] == pytest.approx(-angle / INERTIA, rel=1e-10)
