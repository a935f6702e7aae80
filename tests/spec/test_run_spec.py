"""The rules of a run spec."""

from __future__ import annotations

import copy
import hashlib
import json
import time

import numpy as np
import pytest
from pydantic import ValidationError

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.spec import RunSpec, load_spec


def test_defaults_are_those_of_the_contract(small):
    spec = load_spec(small)
    assert (spec.formulation, spec.stabilization, spec.title) == ("index-1", "none", "")
    assert (spec.time.start, spec.output.every, spec.output.interval, spec.output.quantities) == (0.0, 1, None, "all")
    assert (spec.limits.wall_time, spec.limits.max_steps) == (None, 10_000_000)
    assert spec.output.recorded == {"joints", "constraints", "energy", "forces", "markers", "beams"}


def test_a_spec_is_frozen_all_the_way_down(small):
    spec = load_spec(small)
    for part, key in ((spec, "title"), (spec.time, "end"), (spec.integrator, "stages"), (spec.model, "name")):
        with pytest.raises(ValidationError):
            setattr(part, key, 1)


@pytest.mark.parametrize(
    ("time", "count"),
    [
        ({"end": 1.0, "step": 0.1}, 10),
        ({"end": 1.0, "step": 0.3}, 4),
        ({"end": 15.0, "step": 0.01}, 1500),
        ({"end": 0.3, "step": 0.1}, 3),  # 0.3 / 0.1 = 2.9999999999999996
        ({"start": 0.1, "end": 0.4, "step": 0.1}, 3),  # (0.4 - 0.1) / 0.1 = 3.0000000000000004
        ({"end": 1.0, "step": 2.0}, 1),
        ({"steps": 7, "step": 0.1}, 7),
        ({"start": -1.0, "end": 1.0, "step": 0.5}, 4),
    ],
)
def test_the_number_of_steps_is_that_of_the_contract(time, count, small):
    spec = load_spec(small, time=time)
    assert spec.time.count == count


def test_steps_set_the_end(small):
    assert load_spec(small, time={"start": 1.0, "steps": 4, "step": 0.25}).time.final == 2.0


def test_interval_is_for_methods_with_dense_output(small):
    with pytest.raises(SpecError, match=r"output.interval: .*'rk4' has no dense output.*scipy-dop853"):
        load_spec(small, integrator={"name": "rk4"}, output={"interval": 0.1})
    spec = load_spec(small, integrator={"name": "scipy-dop853"}, output={"interval": 0.1})
    assert (spec.output.every, spec.output.interval) == (None, 0.1)


def test_quantities_are_a_set(small):
    some = load_spec(small, output={"quantities": ["energy", "joints", "energy"]})
    assert some.output.quantities == ("energy", "joints")
    assert load_spec(small, output={"quantities": []}).output.recorded == set()
    whole = load_spec(small, output={"quantities": ["energy", "joints", "forces", "markers", "constraints", "beams"]})
    assert whole.sha256() == load_spec(small).sha256()


def test_whole_numbers_may_be_written_as_floats(small):
    spec = load_spec(small, limits={"max_steps": 1e6})
    assert spec.limits.max_steps == 1_000_000


def test_canonical_json_says_everything_and_reads_back_to_itself(small):
    spec = load_spec(small)
    text = spec.canonical_json()
    data = json.loads(text)
    assert data["time"] == {"end": 1.0, "start": 0.0, "step": 0.01, "steps": None}
    assert data["model"]["masses"] == [1.0, 1.0]
    assert list(data) == sorted(data)
    assert load_spec(data).canonical_json() == text
    assert spec.sha256() == hashlib.sha256(text.encode()).hexdigest()


def test_equal_specs_have_equal_hashes_however_they_are_written(small):
    spelled_out = {
        **copy.deepcopy(small),
        "title": "",
        "model": {"masses": (1, np.float64(1.0)), "lengths": np.ones(2), "name": "mbdkit:double-pendulum"},
        "output": {"every": 1},
    }
    assert load_spec(spelled_out).sha256() == load_spec(small).sha256()
    assert load_spec(spelled_out).run_id() == load_spec(small).run_id()
    assert load_spec(small, title="x").sha256() != load_spec(small).sha256()


def test_the_order_of_bodies_is_kept_because_it_is_that_of_the_arrays(small):
    bodies = {name: {"mass": 1.0} for name in ("z", "a", "m")}
    spec = load_spec(small, model={"name": "mechanism", "bodies": bodies})
    again = load_spec(json.loads(spec.canonical_json()))
    assert list(again.mechanism().bodies) == ["z", "a", "m"]


