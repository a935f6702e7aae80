"""Generalized-alpha has the claimed properties: order 2 in positions, velocities and multipliers, constraints at
positions, damping.
"""

from __future__ import annotations

import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_generalized_alpha.generalized_alpha import GeneralizedAlpha, GeneralizedAlphaOptions

STEPS = (0.005, 0.0025, 0.00125)


def driven_chain() -> mbdkit.Mechanism:
    """Return two rods. A motor turns the first one, and a damped spring connects the end of the second one to
    ground.
    """
    m = mbdkit.Mechanism()
    m.body("a", mass=1.0, inertia=1 / 12, position=(0.5, 0.0))
    m.body("b", mass=0.7, inertia=0.05, position=(1.0, -0.4), angle=-1.57)
    m.revolute("A", m.ground, "a", points=((0.0, 0.0), (-0.5, 0.0)))
    m.revolute("B", "a", "b", points=((0.5, 0.0), (-0.4, 0.0)))
    m.driver("motor", m.ground, "a", coordinate="angle", motion="0.4*sin(2*t) - 0.1*t**2")
    m.spring_damper("s", m.ground, "b", points=((1.5, -1.0), (0.4, 0.0)), stiffness=20.0, damping=1.0, free_length=0.3)
    return m


MODELS: dict[str, Any] = {
    "double pendulum": {"name": "double-pendulum", "angles": [-1.0, -0.4]},
    "driven chain": driven_chain().to_spec(),
}


def run(name: str, integrator: dict[str, Any], step: float, **sections: Any) -> mbdkit.Run:
    spec = {"mbdkit": 1, "model": MODELS[name], "integrator": integrator, "time": {"end": 1.0, "step": step}}
    return mbdkit.run(spec | {"output": {"every": round(0.05 / step)}} | sections).check()


@cache
def reference(name: str) -> mbdkit.Run:
    """Return the motion computed by Gauss-4 on the index-1 equations, whose error is far below 1e-9 here."""
    return run(name, {"name": "gauss", "stages": 4}, 0.0025)


@cache
def ours(name: str, rho_inf: float, step: float) -> mbdkit.Run:
    return run(name, {"name": "generalized-alpha", "rho_inf": rho_inf}, step, formulation="index-3")


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("rho_inf", [0.0, 0.5, 0.8, 0.95])
def test_positions_velocities_and_multipliers_converge_with_order_two(name: str, rho_inf: float) -> None:
    # expected: Arnold and Bruls (2007), theorem 1; for the first steps, Arnold, Bruls and Cardona (2015)
    there = reference(name)
    for mine, theirs in (
        ("trajectory/position", "trajectory/position"),
        ("trajectory/velocity", "trajectory/velocity"),
        ("constraints/method_multiplier", "constraints/multiplier"),
    ):
        errors = [np.abs(ours(name, rho_inf, h).array(mine) - there.array(theirs)).max() for h in STEPS]
        order = np.log2(errors[-2] / errors[-1])
        assert order == pytest.approx(2.0, abs=0.2), f"{mine}: {errors}"


@pytest.mark.parametrize("name", MODELS)
def test_positions_meet_the_joints_and_velocities_by_the_square_of_the_step(name: str) -> None:
    gaps = []
    for step in STEPS:
        found = ours(name, 0.8, step)
        np.testing.assert_allclose(found.misalignment_max, 0.0, rtol=0, atol=4e-15)
        gaps.append(np.abs(found.array("constraints/velocity_residual")).max())
    assert np.log2(gaps[-2] / gaps[-1]) == pytest.approx(2.0, abs=0.2)


def test_a_shorter_last_step_keeps_the_order_of_the_multipliers() -> None:
    # expected: the errors at the end are those of the row before; without a new start they would be a hundred times
    # larger
    for end in (1.0001, 1.002):
        spec = {"mbdkit": 1, "model": MODELS["driven chain"], "time": {"end": end, "step": 0.0025}}
        there = mbdkit.run(spec | {"integrator": {"name": "gauss", "stages": 4}}).check()
        mine = mbdkit.run(spec | {"integrator": {"name": "generalized-alpha"}, "formulation": "index-3"}).check()
        errors = np.abs(mine.array("constraints/method_multiplier") - there.array("constraints/multiplier")).max(axis=1)
        assert errors[-1] < 1.5 * errors[-2]
        assert mine.stats["projections"] == 1


