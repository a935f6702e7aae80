"""What ``mbdkit plugins`` shows of the registry, as data and as text."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from mbdkit.errors import PluginError, SpecError
from mbdkit.registry.catalogue import KINDS, Registered, Registry, Report
from mbdkit.registry.item_options import named_options
from mbdkit.registry.items import Claims, ForceLawPlugin, IntegratorPlugin, Orders
from mbdkit.registry.manager import registry
from mbdkit.registry.policy import API
from mbdkit.text import did_you_mean, listed, table

Schema = dict[str, Any]
WIDTH = 80
DEEPEST = 6  # a plugin's options may contain themselves


def listing(installed: Registry) -> dict[str, Any]:
    """Return ``{"plugins": [...]}`` with id, kind, distribution, version, status and error of each item and failure."""
    return {"plugins": [_entry(report) for report in installed.reports]}


def listing_text(installed: Registry) -> str:
    """Return the listing as a table, with the summaries of the items and the errors of the failures."""
    summaries = {(item.kind, item.id): item.plugin.summary for item in installed.items}
    rows = [("ID", "KIND", "VERSION", "STATUS", "")]
    for report in installed.reports:
        last = report.error or summaries.get((report.kind or "model", report.id), "")
        rows.append((report.id, report.kind or "-", report.origin.version, report.status, last))
    return table(rows)


def find(name: str, installed: Registry | None = None) -> list[Registered]:
    """Return the items that a name or an id means: one, or several of the same name.

    Raises
    ------
    SpecError
        If there is none.
    PluginError
        If it is one that could not be loaded.
    """
    installed = installed or registry()
    for report in installed.failures:
        if report.id == name:
            raise PluginError(f"plugin '{name}' could not be loaded: {report.error}")
    items = [item for item in installed.items if name in (item.id, item.name)]
    if not items:
        names = list(dict.fromkeys(name for kind in KINDS for name in installed.names(kind)))
        raise SpecError(f"there is no plugin '{name}'{did_you_mean(name, names)}; installed: {listed(names)}")
    return items


def details(item: Registered) -> dict[str, Any]:
    """Return everything about an item: origin, options as a JSON schema, claims, references."""
    shown: dict[str, Any] = {
        "id": item.id,
        "name": item.name,
        "kind": item.kind,
        "summary": item.plugin.summary,
        "distribution": item.origin.distribution,
        "version": item.origin.version,
        "entry_point": item.origin.entry_point,
        "options": named_options(item).model_json_schema(),
        "references": list(item.plugin.references),
    }
    claims = _claims(item)
    if isinstance(item.plugin, ForceLawPlugin):
        shown["claims"] = _law_claims(item.plugin)
    if claims is not None:
        shown["claims"] = {name: getattr(claims, name) for name in Claims.__dataclass_fields__}
        shown["claims"]["orders"] = {name: Orders(*orders)._asdict() for name, orders in claims.orders.items()}
    return shown


def page(item: Registered) -> str:
    """Return everything about an item as text."""
    lines = [
        f"{item.id} ({item.kind})",
        f"  {item.plugin.summary}",
        f"  from {item.origin.distribution} {item.origin.version}, entry point {item.origin.entry_point}",
        "",
        "Options:",
        *_option_lines(item.plugin.options),
    ]
    claims = _claims(item)
    if claims is not None:
        lines += ["", "Claims:" if not item.plugin.options.model_fields else "Claims, with these defaults:"]
        lines += [f"  {name.replace('_', ' ')}: {text}" for name, text in _claim_texts(claims)]
    if isinstance(item.plugin, ForceLawPlugin):
        lines += ["", "Claims:"]
        lines += [f"  {name}: {'yes' if value else 'no'}" for name, value in _law_claims(item.plugin).items()]
    if item.plugin.references:
        lines += ["", "References:", *(textwrap.indent(entry.strip(), "  ") for entry in item.plugin.references)]
    return "\n".join(lines)


def diagnosis(installed: Registry) -> dict[str, Any]:
    """Return the listing with where each item came from and how long its entry point took to load [s]."""
    reports = installed.reports
    return {
        "plugin_api": API,
        "plugins": [
            {**_entry(report), "entry_point": report.origin.entry_point, "load_s": round(report.seconds, 6)}
            for report in reports
        ],
    }


def diagnosis_text(installed: Registry) -> str:
    """Return the diagnosis as text: a line for each entry point, and one for each thing that is wrong."""
    reports = installed.reports
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
    return "\n".join(lines) if lines else "no plugins are installed, not even those of mbdkit; install it again"


def is_sound(installed: Registry) -> bool:
    """Tell whether everything could be loaded."""
    return not installed.failures


def _entry(report: Report) -> dict[str, Any]:
    return {
        "id": report.id,
        "kind": report.kind,
        "distribution": report.origin.distribution,
        "version": report.origin.version,
        "status": report.status,
        "error": report.error,
    }


def _claims(item: Registered) -> Claims | None:
    if not isinstance(item.plugin, IntegratorPlugin):
        return None
    try:
        claims = item.plugin.claims(item.plugin.options())
    except Exception:  # options without defaults have no claims to show, and a plugin may fail in any way
        return None
    return claims if isinstance(claims, Claims) else None


def _law_claims(plugin: ForceLawPlugin) -> dict[str, bool]:
    return {"potential": plugin.law.potential not in (None, False), "passive": plugin.law.passive}


def _claim_texts(claims: Claims) -> list[tuple[str, str]]:
    texts = []
    for name in Claims.__dataclass_fields__:
        value = getattr(claims, name)
        if isinstance(value, bool):
            texts.append((name, "yes" if value else "no"))
        elif name == "orders":
            for formulation, orders in value.items():
                named = Orders(*orders)._asdict().items()
                told = [f"{what} {order:g}" for what, order in named if order is not None]
                texts.append((f"orders on {formulation}", listed(told)))
        elif value not in (None, "", ()):
            texts.append((name, listed(value) if isinstance(value, tuple) else str(value)))
    return texts


def _option_lines(options: type[BaseModel]) -> list[str]:
    schema = options.model_json_schema()
    lines: list[str] = []
    for name, kind, default, description in _options(schema, schema.get("$defs", {}), ""):
        lines.append(f"  {name}: {kind}{default}")
        lines += textwrap.wrap(description, WIDTH, initial_indent=" " * 6, subsequent_indent=" " * 6)
    return lines or ["  none"]


def _options(schema: Schema, definitions: Schema, prefix: str) -> Iterator[tuple[str, str, str, str]]:
    """Give name, type, default and description of each option, and after it of the options inside it."""
    for name, info in schema.get("properties", {}).items():
        if "const" in info:  # the type of an element, which is in its name here
            continue
        inside = _inside(info, definitions)
        default = info.get("default")
        text = "" if default is None or inside else f", default {json.dumps(default)}"
        text = ", required" if name in schema.get("required", ()) else text
        yield prefix + name, _type(info, definitions), text, " ".join(info.get("description", "").split())
        for label, inner in inside if prefix.count(".") < DEEPEST else ():
            yield from _options(inner, definitions, f"{prefix}{name}{label}.")


def _inside(info: Schema, definitions: Schema) -> list[tuple[str, Schema]]:
    """Return the schemas of mappings that an option holds, each with how a key path goes on to it."""
    if "$ref" in info:
        target = definitions[info["$ref"].rpartition("/")[2]]
        return [("", target)] if "properties" in target else []
    tags = info.get("discriminator", {}).get("mapping", {})
    if tags:
        return [(f" ({tag})", definitions[ref.rpartition("/")[2]]) for tag, ref in tags.items()]
    members = info.get("additionalProperties")
    if not isinstance(members, dict):
        return []
    return [(f".NAME{label}", inner) for label, inner in _inside(members, definitions)]


def _type(info: Schema, definitions: Schema) -> str:
    """Return the type in a schema in a few words."""
    if "$ref" in info:
        return _type(definitions[info["$ref"].rpartition("/")[2]], definitions)
    if "enum" in info:
        return " | ".join(str(value) for value in info["enum"])
    members = info.get("anyOf") or info.get("oneOf")
    if members:
        words = [_type(member, definitions) for member in members]
        return " | ".join(dict.fromkeys(word for word in words if word != "null"))
    match info.get("type"):
        case "array" if "prefixItems" in info:
            return f"[{', '.join(_type(item, definitions) for item in info['prefixItems'])}]"
        case "array":
            return f"list of {_type(info.get('items', {}), definitions)}"
        case "object" if isinstance(info.get("additionalProperties"), dict):
            return "mapping by name"
        case "object":
            return "mapping"
        case word:
            return {"string": "text", "boolean": "true | false", "integer": "whole number"}.get(
                str(word), str(word or "any")
            )
