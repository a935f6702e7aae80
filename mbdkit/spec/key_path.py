"""Conversion of the location of a pydantic error to a key path in the spec."""

from __future__ import annotations

import types
from collections.abc import Sequence
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mbdkit.mechanism.law_element import Law
from mbdkit.registry.catalogue import Registry
from mbdkit.registry.item_options import named_options
from mbdkit.spec.choices import Choice, registry_of
from mbdkit.spec.law_options import law_element
from mbdkit.spec.plain_data import Path

Model = type[BaseModel]


def walk(location: Sequence[str | int], root: Model) -> tuple[Path, Model | None]:
    """Return the key path of a location, without union tags, and the model that contains its last key.

    Parameters
    ----------
    location
        ``loc`` of a pydantic error.
    root
        The model that was validated.
    """
    return _walk(tuple(location), root, (), (), None, registry_of(root))


def _walk(
    location: Path, annotation: Any, metadata: tuple[Any, ...], path: Path, owner: Model | None, installed: Registry
) -> tuple[Path, Model | None]:
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return _walk(location, inner, (*more, *metadata), path, owner, installed)
    if not location:
        return path, owner
    here, below = location[0], location[1:]
    choice = next((extra for extra in metadata if isinstance(extra, Choice)), None)
    if choice is not None:
        chosen = (item for item in choice.registry.of_kind(choice.kind) if item.id == here)
        return _walk(below, named_options(next(chosen)), (), path, owner, installed)
    if get_origin(annotation) in (Union, types.UnionType):
        members = [member for member in get_args(annotation) if member is not type(None)]
        if len(members) == 1:
            return _walk(location, members[0], metadata, path, owner, installed)
        return _walk(below, _member(members, here, below, metadata), (), path, owner, installed)
    if annotation is Law and here not in Law.model_fields and isinstance(here, str):
        return _walk(below, law_element(installed.get("force-law", here)), (), path, owner, installed)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        for name, field in annotation.model_fields.items():
            if here in (name, field.alias):
                return _walk(below, field.annotation, (field, *field.metadata), (*path, here), annotation, installed)
        return (*path, here), annotation
    arguments = get_args(annotation)
    if isinstance(here, int) and arguments:
        item = arguments[here] if here < len(arguments) and arguments[-1] is not ... else arguments[0]
        return _walk(below, item, (), (*path, here), None, installed)
    if len(arguments) == 2:
        return _walk(below[1:] if below[:1] == ("[key]",) else below, arguments[1], (), (*path, here), None, installed)
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
