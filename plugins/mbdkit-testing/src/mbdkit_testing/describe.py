"""The output of ``mbdkit plugins``: the registry as JSON values and as text."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, cast

from pydantic import BaseModel

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import PluginError, SpecError
from mbdkit.base.text import did_you_mean, listed, table
from mbdkit.registry.catalogue import KINDS, Kind, Registered, Registry, Report
from mbdkit.registry.item import Plugin
from mbdkit.registry.item_options import named_options
from mbdkit.registry.manager import registry
from mbdkit.registry.policy import FAMILIES
from mbdkit_testing.recorded_evidence import KINDS as KINDS_WITH_EVIDENCE
from mbdkit_testing.recorded_evidence import record_texts, records_of, status_of

Schema = dict[str, Any]
WIDTH = 80
DEEPEST = 6  # largest number of levels of nested options, because the options of a plugin may be recursive


def listing(installed: Registry) -> dict[str, object]:
    """Return ``{"plugins": [...]}`` with id, kind, distribution, version, status, error and evidence of each report."""
    return {"plugins": [_entry(report, installed) for report in _shown(installed)]}


def listing_text(installed: Registry) -> str:
    """Return the listing as a table; the last column is the error or, without an error, the summary of the item."""
    summaries = {(item.kind, item.id): item.plugin.summary for item in installed.items}
    rows = [("ID", "KIND", "VERSION", "STATUS", "EVIDENCE", "")]
    for report in _shown(installed):
        last, entry = report.error or summaries.get((report.kind or "", report.id), ""), _entry(report, installed)
        evidence = str(entry["evidence"]).partition(":")[0] or "-"
        rows.append((report.id, report.kind or "-", report.origin.version, report.status, evidence, last))
    return table(rows)


def find(name: str, installed: Registry | None = None, further: Iterable[Kind] = ()) -> list[Registered]:
    """Return the items with options, and those of `further` kinds, that have a short name or full id, or if there are
    none, the items of other kinds; several may have the same short name.

    Raises SpecError if there is no such item, and PluginError if there is a report that the item with this id could not
    be loaded.
    """
    installed = installed or registry()
    named = [item for item in installed.items if name in (item.id, item.name)]
    for report in installed.failures:
        if report.id == name or (not named and report.id.endswith(f":{name}")):
            raise PluginError(f"plugin '{report.id}' could not be loaded: {report.error}")
    if not named:
        names = [item.name for item in installed.items]
        kinds = [kind for kind, item_class in KINDS.items() if issubclass(item_class, Plugin)]
        listing = listed(list(dict.fromkeys(name for kind in kinds for name in installed.names(kind))))
        raise SpecError(f"there is no plugin '{name}'{did_you_mean(name, names)}; installed: {listing}")
    return [item for item in named if _has_options(item) or item.kind in further] or named


def find_to_verify(name: str, further: Iterable[Kind] = ()) -> list[Registered]:
    """Return the items that a name means, as `find` does, or those of the distribution of that name that are of the
    kinds with evidence or of `further` kinds.
    """
    installed, kinds = registry(), (*KINDS_WITH_EVIDENCE, *further)
    items = [item for item in installed.items if item.origin.distribution == name and item.kind in kinds]
    if items and name not in [item.name for item in items]:
        return [item for item in items if name != MBDKIT or item.kind == "integrator"]
    return find(name, installed, further=["element-kind", "joint-kind"])


def _has_options(item: Registered) -> bool:
    return issubclass(KINDS[item.kind], Plugin)


def details(item: Registered) -> dict[str, object]:
    """Return origin of an item and, if it has options, these (a JSON schema), its claims and its references."""
    shown: dict[str, Any] = {
        "id": item.id,
        "name": item.name,
        "kind": item.kind,
        "summary": item.plugin.summary,
        "distribution": item.origin.distribution,
        "version": item.origin.version,
        "entry_point": item.origin.entry_point,
    }
    if _has_options(item):
        shown |= {"options": named_options(item).model_json_schema(), "references": list(item.plugin.references)}
        if claims := item.plugin.claimed():
            shown["claims"] = dict(claims)
    if status := status_of(item):
        shown["evidence"] = {"status": status, "records": records_of(item)}
    return shown


def page(item: Registered) -> str:
    """Return origin, options, claims and references of an item as text; where to read on if it has no options."""
    lines = [
        f"{item.id} ({item.kind})",
        f"  {item.plugin.summary}",
        f"  from {item.origin.distribution} {item.origin.version}, entry point {item.origin.entry_point}",
    ]
    if status := status_of(item):
        lines += [f"  evidence: {status}", *(f"    {text}" for text in record_texts(item))]
    if item.kind in ("element-kind", "joint-kind"):
        return "\n".join([*lines, "", "Keys of an element:", *_option_lines(cast(Any, item.plugin).model())])
    if not _has_options(item):
        return "\n".join([*lines, f"  has no options; its code and its help: mbdkit plugins where {item.id}"])
    lines += ["", "Options:", *_option_lines(item.plugin.options)]
    if claims := item.plugin.claimed():
        chosen = item.plugin.name_key == "name" and item.plugin.options.model_fields
        lines += ["", "Claims, with these defaults:" if chosen else "Claims:"]
        lines += [f"  {name}: {text}" for name, text in claim_texts(claims)]
    if item.plugin.references:
        lines += ["", "References:", *(textwrap.indent(entry.strip(), "  ") for entry in item.plugin.references)]
    return "\n".join(lines)


def diagnosis(installed: Registry) -> dict[str, object]:
    """Return the listing with the entry point of each item and its loading time [s]."""
    return {
        "plugin_api": {name: family.version for name, family in FAMILIES.items()},
        "plugins": [
            {**_entry(report, installed), "entry_point": report.origin.entry_point, "load_s": round(report.seconds, 6)}
            for report in _shown(installed)
        ],
    }


def diagnosis_text(installed: Registry) -> str:
    """Return the diagnosis as text: a line for each entry point and for each of its items with an error or a clash."""
    reports = _shown(installed)
    lines = []
    for origin in dict.fromkeys(report.origin for report in reports):
        here = [report for report in reports if report.origin == origin]
        where = f"{origin.distribution} {origin.version} ({origin.entry_point})"
        if here[0].status == "disabled":
            lines.append(f"{where}: disabled: {here[0].error}")
            continue
        fine = sum(report.status != "error" for report in here)
        lines.append(f"{where}: {fine} of {len(here)} loaded in {1e3 * here[0].seconds:.0f} ms")
        lines += [f"  {report.id}: {report.status}: {report.error}" for report in here if report.status != "ok"]
        if origin.distribution != MBDKIT:
            known = [(report.id, str(_entry(report, installed)["evidence"])) for report in here]
            lines += [f"  {name}: {text}" for name, text in known if text and not text.startswith("verified")]
    return "\n".join(lines) if lines else "no plugins are installed, not even those of mbdkit; install it again"


def _shown(installed: Registry) -> list[Report]:
    """Return the reports without those on items of mbdkit that specs cannot name, such as its commands."""
    return [
        report
        for report in installed.reports
        if report.origin.distribution != MBDKIT
        or report.status != "ok"
        or report.kind is None
        or issubclass(KINDS[report.kind], Plugin)
    ]


def _entry(report: Report, installed: Registry) -> dict[str, object]:
    items = installed.of_kind(report.kind) if report.kind is not None and report.status != "error" else ()
    return {
        "id": report.id,
        "kind": report.kind,
        "distribution": report.origin.distribution,
        "version": report.origin.version,
        "status": report.status,
        "error": report.error,
        "evidence": next((status_of(item) for item in items if item.id == report.id), ""),
    }


def claim_texts(claims: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return name, in words, and text of each claim; empty claims are omitted."""
    texts = []
    for key, value in claims.items():
        name = {"a_stable": "A-stable", "l_stable": "L-stable"}.get(key, key.replace("_", " "))
        if isinstance(value, bool):
            texts.append((name, "yes" if value else "no"))
        elif isinstance(value, Mapping):  # for example, orders by formulation
            for inner, numbers in value.items():
                shown = [f"{what} {number:g}" for what, number in numbers.items() if number is not None]
                texts.append((f"{name} on {inner}", listed(shown)))
        elif key == "conserves" and value:  # other formulations and stabilizations need not conserve it
            texts.append((name, f"{listed(value, 'and')} on {claims['formulations'][0]} without stabilization"))
        elif value not in (None, "", ()):
            texts.append((name, listed(value) if isinstance(value, tuple) else str(value)))
    return texts


