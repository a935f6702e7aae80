"""What was used, in words and with references: formulation, models and integrators of one or several specs."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from mbdkit.errors import SpecError
from mbdkit.registry.catalogue import Kind, Registered
from mbdkit.registry.items import Claims, IntegratorPlugin
from mbdkit.registry.manager import registry
from mbdkit.text import listed

_EQUATIONS = (
    "Planar motion in absolute coordinates: x, y and the angle of every body. The equations of motion are solved in "
    "their index-1 form, M q'' + \u03a6_q\u1d40 \u03bb = Q and \u03a6_q q'' = \u03b3, at every evaluation."
)
_UNSTABILIZED = (
    "Nothing pulls the joints back together: they are held at the level of accelerations, so that the errors of the "
    "integration show as misalignment, the distance by which the two points of a joint fail to meet."
)


@dataclass(frozen=True)
class Methods:
    """A methods section: `paragraphs` of text, and `bibtex`, the entries of exactly what was used."""

    paragraphs: tuple[str, ...]
    bibtex: tuple[str, ...]


def methods(specs: Iterable[Mapping[str, Any]]) -> Methods:
    """Return the methods section of some run specs.

    Parameters
    ----------
    specs
        Run specs as plain mappings, each with the names of its model and integrator.
    """
    specs = list(specs)
    paragraphs = [_EQUATIONS, _stabilization(specs)]
    references = [_own_reference()]
    for kind in ("model", "integrator"):
        for options in _distinct(specs, kind):
            item = _find(kind, options["name"])
            if item is None:
                paragraphs.append(f"The {kind} {options['name']} is not installed here, so its references are missing.")
                continue
            paragraphs.append(_sentence(item, options))
            references += item.plugin.references
    return Methods(tuple(dict.fromkeys(paragraphs)), tuple(dict.fromkeys(entry.strip() for entry in references)))


def _distinct(specs: Iterable[Mapping[str, Any]], kind: str) -> list[dict[str, Any]]:
    """Return the different sections of a kind: of models by name alone, of integrators with all their options."""
    found: dict[str, dict[str, Any]] = {}
    for spec in specs:
        section = dict(spec[kind]) if kind == "integrator" else {"name": spec[kind]["name"]}
        found.setdefault(json.dumps(section, sort_keys=True), section)
    return list(found.values())


def _find(kind: Kind, name: str) -> Registered | None:
    try:
        return registry().get(kind, name)
    except SpecError:
        return None


def _sentence(item: Registered, options: Mapping[str, Any]) -> str:
    origin = f"{item.origin.distribution} {item.origin.version}"
    given = [
        f"{key.replace('_', ' ')} {value}" for key, value in options.items() if key != "name" and value is not None
    ]
    settings = f" with {listed(given, 'and')}" if given else ""
    text = f"{item.kind.capitalize()} {item.name} ({origin}){settings}. {item.plugin.summary}"
    return f"{text} {_claims(item.plugin, options)}".strip() if isinstance(item.plugin, IntegratorPlugin) else text


def _claims(plugin: IntegratorPlugin, options: Mapping[str, Any]) -> str:
    """Return what an integrator claims of itself with these options."""
    try:
        values = {key: value for key, value in options.items() if key != "name"}
        claims = plugin.claims(plugin.options.model_validate_json(json.dumps(values)))
    except Exception:  # a plugin of another version may refuse them, or fail in any way
        return ""
    return _claim_words(claims) if isinstance(claims, Claims) else ""


def _claim_words(claims: Claims) -> str:
    told = [f"order {claims.order:g}"] if claims.order is not None else []
    told += [word for word, held in (("symmetric", claims.symmetric), ("symplectic", claims.symplectic)) if held]
    text = f"Here: {listed(told, 'and')}." if told else ""
    return f"{text} Drift: {claims.drift}." if claims.drift else text


def _stabilization(specs: Iterable[Mapping[str, Any]]) -> str:
    names = {_name(spec.get("stabilization") or "none") for spec in specs}
    if names == {"none"}:
        return _UNSTABILIZED
    return f"Stabilization of the constraints: {listed(sorted(names), 'and')}."


def _name(value: Any) -> str:
    return str(value.get("name", "none")) if isinstance(value, Mapping) else str(value)


def _own_reference() -> str:
    from mbdkit import __version__

    return (
        "@software{mbdkit,\n  author = {{The mbdkit authors}},\n  title = {mbdkit: planar multibody dynamics with "
        f"constraints}},\n  version = {{{__version__}}}\n}}"
    )
