"""The options of an item as in a spec: strictly validated, and including its name."""

from __future__ import annotations

import functools
import re
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, WithJsonSchema, create_model

from mbdkit.base.strict_model import STRICT

if TYPE_CHECKING:
    from mbdkit.registry.catalogue import Registered


@functools.cache
def named_options(item: Registered) -> type[BaseModel]:
    """Return the class of the item's options including its name; strict and frozen even if the plugin's class is
    not.
    """
    options: type[BaseModel] = create_model(
        class_name(f"{item.name} {item.kind}"),
        __base__=type(
            "Options",
            (item.plugin.options,),
            {"__module__": __name__, "model_config": ConfigDict(**STRICT, title=item.name)},
        ),
        __doc__=item.plugin.summary,
        **{item.plugin.name_key: (name_type(item), Field(description=item.plugin.summary))},  # type: ignore[call-overload]
    )
    options.__mbdkit_item__ = item  # type: ignore[attr-defined]
    return options


def name_type(item: Registered) -> Any:
    """Return the type of the key that names the item in a spec; it accepts any of its names and converts them to the
    canonical one.
    """
    names = dict.fromkeys([item.spec_name, item.name, item.id])
    return Annotated[
        str,
        AfterValidator(lambda _: item.spec_name),
        WithJsonSchema({"type": "string", "enum": list(names)}),
    ]


def class_name(name: str) -> str:
    """Return a name in CamelCase."""
    return "".join(word.capitalize() for word in re.split(r"[^A-Za-z0-9]+", name))


def item_of(options: BaseModel | type[BaseModel]) -> Registered:
    """Return the registered item whose options these are."""
    item: Registered = options.__mbdkit_item__  # type: ignore[union-attr]
    return item


def is_of_item(options: type[BaseModel]) -> bool:
    """Return whether these are the options of a registered item."""
    return hasattr(options, "__mbdkit_item__")