@pytest.mark.parametrize("rho_inf", [0.5, 0.7, 0.9])
def test_a_vibration_too_fast_for_the_step_dies_out_as_asked(rho_inf: float) -> None:
    # expected: Chung and Hulbert (1993). At infinite frequency rho_inf is a triple eigenvalue of the amplification
    # matrix, so that amplitudes are proportional to k^2 rho_inf^k; h omega = 500 is large enough for this.
    m = mbdkit.Mechanism()
    m.body("wheel", mass=1.0, inertia=1.0, position=(0.0, 0.0), angle=0.01)
    m.torsion_spring("s", m.ground, "wheel", stiffness=25e6)
    method, p = GeneralizedAlpha(GeneralizedAlphaOptions(rho_inf=rho_inf)), mbdkit.EquationsOfMotion.of(m)
    state, sizes = mbdkit.StepState(p.q0, p.v0), []
    for k in range(60):
        state = method.step(p, 0.1 * k, state, 0.1)
        sizes.append(abs(state.q[2]))
    # margin: error of mbdkit's method at these steps
    assert (sizes[59] / sizes[29] / 4) ** (1 / 30) == pytest.approx(rho_inf, abs=0.02)


def test_going_on_from_a_pickled_state_is_the_same_to_the_bit() -> None:
    method = GeneralizedAlpha(GeneralizedAlphaOptions())
    p, again = mbdkit.EquationsOfMotion.of(driven_chain()), mbdkit.EquationsOfMotion.of(driven_chain())
    state, kept = mbdkit.StepState(p.q0, p.v0), b""
    for k in range(20):
        kept = pickle.dumps(state) if k == 10 else kept
        state = method.step(p, 0.01 * k, state, 0.01)
    other = pickle.loads(kept)
    for k in range(10, 20):
        other = method.step(again, 0.01 * k, other, 0.01)
    for mine, theirs in ((state.q, other.q), (state.v, other.v), (state.multipliers, other.multipliers)):
        assert np.array_equal(mine, theirs)


def test_a_step_that_is_far_too_long_is_told() -> None:
    spec = {"mbdkit": 1, "model": MODELS["double pendulum"], "formulation": "index-3"}
    found = mbdkit.run(
        spec | {"integrator": {"name": "generalized-alpha", "max_iterations": 3}, "time": {"end": 20.0, "step": 0.5}}
    )
    assert found.status_reason.startswith(("newton-failed: ", "singular: "))


def test_other_formulations_are_refused_by_name() -> None:
    with pytest.raises(mbdkit.SpecError, match="does not support the formulation 'index-1', only index-3"):
        run("double pendulum", {"name": "generalized-alpha"}, 0.01)


def test_projection_meets_velocity_constraints_and_keeps_the_order_of_positions_and_velocities() -> None:
    there = reference("driven chain")
    integrator = {"name": "generalized-alpha"}
    errors: dict[str, list[float]] = {"position": [], "velocity": []}
    for step in STEPS[:2]:
        mine = run("driven chain", integrator, step, formulation="index-3", stabilization="projection")
        np.testing.assert_allclose(
            mine.array("constraints/velocity_residual")[1:], 0.0, rtol=0, atol=1e-13
        )  # the first row is the start
        for name, found in errors.items():
            path = f"trajectory/{name}"
            found.append(np.abs(mine.array(path) - there.array(path)).max())
    for coarse, fine in errors.values():
        assert np.log2(coarse / fine) == pytest.approx(2, abs=0.2)


def test_symmetric_projection_and_baumgarte_are_refused() -> None:
    for stabilization in ({"name": "projection", "symmetric": True}, "baumgarte"):
        with pytest.raises(mbdkit.SpecError, match="stabilization"):
            run(
                "double pendulum", {"name": "generalized-alpha"}, 0.01, formulation="index-3",
                stabilization=stabilization,
            )  # fmt: skip


@pytest.mark.parametrize("rho_inf", [-0.1, 1.0, "much"])
def test_a_spectral_radius_out_of_range_is_refused(rho_inf: Any) -> None:
    with pytest.raises(mbdkit.SpecError, match="rho_inf"):
        run("double pendulum", {"name": "generalized-alpha", "rho_inf": rho_inf}, 0.01, formulation="index-3")


def test_a_study_of_methods_takes_it_with_its_formulation() -> None:
    # expected: order 2, no drift of positions
    spec: dict[str, Any] = {
        "mbdkit_study": 1,
        "base": {"model": MODELS["double pendulum"], "time": {"end": 1.0, "step": 0.01}},
        "axes": [{"integrator": [{"name": "rk4"}]}, {"time.step": list(STEPS)}],
        "reference": {"integrator": {"name": "gauss", "stages": 4}, "time.step": 0.0025},
    }
    study = mbdkit.study(spec, with_="generalized-alpha")
    points = [point for point in study.points if point.axes["integrator"] == "generalized-alpha, index-3"]
    errors = [point.values["end_error"] for point in points]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.1)
    np.testing.assert_allclose(max(point.values["misalignment_max"] for point in points), 0.0, rtol=0, atol=1e-14)
