"""Specs of runs that differ in a few values are those, or have the errors, that the validation of whole specs gives."""

from __future__ import annotations

import copy
import json
import math
import random
from typing import Any

import pytest

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path
from mbdkit.spec import RunSpec
from mbdkit.spec.loading import example_names, load_spec
from mbdkit.spec.reading import put
from mbdkit.spec.varied_specs import VariedSpecs
from tests.slow_cases import slow

ODD = (0, -0.0, 1, 1e-300, -1.5, 2.0**70, 1e308, True, None, "", "0.5*pi", "x", [1.0], {}, "double-pendulum")


def numbers_in(value: Any, path: Path) -> list[Path]:
    """Return the key paths of the numbers in plain data."""
    if isinstance(value, dict):
        return [one for key, item in value.items() for one in numbers_in(item, (*path, key))]
    if isinstance(value, list):
        return [one for index, item in enumerate(value) for one in numbers_in(item, (*path, index))]
    return [path] if isinstance(value, int | float) and not isinstance(value, bool) else []


def outcome(make: Any) -> tuple[Any, ...]:
    """Return all that is known of a spec, or the error."""
    try:
        spec = make()
        mechanism = spec.mechanism()
    except SpecError as error:
        return error.key, error.message
    bodies, joints = dict(mechanism.bodies), dict(mechanism.joints)
    return spec.canonical_json(), spec.sha256(), spec.run_id(), spec.model_dump_json(), bodies, joints


@pytest.mark.parametrize("count", [12, *slow(100)])
@pytest.mark.parametrize("example", example_names("run"))
def test_specs_and_errors_are_those_of_whole_specs(example: str, count: int) -> None:
    base = json.loads(load_spec(example).canonical_json())
    text = json.dumps(base)
    varied, dice = VariedSpecs(text), random.Random(example)
    places = [*numbers_in(base["model"], ("model",)), ("time", "step"), ("model", "name"), ("model", "unknown")]
    for _ in range(count):
        values = []
        for place in dice.sample(places, min(2, len(places))):
            value = dice.choice(ODD) if dice.random() < 0.3 else dice.uniform(-2.0, 2.0)
            values.append((place, value))

        def whole(values: list[tuple[Path, Any]] = values) -> RunSpec:
            data = json.loads(text)
            for path, value in values:
                put(data, path, copy.deepcopy(value))
            return RunSpec(**data)

        def shared(values: list[tuple[Path, Any]] = values) -> RunSpec:
            return varied.spec(copy.deepcopy(values))

        assert outcome(shared) == outcome(whole), values


def test_values_of_the_model_do_not_validate_the_whole_spec(monkeypatch: pytest.MonkeyPatch) -> None:
    base = {"mbdkit": 1, "model": {"name": "pendulum"}, "integrator": {"name": "rk4"}, "time": {"end": 1, "step": 0.1}}
    base["model"] = {"name": "single-pendulum", "angle": 0.0}
    varied = VariedSpecs(json.dumps(base))
    varied.spec([(("model", "angle"), 0.5)])
    monkeypatch.setattr("mbdkit.spec.varied_specs.RunSpec", None)
    assert (
        varied.spec([(("model", "angle"), 0.25)]).canonical_json()
        == RunSpec(**base | {"model": {"name": "single-pendulum", "angle": 0.25}}).canonical_json()
    )


PENDULUM: dict[str, Any] = {
    "mbdkit": 1,
    "model": {"name": "double-pendulum"},
    "integrator": {"name": "rk4"},
    "time": {"end": 0.5, "step": 0.01},
}


