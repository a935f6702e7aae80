"""What is understood of an `.osim` file, what cannot change motions and forces, and what else a file contains.

OpenSim publishes no schema. `registry.json` lists its types of components with their properties and default values; it
is printed by ``tests.benchmarks.registry_of_opensim`` from the registry of the Python package `opensim`, whose version
it states.
``understood.yaml`` lists the names that are read, and those that cannot change motions and forces.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import NamedTuple
from xml.etree.ElementTree import Element

import yaml

from mbdkit_opensim.osim_document import flag_of, name_of

_NAMES = yaml.safe_load((files("mbdkit_opensim") / "understood.yaml").read_text("utf-8"))
READ, IGNORED = (
    {kind: frozenset(words.split()) for kind, words in _NAMES[section].items()} for section in ("read", "ignored")
)
#: Sets of a model whose objects `unread_in` does not look at.
SETS = ("ForceSet", "ControllerSet", "ConstraintSet")
IDLE, INERT = (frozenset(_NAMES[section].split()) for section in ("idle", "inert"))


class Unread(NamedTuple):
    """A component, or a property of a component, that is not read.

    `label` says what it is, `name` is the name of the component, and `kind` its type if the component is not read.
    """

    label: str
    name: str
    kind: str = ""


@cache
def registry() -> Mapping[str, Mapping[str, Mapping[str, str]]]:
    """Return the properties and their default values by base class and type; objects are ``:CLASS``."""
    data = json.loads((files("mbdkit_opensim") / "registry.json").read_text("utf-8"))
    return {kind: value for kind, value in data.items() if kind != "source"}


@cache
def defaults_of(kind: str) -> Mapping[str, str]:
    """Return the properties of a type in the registry with their default values; empty if it is not registered."""
    return next((value[kind] for value in registry().values() if kind in value), {})


def is_actuator(kind: str) -> bool:
    """Return whether a type is a muscle, another actuator or a controller, whose forces inverse dynamics computes."""
    return any(kind in registry()[base] for base in ("Actuator", "Muscle", "Controller"))


def is_off(element: Element) -> bool:
    """Return whether a component that may act is switched off."""
    return not all(flag_of(element, tag, default=True) for tag in ("appliesForce", "isEnforced", "enabled"))


def unread_in(element: Element) -> Iterator[Unread]:
    """Yield what is not read of a component of a type in `READ`, and of the objects in its properties."""
    kind, defaults = element.tag, defaults_of(element.tag)
    for part in element:
        tag = part.tag
        if tag in IGNORED[""] | IGNORED.get(kind, frozenset()):
            continue
        if tag in ("components", "ComponentSet"):
            yield from (_component(inner, kind) for inner in _objects(part) if _may_act(inner))
        elif tag in READ[kind]:
            objects = () if tag in SETS else _objects(part)
            yield from (unread for inner in objects if inner.tag in READ for unread in unread_in(inner))
            yield from (_component(inner, tag) for inner in part.iterfind("components/*") if _may_act(inner))
        elif not _is_default(part, defaults.get(tag)):
            yield Unread(f"<{tag}> of {kind}", name_of(element))


def _objects(part: Element) -> Iterator[Element]:
    """Yield the objects in a property, which may be one object, a set, or a list."""
    if part.tag in READ:
        yield part
    else:
        yield from part.iterfind("objects/*" if part.tag.endswith("Set") else "*")


def _component(element: Element, owner: str) -> Unread:
    return Unread(f"{element.tag} in {owner}", name_of(element), element.tag)


def _may_act(component: Element) -> bool:
    """Return whether a component outside of the sets that are read may change motions or forces."""
    return component.tag not in INERT | IDLE and not is_off(component)


def _is_default(part: Element, default: str | None) -> bool:
    """Return whether a property is empty or has its default value."""
    text = (part.text or "").strip()
    if len(part):
        kind = part.tag if default is not None and defaults_of(part.tag) else ""
        return bool(kind) and all(_is_default(inner, defaults_of(kind).get(inner.tag)) for inner in part)
    return not text or (default is not None and _values(text) == _values(default))


def _values(text: str) -> list[float | str]:
    return [_value(word) for word in text.lower().split()]


def _value(word: str) -> float | str:
    try:
        return word if math.isnan(float(word)) else float(word)
    except ValueError:
        return {"true": 1.0, "false": 0.0}.get(word, word)
