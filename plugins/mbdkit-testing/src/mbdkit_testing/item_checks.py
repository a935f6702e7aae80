"""Items under test, and the check of items of every kind: their functions exist, and are what mbdkit calls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mbdkit.registry.catalogue import Registered, Registry
from mbdkit_testing.check import check
from mbdkit_testing.check_result import Result, passed


@dataclass
class ItemUnderTest:
    """An item of any kind under test.

    Parameters
    ----------
    item
        The item in the registry.
    options
        Its options, as in a spec; empty if it has none.
    installed
        The registry of installed plugins, in which the item is looked up by name.
    """

    item: Registered
    options: dict[str, object]
    installed: Registry

    @property
    def claims(self) -> Mapping[str, object]:
        """Claims of the item by name."""
        return {}


@check("contract.functions")
def functions(under_test: ItemUnderTest) -> Result:
    """Every function that the item names exists, is decorated, and takes and returns what its decorator declares."""
    under_test.item.plugin.check_targets()
    return passed(functions=len(under_test.item.plugin.targets()))


CHECKS = (functions,)
