"""Rigid contacts against runs of Siconos (Apache-2.0), stored with its tutorials at b6c9bfd1, in examples/mechanics of
github.com/siconos/siconos-tutorials. These runs are by time-stepping, and have errors in proportion to their steps.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.rigid.scenes import FLOOR, run

import mbdkit
from mbdkit.spec import load_spec
from mbdkit_paper.methods.problems import problems
from tests.margins import assert_within
from tests.models.example_runs import of_all_bodies, ran


@pytest.mark.parametrize(("treatment", "step"), [("event-driven", 5e-3), ("time-stepping", 1e-4)])
def test_the_woodpecker_toy_pecks_as_in_siconos(treatment: str, step: float) -> None:
    """Woodpecker/Woodpecker.ref, steps of 2e-5 s (C. Glocker, Set-Valued Force Laws, 2001). The reference is linear in
    the angles; a mechanism whose levers are 1000 times longer, and whose angles are 1000 times smaller, is linear
    within about 1e-3. The angles of time-stepping, of order 1, have the rates of both bodies before impacts, up to
    20 rad/s, for up to a step too long.
    """
    long, pole, sleeve_x, sleeve_y = 1000.0, 0.0025, 0.0031, 0.0058
    pivot, arm, beak_x, beak_y = 0.010, 0.015, 0.0201, 0.02
    # the reference starts with an overlap of 9e-7 m; here the sleeve touches the pole
    wall = sleeve_x * long - (sleeve_x - pole)
    tilt = brentq(lambda a: long * (sleeve_x * np.cos(a) + sleeve_y * np.sin(a)) - wall, -2e-4, 0.0, xtol=1e-18)
    lean, spin = -0.2788 / long, -7.4583 / long
    at = pivot * long * np.array([np.cos(tilt), np.sin(tilt)])
    out = arm * long * np.array([np.cos(lean), np.sin(lean)])

    def touch(body: str, point: list[float], gap: float, restitution: float) -> dict[str, Any]:
        line = {"line": {"point": [gap, 0.0], "normal": [1.0, 0.0]}}
        shapes = [line, {"point": [long * x for x in point]}]
        return {"bodies": ["ground", body], "shapes": shapes, "restitution": restitution, "friction": 0.3}

    beak = pivot + arm - beak_x
    model = {
        "bodies": {
            "sleeve": {"mass": 0.0003, "inertia": 5e-9 * long**2, "angle": tilt, "velocity": [0.0, -0.3411]},
            "bird": {
                "mass": 0.0045, "inertia": 7e-7 * long**2, "position": (at + out).tolist(), "angle": lean,
                "velocity": [-spin * out[1], -0.3411 + spin * out[0]], "angular_velocity": spin,
            },
        },
        "joints": {
            "pole": {"type": "point-on-line", "bodies": ["ground", "sleeve"], "at": [0, 0], "axis": [0, 1]},
            "pivot": {
                "type": "revolute", "bodies": ["sleeve", "bird"], "points": [[pivot * long, 0.0], [-arm * long, 0.0]],
            },
        },
        "forces": {"spring": {"type": "torsion-spring", "bodies": ["sleeve", "bird"], "stiffness": 0.0056 * long**2}},
        "contacts": {
            "beak": touch("bird", [-beak_x, beak_y], beak * long - (beak - pole), 0.5),
            "low": touch("sleeve", [sleeve_x, -sleeve_y], wall, 0.0),
            "high": touch("sleeve", [sleeve_x, sleeve_y], wall, 0.0),
        },
    }  # fmt: skip
    found = run(model, 0.15, step, treatment)
    late = 20.0 * step if treatment == "time-stepping" else 0.0
    reference = {  # time: height of the sleeve, angles of sleeve and bird
        0.02: (-0.004374, -0.10360, -0.45231), 0.05: (-0.004407, -0.10360, -0.39298),
        0.07: (-0.004697, -0.09038, -0.05316), 0.085: (-0.007208, 0.10291, 0.09421),
        0.1: (-0.007080, 0.02132, 0.00827), 0.125: (-0.011815, -0.10345, -0.13627),
        0.15: (-0.020768, -0.10345, -0.30859),
    }  # fmt: skip
    for t, values in reference.items():
        row = int(np.argmin(np.abs(found.time - t)))
        state = found["sleeve"].position[row, 1], long * found["sleeve"].angle[row], long * found["bird"].angle[row]
        # margin: how far the source is from this model
        assert state == pytest.approx(values, rel=0.0, abs=(3e-3 if t > 0.1 else 1.5e-3) + late)
    if treatment == "event-driven":
        assert found.impacts.contact.tolist() == ["high", "beak", "high", "low", "low"]
        assert np.all(found.impacts.energy_lost > 0.0)


@pytest.mark.parametrize(("treatment", "step"), [("event-driven", 1e-3), ("time-stepping", 2.5e-5)])
def test_a_slider_crank_with_clearance_moves_as_in_siconos(treatment: str, step: float) -> None:
    """SliderCrank/SliderCrankMoreauJeanCombinedProjectionOSI.ref, steps of 1e-4 s, in which the crank turns by up to
    0.9 degrees (P. Flores, R. Leine and C. Glocker, Multibody System Dynamics 23:165-190, 2010, figure 11).
    """
    integrator = {"name": "moreau-jean" if treatment == "time-stepping" else "dop853"}
    time = {"end": 0.02, "step": step}
    found = mbdkit.run("slider-crank-guide", contact={"treatment": treatment}, integrator=integrator, time=time)
    reference = {0.01: (0.151617, 1.0000), 0.015: (0.204258, 1.0000), 0.02: (0.258909, 0.8454)}
    for t, (turns, height) in reference.items():  # of the crank; of the slider over its clearance
        row = int(np.argmin(np.abs(found.time - t)))
        # margin: how far the source is from this model
        assert found["crank"].angle[row] / (2 * np.pi) == pytest.approx(
            turns, abs=3e-3 if treatment == "event-driven" else 4e-3
        )
        assert found["slider"].position[row, 1] / 1e-3 == pytest.approx(height, abs=0.03)
    assert_within(found["slider"].angle, 1e-9)  # both corners of the slider strike together
    assert np.min(found.contacts["top.2"].gap) > -1e-12


def test_time_stepping_of_the_slider_crank_converges_to_its_impacts_as_events() -> None:
    # expected: order 1; dop853 and gauss, which take other steps between the impacts, agree
    problem = problems()["slider-crank-guide"]

    def errors(treatment: str, integrator: dict[str, Any], step: float) -> list[float]:
        spec = problem.spec(step=step, contact={"treatment": treatment}, integrator=integrator)
        return list(problem.errors(mbdkit.run(spec)).values())

    for integrator in ({"name": "dop853"}, {"name": "gauss", "stages": 3}):
        assert_within(max(errors("event-driven", integrator, 1e-4)), 3e-11)
    coarse, fine, finer = (errors("time-stepping", {"name": "moreau-jean"}, step) for step in (4e-5, 2e-5, 1e-5))
    assert np.divide(coarse, fine) == pytest.approx(2.0, abs=0.3)
    assert np.divide(fine, finer) == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize(("treatment", "step"), [("event-driven", 0.01), ("time-stepping", 1e-4)])
def test_a_stick_that_would_gain_energy_as_in_siconos_loses_some(treatment: str, step: float) -> None:
    """ImpactingStick/ImpactingStick.ref, steps of 1e-4 s, in which Newton's law with friction creates 1.08e-4 J."""
    angle = np.pi / 4
    place = {"position": [0.5 * np.sin(angle), 0.5 * np.cos(angle) + 0.01], "angle": angle}
    model = {
        "gravity": [0.0, -10.0],
        "bodies": {"stick": {"mass": 1.0, "inertia": 1 / 12, "velocity": [-0.5, 0.1], "angular_velocity": 0.1} | place},
        "contacts": {
            "floor": {
                "bodies": ["ground", "stick"], "shapes": [FLOOR, {"point": [0.0, -0.5]}], "restitution": 1.0,
                "friction": 0.01,
            },
        },
    }  # fmt: skip
    found = run(model, 0.2, step, treatment)
    state = [*found["stick"].position[-1], found["stick"].angle[-1]]
    # margin: how far the source is from this model
    assert state == pytest.approx([0.252917, 0.247169, 1.081891], abs=2e-3)  # with other energy
    assert 1e-3 < found.energy.dissipated[-1] < 1.6e-3
    assert np.min(np.diff(found.energy.dissipated)) >= 0.0
    assert any("would have created energy at 'floor'" in text for text in found.warnings)
    if treatment == "event-driven":
        # margin: how far the source is from this model
        assert found.impacts.time == pytest.approx([0.0603, 0.1635], abs=8e-4)
        # margin: how far the source is from this model
        assert found.impacts.normal_impulse[0] == pytest.approx(0.373883, rel=0.02)


