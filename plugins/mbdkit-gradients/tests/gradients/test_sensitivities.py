"""Values of quantities at given times, and their derivatives, against closed forms and differences of stepped runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.gradients.bouncing_ball import ball, expected

import mbdkit
from mbdkit import RunError, SpecError, load_spec
from mbdkit_gradients.gradient_parameters import resolved
from mbdkit_gradients.prepared_derivatives import RunPreparation
from mbdkit_gradients.sensitivities import PreparedSensitivities
from tests.margins import assert_within

PARAMETERS = {"m": 1.0, "k": 30.0, "c": 0.4, "x0": 0.3}


def oscillator(**sections: Any) -> dict[str, Any]:
    """A mass on a spring and a damper, along x."""
    return {
        "mbdkit": 1,
        "parameters": PARAMETERS,
        "model": {
            "name": "mechanism",
            "gravity": [0, 0],
            "bodies": {"cart": {"mass": "m", "inertia": 1.0, "position": ["x0", 0]}},
            "joints": {"rail": {"type": "prismatic", "bodies": ["ground", "cart"], "at": [0, 0], "axis": [1, 0]}},
            "forces": {
                "spring": {
                    "type": "spring-damper", "bodies": ["ground", "cart"], "points": [[-2, 0], [0, 0]],
                    "stiffness": "k", "damping": "c", "free_length": 2.0,
                }
            },
        },
        "integrator": {"name": "gauss", "stages": 3},
        "time": {"end": 2.0, "step": 0.01},
    } | sections  # fmt: skip


def closed_form(t: np.ndarray, m: float, k: float, c: float, x0: float) -> np.ndarray:
    """The position of the mass, which starts at rest."""
    decay, rate = c / (2 * m), np.sqrt(k / m - (c / (2 * m)) ** 2 + 0j)
    return x0 * np.exp(-decay * t) * (np.cos(rate * t) + decay / rate * np.sin(rate * t))


@pytest.mark.parametrize(
    ("method", "times"),
    [
        ({"name": "gauss", "stages": 3}, np.linspace(0.0, 2.0, 41)),  # ends of steps
        ({"name": "gauss", "stages": 3}, np.linspace(0.003, 1.997, 57)),  # within steps
        ({"name": "dop853", "adaptive": True, "rtol": 1e-10, "atol": 1e-12}, np.linspace(0.0, 2.0, 41)),
    ],
)
def test_derivatives_of_an_oscillator_are_those_of_the_closed_form(method: dict[str, Any], times: np.ndarray) -> None:
    found = mbdkit.sensitivities(oscillator(integrator=method), ["cart.x", "m*cart.x"], times, list(PARAMETERS))
    assert found.differences == ""
    assert found.units == ("m", "")
    np.testing.assert_allclose(found.values[0], closed_form(times, **PARAMETERS).real, atol=1e-8)
    for k, name in enumerate(PARAMETERS):
        h = 1e-30
        shifted = {**PARAMETERS, name: PARAMETERS[name] + 1j * h}
        exact = closed_form(times.astype(complex), **shifted)
        np.testing.assert_allclose(found.derivatives[0, :, k], exact.imag / h, atol=1e-7)
        product = (shifted["m"] * exact).imag / h
        np.testing.assert_allclose(found["m*cart.x", name], product, atol=1e-7)


def test_times_may_be_in_any_order_and_repeated() -> None:
    one = mbdkit.sensitivities(oscillator(), ["cart.x"], [1.0, 0.5, 1.0], ["k"])
    assert one.values[0, 0] == one.values[0, 2] != one.values[0, 1]
    assert mbdkit.sensitivities(oscillator(), "cart.x", 0.5, "k").values[0, 0] == one.values[0, 1]


ARM: dict[str, Any] = {
    "name": "mechanism",
    "bodies": {
        "a": {"mass": "m", "inertia": 0.1, "position": [0.5, 0]},
        "b": {"mass": 0.5, "inertia": 0.05, "position": ["1 + x0", 0]},
    },
    "joints": {
        "hub": {"type": "revolute", "bodies": ["ground", "a"], "at": [0, 0]},
        "elbow": {"type": "revolute", "bodies": ["a", "b"], "at": [1, 0]},
    },
    "forces": {"spring": {"type": "torsion-spring", "bodies": ["ground", "a"], "stiffness": "k", "damping": "c"}},
}
CASES: dict[str, dict[str, Any]] = {
    "plain": {},
    "states": {
        "states": {"current": {"rate": "3 - 20*states.current - k*a.angular_velocity", "unit": "A"}},
        "forces": {**ARM["forces"], "motor": {"type": "torque", "body": "a", "value": "c*states.current"}},
    },
    "controller": {
        "controllers": {"pd": {"period": 0.05, "delay": 0.01, "outputs": {"u": "-k*elbow.angle"}}},
        "forces": {
            **ARM["forces"],
            "motor": {"type": "torque", "body": "b", "reaction_body": "a", "value": "controllers.pd.u"},
        },
    },
    "input": {
        "inputs": {"u": {"unit": "N*m", "hold": "linear"}},
        "forces": {**ARM["forces"], "motor": {"type": "torque", "body": "a", "value": "c*inputs.u"}},
    },
}  # fmt: skip


def arm(case: str, **sections: Any) -> dict[str, Any]:
    inputs = {"inputs": {"u": {"table": [[0.0, 0.1, 0.2, 0.5], [0.0, 4.0, -3.0, 1.0]]}}} if case == "input" else {}
    return {
        "mbdkit": 1,
        "parameters": {"m": 1.0, "k": 4.0, "c": 0.3, "x0": 0.4},
        "model": ARM | CASES[case],
        "integrator": {"name": "rk4"},
        "time": {"end": 0.6, "step": 0.005},
    } | inputs | sections  # fmt: skip


INITIAL = {"hub.angle": 0.2, "elbow.angle": -0.5, "a.angular_velocity": 1.0}


WHOLE = INITIAL | {"b.angular_velocity": -0.4}
"""Values that determine the start, which is then differentiated as an implicit function."""


@pytest.mark.parametrize(
    ("case", "shift", "initial"),
    [(case, shift, INITIAL) for case in ("plain", "states", "controller", "input") for shift in (0.0, 0.0017)]
    + [("plain", 0.0, WHOLE), ("input", 0.0, WHOLE)],
)
def test_exact_derivatives_agree_with_differences_of_stepped_runs(
    case: str, shift: float, initial: dict[str, float]
) -> None:
    quantities = ["b.angle", "elbow.angle", "b.vx", "joints.elbow.force", "k*a.angular_acceleration"]
    if case == "states":
        quantities.append("states.current")
    names = ["m", "k", "c", "x0", "initial.hub.angle", "initial.a.angular_velocity"]
    times = np.arange(0.05, 0.55, 0.05) + shift
    prepared = PreparedSensitivities(load_spec(arm(case)), quantities, times, names, initial=initial)
    exact = prepared.at({})
    assert exact.differences == ""
    np.testing.assert_allclose(prepared.values({}), exact.values, rtol=1e-9, atol=1e-9)
    prepared.differences = "asked for"
    other = prepared.at({})
    scale = np.max(np.abs(other.values), axis=1)[:, None]
    size = np.max(np.abs(exact.derivatives), axis=1)[:, None]
    # interpolation within steps of a method of order 4 costs digits
    tolerance = 1e-9 if shift == 0.0 else 1e-5
    assert_within((exact.values - other.values) / scale, tolerance)
    assert_within((exact.derivatives - other.derivatives) / (size + 1e-3), max(1e-6, 10 * tolerance))


def test_values_are_those_of_the_run() -> None:
    run = mbdkit.run(arm("controller"))
    found = mbdkit.sensitivities(arm("controller"), ["b.angle", "joints.hub.force_x"], run.time, ["k"])
    assert np.array_equal(found.values[0], run.bodies["b"].angle)
    np.testing.assert_allclose(found.values[1], run.joints["hub"].reaction_force[:, 0], rtol=1e-12)


def test_a_ball_that_bounces_has_differences_that_say_so() -> None:
    ball = {
        "mbdkit": 1,
        "parameters": {"e": 0.8},
        "model": {
            "name": "mechanism",
            "bodies": {"ball": {"mass": 1.0, "inertia": 0.1, "position": [0, 1]}},
            "contacts": {
                "floor": {
                    "bodies": ["ground", "ball"], "restitution": "e",
                    "shapes": [{"line": {"normal": [0, 1]}}, {"circle": {"radius": 0.1}}],
                }
            },
        },
        "contact": {"treatment": "event-driven"},
        "integrator": {"name": "gauss", "stages": 2},
        "time": {"end": 1.0, "step": 0.01},
    }  # fmt: skip
    spec = load_spec(ball)
    times = np.array([0.3, 0.6, 0.9])
    found = mbdkit.sensitivities(spec, ["ball.y", "ball.vy"], times, ["e"])
    assert "contact" in found.differences or "impact" in found.differences
    g, fall = 9.81, np.sqrt(2 * 0.9 / 9.81)
    after = times > fall
    np.testing.assert_allclose(found["ball.y", "e"], np.where(after, g * fall * (times - fall), 0.0), atol=1e-6)
    np.testing.assert_allclose(found["ball.vy", "e"], np.where(after, g * fall, 0.0), atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((["cart.x"], [3.0], ["k"]), r"times: 3 s is outside of the run"),
        ((["cart.x"], [float("nan")], ["k"]), r"times: give a list of finite times"),
        ((["cart.z"], [1.0], ["k"]), r"quantities: .*'z'"),
        ((["cart.x"], [1.0], ["kk"]), r"no parameter 'kk' \(did you mean 'k'\?\)"),
        ((["cart.x"], [1.0], ["initial.cart.x"]), r"no initial value of 'cart.x'"),
        (([3], [1.0], ["k"]), r"a quantity is an expression"),
        ((["cart.x"], [1.0], []), r"at least one parameter"),
    ],
)
def test_wrong_input_is_one_sentence(arguments: Any, message: str) -> None:
    with pytest.raises(SpecError, match=message):
        mbdkit.sensitivities(oscillator(), *arguments)


def test_a_run_that_ends_early_is_an_error() -> None:
    stopped = oscillator(events={"back": {"when": "cart.x", "action": "stop"}})
    assert mbdkit.sensitivities(stopped, ["cart.x"], [0.1], ["k"]).differences.startswith("an event ends the run")
    with pytest.raises(RunError, match=r"the run ends before t = 1 s: .*back"):
        mbdkit.sensitivities(stopped, ["cart.x"], [1.0], ["k"])


@pytest.mark.parametrize("stiffness", ["k", "k*m"])
def test_derivatives_at_other_values_are_those_of_the_closed_form(stiffness: str) -> None:
    """Those of the preparation are known from first values; they hold at others if it is linear in all parameters."""
    source = oscillator()
    source["model"]["forces"]["spring"]["stiffness"] = stiffness
    times, others = np.linspace(0.1, 2.0, 20), {"m": 1.2, "k": 25.0, "c": 0.5, "x0": 0.2}
    prepared = PreparedSensitivities(load_spec(source, ()), ["cart.x"], times, list(PARAMETERS))
    prepared.at({})
    found = prepared.at(others)
    for k, name in enumerate(PARAMETERS):
        z: dict[str, Any] = {**others, name: others[name] + 1e-30j}
        z["k"] = z["k"] * z["m"] if stiffness == "k*m" else z["k"]
        slope = closed_form(times.astype(complex), **z).imag / 1e-30
        np.testing.assert_allclose(found.derivatives[0, :, k], slope, atol=1e-7)


def test_derivatives_follow_a_factor_of_their_parameter_that_is_not_differentiated() -> None:
    # expected: the derivative by the damping at damping zero, times the factor
    source = oscillator(parameters=PARAMETERS | {"d": 1.0})
    source["model"]["forces"]["spring"]["damping"] = "c*d"
    t = np.array([0.5, 1.5])
    prepared = PreparedSensitivities(load_spec(source), ["cart.x"], t, ["c"])
    prepared.at({"c": 0.4, "d": 1.0})
    found = prepared.at({"c": 0.0, "d": 5.0}).derivatives.ravel()
    rate = np.sqrt(30.0)
    exact = 5.0 * 0.3 * (np.sin(rate * t) / rate - t * np.cos(rate * t)) / 2.0
    assert_within(found - exact, 1e-8)


def test_a_derivative_on_one_side_says_so_each_time() -> None:
    spec = load_spec(oscillator(parameters=PARAMETERS | {"c": 0.0}))
    preparation, both = RunPreparation(spec, lambda _: {}), resolved(spec, ["c", "k"])
    for _ in range(2):
        assert preparation._by_differences(both).side.tolist() == [1, 0]  # a damping is not negative


def geared(start: float) -> dict[str, Any]:
    """Two arms, and a rotor on the first one whose belt turns the second one, from a start time [s]."""
    return {
        "mbdkit": 1,
        "parameters": {"l": 0.4, "c": 0.2, "r": 0.05, "J": 0.001, "turn": 0.3, "swing": 0.5},
        "model": {
            "name": "mechanism",
            "bodies": {
                "upper": {
                    "mass": 1.0, "inertia": 0.01, "position": ["l*sin(swing)", "-l*cos(swing)"], "angle": "swing",
                },
                "lower": {"mass": 0.5, "inertia": 0.01, "position": ["l*sin(swing)", "-l*cos(swing) - c"]},
                "rotor": {"mass": 0.1, "inertia": "J", "angle": "turn"},
            },
            "joints": {
                "shoulder": {"type": "revolute", "bodies": ["ground", "upper"], "points": [[0, 0], [0, "l"]]},
                "elbow": {"type": "revolute", "bodies": ["upper", "lower"], "points": [[0, 0], [0, "c"]]},
                "axle": {"type": "revolute", "bodies": ["upper", "rotor"], "points": [[0, "l"], [0, 0]]},
                "belt": {
                    "type": "belt", "bodies": ["rotor", "lower"], "points": [[0, 0], [0, "c"]], "radii": [0.02, "r"],
                },
            },
        },
        "integrator": {"name": "rk4"},
        "time": {"start": start, "end": start + 0.3, "step": 0.01},
    }  # fmt: skip


GIVEN = {"upper.angle": 0.6, "lower.angle": 0.1, "upper.angular_velocity": 0.5, "lower.angular_velocity": 1.0}


@pytest.mark.parametrize("initial", [{}, GIVEN], ids=["start", "given"])
def test_derivatives_with_a_belt_are_exact(initial: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> None:
    # expected: differences of runs
    monkeypatch.delattr(RunPreparation, "_by_differences")
    values = geared(1.0)["parameters"]
    names = [*values, *(f"initial.{one}" for one in initial)]
    quantities, times = ["lower.angle", "rotor.angle"], np.array([1.0, 1.1, 1.3])
    spec = load_spec(geared(1.0))
    other = PreparedSensitivities(load_spec(geared(0.5)), quantities, np.array([0.6]), names, initial=initial)
    other.at(values)
    prepared = PreparedSensitivities(spec, quantities, times, names, initial=initial, like=other)
    found = prepared.at(values)
    assert found.differences == ""
    alone = PreparedSensitivities(spec, quantities, times, names, initial=initial).at(values)
    np.testing.assert_array_equal(found.derivatives, alone.derivatives)
    every = values | {f"initial.{one}": value for one, value in initial.items()}
    for k, name in enumerate(names):
        h = 1e-3 * every[name]
        at = {place: prepared.values(every | {name: every[name] + place * h}, initial) for place in (-2, -1, 1, 2)}
        slope = (8.0 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12.0 * h)
        assert_within((found.derivatives[..., k] - slope) / np.max(np.abs(slope)), 1e-7, name)


@pytest.mark.parametrize("method", [{"name": "dopri5"}, {"name": "gauss", "stages": 2}], ids=lambda one: one["name"])
def test_controlled_steps_end_at_jumps_of_forces(method: dict[str, Any]) -> None:
    # expected: the closed form of a ball that bounces on a damped pad, within contact and after it
    times = [0.45, 0.9]
    spec = ball(0.9, 0.01, {**method, "adaptive": True, "rtol": 1e-9, "atol": 1e-11}) | {"time": {"end": 0.9}}
    found = mbdkit.sensitivities(spec, ["ball.y", "ball.vy"], times, ["y", "k", "c"])
    for place, time in enumerate(times):
        np.testing.assert_allclose(found.derivatives[:, place], expected(time), rtol=2e-6, atol=1e-12)
