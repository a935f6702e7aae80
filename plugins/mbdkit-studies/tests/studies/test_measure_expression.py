"""Expressions of measures, of beams too: values against closed forms, units by the rules of physics, and refusals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import Mechanism, Run, RunSpec, SpecError
from mbdkit.events.event_expression import RunExpression
from mbdkit.measures.measure_expression import MeasureExpression, SeriesExpression
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


LENGTH, ELEMENTS, FORCE, PULL, BENDING = 2.0, 4, 1e-3, 2e-3, 50.0
MIDDLES = LENGTH * (np.arange(ELEMENTS) + 0.5) / ELEMENTS
MOMENTS = FORCE * (LENGTH - MIDDLES)  # of statics, whatever the stiffness
ENERGY = float(np.sum(MOMENTS**2)) * LENGTH / ELEMENTS / (2 * BENDING) + LENGTH / 2 * (FORCE**2 + PULL**2) / 1e6
LOAD = "model.forces.load.value.1"
SECTIONS: dict[str, Any] = {"integrator": {"name": "radau-iia", "stages": 2}, "time": {"end": 0.02, "step": 0.005}}


def cantilever(**more: Any) -> mbdkit.Mechanism:
    """Return a weightless cantilever along the x axis with a force (PULL, FORCE) at its end b."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": 1e6, "shear": 1e6, "bending": BENDING}
    leaf = m.beam(
        "leaf", a=(0, 0), b=(LENGTH, 0), elements=ELEMENTS, stiffness=stiffness, mass_per_length=1.0, damping=1.0,
        **more,
    )  # fmt: skip
    m.weld("clamp", m.ground, leaf[0], at=(0, 0))
    m.force("load", leaf[-1], value=(PULL, FORCE))
    return m


def spec_of(m: mbdkit.Mechanism) -> mbdkit.RunSpec:
    """Return a run that starts in the state of a mechanism."""
    return load_spec({"mbdkit": 1, "model": m.to_spec()}, **SECTIONS)


def at_rest() -> mbdkit.RunSpec:
    """Return a run that starts from its equilibrium."""
    start = mbdkit.equilibrium(spec_of(cantilever())).position
    return spec_of(cantilever(start=[tuple(row) for row in start.tolist()]))


OF_BEAM = at_rest()


@pytest.fixture(scope="module")
def run_of_beam() -> Iterator[Run]:
    """Yield the run of `OF_BEAM`."""
    with mbdkit.run(OF_BEAM) as result:
        yield result


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [
        ("final(beams.leaf.moment[0])", MOMENTS[0], "N m"),
        ("final(beams['leaf'].moment[-1])", MOMENTS[3], "N m"),
        ("max(abs(joints.clamp.torque))", FORCE * LENGTH, "N m"),
        ("max(abs(beams.leaf.moment))", MOMENTS[0], "N m"),
        ("min(beams.leaf.moment)", MOMENTS[3], "N m"),
        ("max(-beams.leaf.moment)", -MOMENTS[3], "N m"),
        ("mean(along_max(beams.leaf.moment))", MOMENTS[0], "N m"),
        ("at(along_min(beams.leaf.moment), 0.01)", MOMENTS[3], "N m"),
        ("mean(beams.leaf.shear[2])", FORCE, "N"),
        ("rms(beams.leaf.axial[1])", PULL, "N"),
        ("max(abs(beams.leaf.axial)/2 + abs(beams.leaf.shear))", PULL / 2 + FORCE, "N"),
        ("final(beams.leaf.strain_energy)", ENERGY, "J"),
    ],
)
def test_internal_forces_are_those_of_statics(run_of_beam: Run, text: str, value: float, unit: str) -> None:
    expression = MeasureExpression.parse(text, OF_BEAM)
    assert expression.unit.text == unit
    assert expression.of(run_of_beam) == pytest.approx(value, rel=4e-4)  # the pull relieves the moments by 5e-5


def test_integrals_of_beams_are_computed_with_the_run() -> None:
    run = mbdkit.run(
        OF_BEAM, measures={"all_time": "integral(along_max(abs(beams.leaf.moment)))"}, output={"every": 100}
    )
    assert run.measures["all_time"] == pytest.approx(0.02 * MOMENTS[0], rel=2e-4)
    assert run.measures.units["all_time"] == "J s"
    assert list(run.integrals) == ["along_max(abs(beams.leaf.moment))"]


def test_derivatives_by_the_load_are_those_of_statics() -> None:
    # the equilibrium of the start does not follow the load, but heavy damping has the beam follow it in the end
    measures = ["final(beams.leaf.moment[1])", "final(along_max(abs(beams.leaf.moment)))"]
    found = mbdkit.gradient(
        OF_BEAM, measures, LOAD, time={"end": 40.0, "step": 0.5}, integrator={"name": "radau-iia", "stages": 3}
    )
    expected = [MOMENTS[1] / FORCE, MOMENTS[0] / FORCE]
    np.testing.assert_allclose(found.jacobian[:, 0], expected, rtol=1e-3)
    assert found.check is not None
    assert found.check.is_passed, str(found)


