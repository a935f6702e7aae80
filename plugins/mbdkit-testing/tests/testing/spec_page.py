"""Writes the page on specs from their models.

``python plugins/mbdkit-testing/tests/testing/spec_page.py mbdkit/guide/spec.md`` writes it.
"""

from __future__ import annotations

import inspect
import sys
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, cast, get_args

from pydantic import BaseModel

from mbdkit.mechanism.mechanism_data import MechanismData
from mbdkit.mechanism.values import Table
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.element_items import ElementKind, JointKind, ModelKey
from mbdkit.registry.feature_items import SpecKind
from mbdkit.registry.manager import registry
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.schema import schema_of
from mbdkit_biomech.muscles.muscle import Muscle, PathItem
from mbdkit_contact.contact import Compliance, Contact, Friction, Shape
from mbdkit_design.design_spec import DesignSpec
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_testing.describe import claim_texts, options_in

WIDTH = 120

BEGINNING = """\
# Spec reference

Every key of run specs, study specs, specs of inverse dynamics, design specs and specs of identifications. Each key is
followed by its type and its default; a key without a default is optional unless it is marked as required.

<!-- Written by `python plugins/mbdkit-testing/tests/testing/spec_page.py mbdkit/guide/spec.md`; do not edit. -->

Specs are YAML, TOML or JSON files. Unknown keys are errors. A number without a unit is in the SI unit given in
brackets, an angle in radians. Another unit of the same quantity can follow the number after a space, as in `30 deg`,
`2 N/mm` and `500 ms`. Any number of the model may also be an expression of `parameters`, such as `0.5*crank` or
`degrees(45)`. `mbdkit schema KIND`, where KIND is `run`, `study`, `inverse`, `design` or `identify`, prints these keys,
and those of installed plugins, as a JSON schema for editors; `mbdkit plugins show NAME` prints the options of one
model, integrator, controller of steps or force law.
"""

PARTS = ("model", "integrator", "stabilization")  #: Keys of a run spec that are described in separate sections.


def page(installed: Registry) -> str:
    """Return the page, as Markdown, on specs with the plugins of a registry."""
    run, inverse, identify = (_schema(installed, kind) for kind in ("run", "inverse", "identify"))
    first = [f"- `{key}`: {_flat(run['properties'][key]['description'])} See below." for key in PARTS]
    study, design = StudySpec.model_json_schema(), DesignSpec.model_json_schema()
    identify["properties"]["base"] |= {"anyOf": [{"type": "string"}, {"type": "object"}]}
    law, *forces = reversed(_models(MechanismData, "forces"))
    parts = [
        BEGINNING.rstrip("\n"),
        "## Run spec",
        "\n".join([_version("mbdkit", run), *first, _keys(_without(run, PARTS))]),
        "## The model `mechanism`",
        (
            "Bodies, beams, joints, forces, markers, muscles, cuffs and contacts have names, under which the archive "
            "records their results."
        ),
        _keys(MechanismData.model_json_schema(), 0),
        *_key("bodies"),
        *_key("beams"),
        "### `joints`",
        "`type` selects the type of the joint. `bodies` are the first body a and the second body b.",
        *_types(_models(MechanismData, "joints")),
        *_types(_model_of(item) for item in installed.of_kind("joint-kind")),
        "### `forces`",
        "`type` selects the type of the force element; with `type: law`, `law` selects the force law.",
        *_types(reversed(forces)),
        *(part for item in installed.of_kind("force-law") for part in _item(item, "####", f"law: {item.name}")),
        "#### `pathway`",
        "The length, angle or coordinate that a law acts along; `type` selects it.",
        *_types(_models(law, "pathway"), "#####"),
        *_model("### Functions of time", Table),
        (
            "Instead of a table, a motion, torque or force may be a number, or an expression of `t` and the "
            "parameters. The page `mechanism` lists operators and functions."
        ),
        *_model("### Functions of an angle", *_models(MechanismData, "joints", "center", "x")),
        "Instead of a table, a `center` may have a number, or an expression of `angle` and the parameters.",
        *_key("markers"),
        *_model("### `muscles`", Muscle),
        *_model("#### Items of `path`", PathItem),
        *_model("### `contacts`", Contact),
        *_model("#### Items of `shapes`", Shape),
        *_model("#### `friction`", Friction),
        *_model("#### `compliance`", Compliance),
        *_model("### `cuffs`", _model_of(installed.get("element-kind", "cuff"))),
        *(part for key in ("coordinates", "states", "inputs", "controllers", "assembly") for part in _key(key)),
        "## Keys of every model",
        *(part for item in installed.of_kind("model-key") for part in _model(f"### `{item.name}`", _model_of(item))),
        "## Other models",
        *(part for item in installed.of_kind("model") if item.name != "mechanism" for part in _item(item)),
        "## Integrators",
        "Claims hold for the default options. The page `methods` helps to choose.",
        *(part for item in installed.of_kind("integrator") for part in _item(item)),
        "### `step_control`",
        "Adaptive steps of every integrator may have one of these controllers. The page `methods` helps to choose.",
        *(part for item in installed.of_kind("step-control") for part in _item(item, "####")),
        "## Stabilizations",
        *(
            part
            for model in _models(RunSpec, "stabilization")
            for part in _model(f"### `{get_args(model.model_fields['name'].annotation)[0]}`", model)
        ),
        "## Study spec",
        "\n".join([_version("mbdkit_study", study), _keys(study)]),
        "## Spec of inverse dynamics",
        (
            "The page `inverse` explains this spec. Instead of a mapping, a column may be given by its heading alone. "
            "Columns of loads have the same keys `column`, `unit`, `scale` and `deviation` as columns of the motion."
        ),
        "\n".join([_version("mbdkit", inverse), first[0].replace("below", "above"), _keys(_without(inverse, PARTS))]),
        "## Design spec",
        "The page `design` explains this spec.",
        "\n".join([_version("mbdkit_design", design), _keys(design)]),
        "## Spec of an identification",
        (
            "The page `identify` explains this spec. Instead of a mapping, an observed quantity or an input may be "
            "given by the heading of its column alone."
        ),
        "\n".join([_version("mbdkit_identify", identify), _keys(identify)]),
    ]
    return "\n\n".join("\n".join(_wrapped(part.splitlines())) for part in filter(None, parts)) + "\n"


