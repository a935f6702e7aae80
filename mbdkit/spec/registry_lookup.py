"""Lookup of the options of plugins in a registry, for the validation of elements and for error messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from mbdkit.base.text import listed
from mbdkit.mechanism.law_element import Law
from mbdkit.registry.catalogue import Registry
from mbdkit.registry.item_options import is_of_item, item_of, named_options
from mbdkit.registry.manager import registry
from mbdkit.spec.choices import Choice
from mbdkit.spec.law_options import law_element


@dataclass(frozen=True)
class RegistryLookup:
    """The `PluginLookup` of a registry.

    Parameters
    ----------
    registry
        Function that returns the registry, called only if a law or an option is looked up.
    """

    registry: Callable[[], Registry] = registry

    def law_element(self, name: str) -> type[Law]:
        """Return the element class of the force law with this short or long name."""
        return law_element(self.registry().get("force-law", name))

    def selected_options(self, metadata: Sequence[Any], item: str | int) -> type[BaseModel] | None:
        """Return the options of an item; None unless `metadata` contains a `Choice`."""
        for choice in metadata:
            if isinstance(choice, Choice):
                return next(named_options(known) for known in choice.registry.of_kind(choice.kind) if known.id == item)
        return None

    def owners_of(self, key: str, options: type[BaseModel]) -> str:
        """Return a phrase that names the other items of the same kind with an option `key`; empty if there are none."""
        if not is_of_item(options):
            return ""
        item = item_of(options)
        items = self.registry().of_kind(item.kind)
        others = [f"'{other.name}'" for other in items if key in other.plugin.options.model_fields]
        if not others:
            return ""
        return f"'{key}' belongs to {listed(others, 'and')}, not to the {item.plugin.label()} '{item.name}'"
