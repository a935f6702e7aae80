"""Objectives and conditions with measured functions of time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.interpolate import CubicSpline

import mbdkit
import mbdkit_biomech
from mbdkit import SpecError
from predict.exact_optima import block
from tests.margins import assert_within

TIMES = np.linspace(0.0, 1.0, 21)
SWING = 0.3 * np.sin(4.0 * TIMES) + 0.05 * np.cos(9.0 * TIMES)


def tracking(**sections: Any) -> dict[str, Any]:
    """Return a pendulum (1 kg, 0.1 kg m^2 about its centre, 0.5 m below the hinge) that follows a measured angle."""
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.0, -0.5))
    m.revolute("hip", m.ground, rod, at=(0, 0))
    m.torque("motor", rod, value=0.0)
    return {
        "mbdkit_predict": 1, "base": {"model": m.to_spec()}, "duration": 1.0, "tolerance": 1e-7,
        "controls": {"forces.motor.value": {"bounds": [-50, 50]}},
        "initial": {"hip.angle": 0, "rod.angular_velocity": 0},
        "measured": {"hip": {"table": [TIMES.tolist(), SWING.tolist()]}},
        "minimize": "integral(100*(hip.angle - measured.hip)**2 + 0.01*forces.motor.value**2)", **sections,
    }  # fmt: skip


def exact_tracking() -> float:
    """Return the optimum of `tracking` from Pontryagin's principle, for the spline through the same points."""
    measured, inertia, gravity = CubicSpline(TIMES, SWING), 0.35, 0.5 * 9.81

    def rates(t: np.ndarray, y: np.ndarray) -> np.ndarray:
        angle, rate, p, q, _ = y
        torque, gap = -q / (0.02 * inertia), angle - measured(t)
        return np.array(
            [rate, (torque - gravity * np.sin(angle)) / inertia, -200 * gap + q * gravity * np.cos(angle) / inertia, -p,
             100 * gap**2 + 0.01 * torque**2]
        )  # fmt: skip

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([a[0], a[1], b[2], b[3], a[4]])

    found = solve_bvp(rates, ends, np.linspace(0, 1, 401), np.zeros((5, 401)), tol=1e-10, max_nodes=100_000)
    assert found.success
    return float(found.y[4, -1])


def test_measured_functions_have_their_value_at_the_end_and_forces_are_refused_there() -> None:
    # from rest to rest over x, the least effort is 12 x^2; the least 1000 (x - 1)^2 + 12 x^2 is 12000 / 1012
    spec = block(final={"block.vx": 0}, measured={"place": {"table": [[0, 1], [5, 1]], "interpolation": "linear"}})
    effort = " + integral(forces.push.value**2)"
    run = mbdkit.predict(spec | {"minimize": "1000*final((block.x - measured.place)**2)" + effort})
    assert_within(run.objective - 12000 / 1012, run.objective_error)
    with pytest.raises(SpecError, match="`final` depends on accelerations, reactions or controls") as caught:
        mbdkit.predict(spec | {"minimize": "final((forces.push.value - 5)**2)" + effort})
    assert caught.value.key == "minimize"


def test_a_pendulum_follows_a_measured_angle() -> None:
    run = mbdkit.predict(tracking())
    assert (run.status, run.verdict) == ("complete", "good")
    error = abs(run.objective - exact_tracking())
    assert error <= run.objective_error < 1e-6 * run.objective
    np.testing.assert_allclose(
        run.states["measured.hip"].value[1:], CubicSpline(TIMES, SWING)(run.time[1:]), atol=1e-12
    )


def test_torques_of_a_leg_that_follows_gait_are_those_of_inverse_dynamics() -> None:
    # expected: torques by inverse dynamics of the splines through the same columns; effort costs next to nothing
    table = str(Path(mbdkit_biomech.__file__).parent / "examples" / "walking.csv")
    m = mbdkit.Mechanism()
    thigh = m.body("thigh", mass=7.5, inertia=0.13, position=(0, -0.19))
    shank = m.body("shank", mass=4.6, inertia=0.1, position=(0, -0.64))
    m.revolute("hip", m.ground, thigh, at=(0, 0))
    m.revolute("knee", thigh, shank, at=(0, -0.44))
    columns = {f"{name}.angle": {"column": f"{name}_flexion", "unit": "deg"} for name in ("hip", "knee")}
    columns["knee.angle"] |= {"scale": -1}
    motion = {"file": table, "columns": columns, "smooth": "none"}
    inverse = mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion})
    m.torque("hip", thigh, value=0.0)
    m.torque("knee", shank, reaction_body=thigh, value=0.0)
    run = mbdkit.predict(
        {
            "mbdkit_predict": 1, "base": {"model": m.to_spec()}, "duration": 1.0, "tolerance": 1e-4,
            "controls": {f"forces.{name}.value": {"bounds": [-500, 500]} for name in ("hip", "knee")},
            "measured": {x: {"file": table, "y": f"{x}_flexion", "unit": "deg"} for x in ("hip", "knee")},
            "minimize": "integral((hip.angle - measured.hip)**2 + (knee.angle + measured.knee)**2)"
                        " + 1e-9*integral(forces.hip.value**2 + forces.knee.value**2)",
        }
    )  # fmt: skip
    times = np.linspace(0.1, 0.9, 17)
    for name in ("hip", "knee"):
        own = np.interp(times, run.time, run.controls[f"forces.{name}.value"].value)
        exact = np.interp(times, inverse.time, inverse.actuators[name].value)
        np.testing.assert_allclose(own, exact, atol=0.02 * np.ptp(exact))


