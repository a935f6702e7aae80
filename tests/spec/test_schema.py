"""The JSON schema that editors use."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

import pytest

from mbdkit.spec import example_names, load_spec
from mbdkit.spec.schema import HOME, builtin_schema_text, run_schema

SCHEMA = Path(__file__).parents[2] / "schemas" / "run.schema.json"


def test_the_schema_in_the_repository_is_fresh():
    assert SCHEMA.read_text("utf-8") == builtin_schema_text(), (
        "schemas/run.schema.json is stale; write it again: `python -m mbdkit.spec.schema > schemas/run.schema.json`"
    )


def test_the_schema_names_every_section_and_describes_it():
    schema = run_schema()
    assert schema["required"] == ["mbdkit", "model", "integrator", "time"]
    for name, section in schema["properties"].items():
        assert section.get("description"), name


def test_a_choice_is_made_by_name():
    choices = run_schema()["properties"]["integrator"]["oneOf"]
    names = set()
    for choice in choices:
        definition = run_schema()["$defs"][choice["$ref"].rpartition("/")[2]]
        assert "name" in definition["required"]
        names |= set(definition["properties"]["name"]["enum"])
    assert {"gauss", "mbdkit:gauss", "rk4"} <= names


@pytest.mark.parametrize("name", example_names())
def test_every_packaged_example_is_valid_and_names_the_schema(name):
    assert load_spec(name).mechanism().bodies
    first = (files("mbdkit.models") / "examples" / f"{name}.yaml").read_text("utf-8").splitlines()[0]
    assert first == f"# yaml-language-server: $schema={HOME}"


def test_the_schema_is_json():
    assert json.loads(builtin_schema_text())["$id"] == HOME
