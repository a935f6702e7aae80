"""Measures and events of beams: values and derivatives against the statics of a cantilever, and one sentence each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import Run, SpecError
from mbdkit.events.event_expression import RunExpression
from mbdkit.measures.measure_expression import MeasureExpression, SeriesExpression
from mbdkit.spec import load_spec

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


SPEC = at_rest()


@pytest.fixture(scope="module")
def run() -> Iterator[Run]:
    """Yield the run of `SPEC`."""
    with mbdkit.run(SPEC) as result:
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
def test_internal_forces_are_those_of_statics(run: Run, text: str, value: float, unit: str) -> None:
    expression = MeasureExpression.parse(text, SPEC)
    assert expression.unit.text == unit
    assert expression.of(run) == pytest.approx(value, rel=3e-4)  # the pull relieves the moments by 5e-5


def test_integrals_of_beams_are_computed_with_the_run() -> None:
    run = mbdkit.run(SPEC, measures={"all_time": "integral(along_max(abs(beams.leaf.moment)))"}, output={"every": 100})
    assert run.measures["all_time"] == pytest.approx(0.02 * MOMENTS[0], rel=1e-4)
    assert run.measures.units["all_time"] == "J s"
    assert list(run.integrals) == ["along_max(abs(beams.leaf.moment))"]


def test_derivatives_by_the_load_are_those_of_statics() -> None:
    # the equilibrium of the start does not follow the load, but heavy damping has the beam follow it in the end
    measures = ["final(beams.leaf.moment[1])", "final(along_max(abs(beams.leaf.moment)))"]
    found = mbdkit.gradient(
        SPEC, measures, LOAD, time={"end": 40.0, "step": 0.5}, integrator={"name": "radau-iia", "stages": 3}
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
        MeasureExpression.parse(text, SPEC)
    assert words in caught.value.message


def test_elements_of_two_beams_are_not_combined() -> None:
    m = cantilever()
    more = m.beam("twig", a=(0, 1), b=(1, 1), elements=ELEMENTS, mass_per_length=1.0, E=1.0, nu=0.3, A=1.0, I=1.0)
    m.weld("other", m.ground, more[0], at=(0, 1))
    with pytest.raises(SpecError, match="combines the elements of two beams, leaf and twig"):
        MeasureExpression.parse("max(beams.leaf.moment - beams.twig.moment)", spec_of(m))


def test_quantities_that_are_not_recorded_and_histories_of_all_elements_are_refused() -> None:
    spec = mbdkit.RunSpec(**{**SPEC.model_dump(mode="json"), "output": {"quantities": ["energy"]}})
    with pytest.raises(SpecError, match="add 'beams' to"):
        MeasureExpression.parse("max(beams.leaf.moment)", spec)
    with pytest.raises(SpecError, match="has a value in each element of a beam"):
        SeriesExpression.parse("abs(beams.leaf.moment)", SPEC)


def test_an_event_is_where_an_element_reaches_a_moment() -> None:
    # a straight beam under heavy damping bends slowly; the record tells when its first element has half the moment
    half = MOMENTS[0] / 2
    events = {"half": {"when": f"beams.leaf.moment[0] - {half}"}, "soft": {"when": "beams.leaf.strain_energy - 1e-9"}}
    run = mbdkit.run(spec_of(cantilever()), time={"end": 4.0, "step": 0.01}, events=events)
    beam = run.beams["leaf"]
    for name, values, level in (("half", beam.moment[:, 0], half), ("soft", beam.strain_energy, 1e-9)):
        at = run.events.of_name(name).time[0]
        assert np.interp(at, run.time, values) == pytest.approx(level, rel=2e-3)  # between rows


def test_an_event_needs_one_element() -> None:
    with pytest.raises(SpecError, match=r"choose an element, from 0: beams\.leaf\.moment\[0\]"):
        RunExpression.parse("beams.leaf.moment - 1", SPEC.mechanism())