def test_an_extreme_value_that_elements_share_has_no_derivative() -> None:
    # all elements have the axial force of the end; a force on a node between changes some of them
    def pulled(**more: Any) -> mbdkit.RunSpec:
        m = cantilever(**more)
        m.force("pull", "leaf.4", value=(100.0, 0.0))
        m.force("between", "leaf.2", value=(1e-15, 0.0))
        return spec_of(m)

    start = mbdkit.equilibrium(pulled()).position
    spec = pulled(start=[tuple(row) for row in start.tolist()])
    place = "model.forces.between.value.0"
    doubts = {
        quantity: mbdkit.gradient(spec, f"final(along_max(beams.leaf.{quantity}))", place, check=False).doubts
        for quantity in ("axial", "moment")
    }
    assert "the elements 0 and 3 share the extreme value along the beam" in doubts["axial"][0]
    assert not doubts["moment"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("max(beams.leaf.momnt)", "beam 'leaf' has no 'momnt' (did you mean 'moment'?); it has axial, shear, moment"),
        ("max(beams.laef.moment)", "there is no beam 'laef' (did you mean 'leaf'?)"),
        ("max(leaf.moment)", "'leaf' is a beam; write beams.leaf.moment"),
        ("max(beams.leaf.moment[4])", "'4' is not an element of the beam 'leaf', which has the elements 0 to 3"),
        ("max(beams.leaf.moment[-5])", "'-5' is not an element of the beam 'leaf'"),
        ("max(beams.leaf.moment[0.5])", "'0.5' is not an element of the beam 'leaf'"),
        ("max(beams.leaf.strain_energy[0])", "'strain_energy' is a quantity of the whole beam"),
        ("final(beams.leaf.moment)", "has a value in each element of a beam; name an element"),
        ("beams.leaf.moment", "the expression changes over time"),
        ("along_max(beams.leaf.moment)", "the expression changes over time"),
        ("max(along_max(t))", "'along_max' needs a quantity along a beam, such as beams.NAME.moment"),
        ("max(along_max(beams.leaf.moment, 1))", "'along_max' takes 1 argument"),
        ("max(along_max)", "'along_max' is a function and needs its argument in parentheses"),
        ("max(alongmax(beams.leaf.moment))", "did you mean 'along_max'?"),
        ("max(beams.leaf.moment*joints.clamp.force)", "combines a vector with the elements of the beam 'leaf'"),
        ("max(beams.leaf.moment + beams.leaf.axial)", "adds quantities of different units, N m and N"),
        ("max(beams)", "'beams' is not a quantity by itself; write beams.NAME.strain_energy"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(text: str, words: str) -> None:
    with pytest.raises(SpecError) as caught:
        MeasureExpression.parse(text, OF_BEAM)
    assert words in caught.value.message


def test_elements_of_two_beams_are_not_combined() -> None:
    m = cantilever()
    more = m.beam("twig", a=(0, 1), b=(1, 1), elements=ELEMENTS, mass_per_length=1.0, E=1.0, nu=0.3, A=1.0, I=1.0)
    m.weld("other", m.ground, more[0], at=(0, 1))
    with pytest.raises(SpecError, match="combines the elements of two beams, leaf and twig"):
        MeasureExpression.parse("max(beams.leaf.moment - beams.twig.moment)", spec_of(m))


def test_quantities_that_are_not_recorded_and_histories_of_all_elements_are_refused() -> None:
    spec = mbdkit.RunSpec(**{**OF_BEAM.model_dump(mode="json"), "output": {"quantities": ["energy"]}})
    with pytest.raises(SpecError, match="add 'beams' to"):
        MeasureExpression.parse("max(beams.leaf.moment)", spec)
    with pytest.raises(SpecError, match="has a value in each element of a beam"):
        SeriesExpression.parse("abs(beams.leaf.moment)", OF_BEAM)


def test_an_event_is_where_an_element_reaches_a_moment() -> None:
    # a straight beam under heavy damping bends slowly; the record tells when its first element has half the moment
    half = MOMENTS[0] / 2
    events = {"half": {"when": f"beams.leaf.moment[0] - {half}"}, "soft": {"when": "beams.leaf.strain_energy - 1e-9"}}
    run = mbdkit.run(spec_of(cantilever()), time={"end": 4.0, "step": 0.01}, events=events)
    beam = run.beams["leaf"]
    for name, values, level in (("half", beam.moment[:, 0], half), ("soft", beam.strain_energy, 1e-9)):
        at = run.events.of_name(name).time[0]
        # margin: resolution of the rows
        assert np.interp(at, run.time, values) == pytest.approx(level, rel=2e-3)  # between rows


def test_an_event_needs_one_element() -> None:
    with pytest.raises(SpecError, match=r"choose an element, from 0: beams\.leaf\.moment\[0\]"):
        RunExpression.parse("beams.leaf.moment - 1", OF_BEAM.mechanism())
