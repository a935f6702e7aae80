"""Stage equations: how fast Newton converges, what the two solvers agree on, when they give up, and reversibility."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.start import start_method
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.methods import gauss
from mbdkit.methods.kinds import ImplicitRungeKutta

from .running import DOUBLE, driven_chain, run, spec_run, workspace_of


def change_after(iterations: int, stages: int, step: float, solver: str = "newton", model: Any = None) -> float:
    """Return the largest change of an acceleration in the last of so many iterations of the first step."""
    integrator = {"name": "gauss", "stages": stages, "stage_solver": solver, "max_iterations": iterations}
    result = spec_run(model or driven_chain(), integrator, {"steps": 1, "step": step})
    assert result.status == "failed"
    found = re.search(r" by ([0-9.]+(e[+-][0-9]+)?)", result.status_reason)
    assert found is not None
    return float(found[1])


@pytest.mark.parametrize("stages", [1, 2, 3, 4])
def test_newton_contracts_at_least_like_the_step_on_a_driven_chain_with_a_distant_spring(stages: int) -> None:
    # expected: simplified Newton with exact tangents contracts by O(h) or better each iteration
    rates = [change_after(3, stages, h) / change_after(2, stages, h) for h in (0.08, 0.02)]
    assert rates[0] < 0.2
    assert rates[1] < rates[0] / 4


@pytest.mark.parametrize("stages", [2, 3])
def test_newton_contracts_much_faster_than_fixed_point_where_springs_are_stiff(stages: int) -> None:
    newton, fixed = (
        [change_after(k, stages, 0.01, solver, stiff_chain()) for k in (2, 3)] for solver in ("newton", "fixed-point")
    )
    assert newton[1] / newton[0] < 0.2 * fixed[1] / fixed[0]


@pytest.mark.parametrize("stages", range(1, 7))
@pytest.mark.parametrize("model", [DOUBLE, driven_chain()], ids=["double pendulum", "driven chain"])
def test_newton_and_fixed_point_give_the_same_motion_to_round_off(stages: int, model: Any) -> None:
    newton, fixed = (
        run(model, {"name": "gauss", "stages": stages, "stage_solver": solver}, end=0.5, step=0.005)
        for solver in ("newton", "fixed-point")
    )
    for path in ("trajectory/position", "trajectory/velocity", "energy/total", "energy/work"):
        np.testing.assert_allclose(newton.array(path), fixed.array(path), rtol=0, atol=1e-11)


@pytest.mark.parametrize("stages", [2, 3])
def test_a_tolerance_saves_iterations_at_the_price_that_it_names(stages: int) -> None:
    exact = run(driven_chain(), {"name": "gauss", "stages": stages}, end=0.5, step=0.01)
    loose = run(driven_chain(), {"name": "gauss", "stages": stages, "tolerance": 1e-6}, end=0.5, step=0.01)
    assert loose.stats["newton_iterations"] < 0.8 * exact.stats["newton_iterations"]
    np.testing.assert_allclose(
        loose.array("trajectory/position"), exact.array("trajectory/position"), rtol=0, atol=1e-6
    )


@pytest.mark.parametrize("stages", [3, 5])
def test_the_extrapolated_start_saves_iterations(stages: int) -> None:
    # expected: a step starts from the last collocation polynomial, wrong by O(h^s), where the first one knows nothing
    integrator = {"name": "gauss", "stages": stages, "stage_solver": "fixed-point"}
    result = run(DOUBLE, integrator, end=0.1, step=0.005)
    iterations = result.array("steps/iterations")
    assert iterations[1:].mean() < iterations[0]


@pytest.mark.parametrize("solver", ["newton", "fixed-point"])
def test_an_iteration_that_does_not_converge_ends_the_run_and_says_where(solver: str) -> None:
    m = driven_chain(stiffness=1e7)
    result = spec_run(m, {"name": "gauss", "stage_solver": solver, "max_iterations": 20}, {"end": 10.0, "step": 2.0})
    assert result.status == "failed"
    code, _, sentence = result.status_reason.partition(": ")
    assert code == "newton-failed"
    assert "in step 1 from t = 0 s" in sentence
    assert "did not converge" in sentence or "ran away" in sentence or "is singular at" in sentence
    assert "time.step" in sentence  # the hint


def test_where_the_iteration_stalls_is_named() -> None:
    integrator = {"name": "gauss", "stage_solver": "fixed-point", "max_iterations": 3}
    result = spec_run(driven_chain(), integrator, {"end": 1.0, "step": 0.01})
    assert result.status_reason.startswith("newton-failed: ")
    assert re.search(r"body 'r[0-9]'|joint '?J[0-9]", result.status_reason)


def stiff_chain() -> Mechanism:
    """Return the driven chain with a stiff spring-damper that starts at its free length."""
    m = driven_chain(stiffness=1e4, damping=1000.0)
    spring = m.forces["s"]
    gap = np.subtract(m.to_global("r3", (0.3, -0.1)), m.to_global("r0", (0.2, 0.1)))
    m.forces["s"] = spring.model_copy(update={"free_length": float(np.hypot(*gap))})
    return m


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_newton_takes_steps_on_a_stiff_damper_at_which_fixed_point_fails(stages: int) -> None:
    newton, fixed = (
        spec_run(
            stiff_chain(),
            {"name": "gauss", "stages": stages, "stage_solver": solver},
            {"end": 0.5, "step": 0.01},
        )
        for solver in ("newton", "fixed-point")
    )
    assert newton.status == "complete"
    assert fixed.status == "failed"
    assert fixed.status_reason.startswith("newton-failed: ")


def pendulum() -> Mechanism:
    """Return two rods released at rest 0.5 rad from hanging."""
    m = Mechanism()
    angle = 0.5 - np.pi / 2
    along = np.array([np.cos(angle), np.sin(angle)])
    for i in range(2):
        m.body(f"r{i}", mass=1.0, inertia=1 / 12, position=(i + 0.5) * along, angle=angle)
        m.revolute(f"J{i}", m.ground if i == 0 else "r0", f"r{i}", at=i * along)
    return m


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_the_stepper_run_back_with_turned_velocities_returns_to_its_start(stages: int) -> None:
    # expected: the start; Gauss methods are symmetric, and round-off of a regular motion grows slowly
    method = ImplicitRungeKutta(gauss.tableau(stages))
    workspace = workspace_of(pendulum())
    start = np.concatenate([workspace.q0, workspace.v0])
    for _ in range(2):
        stepper = start_method(method, workspace, Timetable(0.0, 10.0, step=0.01, steps=1000))
        while not stepper.finished:
            stretch = stepper.advance()
            assert stepper.failure is None
        workspace.q0, workspace.v0 = stretch.q[-1].copy(), -stretch.v[-1]
    np.testing.assert_allclose(np.concatenate([workspace.q0, workspace.v0]), start, rtol=0, atol=1e-10)


@pytest.mark.parametrize("stages", range(1, 7))
def test_gauss_keeps_quadratic_invariants(stages: int) -> None:
    # expected: a free pair on a spring keeps its moment of momentum, which is quadratic in (q, v)
    m = Mechanism(gravity=(0.0, 0.0))
    m.body("a", mass=1.0, position=(0.0, 0.0), velocity=(0.3, -0.5))
    m.body("b", mass=2.0, position=(1.0, 0.2), velocity=(0.1, 0.4))
    m.spring_damper("s", "a", "b", points=((0, 0), (0, 0)), stiffness=20.0, free_length=0.7)
    result = run(m, {"name": "gauss", "stages": stages}, end=5.0, step=0.05)
    moment = np.zeros(len(result.time))
    for name, mass in (("a", 1.0), ("b", 2.0)):
        x, v = np.asarray(result[name].position), np.asarray(result[name].velocity)
        moment += mass * (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])
    np.testing.assert_allclose(moment, moment[0], rtol=0, atol=5e-14)


@pytest.mark.parametrize("steps", [10, 20, 40])
@pytest.mark.parametrize("angle", [0.0, 0.1, 0.2, 2.2])
def test_accelerations_that_vanish_exactly_are_no_divergence(angle: float, steps: int) -> None:
    # expected: a slide takes up what a spring would turn its body by, so the slider goes on along it as it began
    m = Mechanism(gravity=(0.0, 0.0))
    m.body("slider", mass=2.5, inertia=0.3, position=(0.0, 0.5), angle=angle, velocity=(0.2, -0.8))
    m.prismatic("slide", m.ground, "slider", at=(0.2, 0.7), axis=(-0.5, -5.0))
    m.torsion_spring("twist", m.ground, "slider", stiffness=3.4, free_angle=-0.5)
    slider = run(m, {"name": "gauss", "stages": 2}, end=0.5, step=0.5 / steps)["slider"]
    np.testing.assert_allclose(slider.position[-1] - slider.position[0], 0.5 * slider.velocity[0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(slider.acceleration, 0.0, rtol=0, atol=1e-14)
