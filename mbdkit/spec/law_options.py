"""Classes of force elements: one for each installed force law, with the options of the law as fields."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, cast

from pydantic import BaseModel, ConfigDict, Field, create_model

from mbdkit.base.strict_model import STRICT
from mbdkit.mechanism.law_element import Law
from mbdkit.registry.item_options import class_name, name_type

if TYPE_CHECKING:
    from mbdkit.registry.catalogue import Registered
    from mbdkit.registry.items import ForceLawPlugin


@functools.cache
def law_element(item: Registered) -> type[Law]:
    """Return the strict, frozen class of elements of type ``law`` for one force law, with its options as fields."""
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
        f"{class_name(item.name)}Law",
        __base__=type("Options", (plugin.options, Law), namespace),
        __doc__=plugin.summary,
        law=(name_type(item), Field(description=plugin.summary)),
    )
    return cast("type[Law]", element)