def _option_lines(options: type[BaseModel]) -> list[str]:
    if not options.model_fields:  # pydantic cannot create a schema of BaseModel itself
        return ["  none"]
    schema = options.model_json_schema()
    lines: list[str] = []
    for name, kind, default, description in options_in(schema):
        lines.append(f"  {name}: {kind}{default}")
        lines += textwrap.wrap(description, WIDTH, initial_indent=" " * 6, subsequent_indent=" " * 6)
    return lines


def options_in(schema: Schema, deepest: int = DEEPEST) -> Iterator[tuple[str, str, str, str]]:
    """Yield name, type, default and description of each option in a JSON schema, followed by those nested in it.

    Parameters
    ----------
    schema
        The schema of a mapping, with its definitions.
    deepest
        Largest number of levels of nested options that are included; 0 for none.
    """
    yield from _options(schema, schema.get("$defs", {}), "", deepest)


def _options(schema: Schema, definitions: Schema, prefix: str, deepest: int) -> Iterator[tuple[str, str, str, str]]:
    for name, info in schema.get("properties", {}).items():
        if "const" in info:  # a key with only one value, such as `type`, which is part of the heading
            continue
        inside = _inside(info, definitions)
        default = info.get("default")
        text = "" if default is None or inside else f", default {json.dumps(default)}"
        text = ", required" if name in schema.get("required", ()) else text
        yield prefix + name, _type(info, definitions), text, " ".join(info.get("description", "").split())
        for label, inner in inside if prefix.count(".") < deepest else ():
            yield from _options(inner, definitions, f"{prefix}{name}{label}.", deepest)


