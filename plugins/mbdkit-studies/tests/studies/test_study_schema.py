"""The JSON schema of studies that editors use."""

from __future__ import annotations

import json
import re
from importlib.resources import files

import pytest

from mbdkit.spec.schema import HOME, run_schema
from mbdkit_studies.spec.study_loading import load_study_spec, study_names
from mbdkit_studies.spec.study_schema import study_schema


@pytest.mark.parametrize("name", study_names())
def test_every_packaged_study_is_valid_and_names_the_schema(name):
    assert load_study_spec(name).title
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
