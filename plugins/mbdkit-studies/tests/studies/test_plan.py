"""From a study to its runs: values with units, warnings, the schema, and why runs are not vectorized."""

from __future__ import annotations

import json
import math
import re
import time
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.registry.manager import registry
from mbdkit.spec import load_spec
from mbdkit.spec.schema import HOME, run_schema
from mbdkit_studies.compute.study_plan import plan_study
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.spec.study_loading import load_study_spec, study_names, study_schema


def points(study):
    return PlannedPoints(load_study_spec(study))


def test_axes_multiply_and_the_last_one_changes_fastest(small):
    found = [(point.number, point.axes["integrator"], point.axes["time.step"]) for point in points(small)]
    assert found == [(1, "rk4", 0.02), (2, "rk4", 0.01), (3, "Gauss 2", 0.02), (4, "Gauss 2", 0.01)]


def test_a_study_may_have_more_axes_than_numpy_has_dimensions(small):
    small["axes"] = [{f"parameters.p{i}": [float(i)]} for i in range(70)] + [{"time.step": [0.01, 0.1]}]
    small["base"] = small["base"] | {"parameters": {f"p{i}": 0.0 for i in range(70)}}
    planned = points(small)
    assert [point.axes["time.step"] for point in planned] == [0.01, 0.1]
    assert planned[1].axes["parameters.p69"] == 69.0


def test_a_point_is_the_run_that_its_spec_would_be_by_itself(small):
    run = {"integrator": {"name": "gauss", "stages": 2}, "time": {"end": 0.5, "step": 0.01}}
    alone = load_spec({"mbdkit": 1, "model": {"name": "double-pendulum"}, **run})
    assert points(small)[3].run_id == alone.run_id()


def test_keys_are_set_in_order_base_overrides_axes(small):
    small["base"] = "pendulum"
    small["overrides"] = {"time": {"end": 1.0, "step": 0.5}, "model.length": 2.0, "output.every": 3}
    small["axes"] = [{"integrator": [{"name": "gauss", "stages": 1}]}, {"integrator.stages": [2, 3]}]
    found = points(small)
    assert [point.spec.integrator.stages for point in found] == [2, 3]
    assert {point.spec.time.step for point in found} == {0.5}
    assert {point.spec.model.length for point in found} == {2.0}
    assert {point.spec.output.every for point in found} == {3}


def test_a_list_in_the_base_is_changed_item_by_item(small):
    small["base"] = small["base"] | {"model": {"name": "double-pendulum", "lengths": [1.0, 2.0]}}
    small["overrides"] = {"model.lengths[1]": 3.0}
    assert points(small)[0].spec.model.lengths == (1.0, 3.0)
    assert small["base"]["model"]["lengths"] == [1.0, 2.0]


@pytest.mark.parametrize(
    "points",
    [
        {"axes": [{"model.angles.0": [0.1, 0.2]}]},
        {"axes": [{"model.angles[0]": [0.1, 0.2]}], "store": "hashes"},
        {"sample": {"n": 2, "method": "random", "variables": {"model.angles.0": {"uniform": [0.2, 0.2000001]}}}},
    ],
)
def test_items_of_a_list_that_the_base_leaves_at_its_default_are_set(points):
    model, base = {"name": "double-pendulum"}, {"mbdkit": 1, "integrator": {"name": "rk4"}}
    base |= {"time": {"end": 0.02, "step": 0.01}, "model": model}
    done = mbdkit.study({"mbdkit_study": 1, "base": base, "overrides": {"model.gravity.1": -5.0}, **points})
    assert [point.status for point in done.points] == ["complete"] * 2
    (angle,) = done.points[1].axes.values()
    whole = mbdkit.run(base | {"model": model | {"angles": [angle, 0.0], "gravity": [0.0, -5.0]}})
    assert done.remake(1).data_sha256 == whole.data_sha256


def test_there_is_one_reference_for_all_points_that_it_fits(small):
    small["axes"] = [{"model": [{"name": "single-pendulum"}, {"name": "double-pendulum"}]}, *small["axes"]]
    found = points(small)
    assert len(found) == 8
    of_model = {name: {p.reference_id for p in found if p.spec.model.name == name} for name in
                ("single-pendulum", "double-pendulum")}  # fmt: skip
    assert [len(ids) for ids in of_model.values()] == [1, 1]
    assert of_model["single-pendulum"] != of_model["double-pendulum"]
    assert found[0].reference.integrator.stages == 4
    assert found[0].reference.model.name == "single-pendulum"


