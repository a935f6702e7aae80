"""The check of items of every kind: the functions that they name exist, and are what mbdkit calls."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from mbdkit.plugin.specs import Registered, Registry
from mbdkit_testing.check import check
from mbdkit_testing.check_result import Result, passed


@dataclass
class ItemUnderTest:
    """An item of any kind, which has no `options`."""

    item: Registered
    options: dict[str, Any]
    installed: Registry
    claims: dict[str, Any] = field(default_factory=dict)


@check("contract.functions")
def functions(under_test: Any) -> Result:
    """Every function that the item names exists, is decorated, and takes and returns what its decorator declares."""
    under_test.item.plugin.check_targets()
    return passed(functions=len(under_test.item.plugin.targets()))


CHECKS = (functions,)
