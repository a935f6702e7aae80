"""Runs see what functions of time do, whether or not the motion depends on it."""

import math
from typing import Any

import pytest

import mbdkit
from mbdkit import SpecError

SLIDE: dict[str, Any] = {
    "gravity": [0, 0],
    "bodies": {"b": {"mass": 1.0, "inertia": 0.1}},
    "joints": {"s": {"type": "prismatic", "bodies": ["ground", "b"], "at": [0, 0], "axis": [1, 0]}},
}
METHODS = [
    {"name": "dopri5", "adaptive": True},
    {"name": "dop853", "adaptive": True},
    {"name": "radau-iia", "stages": 2, "adaptive": True},
    {"name": "radau-iia", "stages": 3, "adaptive": True},
    {"name": "gauss", "stages": 3, "adaptive": True},
    {"name": "scipy-dop853"},
    {"name": "scipy-lsoda"},
]


def run(model: dict[str, Any], integrator: dict[str, Any], end: float, **more: Any) -> Any:
    spec = {"mbdkit": 1, "model": {"name": "mechanism", **model}, "integrator": integrator, "time": {"end": end}}
    return mbdkit.run(spec | more)


def driven(motion: str, **more: Any) -> Any:
    model = {
        "gravity": [0, -9.81],
        "bodies": {"b": {"mass": 1.0, "inertia": 1.0}, "c": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0]}},
        "joints": {
            "j": {"type": "revolute", "bodies": ["ground", "b"], "at": [0, 0]},
            "k": {"type": "revolute", "bodies": ["b", "c"], "at": [0.1, 0]},
            "m": {"type": "driver", "bodies": ["ground", "b"], "coordinate": "angle", "motion": motion},
        },
    }
    return run(model, {"name": "dop853", "adaptive": True}, 1.5, **more)


@pytest.mark.parametrize("method", METHODS, ids=lambda x: f"{x['name']}{x.get('stages', '')}")
def test_integrals_of_the_force_of_a_joint_at_rest_are_those_of_the_load(method: dict[str, Any]) -> None:
    load = {"forces": {"F": {"type": "force", "body": "b", "value": ["0", "10*sin(7*t + 1)"]}}}
    y = "joints.s.force_y"
    measures = {"I": f"integral({y})", "m": f"mean({y})", "r": f"rms({y})", "w": f"integral(sin(40*t/T)*{y})"}
    found = run(SLIDE | load, method, 2.0, measures=measures, parameters={"T": "1 s"}).measures
    exact = 10 / 7 * (math.cos(1) - math.cos(15))  # the joint acts on ground with the load
    square = 100 * (1.0 - (math.sin(30) - math.sin(2)) / 28)
    product = 5 * ((math.sin(33 * 2 - 1) + math.sin(1)) / 33 - (math.sin(47 * 2 + 1) - math.sin(1)) / 47)
    sign = math.copysign(1.0, found["I"] * exact)
    assert found["I"] == pytest.approx(sign * exact, abs=1e-4)
    assert found["m"] == pytest.approx(sign * exact / 2, abs=1e-4)
    assert found["r"] == pytest.approx(math.sqrt(square / 2), rel=1e-4)
    assert found["w"] == pytest.approx(sign * product, abs=1e-4)


@pytest.mark.parametrize("method", METHODS, ids=lambda x: f"{x['name']}{x.get('stages', '')}")
def test_a_short_pulse_far_from_any_sample_pushes_a_body_at_rest(method: dict[str, Any]) -> None:
    load = {"forces": {"F": {"type": "force", "body": "b", "value": ["1e3*exp(-((t - 1.2345678)/1e-3)**2)", "0"]}}}
    assert run(SLIDE | load, method, 2.0)["b"].velocity[-1, 0] == pytest.approx(math.sqrt(math.pi), rel=1e-5)