def test_a_family_takes_from_the_top_what_it_leaves_out(small):
    study = small | {
        "axes": [], "overrides": {"time.step": 0.1, "output.every": 2},
        "families": {
            "plain": {"axes": [{"integrator": [{"name": "rk4"}, {"name": "rk-gill"}]}]},
            "own": {
                "title": "Everything its own", "base": "pendulum", "overrides": {"time": {"end": 1.0, "step": 0.25}},
                "axes": [{"model.length": [1.0, 2.0, 3.0]}], "reference": "none", "repeats": 3,
            },
            "one": {"overrides": {"integrator": {"name": "rk4"}}},
        },
    }  # fmt: skip
    del study["axes"]
    found = points(study)
    assert [point.family for point in found] == ["plain"] * 2 + ["own"] * 3 + ["one"]
    assert [point.number for point in found] == [1, 2, 3, 4, 5, 6]
    plain, own, one = found[0], found[2], found[5]
    assert (plain.spec.time.step, plain.spec.output.every, plain.grid.repeats) == (0.1, 2, 1)
    assert (own.spec.time.step, own.spec.output.every, own.grid.repeats) == (0.25, 2, 3)
    assert plain.reference is not None
    assert own.reference is None
    assert one.axes == {}
    assert one.run_id == plain.run_id


def test_a_base_file_is_looked_for_beside_the_study(tmp_path):
    (tmp_path / "base.yaml").write_text(
        "mbdkit: 1\nmodel: {name: single-pendulum}\nintegrator: {name: rk4}\ntime: {end: 1.0, step: 0.1}\n"
    )
    (tmp_path / "study.yaml").write_text("mbdkit_study: 1\nbase: base.yaml\naxes: [{time.step: [0.1, 0.2]}]\n")
    spec = load_study_spec(tmp_path / "study.yaml")
    assert spec.base["model"] == {"name": "single-pendulum"}
    assert [point.spec.time.step for point in PlannedPoints(spec)] == [0.1, 0.2]


def test_a_mechanism_built_in_python_is_a_base():
    import mbdkit

    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=1 / 12, position=(0.5, 0.0))
    m.revolute("A", m.ground, rod, at=(0.0, 0.0))
    overrides = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}}
    study = {"mbdkit_study": 1, "base": m, "overrides": overrides, "axes": [{"model.bodies.rod.mass": [1.0, 2.0]}]}
    assert [point.spec.mechanism().bodies["rod"].mass for point in points(study)] == [1.0, 2.0]


def test_one_value_may_set_several_keys_and_its_axis_has_a_name_of_its_own(small):
    coarse = {"label": "coarse", "set": {"integrator": {"name": "gauss", "stages": 3}, "time.step": 0.05}}
    fine = {"label": "fine", "set": {"integrator.name": "rk4"}}
    small["axes"] = [{"method": [coarse, fine]}, {"time.end": [0.5, 1.0]}]
    small["base"] = small["base"] | {"integrator": {}}
    small["reference"] = {"integrator": {"name": "gauss", "stages": 4}}
    found = points(small)
    assert found[1].axes == {"method": "coarse", "time.end": 1.0}
    assert found[2].axes == {"method": "fine", "time.end": 0.5}
    told = [(point.spec.integrator.name, point.spec.time.step, point.spec.time.end) for point in found]
    assert told == [("gauss", 0.05, 0.5), ("gauss", 0.05, 1.0), ("rk4", 0.02, 0.5), ("rk4", 0.02, 1.0)]


def test_what_needs_a_distribution_that_is_not_there_is_planned_but_lacks_it(small):
    rk4 = {"label": "here", "value": {"name": "rk4"}, "if_installed": "MBDkit"}
    absent = {"label": "absent", "value": {"name": "acme-magic:magic"}, "if_installed": "acme-magic"}
    small["axes"][0] = {"integrator": [rk4, absent]}
    found = points(small)
    assert [(point.axes["integrator"], point.lacking) for point in found] == [
        ("here", ""), ("here", ""), ("absent", "acme-magic"), ("absent", "acme-magic"),
    ]  # fmt: skip
    assert found[0].spec.integrator.name == "rk4"


