"""JSON schema of run specs, for editors and other tools, and what the schemas of other specs have in common."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import Any, cast

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from mbdkit.base.units import PERCENT, QUANTITY, described_units
from mbdkit.mechanism.element_kinds import kinds_with_section
from mbdkit.mechanism.law_element import Law
from mbdkit.registry.catalogue import Registry
from mbdkit.registry.feature_items import SpecKind
from mbdkit.registry.manager import registry
from mbdkit.spec.choices import law_element
from mbdkit.spec.model_spec import ModelSpec, choosing_from
from mbdkit.spec.run_spec import RunSpec, with_sections
from mbdkit.spec.spec_kinds import kind_named, spec_kinds, spec_schema

DRAFT = "https://json-schema.org/draft/2020-12/schema"
#: Pattern that distinguishes an expression, or a number with a unit, from a number in quotes.
EXPRESSION = "[-+*/(A-Za-z%]"
LOCAL = "#/$defs/"
HOME = "https://raw.githubusercontent.com/mbdkit/mbdkit/main/schemas/{}.schema.json"


def run_schema(installed: Registry | None = None, spec: type[RunSpec] = RunSpec) -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of the run spec, or of a class derived from it.

    `installed`: registry of the models, integrators and force laws to include; by default, all that are installed.
    """
    schema = model_schema(with_sections(spec, kinds_with_section()), installed)
    schema["required"].remove("integrator")
    return schema | {"anyOf": [{"required": ["integrator"]}, {"required": ["accuracy"]}]}


def schema_of(kind: SpecKind, installed: Registry | None = None) -> dict[str, Any]:
    """Return the JSON schema of a kind of specs."""
    if kind.schema is not None:
        return spec_schema.of(kind.schema)(installed)
    assert kind.model is not None
    return run_schema(installed, cast("type[RunSpec]", kind.model()))


def model_schema(spec: type[ModelSpec], installed: Registry | None) -> dict[str, Any]:
    """Return the schema of a spec with a model, for the plugins of a registry; by default, for all that are
    installed.
    """
    chosen = installed if installed is not None else registry()
    laws = [law_element(item) for item in chosen.of_kind("force-law")]
    models: list[type[BaseModel]] = [choosing_from(chosen, spec), Law, *laws]
    references, whole = models_json_schema([(model, "validation") for model in models])
    definitions = whole["$defs"]
    names = [references[model, "validation"]["$ref"].rpartition("/")[2] for model in models]
    schema = definitions.pop(names[0])
    if laws:  # an element of type law must use one of the installed laws
        definitions[names[1]] = {"oneOf": [{"$ref": f"#/$defs/{name}"} for name in names[2:]]}
    schema = {"$defs": definitions, **schema}
    _allow_expressions(schema)
    return {"$schema": DRAFT, **_described(_allow_units(schema))}


def schema_with_bases(
    spec: type[BaseModel],
    kinds: Mapping[str, str],
    installed: Registry | None,
    *,
    holder: str = "",
    units: Set[str] | None,
) -> dict[str, Any]:
    """Return the schema of a spec whose bases are specs of other kinds.

    `kinds`: kind of the bases by the names of their definitions. `holder`: definition that has a key `base`, too.
    `units`: definitions of which all numbers may have units; None if no number may.
    """
    schema = _described(spec.model_json_schema())
    if units is not None:
        _allow_units(schema, *units)
    schemas = {name: schema_of(kind_named(kind), installed) for name, kind in kinds.items()}
    references = [{"$ref": f"{LOCAL}{name}"} for name in kinds]
    for place in (schema, *([schema["$defs"][holder]] if holder else [])):
        place["properties"]["base"]["anyOf"] = [{"type": "string"}, *references]
    for base in reversed(schemas.values()):
        schema["$defs"] |= base["$defs"]
    for name, base in schemas.items():
        schema["$defs"][name] = {"type": "object", "properties": base["properties"], "additionalProperties": False}
    return {"$schema": DRAFT, **schema}


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


def _allow_units(schema: dict[str, Any], *sections: str) -> dict[str, Any]:
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


def _described(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema whose description ends before the errors that the class raises."""
    return schema | {"description": schema["description"].partition("\n\nRaises")[0]}


def repository_schemas() -> dict[str, str]:
    """Return the texts of the files in the folder ``schemas`` by name: the schemas with only the built-in plugins.

    Definitions that several kinds have in common are in ``definitions.schema.json``, to which the others refer.
    """
    builtin = registry().only("mbdkit")
    schemas = {kind.name: schema_of(kind, builtin) for kind in spec_kinds()}
    shared = _shared_definitions([schema["$defs"] for schema in schemas.values()])
    files = {"definitions": {"$schema": DRAFT, "$defs": shared}}
    for kind, schema in schemas.items():
        local = {name: part for name, part in schema.pop("$defs").items() if name not in shared}
        files[kind] = _redirect_references({"$defs": local, **schema}, shared)
    return {
        f"{name}.schema.json": _text({"$schema": DRAFT, "$id": HOME.format(name), **schema})
        for name, schema in files.items()
    }


def _shared_definitions(of_kinds: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the definitions that several kinds contain and that are the same in all of them, references included."""
    copies: dict[str, list[Any]] = {}
    for definitions in of_kinds:
        for name, part in definitions.items():
            copies.setdefault(name, []).append(part)
    shared = {name: parts[0] for name, parts in copies.items() if len(parts) > 1 and all(p == parts[0] for p in parts)}
    while local := [name for name, part in shared.items() if any(r not in shared for r in _references(part))]:
        for name in local:
            del shared[name]
    return dict(sorted(shared.items()))


def _references(part: object) -> Iterator[str]:
    """Yield the names of the definitions to which a part of a schema refers."""
    if isinstance(part, str) and part.startswith(LOCAL):
        yield part.removeprefix(LOCAL)
    for inner in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        yield from _references(inner)


def _redirect_references(part: Any, shared: Mapping[str, Any]) -> Any:
    """Return a part of a schema whose references to `shared` definitions lead to their file."""
    if isinstance(part, dict):
        return {key: _redirect_references(value, shared) for key, value in part.items()}
    if isinstance(part, list):
        return [_redirect_references(inner, shared) for inner in part]
    if isinstance(part, str) and part.startswith(LOCAL) and part.removeprefix(LOCAL) in shared:
        return f"definitions.schema.json{part}"
    return part


def _text(schema: dict[str, Any]) -> str:
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    for name, text in repository_schemas().items():
        Path(sys.argv[1], name).write_text(text, "utf-8")
