"""JSON schema of run specs, for editors and other tools, and what the schemas of other specs have in common."""

from __future__ import annotations

import json
import sys
from typing import Any, cast

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from mbdkit.base.units import PERCENT, QUANTITY, described_units
from mbdkit.mechanism.law_element import Law
from mbdkit.registry.catalogue import Registry
from mbdkit.registry.feature_items import SpecKind
from mbdkit.registry.manager import registry
from mbdkit.spec.choices import law_element
from mbdkit.spec.run_spec import RunSpec, spec_type
from mbdkit.spec.spec_kinds import kind_named, spec_schema

DRAFT = "https://json-schema.org/draft/2020-12/schema"
EXPRESSION = "[-+*/(A-Za-z%]"
"""Pattern that distinguishes an expression, or a number with a unit, from a number in quotes."""
HOME = "https://raw.githubusercontent.com/mbdkit/mbdkit/main/schemas/{}.schema.json"


def run_schema(installed: Registry | None = None, spec: type[RunSpec] = RunSpec) -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of the run spec, or of a class derived from it.

    `installed`: registry of the models, integrators and force laws to include; by default, all that are installed.
    """
    chosen = installed if installed is not None else registry()
    schema = model_schema(spec_type(chosen, spec), chosen)
    schema["required"].remove("integrator")
    schema["anyOf"] = [{"required": ["integrator"]}, {"required": ["accuracy"]}]
    return {"$schema": DRAFT, **described(schema)}


def schema_of(kind: SpecKind, installed: Registry | None = None) -> dict[str, Any]:
    """Return the JSON schema of a kind of specs."""
    if kind.schema is not None:
        return spec_schema.of(kind.schema)(installed)
    assert kind.model is not None
    return run_schema(installed, cast("type[RunSpec]", kind.model()))


def model_schema(spec: type[BaseModel], chosen: Registry) -> dict[str, Any]:
    """Return the schema of a spec with a model."""
    laws = [law_element(item) for item in chosen.of_kind("force-law")]
    models: list[type[BaseModel]] = [spec, Law, *laws]
    references, whole = models_json_schema([(model, "validation") for model in models])
    definitions = whole["$defs"]
    names = [references[model, "validation"]["$ref"].rpartition("/")[2] for model in models]
    schema = definitions.pop(names[0])
    if laws:  # an element of type law must use one of the installed laws
        definitions[names[1]] = {"oneOf": [{"$ref": f"#/$defs/{name}"} for name in names[2:]]}
    schema = {"$defs": definitions, **schema}
    _allow_expressions(schema)
    return allow_units(schema)


def _allow_expressions(schema: dict[str, Any]) -> None:
    """Allow expressions for all numbers of the model in a schema of run specs; limits apply to plain numbers only."""
    definitions = schema["$defs"]
    reached: set[str] = set()
    pending: list[Any] = [schema["properties"]["model"]]
    while pending:
        part = pending.pop()
        if isinstance(part, list):
            pending += part
            continue
        if not isinstance(part, dict):
            continue
        name = part.get("$ref", "").rpartition("/")[2] if isinstance(part.get("$ref"), str) else ""
        if name and name not in reached:
            reached.add(name)
            pending.append(definitions[name])
        if part.get("type") in ("number", "integer"):
            part |= {"type": [part["type"], "string"], "pattern": EXPRESSION}
        pending += part.values()


def allow_units(schema: dict[str, Any], *sections: str) -> dict[str, Any]:
    """Allow units for numbers of keys whose descriptions name a unit, and for all numbers of the classes of sections
    with the names `sections`; allow % for all other numbers.
    """
    for name, part in [("", schema), *schema.get("$defs", {}).items()]:
        for info in part.get("properties", {}).values():
            has_unit = name in sections or described_units(info.get("description", ""))
            _allow_text(info, QUANTITY if has_unit else PERCENT)
    return schema


def _allow_text(part: object, pattern: str) -> None:
    """Allow texts that match a pattern for the numbers in a part of a schema."""
    if isinstance(part, dict) and {"type": "string"} in part.get("anyOf", ()):
        return  # any text is already allowed
    if isinstance(part, dict) and part.get("type") == "number":
        part |= {"type": ["number", "string"], "pattern": pattern}
    for inner in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        _allow_text(inner, pattern)


def described(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema whose description ends before the errors that the class raises."""
    return schema | {"description": schema["description"].partition("\n\nRaises")[0]}


def builtin_schema_text(kind: str) -> str:
    """Return the text of ``schemas/KIND.schema.json``: the schema with only the built-in plugins."""
    schema = schema_of(kind_named(kind), registry().only("mbdkit"))
    home = HOME.format(kind)
    return json.dumps({"$schema": schema.pop("$schema"), "$id": home, **schema}, indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    print(builtin_schema_text(sys.argv[1]), end="")