def seconds_until_refused(study: dict[str, Any], words: str) -> float:
    begin = time.process_time()
    with pytest.raises(SpecError, match=words):
        PlannedPoints(load_study_spec(study))
    return time.process_time() - begin


@pytest.mark.usefixtures("no_garbage_collection")
def test_a_study_with_too_many_runs_is_refused_before_its_axes_are_expanded(small):
    small["axes"] = [{f"k{index}": {"linspace": [0, 1, 10_000]}} for index in range(40)]
    assert seconds_until_refused(small, "makes too many runs; a study has at most 10000") < 0.5


@pytest.mark.usefixtures("no_garbage_collection")
def test_a_study_that_sets_too_many_values_is_refused_before_its_axes_are_expanded(small):
    small["axes"] = [{f"k{index}": {"linspace": [0, 1, 10_000]} for index in range(1000)}]
    assert seconds_until_refused(small, "lists 10000000 values; the axes of a study list at most 1000000") < 0.5


@pytest.mark.usefixtures("no_garbage_collection")
@pytest.mark.parametrize("key", ["a." * 100_000 + "b", "a" + "[0]" * 100_000])
def test_a_key_that_is_deeper_than_any_spec_is_refused_in_a_sentence(small, key):
    small["axes"] = [{key: [0]}]
    assert seconds_until_refused(small, r"^.{0,400}should be a dotted key of a run spec") < 0.5


def test_an_index_with_thousands_of_digits_is_refused_as_part_of_a_name(small):
    small["axes"] = [{f"a[{'9' * 10_000}]": [0]}]
    with pytest.raises(SpecError, match="unknown key"):
        _ = points(small)[0].spec


@pytest.mark.usefixtures("no_garbage_collection")
def test_many_values_with_one_label_are_told_apart_soon(small):
    least = []
    for count in (299, 2999):  # ten times as many take a hundred times as long if each is compared with all others
        seconds = []
        for _ in range(3):
            small["axes"] = [{"time.step": [{"label": "a", "value": 1 + index} for index in range(count)]}]
            begin = time.process_time()
            labels = [point.axes["time.step"] for point in points(small)]
            seconds.append(time.process_time() - begin)
        assert labels[0] == "a"
        assert labels[-1] == f"a ({count})"
        least.append(min(seconds))
    assert least[1] < 40 * least[0]


@pytest.mark.parametrize(
    ("axis", "told"),
    [
        ({"model.bodies.rod.angular_velocity": [1.0, 2.0]}, True),
        ({"model.bodies.rod.angular_velocity": [1.0, 2.0], "model.bodies.rod.velocity.1": [0.5, 1.0]}, False),
        ({"model.bodies.rod.mass": [1.0, 2.0], "model.bodies.rod.inertia": [0.1, 0.2]}, False),
    ],
)
def test_varied_initial_values_that_assembly_changes_are_told(axis: dict[str, list[float]], told: bool) -> None:
    # expected: a rod on a pin at its end keeps the share I / (I + m a^2) = 1/4 of a rate given without its velocity
    rod = {"mass": 1.0, "inertia": 1.0 / 12.0, "position": [0.5, 0.0], "velocity": [0.0, 0.0], "angular_velocity": 0.0}
    pin = {"type": "revolute", "bodies": ["ground", "rod"], "at": [0.0, 0.0]}
    model = {"name": "mechanism", "bodies": {"rod": rod}, "joints": {"pin": pin}}
    base = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}}
    warnings = plan_study(load_study_spec({"mbdkit_study": 1, "base": base, "axes": [axis]})).warnings()
    assert len(warnings) == told
    assert not told or "angular_velocity from 1 to 2, but the start after assembly from 0.25 to 0.5" in warnings[0]


def test_varied_starts_without_freedom_are_not_advised_to_vary_together() -> None:
    bodies = ["ground", "rod"]
    pin = {"type": "revolute", "bodies": bodies, "points": [[0, 0], [-0.5, 0]]}
    motor = {"type": "driver", "bodies": bodies, "coordinate": "angle", "motion": "t"}
    rod = {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0], "angle": 0.0, "angular_velocity": 1.0}
    model = {"name": "mechanism", "bodies": {"rod": rod}, "joints": {"pin": pin, "motor": motor}}
    base = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}}
    study = {"mbdkit_study": 1, "base": base, "axes": [{"model.bodies.rod.angle": [0.1, 0.2]}]}
    (warning,) = plan_study(load_study_spec(study)).warnings()
    assert "no freedom; vary its dimensions or the motions of its drivers" in warning
    assert "together" not in warning