def _inside(info: Schema, definitions: Schema) -> list[tuple[str, Schema]]:
    """Return the schemas of the mappings inside an option, each with the suffix to append to its key path."""
    if "$ref" in info:
        target = definitions[info["$ref"].rpartition("/")[2]]
        return [("", target)] if "properties" in target else []
    given = [one for one in info.get("anyOf", ()) if one != {"type": "null"}]
    members = [] if any(_kind(one) == "number" for one in given) else given  # a text beside a mapping is its short form
    if found := [one for member in members for one in _inside(member, definitions)]:
        return found
    choice = info.get("discriminator", {})
    tags: dict[str, list[str]] = {}
    for tag, ref in choice.get("mapping", {}).items():
        tags.setdefault(ref.rpartition("/")[2], []).append(tag)
    if tags:
        key = choice["propertyName"]
        return [(f" ({' | '.join(own)})", _without(definitions[name], key)) for name, own in tags.items()]
    named = info.get("additionalProperties")
    inner = _inside(named, definitions) if isinstance(named, dict) else []
    return [(f".NAME{label}", schema) for label, schema in inner]


def _without(schema: Schema, key: str) -> Schema:
    """Return the schema of a mapping without one of its keys."""
    return schema | {"properties": {name: info for name, info in schema["properties"].items() if name != key}}


def _kind(info: Schema) -> object:
    """Return the type in a schema; for a number that may also be a text with a unit, the type of the number."""
    kind = info.get("type")
    return kind[0] if isinstance(kind, list) else kind


def _type(info: Schema, definitions: Schema) -> str:
    """Return a short name of the type in a schema."""
    if "$ref" in info:
        return _type(definitions[info["$ref"].rpartition("/")[2]], definitions)
    if "const" in info:
        return str(info["const"])
    if "enum" in info:
        return " | ".join(str(value) for value in info["enum"])
    if members := info.get("anyOf") or info.get("oneOf"):
        words = [_type(member, definitions) for member in members]
        return " | ".join(dict.fromkeys(word for word in words if word != "null"))
    match _kind(info):
        case "array" if "prefixItems" in info:
            return f"[{', '.join(_type(item, definitions) for item in info['prefixItems'])}]"
        case "array":
            return f"list of {_type(info.get('items', {}), definitions)}"
        case "object" if isinstance(info.get("additionalProperties"), dict):
            return "mapping by name"
        case "object":
            return "mapping"
        case word:
            shown = {"string": "text", "boolean": "true | false", "integer": "whole number"}
            return shown.get(str(word), str(word or "any"))
