"""Gradients through the corners and jumps of force laws: closed forms of a bouncing ball, by complex step."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.gradients.bouncing_ball import GAUSS, GRAVITY, HEIGHT, MEASURES, PAD, STIFFNESS, ball, bounce, expected
from tests.gradients.checks import assert_passed

import mbdkit
from tests.margins import assert_within


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "engages_at"),
    [
        pytest.param(0.45, PAD, id="in contact"),
        pytest.param(0.9, PAD, id="after it"),
        pytest.param(0.9, 0.25, id="preload"),
    ],
)
def test_gradients_through_a_jump_of_the_force_are_those_of_the_motion(end: float, engages_at: float) -> None:
    # expected: the closed form; the damper makes the force jump when contact begins, and so does a preload
    law = {} if engages_at == PAD else {"engages_at": engages_at}
    found = mbdkit.gradient(ball(end, 0.01, **law), MEASURES, ["y", "k", "c"])
    np.testing.assert_allclose(found.jacobian, expected(end, engages_at=engages_at), rtol=2e-7, atol=1e-12)
    assert_passed(found)


def test_gradients_within_the_step_in_which_the_force_jumps() -> None:
    # expected: the closed form; contact begins at 0.3778 s, and the derivatives of the velocity jump there
    times = (0.3777, 0.3779, 0.3795)
    measures = [f"at(ball.{value}, {time})" for time in times for value in ("y", "vy")]
    found = mbdkit.gradient(ball(0.4, 0.01), measures, ["y", "k", "c"], check=False)
    np.testing.assert_allclose(found.jacobian, np.vstack([expected(time) for time in times]), rtol=1e-5, atol=1e-9)


def test_gradients_through_corners_have_the_order_of_the_method() -> None:
    # expected: the closed form; the force of a pad without damping has corners, but no jumps
    def error(step: float) -> float:
        spec = ball(0.9, step, {"name": "rk4"})
        spec["parameters"]["c"] = 0.0
        found = mbdkit.gradient(spec, MEASURES, ["y", "k"], check=False)
        columns = []
        for i in range(2):
            moved = [HEIGHT + (1e-30j if i == 0 else 0.0), STIFFNESS + (1e-30j if i == 1 else 0.0)]
            columns.append([x.imag / 1e-30 for x in bounce(*moved, 0.0, 0.9)])
        return float(np.max(np.abs(found.jacobian / np.array(columns).T - 1.0)))

    assert_within(error(0.0025), 1e-5)
    assert np.log2(error(0.01) / error(0.0025)) / 2.0 > 3.5


def test_energies_jump_with_the_force() -> None:
    # expected: potential, kinetic and dissipated energy sum up to that at the start, m g y
    spec = ball(0.9, 0.01)
    energies = ["final(energy.total)", "final(energy.dissipated)"]
    found = mbdkit.gradient(spec, energies, ["y", "k", "c"], check=False)
    np.testing.assert_allclose(found.jacobian.sum(axis=0), [GRAVITY, 0.0, 0.0], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_events_and_integrals_of_a_run_with_corners() -> None:
    # expected: differences of runs; the impulse of the pad is the change of the momentum and that of gravity
    spec = ball(0.9, 0.01)
    spec["events"] = {"up": {"when": "ball.vy - 1.0", "direction": "falling", "action": "stop"}}
    spec["events"]["touch"] = {"when": "ball.y - 0.2", "action": "note"}
    measures = ["events.touch.time", "final(t)", "integral(forces.pad.value)", "final(bodies.ball.vy)"]
    found = mbdkit.gradient(spec, measures, ["y", "k", "c"])
    assert_passed(found)
    assert 0.37 < found.value[0] < 0.45


@pytest.mark.parametrize("gap", [0.3, 0.3037])
def test_measures_of_the_continuous_motion_through_corners_and_their_gradients(gap: float) -> None:
    # a slider meets a spring after gap / v, at the end of a step or within it, and oscillates with w = 10 until pi / w
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("b", mass=1.0, inertia=1.0, position=(-gap, 0.0), velocity=(1.0, 0.0))
    m.prismatic("rail", m.ground, "b", at=(0.0, 0.0), axis=(1.0, 0.0))
    between = {"type": "two-points", "bodies": ["ground", "b"], "points": [[-2.0, 0.0], [0.0, 0.0]]}
    model = m.to_spec()
    model["forces"] = {
        "stop": {
            "type": "law", "law": "one-sided", "acts": "tension", "stiffness": 100.0, "free_length": 2.0,
            "pathway": between,
        }
    }  # fmt: skip
    spec = {"mbdkit": 1, "model": model, "integrator": GAUSS, "time": {"end": 0.7, "step": 0.01}}
    turn = 10.0 * (0.4567 - gap)
    x, v = np.sin(turn) / 10.0, np.cos(turn)
    expected = {
        "min(b.ax)": (-10.0, -10.0), "max(b.x)": (0.1, 0.1), "integral(abs(b.ax))": (2.0, 2.0),
        "at(b.x, 0.4567)": (x, x + v * gap), "at(b.ax, 0.4567)": (-100.0 * x, -100.0 * (x + v * gap)),
    }  # fmt: skip
    found = mbdkit.gradient(spec, list(expected), "model.bodies.b.velocity.0")
    np.testing.assert_allclose(found.value, [value for value, _ in expected.values()], rtol=1e-7)
    np.testing.assert_allclose(found.jacobian[:, 0], [slope for _, slope in expected.values()], rtol=1e-6)
    assert_passed(found)


ADAPTIVE = [{"name": "dopri5"}, {"name": "dop853"}, GAUSS]


@pytest.mark.parametrize("method", ADAPTIVE, ids=lambda one: str(one["name"]))
def test_controlled_steps_end_at_jumps_of_the_force(method: dict[str, object]) -> None:
    # expected: the closed form of one bounce; for two, fixed steps, which end at the jumps too
    controlled = {**method, "adaptive": True, "rtol": 1e-9, "atol": 1e-11}
    twice = mbdkit.gradient(ball(1.1, 0.002), MEASURES, ["y", "k", "c"], check=False)
    for end, jacobian in ((0.9, expected(0.9)), (1.1, twice.jacobian)):
        rare = {"time": {"end": end}, "output": {"every": 7}}  # recorded states play no part
        found = mbdkit.gradient(ball(end, 0.01, controlled) | rare, MEASURES, ["y", "k", "c"])
        np.testing.assert_allclose(found.jacobian, jacobian, rtol=2e-6, atol=1e-12)
        assert_passed(found)


@pytest.mark.parametrize("method", ADAPTIVE, ids=lambda one: str(one["name"]))
@pytest.mark.parametrize("action", ["note", "stop"])
def test_events_shortly_before_a_corner_have_times_and_derivatives(method: dict[str, object], action: str) -> None:
    # expected: the time of the event of the run; a corner ends the step in which the event occurs
    spec = ball(0.9, 0.01, {**method, "adaptive": True, "rtol": 1e-7, "atol": 1e-9}) | {"time": {"end": 0.9}}
    spec["events"] = {"near": {"when": f"ball.y - {PAD + 0.005}", "action": action}}
    found = mbdkit.gradient(spec, ["events.near.time"], ["y"])
    fall = np.sqrt(2.0 * (HEIGHT - PAD - 0.005) / GRAVITY)
    assert found.value[0] == pytest.approx(fall, rel=1e-7)
    assert found.jacobian[0, 0] == pytest.approx(1.0 / (GRAVITY * fall), rel=1e-6)
    assert_passed(found)


def test_steps_too_long_for_the_interpolation_between_their_ends_have_gradients() -> None:
    # expected: energy, F = m g + sqrt((m g)^2 + 2 k m g h) for a fall of h onto a rope of stiffness k, within the error
    # of the long steps; and the derivative of these steps, by differences of their results
    mass, stiffness, fall, small = 2.0, 5000.0, 0.5, 1e-4
    pathway = {"type": "two-points", "bodies": ["ground", "ball"], "points": [[0.0, 3.0], [0.0, 0.0]]}
    rope = {"type": "law", "law": "one-sided", "acts": "tension", "stiffness": stiffness, "free_length": 2.0}
    bodies = {"ball": {"mass": "m", "inertia": 0.1, "position": [0.0, 1.0 + fall]}}
    model = {"name": "mechanism", "bodies": bodies, "forces": {"rope": rope | {"pathway": pathway}}}
    spec = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.5, "step": 0.02}}
    lighter, found, heavier = (
        mbdkit.gradient(spec | {"parameters": {"m": m}}, ["max(abs(forces.rope.value))"], ["m"], check=False)
        for m in (mass - small, mass, mass + small)
    )
    weight = mass * GRAVITY
    # margin: error of mbdkit's method at these steps
    assert found.value[0] == pytest.approx(weight + np.sqrt(weight**2 + 2.0 * stiffness * weight * fall), rel=0.013)
    assert found.jacobian[0, 0] == pytest.approx((heavier.value[0] - lighter.value[0]) / (2.0 * small), rel=1e-5)


CONTROLLED = [{"name": name, "adaptive": True, "rtol": 1e-8} for name in ("dop853", "radau-iia", "gauss")]


def block(law: str, integrator: dict[str, object], **time: float) -> dict[str, object]:
    """A block of 1 kg on a rail, at x = 0.3 m, with a force that is an expression of its position."""
    force = {"type": "force", "body": "b", "point": [0, 0], "value": [law, 0]}
    rail = {"type": "prismatic", "bodies": ["ground", "b"], "points": [[0, 0], [0, 0]], "axis": [1, 0]}
    body = {"mass": 1, "inertia": 1, "position": [0.3, 0], "velocity": ["v", 0]}
    model = {"name": "mechanism", "bodies": {"b": body}, "joints": {"J": rail}, "forces": {"load": force}}
    return {
        "mbdkit": 1, "parameters": {"k": 20.0, "v": 1.0}, "model": model, "integrator": integrator,
        "time": {"end": 1.0, **time},
    }  # fmt: skip


def beyond_the_corner(k: complex, v: complex) -> complex:
    """Return the position at t = 1 s of that block under the force -k |x|: a cosine, and then a hyperbolic sine."""
    w = np.sqrt(k)
    size, phase = np.sqrt(0.09 + v**2 / k), np.arctan(0.3 * w / v)  # x = size sin(phase + w t)
    return complex(-size * np.sinh(w - np.pi + phase))


@pytest.mark.parametrize("method", CONTROLLED, ids=lambda one: str(one["name"]))
def test_gradients_through_a_kink_of_an_expression_of_the_state(method: dict[str, object]) -> None:
    # expected: the closed form; with stages beyond the kink, radau-iia is wrong by 7 %, dop853 by 6 %
    found = mbdkit.gradient(block("-k*abs(b.x)", method), "final(b.x)", ["k", "v"])
    right = [beyond_the_corner(20.0 + 1e-30j, 1.0).imag, beyond_the_corner(20.0, 1.0 + 1e-30j).imag]
    np.testing.assert_allclose(found.jacobian[0], np.array(right) / 1e-30, rtol=1e-6)
    assert_passed(found)


@pytest.mark.parametrize(
    ("law", "method", "time", "advice"),
    [
        ("-k*abs(b.x)", GAUSS, {"step": 0.01}, "use a method with `adaptive: true`, whose steps do"),
        ("-k*b.x/abs(b.x)", CONTROLLED[0], {}, "let it change over a small range instead, as `tanh` does"),
    ],
)
def test_a_doubt_about_a_kink_names_the_expression_and_what_helps(law, method, time, advice) -> None:
    found = mbdkit.gradient(block(law, method, **time), "final(b.x)", ["k", "v"])
    (doubt,) = found.doubts
    assert f"model.forces.load.value, ['{law}', 0.0], is not smooth at a state that the run passes" in doubt
    assert doubt.endswith(advice)


def bounce_of_a_ball(stiffness: float, height: float) -> float:
    """Return the position at 0.35 s of a ball of 1 kg that falls on a half-space with the law of Hunt and Crossley."""

    def rates(_t: float, y: np.ndarray) -> list[float]:
        return [y[1], -9.81 - stiffness * np.sign(y[0]) * abs(y[0]) ** 1.5 * (1.0 - 1.5 * 0.3 * y[1])]

    def separates(_t: float, y: np.ndarray) -> float:
        return float(y[0])

    separates.terminal, separates.direction = True, 1.0  # type: ignore[attr-defined]
    begin = np.sqrt(2.0 * height / 9.81)
    start = [-1e-300, -9.81 * begin]
    touch = solve_ivp(rates, (begin, 0.35), start, method="DOP853", rtol=1e-12, atol=1e-15, events=separates)
    rest = 0.35 - touch.t[-1]
    return float(touch.y[1, -1] * rest - 9.81 * rest**2 / 2.0 + 0.1)


def ball_on_the_ground(integrator: dict[str, object], **time: float) -> dict[str, object]:
    shapes = [{"line": {"normal": [0, 1]}}, {"circle": {"radius": 0.1}}]
    compliance = {"law": "hunt-crossley", "stiffness": "k", "dissipation": 0.3}
    contact = {"bodies": ["ground", "b"], "shapes": shapes, "compliance": compliance}
    body = {"mass": 1.0, "inertia": 0.01, "position": [0, "0.1 + h"]}
    return {
        "mbdkit": 1, "parameters": {"k": 1e5, "h": 0.2}, "integrator": integrator, "time": {"end": 0.35, **time},
        "model": {"name": "mechanism", "bodies": {"b": body}, "contacts": {"c": contact}},
    }  # fmt: skip


@pytest.mark.parametrize("method", [{"name": "dopri5", "adaptive": True, "rtol": 1e-8}, *CONTROLLED[::2]])
def test_gradients_across_an_impact_by_the_law_of_hunt_and_crossley(method: dict[str, object]) -> None:
    # expected: differences of the motion by DOP853 from the begin of contact to its end
    right = [
        (bounce_of_a_ball(1e5 + 10.0, 0.2) - bounce_of_a_ball(1e5 - 10.0, 0.2)) / 20.0,
        (bounce_of_a_ball(1e5, 0.2 + 2e-5) - bounce_of_a_ball(1e5, 0.2 - 2e-5)) / 4e-5,
    ]
    found = mbdkit.gradient(ball_on_the_ground(method), "final(b.y)", ["k", "h"])
    np.testing.assert_allclose(found.jacobian[0], right, rtol=3e-3)  # 1e-2 in steps that pass over the begin
    assert np.all(np.abs(found.jacobian[0] - right) <= 2.0 * found.error[0])
    assert_passed(found)


def test_a_doubt_about_fixed_steps_through_a_contact_says_what_helps() -> None:
    spec = ball_on_the_ground({"name": "rk4"}, step=5e-4)
    (doubt,) = mbdkit.gradient(spec, "final(b.y)", ["k", "h"]).doubts
    assert "a contact that begins or ends is not smooth" in doubt
    assert "use a method with `adaptive: true`" in doubt
