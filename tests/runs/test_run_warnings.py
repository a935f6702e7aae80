"""Warnings about values of a spec that are valid but probably not meant: printed, and kept in the archive."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.engine.assembly import AssembledState
from mbdkit.mechanism.improbable_bodies import improbable_bodies, improbable_inertias
from mbdkit.mechanism.improbable_values import (
    improbable_beams,
    improbable_frictions,
    improbable_lengths,
)
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.runs.findings import findings
from mbdkit.runs.preparation import build, caution
from mbdkit.spec import RunSpec, load_spec
from mbdkit.spec.loading import example_names
from mbdkit.spec.reading import parse_key, put

SPEC: dict[str, Any] = {
    "mbdkit": 1,
    "model": {
        "name": "mechanism",
        "bodies": {"rod": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}},
        "joints": {"A": {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0, 0], [-0.5, 0]]}},
    },
    "integrator": {"name": "rk4"},
    "time": {"end": 0.1, "step": 0.01},
}


def changed(values: dict[str, Any]) -> RunSpec:
    """Return the spec with other values; ``__`` separates the parts of a key."""
    data = copy.deepcopy(SPEC)
    for key, value in values.items():
        put(data, parse_key(key.replace("__", ".")), value)
    return load_spec(data)


def warnings_of(**values: Any) -> tuple[str, ...]:
    """Return the warnings about the spec with other values."""
    return tuple(map(str, caution(changed(values))))


def start_warnings(spec: RunSpec, start: AssembledState) -> tuple[str, ...]:
    """Return the warnings about the start of a run."""
    return tuple(map(str, findings("start", spec, start)))


DRIVER = {"type": "driver", "bodies": ["ground", "rod"], "coordinate": "angle"}


def driven(motion: Any, joint: str = "D", **driver: Any) -> dict[str, Any]:
    return {f"model__joints__{joint}": {**DRIVER, "motion": motion, **driver}}


TABLES = yaml.safe_load(Path(__file__).with_name("improbable_values.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("values", "place"), TABLES["told"])
def test_a_value_that_is_probably_not_meant_is_told_with_its_key(values: dict[str, Any], place: str) -> None:
    told = warnings_of(**values)
    assert len(told) == 1
    assert place in told[0]


@pytest.mark.parametrize("values", TABLES["not told"])
def test_a_value_that_may_be_meant_is_not_told(values: dict[str, Any]) -> None:
    assert warnings_of(**values) == ()


MOTIONS = TABLES["motions in radians"] | {"long sum": ("+".join(["0.001*t"] * 1000), {})}


@pytest.mark.parametrize(("motion", "parameters"), MOTIONS.values(), ids=MOTIONS)
def test_motions_that_may_be_in_radians_are_not_told(motion: str, parameters: dict[str, Any]) -> None:
    assert warnings_of(parameters=parameters, **driven(motion)) == ()


LINE = {"type": "point-on-line", "bodies": ["ground", "rod"], "at": [0, 0], "axis": [0, 1]}
MOVED = {**DRIVER, "coordinate": "x", "motion": "0.5 + t**2"}


@pytest.mark.parametrize(
    ("values", "note"),
    [
        pytest.param(
            driven({"table": [[0, 0.21, 9], [0, 1, 1]]}), "D.motion changes from 0 s to 0.21 s", id="short run"
        ),
        pytest.param(driven({"table": [[0, 0.2], [0, 1]]}), "", id="half a table"),
        pytest.param(
            {"measures": {"clamp": "max(abs(joints.A.torque))"}}, "A.torque in measures.clamp is always zero", id="pin"
        ),
        pytest.param({"measures": {"load": "max(abs(joints.A.force_x))"}}, "", id="force of a pin"),
        pytest.param(
            {"model__joints__A__center": {"x": "0.3*angle"}, "measures": {"m": "max(A.torque)"}}, "", id="moving centre"
        ),
        pytest.param(
            {"model__joints__A": LINE, "measures": {"m": "max(A.force_y)"}},
            "A.force_y in measures.m is always zero",
            id="slot",
        ),
        pytest.param(
            {"model__gravity": [1, 0], "model__joints__A": LINE, "measures": {"m": "max(A.force_x)"}},
            "",
            id="across a slot",
        ),
        pytest.param(
            {**driven("t", "A"), "measures": {"m": "max(abs(A.force))"}},
            "a driver of angle transmits no force",
            id="motor",
        ),
        pytest.param({"model__joints__A": MOVED, "measures": {"m": "max(A.force_y)"}}, "a driver of x", id="jack"),
        pytest.param({"model__joints__A": MOVED, "measures": {"m": "max(A.force_x)"}}, "", id="along a jack"),
    ],
)
def test_short_runs_and_reactions_that_are_always_zero_are_noted_without_doubt(
    values: dict[str, Any], note: str
) -> None:
    spec = changed(values)
    told = [one.sentence for one in caution(spec) if one.level is None]
    assert len(told) == bool(note)
    assert all(note in sentence for sentence in told)
    if "measures" in values:
        assert (max(map(abs, mbdkit.run(spec).measures.values())) < 1e-14) == bool(note)


TRIANGLE = {"polygon": [[0, 0], [3, 0], [0, 1]]}
TOUCHING = {"bodies": ["ground", "rod"], "friction": 0.5, "compliance": {"stiffness": 1e5}}


@pytest.mark.parametrize(
    ("element", "size"),
    [
        # expected: by hand, in the frame of a body at an angle of 0
        ({"contacts": {"c": {**TOUCHING, "shapes": [{"line": {"normal": [0, 1]}}, {"circle": {"radius": 0.1}}]}}}, 0.2),
        ({"contacts": {"c": {**TOUCHING, "shapes": [{"circle": {"radius": 9}}, TRIANGLE]}}}, 3.0),
        ({"markers": {"m": {"body": "rod", "point": [0.0, 0.3]}}}, 0.3),
        ({"forces": {"f": {"type": "force", "body": "rod", "point": [0.4, 0.0], "value": [0, 1]}}}, 0.4),
        (
            {"forces": {"s": {"type": "spring-damper", "bodies": ["ground", "rod"], "points": [[0, 0], [0.2, 0.0]],
                              "stiffness": 10.0}}},
            0.7,
        ),
    ],
)  # fmt: skip
def test_the_size_of_a_body_without_joints_follows_from_its_points(element: dict[str, Any], size: float) -> None:
    assert warnings_of(model__joints={}, **{f"model__{kind}": value for kind, value in element.items()}) == ()
    told = warnings_of(
        model__joints={},
        model__bodies__rod__inertia=3920,
        **{f"model__{kind}": value for kind, value in element.items()},
    )
    assert len(told) == 1
    assert f"the mechanism has a size of {size:g} m" in told[0]


@pytest.mark.parametrize(
    "improbable",
    [
        improbable_inertias,
        improbable_frictions,
        improbable_beams,
        improbable_lengths,
        improbable_bodies,
    ],
)
def test_no_value_of_the_packaged_examples_is_improbable(improbable: Callable[[Mechanism], Iterator[str]]) -> None:
    assert [text for name in example_names("run") for text in improbable(load_spec(name).mechanism())] == []


@pytest.mark.parametrize(
    ("length", "crank", "slider_inertia", "told"),
    [
        pytest.param(250.0, 0.08, 1e-4, "body 'rod' at model.bodies.rod are up to 125 m away", id="m for mm"),
        pytest.param(
            600.0, 80.0, 1e-4, "'rod' at model.bodies.rod is 600 m long, but has a mass of only", id="all in mm"
        ),
        pytest.param(20.0, 0.08, 1e-4, "", id="long rod"),
        pytest.param(250.0, 0.08, 1.0, "", id="large slider"),
        pytest.param(250.0, 0.0, None, "", id="points on a rope"),
    ],
)
def test_a_body_much_larger_than_all_others_or_too_light_for_its_length_is_told(
    length: float, crank: float, slider_inertia: float | None, told: str
) -> None:
    m = mbdkit.Mechanism()
    m.body("crank", mass=20.0, inertia=1e-4 if crank else None, position=(crank / 2, 0))
    m.body("rod", mass=100.0, inertia=length**2, position=(crank + length / 2, 0))
    m.body("slider", mass=1.0, inertia=slider_inertia, position=(crank + length, 0))
    m.revolute("A", m.ground, "crank", points=((0, 0), (-crank / 2, 0)))
    m.revolute("B", "crank", "rod", points=((crank / 2, 0), (-length / 2, 0)))
    m.revolute("C", "rod", "slider", points=((length / 2, 0), (0, 0)))
    found = [*improbable_bodies(m)]
    assert len(found) == bool(told)
    assert all(told in text for text in found)


SECTION = {"A": 1e-4, "I": 2.1e-10}
STEEL: dict[str, Any] = {"a": (0.0, 0.0), "b": (1.0, 0.0), "E": 2.1e11, "nu": 0.3, "density": 7850.0, **SECTION}


@pytest.mark.parametrize(
    ("values", "key", "advice"),
    [
        pytest.param({"E": 210.0}, ".E", "`210 GPa`", id="GPa"),
        pytest.param({"E": 2.1e5}, ".E", "`210000 MPa`", id="MPa"),
        pytest.param({"density": 7.85}, ".density", "`7.85 g/cm^3`", id="g/cm^3"),
        pytest.param({"A": 100.0, "I": 210.0}, "", "`I: 210 mm^4`", id="mm"),
        pytest.param({"A": 100.0}, ".A", "`A: 100 mm^2`", id="mm^2"),
        pytest.param({"I": 210.0}, ".I", "`I: 210 mm^4`", id="mm^4"),
        pytest.param({"rotary_inertia": 1.6e3}, ".rotary_inertia", "`1600 kg*mm^2/m`", id="kg mm^2/m"),
        pytest.param(
            {"stiffness": {"axial": 2e7, "shear": "none", "bending": 4.4e7}, "I": None},
            ".stiffness.bending",
            "`4.4e+07 N*mm^2`",
            id="N mm^2",
        ),
        pytest.param({"A": 1e-2, "I": 2.08e-10}, ".A", "`A: 0.01 mm^2`", id="A 100 times too large"),
        pytest.param({}, "", "", id="steel"),
        pytest.param({"E": 1e3, "density": 1000.0, "A": 1e-3, "I": 1e-7}, "", "", id="tissue"),
        pytest.param({"E": 1e6, "density": 1100.0}, "", "", id="rubber"),
        pytest.param({"E": 1e10, "density": 500.0, "A": 0.02, "I": 6.7e-5}, "", "", id="wood"),
        pytest.param({"E": 1.4e11, "density": 1600.0}, "", "", id="carbon fibre"),
        pytest.param({"E": 7e5, "density": 5540.0, "A": 1.8e-3, "I": 1.215e-8}, "", "", id="flexible pendulum"),
        pytest.param({"b": (0.002, 0.0), "A": 5e-5, "I": 1e-12}, "", "", id="flexure hinge"),
    ],
)
def test_units_of_beams_are_doubted_once_each_at_the_key_of_the_spec(
    values: dict[str, Any], key: str, advice: str
) -> None:
    m = mbdkit.Mechanism()
    m.beam("blade", **STEEL | values)
    found = [*improbable_inertias(m), *improbable_beams(m)]
    assert len(found) == bool(advice)
    assert all(f"at model.beams.blade{key} " in text and advice in text for text in found)


def test_messages_about_the_nodes_of_a_beam_name_its_keys() -> None:
    model: dict[str, Any] = {"name": "mechanism", "beams": {"blade": {**STEEL, "angular_velocity": 3600.0}}}
    model["joints"] = {"clamp": {"type": "weld", "bodies": ["ground", "blade.0"], "at": [0, 0]}}
    spec = load_spec({**SPEC, "model": model})
    (told,) = start_warnings(spec, build(spec)[1])
    assert "check those at model.beams.blade and its neighbours" in told
    model["beams"]["blade"]["load"] = ["1/t", 0]
    with pytest.raises(SpecError, match=r"model.beams.blade.load: .* is not finite at the start"):
        build(load_spec({**SPEC, "model": model}))


@pytest.mark.parametrize(
    ("values", "told"),
    [
        # expected: by hand; the pin is moved from x to 0, the size is 0.5 m
        ({"position": [0.56, 0.0]}, 0.06),
        ({"position": [0.54, 0.0]}, None),
        ({"position": [0.0, 0.0], "angle": 0.0}, 0.5),
    ],
)
def test_a_start_that_assembly_moves_far_is_told_with_the_body(values: dict[str, Any], told: float | None) -> None:
    data = copy.deepcopy(SPEC)
    data["model"]["bodies"]["rod"] |= values
    data["model"]["joints"]["A"]["bodies"] = ["ground", "rod"]
    spec = load_spec(data)
    _, start = build(spec)
    warnings = start_warnings(spec, start)
    if told is None:
        assert warnings == ()
        return
    assert len(warnings) == 1
    assert f"moves a point of rod by {told:.3g} m" in warnings[0]
    assert "model.bodies.rod" in warnings[0]


def test_warnings_are_printed_and_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = copy.deepcopy(SPEC)
    data["model"]["bodies"]["rod"] |= {"position": [0.7, 0.0]}
    data["time"] = {"end": 0.1, "step": 0.5}
    with mbdkit.run(data, archive=tmp_path / "warned.h5") as run:
        assert [warning.partition(" ")[0] for warning in run.warnings] == ["the", "assembly"]
        kept = run.warnings
    assert all(f"warning: {warning}" in capsys.readouterr().err for warning in kept[:1])
    with mbdkit.load(tmp_path / "warned.h5") as run:
        assert run.warnings == kept
        assert run.verdict == "doubtful"


BEAM = {"a": [0, 0], "b": [1, 0], "elements": 20, "E": 2e11, "nu": 0.3, "A": 4e-4, "I": 1.3e-8, "density": 8000}


@pytest.mark.parametrize(
    ("integrator", "step", "expected"),
    [
        ({"name": "radau-iia", "stages": 2}, 1e-3, ("beam 'link'", "step of 0.001 s", "radau-iia damps faster ones")),
        ({"name": "gauss", "stages": 2}, 1e-3, ("gauss keeps the energy of faster motions, but not their freq",)),
        ({"name": "gauss", "stages": 2}, 1e-7, None),
        ({"name": "rk4"}, 1e-3, None),  # which fails
    ],
)
def test_motions_of_beams_that_steps_do_not_resolve_are_named(
    integrator: dict[str, Any], step: float, expected: tuple[str, ...] | None
) -> None:
    found = warnings_of(model={"name": "mechanism", "beams": {"link": BEAM}}, integrator=integrator, time__step=step)
    assert len(found) == (expected is not None)
    for part in expected or ():
        assert part in found[0]


def test_the_place_of_a_node_is_not_an_angle() -> None:
    nodes = [[6.4, 7.2 + i, 0.0] for i in range(3)]
    beam = BEAM | {"elements": 2, "start": nodes}
    assert warnings_of(model={"name": "mechanism", "beams": {"link": beam}}) == ()


def test_what_steps_do_not_resolve_of_a_beam_does_not_question_the_run() -> None:
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.beam("link", velocity=(1.0, 0.0), **BEAM)
    run = mbdkit.run(m, integrator={"name": "gauss", "stages": 2}, time={"end": 2e-3, "step": 1e-3})
    assert len(run.warnings) == 1
    assert not run.verdict_reasons


def test_steps_in_which_a_stiff_beam_turns_too_far_say_so() -> None:
    spec = load_spec("spin-up-beam").model_dump(mode="json")
    spec["model"]["joints"]["motor"]["motion"] = "6*t"
    spec["model"]["beams"]["blade"]["angular_velocity"] = 6.0
    run = mbdkit.run(load_spec(spec, time={"end": 0.8, "step": 0.1}))
    assert run.status == "failed"
    assert "at most about 0.2 rad in an implicit step" in run.status_reason


def test_an_unused_parameter_is_told_but_does_not_question_the_run() -> None:
    run = mbdkit.run(SPEC | {"parameters": {"crank": 1.0}})
    assert run.warnings == ["the parameter at parameters.crank is not used"]
    assert run.verdict == "unknown"
    assert not run.verdict_reasons


@pytest.mark.parametrize(
    ("speed", "rate", "told"),
    [(0.0, 4.0, "from 4 to 1 rad/s"), (2.0, 4.0, ""), (0.75, 1.6, "from 1.6 to 1.525 rad/s"), (0.75, 1.505, "")],
)
def test_a_given_velocity_that_assembly_changes_by_five_percent_is_told(speed: float, rate: float, told: str) -> None:
    # expected: a rod on a pin at its end keeps the share I / (I + m a^2) = 1/4 of its rate, and 3/4 of that of its
    # centre, which is at 0.5 m
    m = mbdkit.Mechanism()
    m.body("rod", mass=1.0, inertia=1.0 / 12.0, position=(0.5, 0.0), velocity=(0.0, speed), angular_velocity=rate)
    m.revolute("pin", "ground", "rod", at=(0.0, 0.0))
    spec = load_spec(m, time={"end": 0.1, "step": 0.01}, integrator={"name": "rk4"})
    warnings = start_warnings(spec, build(spec)[1])
    assert len(warnings) == bool(told)
    assert all(f"changes the angular velocity of rod {told}" in warning for warning in warnings)


@pytest.mark.parametrize("share", [0.45, 0.55])
def test_a_circle_that_sinks_in_by_more_than_half_its_radius_is_doubted(share):
    # a ball that is put on a linear spring sinks in by 2 m g / k
    radius, ball = 0.1, {"mass": 1.0, "inertia": 0.004, "position": [0.0, 0.1]}
    floor = {
        "bodies": ["ground", "ball"],
        "shapes": [{"line": {"normal": (0, 1)}}, {"circle": {"radius": radius}}],
        "compliance": {"law": "linear", "stiffness": 2.0 * 9.81 / (share * radius)},
    }
    model = {"name": "mechanism", "bodies": {"ball": ball}, "contacts": {"floor": floor}}
    run = mbdkit.run(copy.deepcopy(SPEC) | {"model": model, "time": {"end": 0.5, "step": 0.005}})
    told = [one for one in run.warnings if one.startswith("contact 'floor' overlaps by 0.055 m")]
    assert len(told) == (share > 0.5)
    assert (run.verdict == "doubtful") == (share > 0.5)


def test_doubts_about_spec_and_rows_are_accepted_by_their_criteria() -> None:
    m = mbdkit.Mechanism(gravity=(0.0, -9.81))
    m.body("ball", mass=1.0, inertia=0.1, angle=400.0, position=(0.0, 0.1))
    shapes = [{"line": {"normal": [0.0, 1.0]}}, {"circle": {"radius": 0.1}}]
    m.contact("floor", "ground", "ball", shapes=shapes, compliance={"stiffness": 50.0})
    spec = {"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "rk4"}, "time": {"end": 0.3, "step": 1e-3}}
    run = mbdkit.run(spec)
    doubts = [one for one in run.warnings if "400 rad" in one or "overlaps by" in one]
    assert run.verdict == "doubtful"
    assert [*run.verdict_reasons] == doubts
    accepting = mbdkit.run(spec, accept=["degrees", "deep-overlaps"])
    assert (accepting.verdict, accepting.warnings) == ("unknown", run.warnings)
    assert accepting.verdict_reasons == [f"Accepted by the spec: {one}" for one in doubts]
    assert accepting.data_sha256 == run.data_sha256
    with pytest.raises(SpecError, match="'degrees'"):
        load_spec({**spec, "accept": ["degree"]})
