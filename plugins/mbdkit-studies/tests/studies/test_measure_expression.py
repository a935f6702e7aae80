"""Expressions of measures: values against closed forms, units against the rules of physics, and one sentence each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import Mechanism, Run, RunSpec, SpecError
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.spec import load_spec

G, MASS, END, STEP = 9.81, 2.0, 1.0, 0.01


def thrown() -> RunSpec:
    """A point mass thrown upwards beside one that hangs from a weightless joint, and a wheel that a motor turns."""
    m = Mechanism()
    ball = m.body("ball", mass=MASS, position=(0.0, 0.0), velocity=(3.0, 4.0))
    weight = m.body("weight", mass=5.0, inertia=1.0, position=(0.0, -1.0))
    wheel = m.body("wheel", mass=1.0, inertia=0.5, position=(9.0, 0.0), angular_velocity=2.0)
    m.weld("hook", m.ground, weight, at=(0.0, 0.0))
    m.revolute("axle", m.ground, wheel, at=(9.0, 0.0))
    m.driver("motor", m.ground, wheel, coordinate="angle", motion="2*t")
    m.torque("brake", wheel, value=3.0)
    m.marker("rim", wheel, point=(0.5, 0.0))
    m.spring_damper("soft", m.ground, ball, from_=(0.0, 0.0), to=(0.0, 0.0), stiffness=0.0, free_length=1.0)
    return load_spec(
        {"mbdkit": 1, "model": m.to_spec(), "parameters": {"lever": 0.25}}, integrator={"name": "rk4"},
        time={"end": END, "step": STEP}, events={"top": {"when": "ball.vy"}, "never": {"when": "ball.x + 1"}},
    )  # fmt: skip


SPEC = thrown()


@pytest.fixture(scope="module")
def run() -> Iterator[Run]:
    """Yield the run of `SPEC`."""
    with mbdkit.run(SPEC) as result:
        assert result.status == "complete"
        yield result


TOP = 4.0 / G
VALUES = {
    # free flight: v = v0 - g t, recorded exactly by a method of order 4
    "final(ball.x)": (3.0, "m"),
    "final(ball.y)": (4.0 - G / 2, "m"),
    "integral(ball.vy)": (4.0 - G / 2, "m"),  # the trapezoidal rule is exact for a linear function
    "mean(ball.vy)": (4.0 - G / 2, "m/s"),
    "min(ball.vy)": (4.0 - G, "m/s"),
    "max(abs(ball.vy))": (G - 4.0, "m/s"),
    "abs(final(ball.velocity))": (math.hypot(3.0, 4.0 - G), "m/s"),
    "max(abs(ball.acceleration))": (G, "m/s^2"),
    "at(ball.vy, 0.255)": (4.0 - 0.255 * G, "m/s"),
    "at(ball.vy, events.top.time)": (0.0, "m/s"),
    "events.top.time": (TOP, "s"),
    "events.top.last_time - events.top.time": (0.0, "s"),
    "events.top.count": (1.0, "1"),
    "events.never.count": (0.0, "1"),
    "0.5*2*final(abs(ball.velocity))**2": ((9.0 + (4.0 - G) ** 2), "m^2/s^2"),
    # a weight at rest: the hook carries m g, upwards
    "max(abs(joints.hook.force))": (5.0 * G, "N"),
    "final(joints.hook.force_y)": (5.0 * G, "N"),
    "max(abs(joints.hook.force + joints.hook.force))": (10.0 * G, "N"),
    "max(abs(joints.hook.force - joints.hook.force))": (0.0, "N"),
    "integral(abs(joints.hook.force))": (5.0 * G, "N s"),
    "rms(joints.hook.force_y)": (5.0 * G, "N"),
    # a wheel turned at 2 rad/s against a torque of 3 N m
    "final(wheel.angle)": (2.0, "rad"),
    "max(cos(wheel.angle))": (1.0, "1"),
    "mean(forces.brake.value)": (3.0, "N m"),
    "mean(forces.brake.power)": (6.0, "W"),
    "mean(joints.motor.driver_power)": (-6.0, "W"),
    "integral(joints.motor.driver_power)": (-6.0, "J"),
    "mean(forces.brake.value * wheel.angular_velocity)": (6.0, "W"),
    "max(abs(markers.rim.velocity))": (1.0, "m/s"),
    "final(markers.rim.x)": (9.0 + 0.5 * math.cos(2.0), "m"),
    "max(max(joints.motor.angle, wheel.angle - 1))": (2.0, "rad"),
    "final(t)": (END, "s"),
    "sqrt(final(ball.x)*final(ball.x))": (3.0, "m"),
    "final(energy.kinetic)/final(energy.kinetic)": (1.0, "1"),
    "max(wheel.angle) - 0.5": (1.5, "rad"),
    "degrees(180)*final(t)": (math.pi, "s"),
}


@pytest.mark.parametrize("text", VALUES)
def test_a_value_is_that_of_the_closed_form_with_its_unit(run: Run, text: str) -> None:
    value, unit = VALUES[text]
    expression = MeasureExpression.parse(text, SPEC)
    assert expression.unit.text == unit
    assert expression.of(run) == pytest.approx(value, rel=1e-9, abs=1e-9)


def test_a_root_mean_square_converges_to_the_closed_form(run: Run) -> None:
    # the integral of (4 - g t)^2 over 1 s; the error of the trapezoidal rule is g^2 h^2 / 6
    exact = 16.0 - 4.0 * G + G * G / 3.0
    found = MeasureExpression.parse("rms(ball.vy)", SPEC).of(run) ** 2
    assert found - exact == pytest.approx(G * G * STEP * STEP / 6.0, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("final(wheel.angle)", "deg", math.degrees(2.0)),
        ("final(ball.x)", "mm", 3000.0),
        ("max(abs(joints.hook.force))", "kN", 0.005 * G),
        ("mean(forces.brake.value)", "J", 3.0),
        ("integral(wheel.angular_velocity)", "rad", 2.0),
        ("mean(wheel.angular_velocity)", "deg/s", math.degrees(2.0)),
        ("lever*max(abs(joints.hook.force))", "N m", 1.25 * G),
        ("final(ball.x) + lever", "m", 3.25),
    ],
)
def test_a_value_is_given_in_the_unit_that_is_asked_for(run: Run, text: str, unit: str, value: float) -> None:
    assert MeasureExpression.parse(text, SPEC, unit).of(run) == pytest.approx(value, rel=1e-9)


def test_what_did_not_happen_is_not_a_number(run: Run) -> None:
    for text in ("events.never.time", "at(ball.x, events.never.time)", "final(ball.x)/events.never.count"):
        assert math.isnan(MeasureExpression.parse(text, SPEC).of(run))
    assert math.isnan(MeasureExpression.parse("log(0 - final(ball.x)/final(ball.x))", SPEC).of(run))


def test_a_single_row_has_a_mean_but_no_integral() -> None:
    start: Any = SimpleNamespace(
        time=np.array([0.0]), bodies={"ball": SimpleNamespace(index=0)},
        column=lambda path, index, part: np.array([[3.0, 4.0]]), integrals={},
    )  # fmt: skip
    assert MeasureExpression.parse("mean(ball.vy)", SPEC).of(start) == 4.0
    assert MeasureExpression.parse("rms(ball.vy)", SPEC).of(start) == 4.0
    assert MeasureExpression.parse("integral(ball.vy)", SPEC).of(start) == 0.0


REFUSED = {
    "max(abs(joints.hook.force)) + max(ball.x)": "adds quantities of different units, N and m",
    "max(ball.x) - max(ball.vx)": "subtracts quantities of different units, m and m/s",
    "max(max(ball.x), max(ball.vx))": "compares quantities of different units, m and m/s",
    "sin(final(ball.x))": "sin needs a number or an angle, not m",
    "at(ball.x, final(ball.x))": "is a time, but it has the unit m", "at(ball.x, 7)": "the run goes from 0 s to 1 s",
    "at(ball.x, ball.x)": "is one time, such as 0.5 or events.NAME.time",
    "ball.x": "changes over time, but a measure is one number; apply max, min, mean",
    "final(ball.position)": "is a vector, but a measure is one number; use abs of it",
    "max(joints.hook.force)": "'joints.hook.force' is a vector, which has no 'max'; use abs of it",
    "max(final(ball.x))": "'final(ball.x)' does not change over time",
    "abs(final(ball.position) + 1)": "adds a vector and a number",
    "abs(1/final(ball.position))": "not possible with a vector in '/'",
    "abs(final(ball.position)*final(ball.position))": "not possible with a vector in '*'",
    "max(abs(joints.hok.force))": "there is no joint 'hok' (did you mean 'hook'?)",
    "max(abs(joints.hook.forse))": "joint 'hook' has no 'forse' (did you mean 'force'?)",
    "max(joints.hook.force_z)": "has no 'force_z'", "events.tip.time": "there is no event 'tip' (did you mean 'top'?)",
    "events.top.tim": "event 'top' has no 'tim' (did you mean 'time'?)",
    "meen(ball.x)": "'meen' is not a function that can be used (did you mean 'mean'?)",
    "mean": "'mean' is a function and needs its argument in parentheses", "rms(ball.x, 2)": "'rms' takes 1 argument",
    "at(ball.x)": "'at' takes 2 arguments", "2*3": "contains no quantity of the run",
    "final(ball.angle)": "'ball' is a point mass",
    "lever*final(ball.x)": "the unit of this expression is unknown, because parameters and some states have none",
    "__import__('os').system('true')": "is not a function that can be used",
    "final(ball.x) if 1 else 2": "is not part of an expression of a run",
    "final(ball.x": "the expression cannot be parsed",
}  # fmt: skip


@pytest.mark.parametrize("text", REFUSED)
def test_what_is_wrong_is_one_sentence(text: str) -> None:
    with pytest.raises(SpecError) as error:
        MeasureExpression.parse(text, SPEC)
    assert REFUSED[text] in str(error.value)


@pytest.mark.parametrize("text", ["joints.R.knee.force", "R.knee.force"])
def test_names_with_dots_need_quotes(text: str) -> None:
    model = {"bodies": {"R.Shank": {"mass": 1.0, "inertia": 0.1}}}
    model["joints"] = {"R.knee": {"type": "revolute", "bodies": ["ground", "R.Shank"], "at": [0.0, 0.1]}}
    spec = load_spec(SPEC, model={"name": "mechanism"} | model, events={}, measures={})
    with pytest.raises(SpecError, match=r'a name with a dot, which needs quotes: joints\["R\.knee"\]\.force'):
        MeasureExpression.parse(f"max(abs({text}))", spec)


def test_a_unit_of_another_quantity_is_refused() -> None:
    with pytest.raises(SpecError, match=r"unit: the expression has the unit m, which cannot be given in N"):
        MeasureExpression.parse("final(ball.x)", SPEC, "N")


def test_what_the_runs_do_not_record_is_refused() -> None:
    spec = load_spec(SPEC, output={"quantities": ["joints"]})
    assert MeasureExpression.parse("max(joints.hook.misalignment)", spec).unit.text == "m"
    with pytest.raises(SpecError, match=r"add 'energy' to `output\.quantities`"):
        MeasureExpression.parse("max(energy.total)", spec)


def test_components_in_the_frame_of_a_body_have_the_norm_of_the_force(run: Run) -> None:
    found = [
        MeasureExpression.parse(f"max(abs(joints.axle.{name}))", SPEC).of(run)
        for name in ("force", "force_first", "force_second")
    ]
    assert found == pytest.approx([np.max(np.linalg.norm(run.joints["axle"].reaction_force, axis=1))] * 3)
