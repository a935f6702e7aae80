"""Conversion of the location of a pydantic error to a key path in the spec."""

from __future__ import annotations

import types
from collections.abc import Sequence
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mbdkit.base.plain_data import Path
from mbdkit.mechanism.law_element import Law, PluginLookup

Model = type[BaseModel]


def walk(location: Sequence[str | int], root: Any, plugins: PluginLookup) -> tuple[Path, Model | None]:
    """Return the key path of a location, without union tags, and the model that contains its last key.

    Parameters
    ----------
    location
        ``loc`` of a pydantic error.
    root
        The model or type that was validated.
    plugins
        Lookup of the models that plugins add.
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
            annotation = _member(members, here, rest, metadata)
        elif annotation is Law and here not in Law.model_fields and isinstance(here, str):
            annotation = plugins.law_element(here)
        elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
            path, owner = (*path, here), annotation
            fields = annotation.model_fields.items()
            field = next((field for name, field in fields if here in (name, field.alias)), None)
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


def _member(members: list[Any], label: str | int, below: Path, metadata: tuple[Any, ...]) -> Any:
    """Return the member of a union that pydantic's label denotes: by tag, by class name, or by the keys below it."""
    tag = next(
        (extra.discriminator for extra in metadata if isinstance(extra, FieldInfo) and extra.discriminator), None
    )
    for member in members:
        bare = get_args(member)[0] if get_origin(member) is Annotated else member
        if isinstance(tag, str) and isinstance(bare, type) and issubclass(bare, BaseModel):
            if label in get_args(bare.model_fields[tag].annotation):
                return member
        elif getattr(member, "__name__", None) == label:
            return member
    return next((member for member in members if below and get_args(member)), None)