MASS = "model.bodies.rod.mass"


@pytest.mark.parametrize(
    ("mass", "inertia", "axis", "advice"),
    [
        pytest.param(1.0, 0.1, {MASS: [1.0, 2.0]}, "write both as expressions", id="numbers"),
        pytest.param("m", "I", {MASS: [1.0, 2.0]}, "vary parameters.m instead", id="expressions of a parameter"),
        pytest.param("m", "I", {"case": [{"label": "a", "set": {MASS: 2.0}}]}, "vary parameters.m", id="several keys"),
        pytest.param("m", "I", {"parameters.m": [1.0, 2.0]}, "", id="parameter"),
        pytest.param("m", 0.1, {"parameters.m": [1.0, 2.0]}, "write the inertia as an expression", id="mass alone"),
        pytest.param("2*n", "0.1*k", {"parameters.m": [1.0, 2.0]}, "through parameters.m", id="mass alone, indirectly"),
        pytest.param("m", "0.1*k", {"parameters": [{"m": 1.0, "k": 2.0}]}, "", id="whole section"),
        pytest.param("n", "I", {"parameters.k": [1.0, 2.0]}, "", id="parameter of neither"),
        pytest.param(1.0, None, {MASS: [1.0, 2.0]}, "", id="point mass"),
    ],
)
def test_a_mass_that_varies_without_its_inertia_is_noted(
    mass: Any, inertia: Any, axis: dict[str, list[Any]], advice: str
) -> None:
    model = {"name": "mechanism", "bodies": {"rod": {"mass": mass, "inertia": inertia}}}
    base: dict[str, Any] = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 1, "step": 0.1}}
    if isinstance(mass, str):
        base["parameters"] = {"m": 1.0, "I": "m/12", "n": "m + 1", "k": 3.0}
    notes = plan_study(load_study_spec({"mbdkit_study": 1, "base": base, "axes": [axis]})).notes()
    assert len(notes) == bool(advice)
    assert all("'rod'" in note and "inertia" in note and advice in note for note in notes)


@pytest.mark.parametrize(
    ("variables", "told"),
    [
        pytest.param({"parameters.l": {"normal": [0.02, 0.4]}}, "near the value 0.4", id="exchanged"),
        pytest.param({"parameters.l": {"normal": ["2 cm", "40 cm"]}}, "near the value 0.4", id="exchanged, in cm"),
        pytest.param({"model.angle": {"norm": {"loc": 0.02, "scale": 0.5}}}, "near the value 0.5", id="of the model"),
        pytest.param({"parameters.l": {"normal": [0.4, 0.02]}}, "", id="in order"),
        pytest.param({"parameters.l": {"normal": [0.0, 0.4]}}, "", id="mean zero"),
        pytest.param({"model.rate": {"normal": [0.01, 0.1]}}, "", id="around a small value"),
        pytest.param({"parameters.l": {"uniform": [-0.4, 0.42]}}, "", id="uniform"),
        pytest.param(
            {"parameters.l": {"truncnorm": [0.3, 0.5, 0.4, 0.02]}}, "write [-5, 5, 0.4, 0.02]", id="limits as values"
        ),
        pytest.param({"parameters.l": {"truncnorm": [-2, 2, 0.4, 0.02]}}, "", id="limits in units of the scale"),
        pytest.param({"parameters.l": {"truncnorm": [0, 2, 1.0, 0.02]}}, "", id="upper half"),
    ],
)
def test_improbable_parameters_of_distributions_are_noted(variables: dict[str, Any], told: str) -> None:
    base = {
        "mbdkit": 1, "parameters": {"l": "40 cm"},
        "model": {"name": "single-pendulum", "angle": "0.5 rad", "rate": 0.01}, "integrator": {"name": "rk4"},
        "time": {"end": 1, "step": 0.1},
    }  # fmt: skip
    sample = {"n": 4, "seed": 5, "variables": variables}
    notes = plan_study(load_study_spec({"mbdkit_study": 1, "base": base, "sample": sample})).notes()
    assert len(notes) == bool(told)
    assert all(told in note for note in notes)


