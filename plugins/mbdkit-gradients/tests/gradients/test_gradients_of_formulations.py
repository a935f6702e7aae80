"""Gradients of all formulations, stabilizations and kinds of steps: differences of runs, and the exact motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.gradients.checks import assert_passed
from tests.gradients.slider_crank import SLIDER_CRANK

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit_gradients.derived_values import DerivedValue, of_operands
from tests.margins import assert_within

MEASURES = (
    "final(bodies.rod.angle)", "max(abs(joints.B.force))", "integral(energy.kinetic)", "final(energy.dissipated)",
)  # fmt: skip
PARAMETERS = ("k", "c", "model.bodies.rod.mass", "model.bodies.crank.angular_velocity", "model.joints.B.points.0.0")

RADAU = {"name": "radau-iia", "stages": 3}
FIXED: dict[str, Any] = {"time": {"end": 1.0, "step": 0.02}}
FREE: dict[str, Any] = {"time": {"end": 1.0}}
KINDS: dict[str, dict[str, Any]] = {
    "index-2": {"formulation": "index-2", "integrator": RADAU, **FIXED},
    "index-3": {"formulation": "index-3", "integrator": RADAU, **FIXED},
    "ggl": {"formulation": "ggl", "integrator": RADAU, **FIXED},
    "joint-coordinates": {"formulation": "joint-coordinates", "integrator": {"name": "rk4"}, **FIXED},
    "gauss": {"integrator": {"name": "gauss", "stages": 3}, **FIXED},
    "baumgarte": {"integrator": {"name": "rk4"}, "stabilization": {"name": "baumgarte"}, **FIXED},
    "projection": {"integrator": {"name": "rk4"}, "stabilization": "projection", **FIXED},
    "projection of radau": {"integrator": RADAU, "stabilization": {"name": "projection", "every": 3}, **FIXED},
    "dopri5": {"integrator": {"name": "dopri5", "adaptive": True, "rtol": 1e-8, "atol": 1e-8}, **FREE},
    "dop853": {
        "integrator": {"name": "dop853", "adaptive": True, "rtol": 1e-8, "atol": 1e-8}, "stabilization": "projection",
        **FREE,
    },
    "adaptive radau": {"integrator": {**RADAU, "adaptive": True, "rtol": 1e-8, "atol": 1e-8}, **FREE},
    "adaptive index-3": {
        "formulation": "index-3", "integrator": {**RADAU, "adaptive": True, "rtol": 1e-7, "atol": 1e-7}, **FREE
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    """Derivatives of another method with a small step."""
    sections = {"integrator": {"name": "gauss", "stages": 5}, "time": {"end": 1.0, "step": 0.02}}
    return mbdkit.gradient(SLIDER_CRANK, MEASURES[:1] + MEASURES[2:], PARAMETERS, check=False, **sections).jacobian


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (i % 2)) for i, kind in enumerate(KINDS)]
)
def test_gradients_of_every_kind_of_step(kind: str, exact: np.ndarray) -> None:
    # expected: differences of runs, which have the same steps; and the derivatives of the motion, up to the error of
    # the method
    found = mbdkit.gradient(SLIDER_CRANK, MEASURES, PARAMETERS, **KINDS[kind])
    assert_passed(found)
    assert_within(np.max(found.check.error / np.abs(found.check.derivative)), 1e-5)
    np.testing.assert_allclose(found.jacobian[[0, 2, 3]], exact, rtol=0, atol=2e-5)
    # the same bits, since the gradient is that of the numbers that a run computes
    run = mbdkit.run(SLIDER_CRANK, measures={"first": MEASURES[0], "last": MEASURES[3]}, **KINDS[kind])
    assert found.value[[0, 3]].tolist() == [run.measures["first"], run.measures["last"]]


@pytest.mark.parametrize("kind", ["projection", "dopri5", "ggl"])
def test_events_have_derivatives_with_every_kind_of_step(kind: str) -> None:
    # expected: the angle where the run ends does not depend on the stiffness, and differences of runs for its time
    events = {"turned": {"when": "crank.angle - 1.5", "action": "stop"}}
    spec = {**SLIDER_CRANK, **KINDS[kind], "events": events}
    found = mbdkit.gradient(spec, ["final(t)", "final(bodies.crank.angle)", "integral(energy.kinetic)"], ["k", "c"])
    assert 0.0 < found.value[0] < 1.0
    np.testing.assert_allclose(found.jacobian[1], 0.0, rtol=0, atol=1e-10)
    assert_passed(found)


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"integrator": {"name": "scipy-dop853"}, **FREE}, "only steps of explicit"),
        ({"formulation": "index-3", "integrator": {"name": "rattle"}, **FIXED}, "only steps of explicit"),
        (
            {
                "integrator": {"name": "gauss", "stages": 2},
                "stabilization": {"name": "projection", "symmetric": True},
                **FIXED,
            },
            "symmetric projections",
        ),
    ],
)
def test_what_has_no_derivatives_says_so(sections: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError, match=message):
        mbdkit.gradient(SLIDER_CRANK, MEASURES, "k", **sections)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_products_of_vectors_and_numbers_pair_their_own_axes(count: int) -> None:
    # expected: the product rule, component by component
    rng = np.random.default_rng(1)
    x, y = (
        DerivedValue(rng.normal(size=(2, 5)), rng.normal(size=(count, 2, 5))),
        DerivedValue(rng.normal(size=5), rng.normal(size=(count, 5))),
    )
    for one, other in ((x, y), (y, x)):
        found = of_operands("mul", 0.0, one, other)
        assert found.value == pytest.approx(x.value * y.value)
        for k in range(count):
            for i in range(2):
                assert found.slope[k, i] == pytest.approx(x.slope[k, i] * y.value + x.value[i] * y.slope[k])
