"""The keys of the schemas of specs, and those that a spec has: texts of a file, a definition in it, and a property."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from referencing import Registry, Resource

FOLDER = Path(__file__).parents[2] / "schemas"
SCHEMAS: dict[str, Any] = {
    path.name: json.loads(path.read_text("utf-8")) for path in sorted(FOLDER.glob("*.schema.json"))
}
REGISTRY: Registry[Any] = Registry().with_resources(
    (schema["$id"], Resource.from_contents(schema)) for schema in SCHEMAS.values()
)
DRAFT = SCHEMAS["run.schema.json"]["$schema"]
KINDS = [name for name in SCHEMAS if name != "definitions.schema.json"]


def schema_of(spec: dict[str, Any]) -> str:
    """Return the file with the schema of a spec."""
    kinds = [kind for kind in ("study", "design", "identify", "predict") if f"mbdkit_{kind}" in spec]
    return f"{[*kinds, 'inverse' if 'motion' in spec else 'run'][0]}.schema.json"


def problems(spec: dict[str, Any]) -> list[str]:
    """Return what contradicts the schema of a spec."""
    validator = Draft202012Validator(SCHEMAS[schema_of(spec)], registry=REGISTRY)
    return [f"{list(error.absolute_path)}: {error.message[:200]}" for error in validator.iter_errors(spec)]


def every_key() -> set[str]:
    """Return the keys of all schemas."""
    return {f"{_name(part)}.{key}" for part in _objects([*SCHEMAS.values()]) for key in part["properties"]}


def keys_of(spec: dict[str, Any]) -> set[str]:
    """Return the keys that a valid spec has."""
    file = schema_of(spec)
    return set(_keys(spec, SCHEMAS[file], file))


@cache
def _homes() -> dict[tuple[str, frozenset[str]], str]:
    """Return the first file with a part of this name and these properties: schemas repeat those of bases."""
    found = {("", frozenset(SCHEMAS[name]["properties"])): name for name in KINDS}
    for name, schema in SCHEMAS.items():
        for part in _objects(schema):
            found.setdefault((_title(part), frozenset(part["properties"])), name)
    return found


def _title(part: dict[str, Any]) -> str:
    """Return the name of a part of a schema that has properties; of an element in line, its type."""
    properties = part["properties"]
    if any(frozenset(properties) == frozenset(SCHEMAS[name]["properties"]) for name in KINDS):
        return ""
    return part.get("title") or properties.get("type", {}).get("const") or "+".join(properties)


def _name(part: dict[str, Any]) -> str:
    title = _title(part)
    return f"{_homes()[title, frozenset(part['properties'])].split('.')[0]}:{title}"


def _objects(part: Any) -> Iterator[dict[str, Any]]:
    """Yield all parts of a schema that have properties."""
    if isinstance(part, dict):
        if isinstance(part.get("properties"), dict) and "type" in part:
            yield part
        for key, inner in part.items():
            for below in inner.values() if key in ("properties", "$defs") and isinstance(inner, dict) else [inner]:
                yield from _objects(below)
    elif isinstance(part, list):
        for inner in part:
            yield from _objects(inner)


@cache
def _validator(text: str, file: str) -> Draft202012Validator:
    part = {"$schema": DRAFT, "$id": f"{SCHEMAS[file]['$id']}.part", **_absolute(json.loads(text), file)}
    return Draft202012Validator(part, registry=REGISTRY)


def _absolute(part: Any, file: str) -> Any:
    if isinstance(part, dict):
        return {
            key: f"{SCHEMAS[file]['$id']}{inner}"
            if key == "$ref" and str(inner).startswith("#")
            else _absolute(inner, file)
            for key, inner in part.items()
        }
    return [_absolute(inner, file) for inner in part] if isinstance(part, list) else part


def _keys(value: Any, part: Any, file: str) -> Iterator[str]:
    """Yield the keys of a value that a part of a schema describes; of alternatives, those that it matches."""
    if not isinstance(part, dict):
        return
    if "$ref" in part:
        other, _, name = part["$ref"].partition("#/$defs/")
        yield from _keys(value, SCHEMAS[other or file]["$defs"][name], other or file)
    for alternative in [*part.get("anyOf", ()), *part.get("oneOf", ()), *part.get("allOf", ())]:
        if _validator(json.dumps(alternative), file).is_valid(value):
            yield from _keys(value, alternative, file)
    if isinstance(value, dict):
        properties = part.get("properties", {})
        for key, inner in value.items():
            if key in properties:
                yield f"{_name(part)}.{key}"
            yield from _keys(inner, properties.get(key, part.get("additionalProperties")), file)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            first = part.get("prefixItems", ())
            yield from _keys(inner, first[index] if index < len(first) else part.get("items"), file)