def test_steps_see_pulses_in_states_and_in_parts_of_expressions_of_the_state() -> None:
    pulse = "exp(-((t - 1.2345678)/1e-3)**2)"
    model = SLIDE | {
        "states": {"z": {"rate": f"1e3*{pulse}", "initial": 0.0}},
        "forces": {"F": {"type": "force", "body": "b", "value": [f"1e3*{pulse}*(1 + 0*b.x)", "0"]}},
    }
    there = run(model, {"name": "dop853", "adaptive": True}, 2.0)
    assert there.states["z"].value[-1] == pytest.approx(math.sqrt(math.pi), rel=1e-5)
    assert there["b"].velocity[-1, 0] == pytest.approx(math.sqrt(math.pi), rel=1e-5)


@pytest.mark.parametrize(
    "motion", ["asin(sin(3*t))", "sqrt((t - 0.7)**2)", "0.3*((t - 0.7)**2)**0.5", "exp(log(t**2))*0 + acos(cos(5*t))"]
)
def test_a_driver_whose_velocity_jumps_at_a_hidden_corner_is_refused(motion: str) -> None:
    with pytest.raises(SpecError, match=r"joints\.m\.motion: the rate of this motion jumps from"):
        driven(motion)


def test_a_driver_that_jumps_within_rounding_errors_is_refused() -> None:
    with pytest.raises(
        SpecError, match=r"joints\.m\.motion: the value of this motion jumps from -1 to 1 rad at t = 1 s"
    ):
        driven("tanh(1e12*(t - 1))", impacts="allow")


def test_hidden_corners_of_drivers_are_impulses_like_those_of_abs() -> None:
    hidden, known = (driven(f"2*{motion}", impacts="allow") for motion in ("sqrt((t - 0.7)**2)", "abs(t - 0.7)"))
    assert len(hidden.impacts.time) == 1
    assert hidden["c"].angle[-1] == pytest.approx(known["c"].angle[-1], abs=1e-6)


def test_a_driver_whose_expression_loses_its_rates_beside_a_corner_is_refused_with_impacts() -> None:
    with pytest.raises(SpecError, match="write the motion with abs, min or max, or as a table"):
        driven("asin(sin(3*t))", impacts="allow")


def test_sharp_but_smooth_drivers_run() -> None:
    there = driven("0.1*sqrt((t - 0.7)**2 + 1e-4)")
    assert there["b"].angle[-1] == pytest.approx(0.1 * math.hypot(0.8, 1e-2), abs=1e-5)


def test_wall_time_limits_nested_measures() -> None:
    nested = {f"m{k}": f"max(abs(joints.J1.force_x - {k}*mean(joints.J1.force_x)))" for k in range(40)}
    there = mbdkit.run(
        "double-pendulum", time={"end": 1e5, "step": 0.001}, integrator={"name": "rk4"}, formulation="index-1",
        limits={"wall_time": 0.3}, measures=nested,
    )  # fmt: skip
    assert there.status_reason.startswith("wall-time")
    assert any(math.isnan(value) for value in there.measures.values())


def test_friction_in_index_3_that_no_step_resolves_is_told_with_its_remedy() -> None:
    angle = -2.7059196626214472
    place = [0.26143 * math.cos(angle), 0.26143 * math.sin(angle)]
    friction = {"coefficient": 0.178, "radius": 0.02856}
    model = {
        "bodies": {"b": {"mass": 1.084, "inertia": 0.1, "angle": angle, "position": place}},
        "joints": {"j": {"type": "revolute", "bodies": ["ground", "b"], "at": [0, 0], "friction": friction}},
    }
    method = {"name": "radau-iia", "stages": 3, "adaptive": True, "rtol": 1e-9}
    there = run(model, method, 0.1, formulation="index-3", stabilization="none")
    assert "use `stabilization: projection`" in there.status_reason
    assert run(model, method, 0.1, formulation="index-3", stabilization="projection").status == "complete"