def test_measured_functions_in_conditions_have_the_value_at_their_time(tmp_path: Path) -> None:
    # from rest to rest over 1.25 m - 0.25 m in 1 s: 12; Bryson-Denham with its limit as a function of time: 4
    (tmp_path / "goal.csv").write_text("t;x [mm];limit\n0;250;0.1111111111111111\n0.5;0;0.1111111111111111\n"
                                       "1;1250;0.1111111111111111\n")  # fmt: skip
    goal = {"file": str(tmp_path / "goal.csv"), "x": "t", "y": "x"}
    at_goal = {"block.x - measured.goal": 0, "block.vx": 0}
    run = mbdkit.predict(block(measured={"goal": goal}, initial=at_goal, final=at_goal))
    assert_within(run.objective - 12.0, run.objective_error)
    assert [file.name for file in run.files or ()] == ["goal.csv"]
    below = {"below": {"value": 'block.x - measured["the limit"]', "max": 0}}
    run = mbdkit.predict(
        block(
            measured={"the limit": goal | {"y": "limit", "unit": "1"}}, initial={"block.x": 0, "block.vx": 1},
            final={"block.x": 0, "block.vx": -1}, subject_to=below, minimize="0.5*integral(forces.push.value**2)",
        )
    )  # fmt: skip
    assert_within(run.objective - 4.0, run.objective_error)
    assert run.objective_error < 1e-5


@pytest.mark.parametrize(
    ("changed", "key", "text"),
    [
        ({"goal": {"y": "angle"}}, "measured.goal.unit", "states no unit of 'angle'"),
        ({"goal": {"y": "angel"}}, "measured.goal.y", "did you mean 'angle'"),
        ({"goal": {"y": "angle", "x": "tiem", "unit": "deg"}}, "measured.goal.x", "did you mean 'time'"),
        ({"goal": {"y": "angle", "unit": "degrees"}}, "measured.goal", "did you mean 'deg'"),
        ({"goal": {"y": "lift", "unit": "m"}}, "measured.goal.unit", "m contradicts the unit in gait.csv, mm"),
        ({"goal": {"x": "lift", "y": "angle"}}, "measured.goal", "mm is not a unit of time"),
        ({"goal": {}}, "measured.goal", "needs either `table"),
        ({"goal": {"y": "gap", "unit": "deg"}}, "measured.goal", "the value is missing"),
        ({"goal": {"x": "gap", "y": "angle", "unit": "deg"}}, "measured.goal", "the time is missing"),
        ({"goal": {"x": "angle", "y": "gap", "unit": "deg"}}, "measured.goal", "times should increase"),
        ({"goal": {"z": "angle"}}, "measured.goal.z", "unknown key"),
        (
            {"goal": {"table": [[0, 1], [1, 2]], "interpolation": "linear", "ends": "clamped"}}, "measured.goal.ends",
            "linear",
        ),
        ({"goal": 5}, "measured.goal", "should be a mapping"),
        ({"goal": {"table": [[0, 0.5], [1, 2]]}}, "measured.goal.table[0]", "covers 0.0 s to 0.5 s, but"),
        ({"goal": {"table": [[0, 1], [1, float("nan")]]}}, "measured.goal.table[1][1]", "finite number"),
        ({"a/b": {"table": [[0, 1], [1, 2]]}}, "measured.a/b", "without '/'"),
        (
            {"gaol": {"table": [[0, 1], [1, 2]]}}, "minimize",
            "there is no measured function 'goal' (did you mean 'gaol'?)",
        ),
    ],
)  # fmt: skip
def test_a_wrong_measured_function_is_one_sentence(
    changed: dict[str, Any], key: str, text: str, tmp_path: Path
) -> None:
    (tmp_path / "gait.csv").write_text("time,angle,gap,lift [mm]\n0,5,1,7\n1,3,,8\n")
    measured = {
        name: given | {"file": str(tmp_path / "gait.csv")}
        if isinstance(given, dict) and "table" not in given
        else given
        for name, given in changed.items()
    }
    with pytest.raises(SpecError) as caught:
        mbdkit.predict(block(measured=measured, minimize="integral((block.x - measured.goal)**2)"))
    assert caught.value.key == key
    assert text in caught.value.message


def test_a_free_duration_refuses_measured_functions() -> None:
    with pytest.raises(SpecError, match="need a duration that is a number"):
        mbdkit.predict(tracking(duration={"bounds": [0.5, 1]}))
