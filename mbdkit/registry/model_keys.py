"""Keys that plugins add to every model, such as `devices`: fields beside the parameters of the model."""

from __future__ import annotations

import functools
from typing import Any, cast

from pydantic import BaseModel, Field, create_model
from pydantic.fields import FieldInfo

from mbdkit.registry.catalogue import Registered
from mbdkit.registry.element_items import ModelKey
from mbdkit.registry.item_options import named_options
from mbdkit.registry.items import ModelPlugin
from mbdkit.registry.manager import registry


def model_keys(item: Registered) -> dict[str, ModelKey]:
    """Return the keys that plugins add to the options of a model, in their order; empty for other items."""
    if not isinstance(item.plugin, ModelPlugin):
        return {}
    model_fields = named_options(item).model_fields
    keys = [cast(ModelKey, known.plugin) for known in registry().of_kind("model-key")]
    return {key.name: key for key in sorted(keys, key=lambda key: key.order) if key.name not in model_fields}


@functools.cache
def options_with_keys(item: Registered, keys: tuple[str, ...] = ()) -> type[BaseModel]:
    """Return the class of the options of an item, see `named_options`; that of a model also has fields for `keys`.

    Other model keys are its `further_keys`, so that only the code of those that are given is imported.
    """
    options = named_options(item)
    if not isinstance(item.plugin, ModelPlugin):
        return options
    own_keys, own_field = (getattr(options, name, None) for name in ("further_keys", "further_field"))
    further = {
        "__module__": __name__,
        "further_keys": staticmethod(lambda: [*(own_keys() if own_keys else ()), *model_keys(item)]),
        "further_field": staticmethod(lambda key: (own_field(key) if own_field else None) or _field(item, key)),
    }
    fields: dict[str, Any] = {key: (field.annotation, field) for key in keys if (field := _field(item, key))}
    base = type("Options", (options,), further)
    extended: type[BaseModel] = create_model(options.__name__, __base__=base, __doc__=options.__doc__, **fields)
    extended.ABSENT_BY_DEFAULT = (*getattr(options, "ABSENT_BY_DEFAULT", ()), *fields)  # type: ignore[attr-defined]
    return extended


def _field(item: Registered, name: str | int) -> FieldInfo | None:
    """Return the field of a model key, whose class is imported; None if there is no such key."""
    if not isinstance(name, str) or (key := model_keys(item).get(name)) is None:
        return None
    values: Any = Field(default_factory=dict, description=key.summary)
    by_name: Any = dict.__class_getitem__((str, key.model()))
    return FieldInfo.from_annotated_attribute(by_name, values)
