"""Conversion of pydantic validation errors to readable error messages about a spec or an element."""

from __future__ import annotations

import json
import pathlib
import re
import types
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails
from pydantic_core.core_schema import ErrorType

from mbdkit.base import higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, parse_path, path_text, value_text
from mbdkit.base.strict_model import LaterVersionError, StrictModel, description
from mbdkit.base.text import did_you_mean, listed, message_of, shortened, shown
from mbdkit.expressions.parser import Expression
from mbdkit.mechanism.law_element import Law, PluginLookup

#: What is wanted instead of a wrong value, and in which bounds, by the kind of error of pydantic; and the section of a
#: mechanism and the type of element that a user probably means by a wrong key (without its plural s).
WANTED, BOUNDS, ELEMENTS = json.loads(pathlib.Path(__file__).with_suffix(".json").read_text(encoding="utf-8")).values()
#: Sections of a run spec whose numbers cannot be expressions.
OUTSIDE_MODEL = frozenset({("time",), ("output",), ("limits",), ("integrator",)})
EXPLAINED = 12  #: Largest number of problems that a message explains; further ones are only counted.
PYDANTIC_KINDS = frozenset(get_args(ErrorType))


def spec_error(
    error: ValidationError,
    root: object,
    *,
    prefix: str = "",
    plugins: PluginLookup | None = None,
    written: Mapping[Path, str] | None = None,
    parameters: Collection[str] = (),
) -> SpecError:
    """Convert a pydantic validation error to a SpecError.

    Parameters
    ----------
    error
        The validation error.
    root
        The model or type that was validated.
    prefix
        Key path of the validated value in a spec; empty if the value is a whole spec.
    plugins
        Lookup of the models that plugins add; by default, of the installed plugins.
    written
        Expressions by key path whose values were validated.
    parameters
        Names of the parameters of the spec, which are no keys of its own.

    Returns
    -------
    SpecError
        Error with the key path of the first problem; its message lists the other problems, one per line.
    """
    lookup: PluginLookup = plugins or higher_layers.installed_plugins()
    problems: dict[Path, list[tuple[ErrorDetails, Path, type[BaseModel] | None]]] = {}
    for details in error.errors(include_url=False):
        path, owner = walk(details["loc"], root, lookup)
        if isinstance(later := details.get("ctx", {}).get("error"), LaterVersionError):
            return SpecError(later.message, key=path_text((*parse_path(prefix), *path)))
        problems.setdefault(_place(details, path), []).append((details, path, owner))
    # If no alternative of a union accepts a value, there may also be an error inside the value, which is more specific.
    above = {path[:length] for path in problems for length in range(len(path))}
    # Unknown keys come first, because a mistyped key explains why another key is missing.
    paths = sorted((path for path in problems if path not in above), key=lambda path: not _is_unknown(*problems[path]))
    sentences = []
    # The number is limited, because each explanation takes time, and there may be thousands of problems.
    for path in paths[:EXPLAINED]:
        value = f" (the value of '{written[path]}')" if written and path in written else ""
        complaints = dict.fromkeys(_complaint(*problem, lookup) + value for problem in problems[path])
        if len(path) == 1 and path[0] in parameters and _is_unknown(*problems[path]):
            full = path_text(("parameters", *path))
            complaints = {f"unknown key; the parameter of this name has the key {full}": None}
        sentences.append((path_text((*parse_path(prefix), *path)), _either(list(complaints))))
    (key, message), *others = sentences
    for location, sentence in others:
        message += f"\n  also: {shortened(shown(location))}: {sentence}"
    if len(paths) > EXPLAINED:
        message += f"\n  and {len(paths) - EXPLAINED} more"
    return SpecError(message, key=key)


def _place(details: ErrorDetails, path: Path) -> Path:
    """Return the key path at which a problem is reported."""
    inner = details.get("ctx", {}).get("error")
    if isinstance(inner, SpecError):
        return value_path(path, parse_path(inner.key))
    match details["type"]:
        case "union_tag_not_found" | "union_tag_invalid":
            return (*path, str(details["ctx"]["discriminator"]).strip("'"))
    return path


def _is_unknown(first: tuple[ErrorDetails, Path, type[BaseModel] | None], *others: object) -> bool:
    inner = first[0].get("ctx", {}).get("error")
    return first[0]["type"] == "extra_forbidden" or (
        isinstance(inner, SpecError) and inner.message.startswith("unknown key")
    )