def test_items_are_set_in_lists_that_the_base_leaves_at_their_defaults() -> None:
    def whole(**model: Any) -> str:
        return load_spec(PENDULUM | {"model": PENDULUM["model"] | model}).canonical_json()

    first, second, gravity = ("model", "angles", "0"), ("model", "angles", 1), ("model", "gravity", "1")
    varied = VariedSpecs(json.dumps(PENDULUM))
    for values, model in [
        ([(first, 0.1)], {"angles": [0.1, 0.0]}),
        ([(first, 0.2)], {"angles": [0.2, 0.0]}),
        ([(second, 0.3)], {"angles": [0.0, 0.3]}),  # without the value of a spec before
        ([(second, "30 deg"), (gravity, -1.0)], {"angles": [0.0, math.radians(30)], "gravity": [0.0, -1.0]}),
        ([(first, 0.1), (second, 0.3)], {"angles": [0.1, 0.3]}),
    ]:
        assert varied.spec(values).canonical_json() == whole(**model)


@pytest.mark.parametrize(
    ("assignment", "key", "words"),
    [
        ("model.angles.2=1", "model.angles.2", "model.angles has 2 items, counted from 0"),
        ("model.angels.0=1", "model.angels", "did you mean 'angles'?"),
        ("model.angles.x=1", "model.angles", r"should be two numbers \[first rod, second rod\], not {'x': 1}"),
        ("model.angles.0=[1]", "model.angles[0]", "should be a number"),
        ("model.name.0=1", "model.name.0", "model.name is the text 'double-pendulum', so it has no '0'"),
        ("output.quantity.0=energy", "output.quantity", "did you mean 'quantities'?"),
    ],
)
def test_a_wrong_key_of_an_item_is_named(assignment: str, key: str, words: str) -> None:
    with pytest.raises(SpecError, match=words) as caught:
        load_spec(PENDULUM, [assignment])
    assert caught.value.key == key


def test_items_of_elements_and_expressions_are_set_by_assignments() -> None:
    model = {
        "name": "mechanism",
        "bodies": {"rod": {"mass": 1.0, "inertia": 0.1}},
        "forces": {"f": {"type": "force", "body": "rod", "value": [0, 1]}},
    }
    base = PENDULUM | {"parameters": {"k": 0.5}, "model": model}
    keys = ["model.bodies.rod.velocity[1]=2*k", "model.bodies.rod.position.0=k", "model.forces.f.point.1=0.2"]
    spec = load_spec(base, keys)
    rod_path = ("model", "bodies", "rod")
    assert spec.written == {(*rod_path, "velocity", 1): "2*k", (*rod_path, "position", 0): "k"}
    rod = spec.mechanism().bodies["rod"]
    assert (rod.position, rod.velocity, spec.mechanism().forces["f"].point) == ((0.5, 0.0), (0.0, 1.0), (0.0, 0.2))
    assert load_spec(json.loads(spec.canonical_json())).sha256() == spec.sha256()


def test_items_of_items_are_set_in_lists_at_their_defaults() -> None:
    bodies = {name: {"mass": 1.0, "inertia": 0.1, "position": [x, 0]} for name, x in (("a", 0.0), ("b", 0.5))}
    gear = {"type": "gear", "bodies": ["a", "b"], "radii": [0.25, 0.25]}
    base = PENDULUM | {"model": {"name": "mechanism", "bodies": bodies, "joints": {"gear": gear}}}
    for key in ("model.joints.gear.points.1.0", "model.joints.gear.points[1][0]"):
        assert load_spec(base, [f"{key}=0.1"]).mechanism().joints["gear"].points == ((0.0, 0.0), (0.1, 0.0))


