"""Conversion of pydantic errors about an element to a SpecError with a key path and a suggestion."""

from __future__ import annotations

from typing import Annotated, Any, get_args, get_origin

from pydantic import BaseModel, ValidationError

from mbdkit.errors import SpecError
from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.forces import Force
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.law_element import Law, find_law
from mbdkit.mechanism.mechanism_data import Assembly, MechanismData
from mbdkit.mechanism.pathways import Pathway
from mbdkit.text import did_you_mean, listed


def _members(union: Any) -> dict[str, type[BaseModel]]:
    """Return the models in an annotated union, keyed by the value of their `type`."""
    models = [get_args(one)[0] if get_origin(one) is Annotated else one for one in get_args(get_args(union)[0])]
    return {get_args(model.model_fields["type"].annotation)[0]: model for model in models}


_BY_TYPE = _members(Joint) | _members(Force)
_PATHWAYS = _members(Pathway)


def spec_error(error: ValidationError, prefix: str, root: type[BaseModel]) -> SpecError:
    """Return the first entry of `error` as a SpecError; `root` is the validated model, `prefix` its key path."""
    entries = error.errors(include_url=False)
    # pydantic lists missing keys first, but a key is often missing because it was mistyped.
    first = next((one for one in entries if one["type"] == "extra_forbidden"), entries[0])
    owner, location = _owner(root, list(first["loc"]))
    if first["type"].startswith("union_tag"):
        location.append("type")
    key = prefix
    for part in location:
        key += f"[{part}]" if isinstance(part, int) else "" if part == "[key]" else f".{part}"
    context = first.get("ctx", {})
    last = str(location[-1]) if location else ""
    message = first["msg"]
    match first["type"]:
        case "value_error" if isinstance(inner := context["error"], SpecError):
            return SpecError(inner.message, key=inner.key).located(prefix=key)
        case "extra_forbidden":
            fields = list(owner.model_fields)
            message = f"unknown key '{last}'{did_you_mean(last, fields)}; known: {listed(fields)}"
        case "missing":
            message = f"'{last}' is missing"
        case "union_tag_invalid":
            given, known = str(context["tag"]), [tag.strip("' ") for tag in context["expected_tags"].split(",")]
            message = f"there is no type '{given}'{did_you_mean(given, known)}; known: {listed(known)}"
        case "union_tag_not_found":
            message = "'type' is missing"
        case _:
            message = f"{message[:1].lower()}{message[1:]}, not {first['input']!r}"
    return SpecError(message, key=key)


def _owner(root: type[BaseModel], location: list[int | str]) -> tuple[type[BaseModel], list[int | str]]:
    """Return the model with the last key of `location` as a field, and the location without pydantic's union tag."""
    if root is MechanismData and len(location) > 2:
        kind, _, part = location[:3]
        if kind in ("joints", "forces") and part in _BY_TYPE:
            owner, inside = _owner(_BY_TYPE[str(part)], location[3:])
            return owner, location[:2] + inside
        return Body, location
    if root is Law and location and location[0] not in Law.model_fields:
        owner, inside = find_law(str(location[0])), location[1:]
        if inside[:1] == ["pathway"] and len(inside) > 1 and inside[1] in _PATHWAYS:
            return _PATHWAYS[str(inside[1])], [inside[0], *inside[2:]]
        return owner, inside
    return (Assembly if location[:1] == ["assembly"] else root), location
