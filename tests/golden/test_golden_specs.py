"""The golden specs of version 1 have every key of the schemas, are valid, and keep their hashes."""

from __future__ import annotations

import json
from importlib.util import find_spec
from typing import Any

import pytest
from typer.testing import CliRunner

from mbdkit import SpecError
from mbdkit.cli import app
from mbdkit.spec.reading import Document, read_file
from mbdkit.spec.spec_kinds import kind_of, spec_loader

from .schema_keys import every_key, keys_of, problems
from .spec_hashes import spec_hash
from .write import HERE, SPECS, golden_specs

pytestmark = pytest.mark.skipif(find_spec("mbdkit_studies") is None, reason="the golden specs are those of all parts")

HASHES: dict[str, str] = json.loads((HERE / "spec_sha256.json").read_text("utf-8"))
OF_PLUGINS = {"definitions:name.name"}
"""Keys that only plugins use: measures by the names of their items."""

#: A spec of each kind.
KINDS = ("run", "study", "inverse", "design", "identify", "predict")


def test_golden_specs_have_every_key_of_the_schemas() -> None:
    specs = {path: read_file(path).data for path in golden_specs()}
    assert {path.name: found for path, spec in specs.items() if (found := problems(spec))} == {}
    assert every_key() - set().union(*map(keys_of, specs.values())) == OF_PLUGINS


@pytest.mark.slow
def test_the_command_that_validates_accepts_golden_specs() -> None:
    results = {path.name: CliRunner().invoke(app, ["validate", str(path)]) for path in sorted(SPECS.glob("*.yaml"))}
    assert {name: result.output for name, result in results.items() if result.exit_code} == {}


def test_no_key_of_version_1_was_removed() -> None:
    frozen = set((HERE / "spec_keys.txt").read_text("utf-8").split())
    assert frozen - every_key() == set()


@pytest.mark.parametrize("name", HASHES)
def test_a_golden_spec_keeps_its_hash(name: str) -> None:
    assert spec_hash(HERE / name) == HASHES[name]


def refusal(spec: dict[str, Any]) -> SpecError:
    with pytest.raises(SpecError) as caught:
        spec_loader.of(kind_of(spec).load)(Document(spec, folder=SPECS), ())
    return caught.value


def version_key(spec: dict[str, Any]) -> str:
    return next(key for key in reversed(spec) if key.startswith("mbdkit"))


@pytest.mark.parametrize("kind", KINDS)
def test_version_2_of_a_spec_is_refused_for_its_version_alone(kind: str) -> None:
    spec = read_file(SPECS / f"{kind}.yaml").data
    key = version_key(spec)
    error = refusal({"later": {"key": 1}, **spec, key: 2})
    assert (error.key, error.message) == (key, "should be 1, not 2: a later mbdkit reads specs of this version")


@pytest.mark.parametrize("kind", KINDS)
def test_a_key_of_a_later_version_1_is_refused_by_its_name(kind: str) -> None:
    error = refusal(read_file(SPECS / f"{kind}.yaml").data | {"weather": "sunny"})
    assert error.key == "weather"
    assert error.message.startswith("unknown key; known here: ")
    assert error.message.endswith("; a later version may know it")


@pytest.mark.parametrize("kind", ["study", "design", "identify", "predict"])
def test_a_base_of_version_2_is_refused_for_its_version(kind: str, mbdkit: Any) -> None:
    spec = read_file(SPECS / f"{kind}.yaml").data
    base = spec["base"] if isinstance(spec["base"], dict) else read_file(SPECS / spec["base"]).data
    later = spec | {"base": base | {"mbdkit": 2}}
    if kind == "study":  # reads its base when it plans the runs
        done = mbdkit("validate", "-", stdin=json.dumps(later))
        assert (done.exit_code, done.stdout) == (2, "")
        assert "mbdkit: should be 1, not 2" in done.stderr
    else:
        assert "not 2: a later mbdkit" in refusal(later).message
