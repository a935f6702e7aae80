"""The JSON schema that editors use."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft202012Validator
from referencing import Registry, Resource

from mbdkit.spec import example_names, example_text
from mbdkit.spec.schema import HOME, repository_schemas, run_schema, schema_of
from mbdkit.spec.spec_kinds import kind_named, spec_kinds, spec_loader
from tests.first_party import PARTS

FOLDER = Path(__file__).parents[2] / "schemas"


@cache
def files():
    return repository_schemas()


@pytest.mark.skipif(not PARTS, reason="the files contain the specs of all parts")
def test_the_schemas_in_the_repository_are_fresh():
    assert {path.name for path in FOLDER.glob("*.json")} == set(files())
    stale = [name for name, text in files().items() if (FOLDER / name).read_text("utf-8") != text]
    assert not stale, "write them again: `python -m mbdkit.spec.schema schemas`"


def test_files_with_shared_definitions_accept_what_the_whole_schema_accepts():
    registry = Registry().with_resources(
        (json.loads(text)["$id"], Resource.from_contents(json.loads(text))) for text in files().values()
    )
    broken = {"mbdkit": 1, "model": {"name": "mechanism", "bodies": {"b": {"mass": -1}}}, "time": {"end": 1}}
    for kind in (kind.name for kind in spec_kinds()):
        split = Draft202012Validator(json.loads(files()[f"{kind}.schema.json"]), registry=registry)
        whole = Draft202012Validator(schema_of(kind_named(kind)))
        for spec in (broken, *(yaml.safe_load(example_text(name)) for name in example_names(kind)[:3])):
            assert split.is_valid(spec) == whole.is_valid(spec), kind


def test_the_schema_names_every_section_and_describes_it():
    schema = run_schema()
    assert schema["required"] == ["mbdkit", "model", "time"]
    assert schema["anyOf"] == [{"required": ["integrator"]}, {"required": ["accuracy"]}]
    for name, section in schema["properties"].items():
        assert section.get("description"), name


def test_a_choice_is_made_by_name():
    schema = run_schema()
    names = set()
    for choice in schema["properties"]["integrator"]["oneOf"]:
        definition = schema["$defs"][choice["$ref"].rpartition("/")[2]]
        assert "name" in definition["required"]
        names |= set(definition["properties"]["name"]["enum"])
    assert {"gauss", "mbdkit:gauss", "rk4"} <= names


@pytest.mark.parametrize("kind", [kind.name for kind in spec_kinds() if example_names(kind.name)])
def test_every_packaged_example_is_valid_and_names_the_schema(kind):
    for name in example_names(kind):
        assert spec_loader.of(kind_named(kind).load)(name, ())
        first = example_text(name).splitlines()[0]
        assert first == f"# yaml-language-server: $schema={HOME.format(kind)}"


def test_every_number_of_the_model_may_be_an_expression_and_no_other():
    schema = run_schema()
    numbers = schema["$defs"]["Body"]["properties"]["mass"], schema["$defs"]["Body"]["properties"]["position"]
    assert numbers[0]["type"] == ["number", "string"]
    assert numbers[0]["exclusiveMinimum"] == 0
    assert numbers[1]["prefixItems"][0]["type"] == ["number", "string"]
    for text, meant in {"0.5*crank": True, "degrees(45)": True, "crank": True, "2.5": False}.items():
        assert bool(re.search(numbers[0]["pattern"], text)) is meant
    step = next(one for one in schema["$defs"]["Time"]["properties"]["step"]["anyOf"] if "pattern" in one)
    assert [bool(re.search(step["pattern"], text)) for text in ("0.5*crank", "2 ms")] == [False, True]
    assert schema["properties"]["parameters"]["additionalProperties"] == {
        "anyOf": [{"type": "number"}, {"type": "string"}]
    }
