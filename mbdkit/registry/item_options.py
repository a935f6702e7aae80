"""The options of an item as a class of pydantic, with the key that names the item in a spec."""

from __future__ import annotations

import functools
import re
import sys
from contextlib import redirect_stdout
from typing import Annotated, Any, cast

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, WithJsonSchema, create_model

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import PluginError, blaming, in_this_process, with_place
from mbdkit.base.interrupts import is_interrupt
from mbdkit.base.strict_model import STRICT
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.item import Plugin


@functools.cache
def named_options(item: Registered) -> type[BaseModel]:
    """Return the class of the item's options with the additional field for the name of the item.

    The class is strict and frozen even if the class of the plugin is not. Items of other distributions are checked
    when their options are first used.

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
    return _named(item)


@functools.cache
def _named(item: Registered) -> type[BaseModel]:
    base = item.plugin.options
    added = {name: target() for name, target in item.plugin.added.items() if name not in base.model_fields}
    namespace = {"__module__": __name__, "model_config": ConfigDict(**STRICT, title=item.name)}
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


def check_item(item: Registered, *, create: bool = False) -> None:
    """Import and check the objects behind the targets of an item, and its options; raises PluginError.

    `create`: whether an integrator is also created with default options, if these have defaults.
    """
    try:
        with in_this_process(), redirect_stdout(sys.stderr):
            item.plugin.check_targets()
            if isinstance(item.plugin, Plugin):
                named = _named(item)
                named.model_rebuild()  # which names what a type refers to and is missing
                named.model_json_schema()
                if create and item.kind == "integrator":
                    _create_with_defaults(item)
    except BaseException as error:  # a plugin may raise any exception, including SystemExit
        if is_interrupt(error):
            raise
        raise PluginError(str(error) if isinstance(error, PluginError) else with_place(error)) from error


def _create_with_defaults(item: Registered) -> None:
    plugin: Any = item.plugin
    try:
        defaults = create_model("Defaults", __base__=plugin.options)()  # BaseModel itself makes no instances
    except ValidationError:
        return
    with blaming("it cannot be created with its default options"):
        plugin.create(defaults)


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
    return cast(Registered, options.__mbdkit_item__)  # type: ignore[union-attr]


def is_of_item(options: type[BaseModel]) -> bool:
    """Return whether these are the options of a registered item."""
    return hasattr(options, "__mbdkit_item__")
