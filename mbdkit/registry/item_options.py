"""The options of an item as a class of pydantic, with the key that names the item in a spec."""

from __future__ import annotations

import functools
import re
import sys
from contextlib import redirect_stdout
from typing import Annotated, Any, cast

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, WithJsonSchema, create_model
from pydantic.fields import FieldInfo

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import PluginError, in_this_process, with_place
from mbdkit.base.strict_model import STRICT
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.element_items import ModelKey
from mbdkit.registry.item import Plugin
from mbdkit.registry.items import ModelPlugin
from mbdkit.registry.manager import registry


@functools.cache
def named_options(item: Registered, keys: tuple[str, ...] = ()) -> type[BaseModel]:
    """Return the class of the item's options with additional fields, for the name of the item and for model keys.

    The class is strict and frozen even if the class of the plugin is not. Items of other distributions are checked
    when their options are first used.

    `keys`: names of model keys.

    Raises
    ------
    PluginError
        If the item is wrong.
    """
    if item.origin.distribution != MBDKIT:  # built-in items are checked by the tests of mbdkit
        try:
            check_item(item)
        except PluginError as error:
            raise PluginError(f"plugin '{item.id}' cannot be used: {error}") from error
    options = _named(item)
    fields: dict[str, Any] = {key: (field.annotation, field) for key in keys if (field := _field(item, key))}
    if not fields:
        return options
    extended: type[BaseModel] = create_model(options.__name__, __base__=options, __doc__=options.__doc__, **fields)
    extended.ABSENT_BY_DEFAULT = (*getattr(options, "ABSENT_BY_DEFAULT", ()), *fields)  # type: ignore[attr-defined]
    return extended


def model_keys(item: Registered) -> dict[str, ModelKey]:
    """Return the keys that plugins add to the options of a model, in their order; empty for other items."""
    if not isinstance(item.plugin, ModelPlugin):
        return {}
    own = item.plugin.options.model_fields
    keys = [cast(ModelKey, known.plugin) for known in registry().of_kind("model-key")]
    return {key.name: key for key in sorted(keys, key=lambda key: key.order) if key.name not in own}


def _field(item: Registered, name: str) -> FieldInfo | None:
    """Return the field of a model key, whose class is imported; None if there is no such key."""
    if (key := model_keys(item).get(name)) is None:
        return None
    values: Any = Field(default_factory=dict, description=key.summary)
    values_by_name: Any = dict.__class_getitem__((str, key.model()))
    return FieldInfo.from_annotated_attribute(values_by_name, values)


@functools.cache
def _named(item: Registered) -> type[BaseModel]:
    base = item.plugin.options
    added = {name: target() for name, target in item.plugin.added.items() if name not in base.model_fields}
    namespace = {
        "__module__": __name__,
        "model_config": ConfigDict(**STRICT, title=item.name),
        "further_keys": staticmethod(lambda: [*getattr(base, "further_keys", list)(), *model_keys(item)]),
        "further_field": staticmethod(
            lambda name: getattr(base, "further_field", lambda _: None)(name) or _field(item, name)
        ),
    }
    options: type[BaseModel] = create_model(
        class_name(f"{item.name} {item.kind}"),
        __base__=type("Options", (base,), namespace),
        __doc__=item.plugin.summary,
        **{item.plugin.name_key: (name_type(item), Field(description=item.plugin.summary)), **added},  # type: ignore[call-overload]
    )
    options.__mbdkit_item__ = item  # type: ignore[attr-defined]
    if added:
        options.ABSENT_BY_DEFAULT = (*getattr(base, "ABSENT_BY_DEFAULT", ()), *added)  # type: ignore[attr-defined]
    return options


def check_item(item: Registered) -> None:
    """Import and check the objects behind the targets of an item, and its options; raises PluginError."""
    try:
        with in_this_process(), redirect_stdout(sys.stderr):
            item.plugin.check_targets()
            if isinstance(item.plugin, Plugin):
                _named(item).model_json_schema()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a plugin may raise any exception, including SystemExit
        raise PluginError(str(error) if isinstance(error, PluginError) else with_place(error)) from error


def name_type(item: Registered) -> Any:
    """Return the type of the key that names the item in a spec.

    The type accepts any name of the item, and converts it to the canonical one.
    """
    names = dict.fromkeys([item.spec_name, item.name, item.id])
    return Annotated[
        str, AfterValidator(lambda _: item.spec_name), WithJsonSchema({"type": "string", "enum": list(names)})
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