def test_walker_walks_in_the_limit_cycle_of_its_source():
    # expected: Garcia et al. (1998), table 1, massless feet: step 3.812092 + 1.579129 slope^(2/3), stance angle
    # 0.970956 slope^(1/3) - 0.270837 slope, and what the slope gives is lost in each impact
    slope, legs = 0.009, ("left", "right")
    run = ran("walker")
    times, lost = run.impacts.time, run.impacts.energy_lost
    stride = run["right"].position[0, 0] + 2 * (run["left"].position[0, 0] - run["right"].position[0, 0])
    mass = sum(body.mass for body in load_spec("walker").mechanism().bodies.values())
    weight = mass * 9.81 * np.array([np.sin(slope), -np.cos(slope)])
    needed = of_all_bodies(run, "walker", "acceleration") - weight
    force = sum(run.ground_reactions[leg].force for leg in legs)
    np.testing.assert_allclose(force, needed, rtol=0, atol=1e-7)
    pressure = run.ground_reactions["left"].center_of_pressure
    stones = np.unique(np.round(pressure[np.isfinite(pressure[:, 0]), 0] / stride, 6))
    assert run.impacts.contact.tolist() == ["second.2", "third.2"]
    steps = np.diff([0.0, *times]) * np.sqrt(9.81)
    assert steps == pytest.approx(np.full(2, 3.812092 + 1.579129 * slope ** (2 / 3)), rel=1e-3)
    assert steps == pytest.approx(np.full(2, np.mean(steps)), rel=1e-6)
    # margin: how far the source is from this model
    assert 0.5 * stride == pytest.approx(np.sin(0.970956 * slope ** (1 / 3) - 0.270837 * slope), rel=5e-3)
    assert lost == pytest.approx(np.full(2, weight[0] * stride), rel=1e-5)
    assert stones == pytest.approx([0.0, 2.0], abs=1e-5)  # footfalls of the left foot
