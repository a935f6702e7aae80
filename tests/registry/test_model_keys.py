"""A key of a plugin that every model has, whose values add elements to the mechanism."""

from __future__ import annotations

import json

import pytest

from tests.installing import install_module, python

pytestmark = pytest.mark.end_to_end

PLUGIN = """
from mbdkit.plugin import ModelKey, Positive, StrictModel, Target, hookimpl
from mbdkit.plugin.seams import element_files, model_extension

class Bob(StrictModel):
    on: str
    mass: Positive
    \"\"\"Mass [kg].\"\"\"

@model_extension
def hang(bobs: dict[str, Bob], mechanism):
    for name, bob in bobs.items():
        mechanism.body(name, mass=bob.mass, inertia=1.0, position=mechanism.bodies[bob.on].position)
        mechanism.weld(f"{name}.weld", bob.on, name, at=mechanism.bodies[bob.on].position)

@element_files
def read(bobs, folder):
    for bob in bobs.values():
        if "file" in bob:
            bob["mass"] = float((folder / bob.pop("file")).read_text())

@hookimpl
def mbdkit_items():
    return [ModelKey(name="bobs", summary="Bobs by name.", model=Target("bob_kit:Bob"), extend=Target("bob_kit:hang"),
                     read_files=Target("bob_kit:read"))]
"""
PROGRAM = """
import json, mbdkit
from mbdkit import load_spec
from mbdkit.spec.schema import run_schema
from pathlib import Path

def masses(model, **more):
    spec = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}} | more
    spec = load_spec(spec)
    again = load_spec(json.loads(spec.canonical_json()))
    assert again.sha256() == spec.sha256()
    return {name: body.mass for name, body in mbdkit.run(again).status and spec.mechanism().bodies.items()}

Path("mass.txt").write_text("0.25")
found = {
    "pendulum": masses({"name": "single-pendulum", "bobs": {"b": {"on": "rod1", "mass": "2*m"}}}, parameters={"m": 1}),
    "mechanism": masses({"name": "mechanism", "bodies": {"a": {"mass": 1, "inertia": 1}},
                         "bobs": {"b": {"on": "a", "mass": "5 g"}}}),
    "file": masses({"name": "single-pendulum", "bobs": {"b": {"on": "rod1", "file": "mass.txt"}}}),
    "none": masses({"name": "single-pendulum"}),
}
assert "bob_kit" in __import__("sys").modules
wrong = {"bobs": {"b": {"on": "rod1", "mas": 1}}}, {"bobs": {"b": {"on": "rod1", "mass": "1 m"}}}, {"bob": {}}
for number, bad in enumerate(wrong):
    try:
        masses({"name": "single-pendulum"} | bad)
    except mbdkit.SpecError as error:
        found[f"wrong {number}"] = str(error)
properties = [one["properties"] for one in run_schema()["$defs"].values() if "properties" in one]
assert sum("bobs" in one for one in properties) > 5
print(json.dumps(found))
"""


def test_a_key_of_a_plugin_extends_the_mechanism_of_every_model(tmp_path) -> None:
    install_module(tmp_path / "site", "bob-kit", PLUGIN)
    done = python("-c", PROGRAM, path=(tmp_path / "site",), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["pendulum"] == {"rod1": 1.0, "b": 2.0}
    assert found["mechanism"] == {"a": 1.0, "b": 0.005}
    assert found["file"] == {"rod1": 1.0, "b": 0.25}
    assert found["none"] == {"rod1": 1.0}
    assert found["wrong 0"].startswith("model.bobs.b.mas: unknown key (did you mean 'mass'?)")
    assert found["wrong 1"].startswith("model.bobs.b.mass: ")
    assert "kg" in found["wrong 1"]
    assert found["wrong 2"].startswith("model.bob: unknown key (did you mean 'bobs'?)")