def test_a_zero_reaction_in_a_measure_of_a_study_is_noted() -> None:
    spec = {"mbdkit_study": 1, "base": "slider-crank", "axes": [{"model.bodies.crank.angle": [0.0]}]}
    notes = plan_study(load_study_spec(spec | {"measures": {"clamp": "max(abs(joints.A.torque))"}})).notes()
    assert ["joints.A.torque in measures.clamp is always zero" in note for note in notes] == [True]


BASE: dict[str, Any] = {
    "mbdkit": 1, "model": {"name": "double-pendulum", "angles": [0.1, 0.2]}, "integrator": {"name": "rk4"},
    "time": {"end": 0.05, "step": 0.01},
}  # fmt: skip


@pytest.mark.parametrize(
    ("sections", "reason"),
    [
        ({}, ""),
        ({"stabilization": "projection"}, "their stabilization is projection"),
        ({"events": {"down": {"when": "rod1.angle"}}}, "they have events"),
        ({"integrator": {"name": "radau-iia"}, "formulation": "index-3"}, "their formulation is index-3"),
        ({"integrator": {"name": "scipy-radau"}}, "mbdkit:scipy-radau cannot be vectorized with these options"),
        ({"measures": {"energy": "integral(energy.kinetic)"}}, "their measures contain integrals over time"),
        ({"check": True}, "their errors are estimated"),
    ],
)
def test_a_study_says_why_its_runs_are_not_vectorized(sections: dict[str, Any], reason: str, tmp_path: Path) -> None:
    said: list[str] = []
    mbdkit.ensemble(BASE | sections, {"model.angles.0": [0.1, 0.2]}, out=tmp_path / "study", notify=said.append)
    told = [text for text in said if "not vectorized" in text]
    wanted = f"the runs are not vectorized but computed one after another, because {reason}"
    assert told == ([wanted] if reason else [])


@pytest.mark.parametrize("name", study_names())
def test_every_packaged_study_is_valid_and_names_the_schema(name):
    assert load_study_spec(name).title
    if callable(registry().get("study", name).plugin.spec):
        return  # it is no file
    first = (files("mbdkit_paper") / name.replace("-", "_") / "study.yaml").read_text("utf-8").splitlines()[0]
    assert first == f"# yaml-language-server: $schema={HOME.format('study')}"


def test_the_schema_of_a_study_knows_the_keys_of_its_base_and_refers_to_nothing_that_is_not_there():
    schema = study_schema()
    assert set(schema["$defs"]["Base"]["properties"]) == set(run_schema()["properties"])
    for name, section in schema["properties"].items():
        assert section.get("description"), name
    text = json.dumps(schema)
    for reference in re.findall(r'"#/\$defs/(.*?)"', text):
        assert reference in schema["$defs"]


def test_studies_have_values_with_units() -> None:
    base = {"model": {"name": "single-pendulum"}, "integrator": {"name": "rk4"}, "time": {"end": 1, "step": 0.1}}
    study = {"mbdkit_study": 1, "base": base}

    def points(**given: Any) -> PlannedPoints:
        return PlannedPoints(load_study_spec(study | given))

    spaced = points(axes=[{"model.angle": {"linspace": ["0 deg", "60 deg", 3]}}, {"model.length": ["50 cm", 1]}])
    assert [list(point.axes.values()) for point in spaced[2:4]] == [[pytest.approx(math.pi / 6), 0.5],
                                                                      [pytest.approx(math.pi / 6), 1]]  # fmt: skip
    drawn = points(sample={"n": 4, "variables": {"model.mass": {"uniform": ["10 g", "20 g"]}}})
    assert all(0.01 < float(point.axes["model.mass"]) < 0.02 for point in drawn)
    with pytest.raises(SpecError, match=r"axes\[0\]\.\"model\.angle\"\[1\].*unit m, but this is a number in rad"):
        points(axes=[{"model.angle": [0.1, "20 mm"]}])
    with pytest.raises(SpecError, match="unit s, but this is a number in kg"):
        points(sample={"n": 4, "variables": {"model.mass": {"uniform": ["10 s", "20 s"]}}})
    with pytest.raises(SpecError, match="`mean` and `std` should have units of the same kind, or none"):
        points(sample={"n": 4, "variables": {"model.mass": {"normal": ["10 g", 1]}}})
