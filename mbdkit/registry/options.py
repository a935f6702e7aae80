"""The options of an item as a spec holds them: with its name among them, and as strict as all of a spec."""

from __future__ import annotations

import functools
import re
from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, WithJsonSchema, create_model

if TYPE_CHECKING:
    from mbdkit.registry.catalogue import Registered

STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


@functools.cache
def named_options(item: Registered) -> type[BaseModel]:
    """Return the item's options with its `name` among them, strict and frozen whatever the plugin's class says."""
    names = dict.fromkeys([item.spec_name, item.name, item.id])
    name = Annotated[
        str,
        AfterValidator(lambda _: item.spec_name),
        WithJsonSchema({"type": "string", "enum": list(names)}),
    ]
    config = ConfigDict(**STRICT, title=item.name)
    options: type[BaseModel] = create_model(
        "".join(word.capitalize() for word in re.split(r"[^A-Za-z0-9]+", f"{item.name} {item.kind}")),
        __base__=type("Options", (item.plugin.options,), {"__module__": __name__, "model_config": config}),
        __doc__=item.plugin.summary,
        name=(name, Field(description=item.plugin.summary)),
    )
    options.__mbdkit_item__ = item  # type: ignore[attr-defined]
    return options


def item_of(options: BaseModel | type[BaseModel]) -> Registered:
    """Return the registered item whose options these are."""
    item: Registered = options.__mbdkit_item__  # type: ignore[union-attr]
    return item


def is_of_item(options: type[BaseModel]) -> bool:
    """Tell whether these are the options of a registered item."""
    return hasattr(options, "__mbdkit_item__")