def _schema(installed: Registry, kind: str) -> dict[str, Any]:
    return schema_of(cast(SpecKind, installed.get("spec-kind", kind).plugin), installed)


def _models(owner: type[BaseModel], *keys: str) -> list[type[BaseModel]]:
    """Return the models of the values of a key in the order of its annotation; other keys lead to it."""
    for key in keys[:-1]:
        owner = _models(owner, key)[0]
    pending: list[object] = [owner.model_fields[keys[-1]].annotation]
    models: list[type[BaseModel]] = []
    while pending:
        annotation = pending.pop(0)
        pending = [*get_args(annotation), *pending]
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            models.append(annotation)
    return models


def _key(key: str) -> list[str]:
    """Return heading, description and keys of the values of a key of the model `mechanism`."""
    return _model(f"### `{key}`", *_models(MechanismData, key))


def _model_of(item: Registered) -> type[BaseModel]:
    """Return the class of the elements, joints or values of an item."""
    return cast("type[BaseModel]", cast(JointKind | ElementKind | ModelKey, item.plugin).model())


def _without(schema: dict[str, Any], keys: Sequence[str]) -> dict[str, object]:
    """Return a schema without some of its keys."""
    properties = {key: info for key, info in schema["properties"].items() if key not in keys}
    required = [key for key in schema["required"] if key not in keys]
    return schema | {"properties": properties, "required": required}


def _version(key: str, schema: dict[str, Any]) -> str:
    """Return the line on the key that identifies the kind of a spec and its version."""
    info = schema["properties"][key]
    return f"- `{key}` ({info['const']}, required): {_flat(info['description'])}"


def _types(models: Iterable[type[BaseModel]], level: str = "####") -> list[str]:
    """Return sections for types of elements; the name of a type is the default of its key `type`."""
    return [
        part
        for model in models
        for part in _model(f"{level} `type: {get_args(model.model_fields['type'].annotation)[0]}`", model)
    ]


def _model(heading: str, model: type[BaseModel]) -> list[str]:
    """Return heading, description and keys of a model."""
    return [heading, _described(model), _keys(model.model_json_schema())]


def _item(item: Registered, level: str = "###", heading: str = "") -> list[str]:
    """Return heading, summary, claims and options of a plugin."""
    texts = [(name, text) for name, text in claim_texts(item.plugin.claimed()) if text != "no"]
    claims = "; ".join(name if text == "yes" else f"{name}: {text}" for name, text in texts)
    options = item.plugin.options
    return [
        f"{level} `{heading or f'name: {item.name}'}`",
        f"{item.plugin.summary}" + (f" Claims: {claims}." if claims else ""),
        _keys(options.model_json_schema()) if options.model_fields else "",
    ]


def _described(model: type[BaseModel]) -> str:
    """Return the docstring of a pydantic model with each paragraph joined into one line."""
    text = inspect.cleandoc(model.__doc__ or "").replace("``", "`")
    return "\n\n".join(_flat(block) for block in text.split("\n\n"))


def _keys(schema: dict[str, object], deepest: int = 6) -> str:
    """Return the keys of a mapping as a list."""
    return "\n".join(
        f"- `{name}` ({kind}{default}): {_flat(description)}".rstrip(": ").rstrip()
        for name, kind, default, description in options_in(schema, deepest)
    )


def _flat(text: str) -> str:
    return " ".join(text.replace("``", "`").split())


def _wrapped(lines: Iterable[str]) -> list[str]:
    """Return lines of at most `WIDTH` characters; lines below an item of a list are indented."""
    wrapped = []
    for line in lines:
        indent = "  " if line.startswith("- ") else ""
        keep = line.startswith(("#", "<!--", "  ")) or not line
        wrapped += (
            [line]
            if keep
            else textwrap.wrap(line, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
        )
    return wrapped


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(registry().only("mbdkit")), encoding="utf-8", newline="\n")