def _as_law(tag: str, plugins: PluginLookup) -> str:
    """Return a hint if the unknown type `tag` of a force element is the name of a force law; otherwise empty."""
    try:
        plugins.law_element(tag)
    except SpecError:
        return ""
    return f", but a force law of this name, which is written `type: law, law: {tag}`"


def _complaint(details: ErrorDetails, path: Path, owner: type[BaseModel] | None, plugins: PluginLookup) -> str:
    kind, given, context = details["type"], details["input"], details.get("ctx", {})
    inner = context.get("error")
    if isinstance(inner, SpecError):
        return inner.message
    match kind:
        case "extra_forbidden":
            if len(path) > 2 and path[-2] in {section for section, _ in ELEMENTS.values()} - {"", path[-3]}:
                return f"'{path[-2]}' is indented too deep, as an element of '{path[-3]}'; indent both alike"
            return _unknown_key(str(path[-1]), owner, plugins)
        case "missing":
            return f"is missing{_purpose(owner, str(path[-1]))}"
        case "union_tag_not_found":
            return "is missing: it selects the kind of element"
        case "union_tag_invalid":
            tags = [tag.strip("' ") for tag in str(context["expected_tags"]).split(",")]
            tags += plugins.joint_types() if "revolute" in tags else []
            key, tag = str(context["discriminator"]).strip("'"), str(context["tag"])
            hint = _as_law(tag, plugins) if "law" in tags else ""
            return f"there is no {key} '{tag}'{hint or did_you_mean(tag, tags)}; known: {listed(tags)}"
        case "literal_error" | "enum":
            values = re.findall(r"'[^']*'|[^',\s]+", str(context["expected"]).replace(" or ", ", "))
            words = [value.strip("'") for value in values] if len(values) > 1 else []
            hint = did_you_mean(given, words) if isinstance(given, str) else ""
            return f"should be {listed(values, 'or')}, not {value_text(given)}{hint}"
        case "too_short" | "too_long" if isinstance(given, list | tuple):
            bound = f"at least {context['min_length']}" if kind == "too_short" else f"at most {context['max_length']}"
            return f"should have {bound} items, not {len(given)}"
        case "value_error" | "assertion_error" if isinstance(inner, Exception):  # raised by options of a plugin
            return message_of(inner) or f"is not valid: {value_text(given)}"
    if kind in WANTED:
        return f"should be {WANTED[kind]}, not {value_text(given)}{_hint(kind, given, path)}"
    if kind in BOUNDS:
        return f"should be {BOUNDS[kind].format(*context.values())}, not {value_text(given)}"
    message = details["msg"]
    if kind in PYDANTIC_KINDS:
        message = f"{message[:1].lower()}{message[1:]}, not {value_text(given)}"
    return message


def value_path(path: Path, key: Path) -> Path:
    """Return the key path of an error that the validator of the value at `path` raised.

    The `key` of the error may be relative to `path`, or absolute.
    """
    return key if path and key[: len(path)] == path else path + key


def _unknown_key(key: str, owner: type[BaseModel] | None, plugins: PluginLookup) -> str:
    if owner is None:
        return "unknown key"
    fields = dict(owner.model_fields)
    known = sorted((info.alias or name for name, info in fields.items()), key=lambda name: name != "name")
    if hasattr(owner, "further_keys"):
        further = [name for name in owner.further_keys() if name not in known]
        after = getattr(owner, "FURTHER_AFTER", "")
        index = known.index(after) + 1 if after in known else len(known)
        known[index:index] = further
        if after and issubclass(owner, StrictModel):  # further keys are sections
            fields |= {name: field for name in further if (field := owner.further_field(name)) is not None}
    message = plugins.owners_of(key, owner) or f"unknown key{did_you_mean(key, known)}"
    for name, info in fields.items():
        section = info.annotation
        if isinstance(section, type) and issubclass(section, BaseModel) and key in section.model_fields:
            message = f"unknown key: '{key}' belongs under '{name}'"
    meant, kind = ELEMENTS.get(key.lower().removesuffix("s"), ("", ""))
    if meant in fields and "bodies" in fields:
        message = f"unknown key; write its elements under '{meant}'{f' with `type: {kind}`' if kind else ''}"
    later = "; a later version may know it" if message == "unknown key" else ""
    return f"{message}; known here: {listed(known)}{later}"


