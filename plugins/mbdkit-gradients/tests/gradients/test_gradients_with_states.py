"""Gradients of runs with first-order states and sampled controllers, against closed forms and sensitivity equations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from tests.gradients.checks import assert_passed

import mbdkit
from mbdkit import Mechanism, SpecError
from mbdkit_gradients.measure_gradients import Gradient

INERTIA, GRAVITY, END = 0.05 + 3.0 * 0.2**2, 3.0 * 9.81 * 0.2, 0.5
VALUES = {"Kp": 40.0, "Kd": 3.0, "lag": 0.05, "start": 0.1}


def leg() -> dict[str, Any]:
    """A leg under proportional and derivative control, with a filtered angle as a nonlinear state."""
    return {
        "name": "mechanism", "bodies": {"leg": {"mass": 3.0, "inertia": 0.05, "position": [0.0, -0.2]}},
        "joints": {"hip": {"type": "revolute", "bodies": ["ground", "leg"], "points": [[0, 0], [0, 0.2]]}},
        "forces": {
            "motor": {
                "type": "torque", "body": "leg",
                "value": "-Kp*(leg.angle - 0.5*sin(2*t)) - Kd*leg.angular_velocity + 5*states.i",
            },
        },
        "states": {"i": {"rate": "(leg.angle - states.i - states.i**3)/lag", "initial": "start"}},
    }  # fmt: skip


def rates(t: float, y: np.ndarray, p: np.ndarray) -> np.ndarray:
    """The derivatives of angle, angular velocity and state."""
    angle, speed, i = y
    torque = -p[0] * (angle - 0.5 * np.sin(2 * t)) - p[1] * speed + 5 * i
    return np.array([speed, (torque - GRAVITY * np.sin(angle)) / INERTIA, (angle - i - i**3) / p[2]])


def exact() -> np.ndarray:
    """The derivatives of angle, velocity, state and its rate at the end by all values, by complex steps."""
    found = []
    for k in range(4):
        p = np.array([*VALUES.values()], dtype=complex)
        p[k] += 1e-30j
        y = np.array([0, 0, p[3]], dtype=complex)
        done = solve_ivp(rates, (0, END), y, args=(p,), method="DOP853", rtol=1e-13, atol=1e-14, max_step=0.002)
        end = done.y[:, -1]
        found.append(np.append(end, rates(END, end, p)[2]).imag / 1e-30)
    return np.array(found).T


MEASURES = ("final(leg.angle)", "final(leg.angular_velocity)", "final(states.i)", "final(states.i.rate)")


def gradient(integrator: dict[str, Any], step: float | None = 0.005, check: bool = False, **more: Any) -> Gradient:
    time = {"end": END} if step is None else {"end": END, "step": step}
    spec = {"mbdkit": 1, "parameters": VALUES, "model": leg(), "integrator": integrator, "time": time} | more
    return mbdkit.gradient(spec, MEASURES, list(VALUES), check=check)


@pytest.mark.parametrize(
    ("integrator", "step", "more"),
    [
        ({"name": "dop853"}, 0.01, {}),
        ({"name": "dop853", "adaptive": True, "rtol": 1e-11, "atol": 1e-11}, None, {}),
        ({"name": "dop853"}, 0.01, {"stabilization": "projection"}),
        ({"name": "gauss", "stages": 4}, 0.01, {}),
        ({"name": "radau-iia", "stages": 5}, 0.01, {}),
        ({"name": "radau-iia", "stages": 5}, 0.01, {"formulation": "index-2"}),
    ],
    ids=str,
)
def test_a_gradient_is_that_of_the_sensitivity_equations(
    integrator: dict[str, Any], step: float | None, more: dict[str, Any]
) -> None:
    found, wanted = gradient(integrator, step, **more), exact()
    size = np.abs(wanted).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found.jacobian / size, wanted / size, atol=1e-8)


@pytest.mark.parametrize("integrator", [{"name": "rk4"}, {"name": "gauss", "stages": 2}], ids=str)
def test_a_gradient_is_that_of_the_discrete_run(integrator: dict[str, Any]) -> None:
    """At large steps it agrees with differences of runs with the same steps, not with the sensitivity equations."""
    found = gradient(integrator, 0.02, check=True)
    assert_passed(found)
    np.testing.assert_allclose(found.check.derivative, found.check.extrapolated, rtol=1e-7)


def rotor(gain: str = "gain", period: str | float = 0.02) -> dict[str, Any]:
    """A rotor under a sampled controller with an integral part, whose output applies after a delay."""
    m = Mechanism(gravity=(0, 0))
    m.body("rotor", mass=1, inertia=0.5, angle=0.3)
    m.revolute("pin", m.ground, "rotor", at=(0, 0))
    model = m.to_spec()
    model["controllers"] = {
        "pid": {
            "period": period,
            "delay": 0.013,
            "outputs": {"u": f"-{gain}*rotor.angle - 2*rotor.angular_velocity - controllers.pid.sum"},
            "states": {"sum": {"initial": 0.1, "next": "controllers.pid.sum + 0.1*rotor.angle"}},
        }
    }
    model["forces"] = {"motor": {"type": "torque", "body": "rotor", "value": "controllers.pid.u"}}
    return model


def moved(gain: complex, angle: complex, total: complex) -> complex:
    """The angle after 0.5 s: between changes of the output, the rotor accelerates uniformly."""
    speed, output, pending = 0j, 0j, 0j
    for _ in range(25):
        pending, total = -gain * angle - 2 * speed - total, total + 0.1 * angle
        for time, following in ((0.013, pending), (0.007, None)):
            angle, speed = angle + time * speed + time**2 * output, speed + 2 * time * output
            output = output if following is None else following
    return angle


@pytest.mark.parametrize("integrator", [{"name": "rk4"}, {"name": "gauss", "stages": 2}], ids=str)
def test_a_gradient_through_samples_is_exact(integrator: dict[str, Any]) -> None:
    # expected: complex steps of the exact solution
    spec = {
        "mbdkit": 1, "parameters": {"gain": 6.0}, "model": rotor(), "integrator": integrator,
        "time": {"end": 0.5, "step": 0.005},
    }  # fmt: skip
    keys = ["gain", "model.bodies.rotor.angle", "model.controllers.pid.states.sum.initial"]
    found = mbdkit.gradient(spec, "final(rotor.angle)", keys, check=False)
    start = np.array([6.0, 0.3, 0.1], dtype=complex)
    wanted = [moved(*(start + 1e-30j * np.eye(3)[k])).imag / 1e-30 for k in range(3)]
    assert found.value[0] == pytest.approx(moved(*start).real, rel=1e-12)
    np.testing.assert_allclose(found.jacobian[0], wanted, rtol=1e-9)


def test_the_time_of_an_event_at_a_sample_has_no_gradient() -> None:
    # the output jumps from 0 to -1.9 at 0.013 s
    spec = {
        "mbdkit": 1, "parameters": {"gain": 6.0}, "model": rotor(), "integrator": {"name": "rk4"},
        "time": {"end": 0.1, "step": 0.005}, "events": {"on": {"when": "controllers.pid.u + 1"}},
    }  # fmt: skip
    with pytest.raises(SpecError, match="no derivative: its expression jumps") as refused:
        mbdkit.gradient(spec, "events.on.time", ["gain"], check=False)
    assert refused.value.key == "events.on.when"


def test_a_gradient_with_an_event_includes_the_state() -> None:
    """The angle at which a filtered rotor has turned by a given amount of its state, without gravity: linear."""
    model = leg() | {"gravity": [0, 0], "states": {"i": {"rate": "(leg.angle - states.i)/lag"}}}
    model["bodies"]["leg"] |= {"angular_velocity": 1.0, "velocity": [0.2, 0.0]}
    model["forces"]["motor"]["value"] = "-Kp*leg.angle + 0*Kd*start"
    events = {"reached": {"when": "states.i - 0.02"}}
    spec = {
        "mbdkit": 1, "parameters": VALUES, "model": model, "integrator": {"name": "dop853"},
        "time": {"end": END, "step": 0.01}, "events": events,
    }  # fmt: skip
    found = mbdkit.gradient(spec, "events.reached.time", ["Kp", "lag"], check=False)

    def state(t: float, gain: float, lag: float) -> np.ndarray:
        matrix = np.array([[0, 1, 0], [-gain / INERTIA, 0, 0], [1 / lag, 0, -1 / lag]])
        return np.asarray(expm(t * matrix) @ [0.0, 1.0, 0.0])

    t, step = float(found.value[0]), 1e-3
    assert state(t, 40.0, 0.05)[2] == pytest.approx(0.02, abs=1e-10)
    rate = (state(t, 40.0, 0.05)[0] - 0.02) / 0.05

    def slope(gain: float, lag: float) -> float:
        up, down, more, less = (state(t, 40.0 + k * gain, 0.05 + k * lag)[2] for k in (1, -1, 2, -2))
        return float(-(8 * (up - down) - (more - less)) / (12 * step) / rate)

    scaled = [slope(step * 40.0, 0.0) / 40.0, slope(0.0, step * 0.05) / 0.05]
    np.testing.assert_allclose(found.jacobian[0], scaled, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [{"name": "rk4"}, {"name": "gauss", "stages": 2}], ids=str)
def test_a_gradient_through_a_stop_includes_the_jump_of_the_rate_of_a_state(integrator: dict[str, Any]) -> None:
    """The force of a stop with a damper jumps at contact, and is part of the rate of a state."""
    model = leg()
    model["bodies"]["leg"] |= {"angular_velocity": 1.0, "velocity": [0.2, 0.0]}
    stop = {
        "type": "law", "law": "one-sided", "acts": "tension", "stiffness": 60.0, "damping": 0.3, "free_length": 0.02,
    }  # fmt: skip
    pathway = {"type": "relative-angle", "bodies": ["ground", "leg"]}
    model["forces"]["stop"] = stop | {"pathway": pathway}
    model["states"]["i"]["rate"] = "(forces.stop.value/10 + leg.angle - states.i)/lag"
    spec = {"mbdkit": 1, "parameters": VALUES, "model": model, "integrator": integrator}
    keys = [*VALUES, "model.forces.stop.stiffness", "model.forces.stop.free_length"]
    found = mbdkit.gradient(spec | {"time": {"end": 0.2, "step": 0.002}}, ["final(leg.angle)", "final(states.i)"], keys)
    assert_passed(found)
    np.testing.assert_allclose(found.check.derivative, found.check.extrapolated, rtol=1e-6)


@pytest.mark.parametrize(
    ("method", "measure", "sentence"),
    [("rk4", "max(leg.angle)", "the gradient of an extremum.* does not include first-order states \\(i\\)")],
)
def test_what_has_no_derivative_says_so(method: str, measure: str, sentence: str) -> None:
    time = {"end": 0.1, "step": 0.01}
    spec = {"mbdkit": 1, "parameters": VALUES, "model": leg(), "integrator": {"name": method}, "time": time}
    with pytest.raises(SpecError, match=sentence):
        mbdkit.gradient(spec, measure, "Kp")


def test_the_times_of_samples_have_no_derivatives() -> None:
    model, time = rotor("6", "period"), {"end": 0.1, "step": 0.01}
    spec = {"mbdkit": 1, "parameters": {"period": 0.02}, "model": model, "integrator": {"name": "rk4"}, "time": time}
    with pytest.raises(SpecError, match="times of the samples of the controller 'pid' depend on 'period'"):
        mbdkit.gradient(spec, "final(rotor.angle)", "period")