def test_a_key_of_a_misspelt_element_does_not_add_an_element() -> None:
    data: dict[str, Any] = {"model": {"name": "mechanism", "bodies": {"shank": {"mass": 3.0}}, "limits": {"low": 1.0}}}
    with pytest.raises(SpecError, match=r"model\.bodies has no 'shnk' \(did you mean 'shank'\?\); to add it, give all"):
        put(data, ("model", "bodies", "shnk", "mass"), 5.0)
    with pytest.raises(SpecError, match=r"has no .wheel. \(it has shank\); to add"):
        put(data, ("model", "bodies", "wheel", "mass"), 5.0)
    assert data["model"]["bodies"] == {"shank": {"mass": 3.0}}
    put(data, ("model", "bodies", "foot"), {"mass": 1.0})
    put(data, ("model", "springs", "cuff", "stiffness"), 100.0)  # the first of its kind
    put(data, ("model", "limits", "high", "value"), 2.0)  # not a mapping of elements
    assert list(data["model"]["bodies"]) == ["shank", "foot"]
    with pytest.raises(SpecError, match=r"motion\.columns has no 'kne' \(did you mean 'knee'\?\)"):
        put({"motion": {"columns": {"knee": {"column": "a"}}}}, ("motion", "columns", "kne", "unit"), "deg")


def test_a_parameter_that_the_base_does_not_have_is_refused_unless_an_expression_uses_it() -> None:
    base = json.loads(load_spec("pendulum").canonical_json())
    varied = VariedSpecs(json.dumps(base | {"parameters": {"angle": 0.1}}))
    with pytest.raises(SpecError, match=r"parameters.angel: .* no such parameter.*did you mean 'angle'"):
        varied.spec([(("parameters", "angel"), 0.2)])
    assert varied.spec([(("parameters", "angle"), 0.2)]).parameters == {"angle": 0.2}
    used = varied.spec([(("parameters", "tilt"), 0.2), (("model", "angle"), "2*tilt")])
    assert used.parameters == {"angle": 0.1, "tilt": 0.2}


NAMED: dict[str, Any] = {
    "mbdkit": 1,
    "parameters": {"length": 1.0, "mass": "2*length", "share": 0.5, "count": 3},
    "model": {
        "name": "mechanism",
        "bodies": {"rod": {"mass": "mass", "inertia": "mass*length**2/12", "position": ["share*length", 0]}},
        "joints": {"pin": {"type": "revolute", "bodies": ["ground", "rod"], "at": [0, 0]}},
        "forces": {"motor": {"type": "torque", "body": "rod", "value": "share*sin(length*t)"}},
    },
    "events": {"low": {"when": "rod.y + share*length"}},
    "integrator": {"name": "rk4"},
    "time": {"end": 1, "step": 0.1},
}


def test_numbers_for_named_parameters_give_the_specs_and_errors_of_whole_specs() -> None:
    text = RunSpec(**copy.deepcopy(NAMED)).canonical_json()
    varied, dice = VariedSpecs(text), random.Random(1)
    for _ in range(60):
        names = dice.sample(["length", "mass", "share", "count"], dice.choice([1, 2]))
        values: list[tuple[Path, object]] = [
            (("parameters", name), dice.choice(ODD) if dice.random() < 0.2 else dice.uniform(-0.2, 2.0))
            for name in names
        ]

        def whole(values: list[tuple[Path, object]] = values) -> RunSpec:
            data = json.loads(text)
            for path, value in values:
                put(data, path, copy.deepcopy(value))
            return RunSpec(**data)

        def shared(values: list[tuple[Path, object]] = values) -> RunSpec:
            return varied.spec(copy.deepcopy(values))

        found, expected = outcome(shared), outcome(whole)
        assert found == expected, values
        if len(found) > 2:
            assert shared().numbers == whole().numbers
            assert str(shared().watched()["low"]) == str(whole().watched()["low"])


def test_numbers_for_named_parameters_do_not_validate_the_whole_spec(monkeypatch: pytest.MonkeyPatch) -> None:
    varied = VariedSpecs(RunSpec(**copy.deepcopy(NAMED)).canonical_json())
    varied.spec([(("parameters", "length"), 0.5)])
    monkeypatch.setattr("mbdkit.spec.varied_specs.RunSpec", None)
    assert varied.spec([(("parameters", "length"), 0.25)]).mechanism().bodies["rod"].mass == 0.5