def test_a_mechanism_and_keywords_are_a_spec():
    mechanism = mbdkit.Mechanism()
    rod = mechanism.body("rod", mass=1.0, inertia=1 / 12, position=(0.5, 0.0))
    mechanism.revolute("A", mechanism.ground, rod, at=(0, 0))
    spec = load_spec(mechanism, integrator={"name": "gauss"}, time={"end": 1, "step": 0.1})
    assert spec.mechanism().to_spec() == mechanism.to_spec()


def test_a_run_spec_can_be_made_and_changed_in_python(small):
    spec = RunSpec(**small)
    assert load_spec(spec) is spec
    longer = load_spec(spec, time={"end": 2.0, "step": 0.01})
    assert longer.time.end == 2.0
    assert longer.model == spec.model
    with pytest.raises(SpecError, match=r"time\.end"):
        RunSpec(**{**small, "time": {"end": "soon"}})


OVERRIDES = [
    ("time.step=0.005", lambda spec: spec.time.step == 0.005),
    ("time.step=5e-3", lambda spec: spec.time.step == 0.005),
    ("model.masses[1]=3", lambda spec: spec.model.masses == (2.0, 3.0)),
    ("model.masses=[1, 3]", lambda spec: spec.model.masses == (1.0, 3.0)),
    ("integrator={name: rk4}", lambda spec: spec.integrator.name == "rk4"),
    ("output.every=5", lambda spec: spec.output.every == 5),
    ("title=a = b", lambda spec: spec.title == "a = b"),
]


@pytest.mark.parametrize(("assignment", "holds"), OVERRIDES)
def test_set_changes_one_key(assignment, holds, small):
    small["model"]["masses"] = [2.0, 2.0]
    assert holds(load_spec(small, [assignment]))
    assert small["time"]["step"] == 0.01, "the caller's dict is left alone"


@pytest.mark.parametrize(
    ("assignment", "key"),
    [
        ("time.step=x", "time.step"),
        ("time.stpe=1", "time.stpe"),
        ("time.step.deeper=1", "time.step.deeper"),
        ("model.masses[7]=1", "model.masses[7]"),
        ("time.step=[1", "time.step"),
        ("time.step=-1", "time.step"),
        ("time.step", ""),
        ("=1", ""),
        ("time..step=1", ""),
    ],
)
def test_a_wrong_set_is_refused_with_what_was_typed(assignment, key, small):
    small["model"]["masses"] = [2.0, 2.0]
    with pytest.raises(SpecError) as caught:
        load_spec(small, [assignment])
    assert caught.value.file == f"--set {assignment}"
    assert caught.value.key == key


def test_a_dict_that_contains_itself_is_refused(small):
    small["model"]["masses"] = small
    with pytest.raises(SpecError, match="contains itself"):
        RunSpec(**small)


@pytest.mark.parametrize("source", [5, None, ["mbdkit"], object()])
def test_what_cannot_be_a_spec_is_refused(source):
    with pytest.raises(SpecError, match="a spec is a file"):
        load_spec(source)


def test_several_mistakes_are_all_named_the_mistyped_key_first(small):
    with pytest.raises(SpecError) as caught:
        load_spec(small, model={"name": "double-pendulum", "masses": [1, -1], "lenghts": [1, 1]}, title=3)
    first, *others = str(caught.value).splitlines()
    assert first.startswith("model.lenghts: unknown key (did you mean 'lengths'?)")
    assert [line.split(":")[1].strip() for line in others] == ["title", "model.masses[1]"]


def test_another_models_key_is_told_whose_it_is(small):
    with pytest.raises(SpecError, match=r"model\.length: 'length' belongs to .*'single-pendulum'.*not to the model"):
        load_spec(small, model={"name": "double-pendulum", "length": 1})


def test_a_key_at_the_wrong_level_is_told_where_it_belongs(small):
    with pytest.raises(SpecError, match="'step' belongs under 'time'"):
        load_spec(small, step=0.1)


def test_the_name_of_a_mechanism_is_the_title_of_its_runs():
    times = {"integrator": {"name": "gauss"}, "time": {"end": 0.1, "step": 0.05}}
    for name, title in (("Jansen leg", "Jansen leg"), ("mechanism", "")):
        mechanism = mbdkit.Mechanism(name=name)
        mechanism.body("ball", mass=1.0)
        assert load_spec(mechanism, **times).title == title
        assert load_spec(mechanism, **times, title="Drop").title == "Drop"


def test_text_of_many_digits_is_refused_at_once():
    # a pattern that tries each part of them as a number would take minutes
    mechanism = {"name": "mechanism", "bodies": {"b": {"mass": "1" * 50_000 + "x"}}}
    begin = time.monotonic()
    with pytest.raises(SpecError, match="mass: should be a number, not the text"):
        load_spec({"mbdkit": 1, "model": mechanism, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}})
    assert time.monotonic() - begin < 10
