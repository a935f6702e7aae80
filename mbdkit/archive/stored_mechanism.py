"""The mechanism of a run as plain data in its archive, which is read without the model and the plugins that made it.

Elements are read one by one, so that an element of a kind that this version does not know is left out and named, and
the others are drawn. Options of force laws of plugins are kept as they were written. No other file is opened.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, cast, get_args

from pydantic import ConfigDict, TypeAdapter, ValidationError

from mbdkit.base.errors import ArchiveError, MbdkitError, SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.plain_data import canonical_text, json_data, parse_path, plain
from mbdkit.base.text import listed, shown
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_data import ELEMENTS, Assembly, MechanismData
from mbdkit.mechanism.parameters import parameter_values, with_expressions
from mbdkit.registry.items import ModelPlugin
from mbdkit.registry.manager import registry
from mbdkit.spec.choices import RegistryLookup

_NAMED = 5  # elements that are named in a sentence
_MOST_UNKNOWN = 100
_ASSEMBLY = TypeAdapter(Assembly)
_SECTIONS = ("bodies", "beams", *ELEMENTS)
_LAST_SECTIONS = ("coordinates", "states", "inputs", "controllers")
_OTHERS = frozenset({"name", "title", "gravity", "assembly"})
#: Finds the force laws of mbdkit itself: those of plugins are not called when an archive is read.
_OWN = RegistryLookup(lambda: registry().only("mbdkit"))


@dataclass(frozen=True)
class StoredMechanism:
    """The mechanism of a run, as far as it is known.

    `mechanism`: the mechanism; None if only the bodies are known. `not_drawn`: sentence on what a drawing lacks and
    why; empty if it is complete.
    """

    mechanism: Mechanism | None
    not_drawn: str = ""


class _ForeignLaw:
    """Stands for the force law of a plugin, which cannot be evaluated."""

    states = ()


class PluginLaw(Law):
    """An element with the force law of a plugin: its pathway, and the options as they were written."""

    model_config = ConfigDict(extra="allow")
    force_law = _ForeignLaw()  # type: ignore[assignment]


def mechanism_json(mechanism: Mechanism) -> str:
    """Return a mechanism as the JSON that archives hold: a model `mechanism` with its name, points in the frames of the
    bodies, and numbers in place of expressions.
    """
    return canonical_text({**mechanism.to_spec(), "title": mechanism.name})


def read_mechanism(text: str, bodies: Sequence[str]) -> StoredMechanism:
    """Return the mechanism that an archive holds.

    `text`: as returned by `mechanism_json`. `bodies`: the names of the recorded bodies. Raises ValueError if `text` is
    damaged.
    """
    data = json_data(text)
    kinds = [item.plugin.key_in_model for item in registry().only("mbdkit").of_kind("element-kind")]  # type: ignore[attr-defined]
    foreign = data.keys() - {*_SECTIONS, *kinds, *_LAST_SECTIONS, *_OTHERS}
    known = (*_SECTIONS, *kinds, *_LAST_SECTIONS)
    sections = {section: data.get(section, {}) for section in (*known, *sorted(foreign))}
    if not all(isinstance(elements, dict) for elements in sections.values()):
        raise ValueError("its elements are not a mapping")
    unknown: list[str] = []
    try:
        mechanism = Mechanism(data.get("gravity", (0.0, -9.81)), name=str(data.get("title", "")))
    except SpecError as error:
        raise ValueError(str(error)) from None
    mechanism.assembly = _ASSEMBLY.validate_json(json.dumps(data.get("assembly", {})))
    for section, elements in sections.items():
        for name, value in elements.items():
            try:
                if section in foreign:
                    raise MbdkitError("a plugin may execute any code")
                _add(mechanism, section, name, _element(section, value))
            except (MbdkitError, ValidationError):
                unknown.append(f"{section}.{name}")
    if set(mechanism.bodies) != set(bodies):
        return StoredMechanism(None, "this version of mbdkit does not know all of its bodies, so only points are drawn")
    mechanism.bodies = {name: mechanism.bodies[name] for name in bodies}
    unknown += _without_wrong_references(mechanism)
    names = shown(listed(unknown, most=_NAMED))
    return StoredMechanism(mechanism, f"not drawn, because not known here: {names}" if unknown else "")


def built_mechanism(spec: Mapping[str, Any]) -> StoredMechanism:
    """Return the mechanism of a run that is stored without it.

    Only models of mbdkit itself build it, because those of plugins may read files.

    `spec`: the spec of the run as a plain mapping.
    """
    name = str(spec.get("model", {}).get("name", ""))
    item = next((model for model in registry().only("mbdkit").of_kind("model") if name in (model.name, model.id)), None)
    lacks = "the mechanism of this run is not stored"
    if item is None:
        why = f"{lacks}, and the model '{shown(name)}' is of a plugin, which may read files"
        return StoredMechanism(None, f"only points of bodies are drawn: {why}")
    plugin = cast(ModelPlugin, item.plugin)
    given = {key: value for key, value in plain(spec["model"]).items() if key != "name"}

    def validate(values: object) -> object:
        return plugin.options.model_validate_json(json.dumps(values), context={"plugins": _OWN})

    try:
        numbers = parameter_values(spec.get("parameters"))
        options, _ = with_expressions(validate, given, plugin.options, numbers, prefix="model", plugins=_OWN)
        return StoredMechanism(cast(Mechanism, plugin.build(options)))
    except (MbdkitError, ArithmeticError, RecursionError) as error:
        why = error.message if isinstance(error, SpecError) else str(error)
        return StoredMechanism(None, f"only points of bodies are drawn: {lacks}, and its model cannot be built: {why}")


@cache
def _adapter(section: str) -> TypeAdapter[Any]:
    field = MechanismData.model_fields.get(section) or MechanismData.further_field(section)
    return TypeAdapter(get_args(field.annotation)[1]) if field is not None else TypeAdapter(None)


def _element(section: str, value: object) -> Any:
    text = json.dumps(value)
    try:
        return _adapter(section).validate_json(text, context={"plugins": _OWN})
    except (MbdkitError, ValidationError):
        if section != "forces":
            raise
        return PluginLaw.model_validate_json(text)


def _add(mechanism: Mechanism, section: str, name: str, element: Any) -> None:
    if section == "beams":
        mechanism._add_beam(name, element)
    else:
        getattr(mechanism, section)[name] = element


def _without_wrong_references(mechanism: Mechanism) -> list[str]:
    """Remove the elements that refer to unknown ones, and return their names.

    Raises ArchiveError if there are too many.
    """
    removed: list[str] = []
    while len(removed) < _MOST_UNKNOWN:
        try:
            mechanism.validate()
        except SpecError as error:
            _, section, name, *_ = (*parse_path(error.key), "", "")
            if getattr(mechanism, str(section), {}).pop(name, None) is None:
                break
            removed.append(f"{section}.{name}")
        else:
            return removed
    raise ArchiveError("the mechanism in this archive is damaged, its elements do not fit together")