def _purpose(owner: type[BaseModel] | None, key: str) -> str:
    if key in ("mbdkit", "mbdkit_study"):
        return f"; write `{key}: 1`, the version of the spec"
    if owner is None or key not in owner.model_fields:
        return ""
    text = " ".join(description(owner, key).split()).rstrip(".")
    return f": {text[:1].lower()}{text[1:]}" if text else ""


def _hint(kind: str, value: object, path: Path) -> str:
    if not isinstance(value, str) or len(value) > 60 or not kind.startswith(("float", "int")):
        return ""
    if re.fullmatch(r"\s*[-+]?\d+,\d+\s*", value):
        return " (write the decimal comma as a point)"
    if re.fullmatch(r"\s*[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?\s*", value):
        return " (leave out the quotes)"
    only = "only the model of a spec and its motions can have expressions"
    try:
        program = Expression.parse(value).program
    except SpecError:
        has_name = re.search(r"(^|[-+*/(])\s*[A-Za-z_]\w*\s*($|[-+*/)])", value) is not None
        return f" ({only})" if has_name and path[:1] in OUTSIDE_MODEL else ""
    if len(program) == 1 and program[0][0] == "const":
        return f" ({only}: write {program[0][1]!r})"
    return ""


def _either(sentences: list[str]) -> str:
    """Join the messages of the alternatives of a union into one: "should be a or b, not c"."""
    parts = [re.fullmatch(r"should be (.*?)(, not .*)", sentence, re.S) for sentence in sentences]
    if len(parts) < 2 or not all(parts):
        return " or ".join(sentences)
    return f"should be {listed([part[1] for part in parts if part], 'or')}{parts[-1][2] if parts[-1] else ''}"


Model = type[BaseModel]


def walk(location: Sequence[str | int], root: object, plugins: PluginLookup) -> tuple[Path, Model | None]:
    """Return the key path of a location, without union tags, and the model that contains its last key.

    `location`: ``loc`` of a pydantic error. `root`: the model or type that was validated. `plugins`: lookup of the
    models that plugins add.
    """
    rest: Path = tuple(location)
    path: Path = ()
    owner: Model | None = None
    annotation, metadata = root, ()
    while rest:
        arguments = get_args(annotation)
        if get_origin(annotation) is Annotated:
            annotation, metadata = arguments[0], (*arguments[1:], *metadata)
            continue
        is_union = get_origin(annotation) in (Union, types.UnionType)
        members = [member for member in arguments if is_union and member is not type(None)]
        if len(members) == 1:
            annotation = members[0]
            continue
        here, rest = rest[0], rest[1:]
        further: tuple[Any, ...] = ()
        if options := plugins.selected_options(metadata, here):
            annotation = options
        elif members:
            annotation = _member(members, here, rest, metadata) or plugins.joint_class(here)
        elif annotation is Law and here not in Law.model_fields and isinstance(here, str):
            annotation = plugins.law_element(here)
        elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
            path, owner = (*path, here), annotation
            fields = annotation.model_fields.items()
            field = next((field for name, field in fields if here in (name, field.alias)), None)
            if field is None and (further_field := getattr(annotation, "further_field", None)) is not None:
                field = further_field(here)
            if field is None:
                break
            annotation, further = field.annotation, (field, *field.metadata)
        elif isinstance(here, int) and arguments:
            path, owner = (*path, here), None
            annotation = arguments[here if here < len(arguments) and arguments[-1] is not ... else 0]
        elif len(arguments) == 2:
            path, owner = (*path, here), None
            annotation, rest = arguments[1], rest[1:] if rest[:1] == ("[key]",) else rest
        else:
            break
        metadata = further
    return path, owner


def _member(members: list[Any], label: str | int, below: Path, metadata: tuple[object, ...]) -> Any:
    """Return the alternative of a union that a label of pydantic denotes, which is a tag, or the name of a class or
    validator; failing that, the first alternative that can contain the keys `below`.
    """
    tag = next(
        (extra.discriminator for extra in metadata if isinstance(extra, FieldInfo) and extra.discriminator), None
    )
    for member in members:
        bare = get_args(member)[0] if get_origin(member) is Annotated else member
        if isinstance(tag, str) and isinstance(bare, type) and issubclass(bare, BaseModel):
            if label in get_args(bare.model_fields[tag].annotation):
                return member
        elif (name := getattr(member, "__name__", None)) == label:
            return member
        elif isinstance(label, str) and label.startswith("function-") and label.endswith(f", {name}]"):
            return member  # a model with its own validator
    return next((member for member in members if below and get_args(member)), None)
