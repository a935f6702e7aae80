"""The options of an item as a spec holds them: with its name among them, and as strict as all of a spec."""

from __future__ import annotations

import functools
import re
from typing import TYPE_CHECKING, Annotated, Any, cast

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, WithJsonSchema, create_model

from mbdkit.errors import PluginError
from mbdkit.mechanism.law_element import Law
from mbdkit.strict_model import STRICT

if TYPE_CHECKING:
    from mbdkit.registry.catalogue import Registered
    from mbdkit.registry.items import ForceLawPlugin

_TAKEN = (*Law.model_fields, "name", "a", "b", "along", "from_", "to", "points")
"""What an element of type law and `Mechanism.law` have of their own."""


@functools.cache
def named_options(item: Registered) -> type[BaseModel]:
    """Return the item's options with its `name` among them, strict and frozen whatever the plugin's class says.

    Those of a force law are a whole element.
    """
    if item.kind == "force-law":
        return law_element(item)
    name, config = _name(item), ConfigDict(**STRICT, title=item.name)
    options: type[BaseModel] = create_model(
        _class_name(f"{item.name} {item.kind}"),
        __base__=type("Options", (item.plugin.options,), {"__module__": __name__, "model_config": config}),
        __doc__=item.plugin.summary,
        name=(name, Field(description=item.plugin.summary)),
    )
    options.__mbdkit_item__ = item  # type: ignore[attr-defined]
    return options


@functools.cache
def law_element(item: Registered) -> type[Law]:
    """Return the element of type ``law`` for one law: with its options beside its name, strict and frozen."""
    plugin: ForceLawPlugin = item.plugin  # type: ignore[assignment]
    namespace = {
        "__module__": __name__,
        "model_config": ConfigDict(**STRICT, title=item.name, use_attribute_docstrings=False),
        "force_law": plugin.law,
        "law_id": item.id,
        "law_options": plugin.options,
        "__mbdkit_item__": item,
    }
    element: type[BaseModel] = create_model(
        f"{_class_name(item.name)}Law",
        __base__=type("Options", (plugin.options, Law), namespace),
        __doc__=plugin.summary,
        law=(_name(item), Field(description=plugin.summary)),
    )
    return cast("type[Law]", element)


def check_law_options(options: type[BaseModel]) -> None:
    """Raise PluginError where a law's options have names that its element has already."""
    for name, info in options.model_fields.items():
        if name in _TAKEN or info.alias in _TAKEN:
            raise PluginError(f"its option '{name}' has a name that every element of type law uses itself")


def _name(item: Registered) -> Any:
    """Return the type of the key by which a spec names the item."""
    names = dict.fromkeys([item.spec_name, item.name, item.id])
    return Annotated[
        str,
        AfterValidator(lambda _: item.spec_name),
        WithJsonSchema({"type": "string", "enum": list(names)}),
    ]


def _class_name(name: str) -> str:
    return "".join(word.capitalize() for word in re.split(r"[^A-Za-z0-9]+", name))


def item_of(options: BaseModel | type[BaseModel]) -> Registered:
    """Return the registered item whose options these are."""
    item: Registered = options.__mbdkit_item__  # type: ignore[union-attr]
    return item


def is_of_item(options: type[BaseModel]) -> bool:
    """Tell whether these are the options of a registered item."""
    return hasattr(options, "__mbdkit_item__")
