"""Names of a package whose modules are imported when a name is first used (PEP 562)."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, MutableMapping
from types import ModuleType
from typing import Any


def import_part(module: str, wanted: str) -> ModuleType:
    """Import a module, which may be of a part of mbdkit that is not installed.

    Raises
    ------
    MissingPartError
        If it is not installed; `wanted` is what needs it.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        from mbdkit.base.errors import MissingPartError

        raise MissingPartError(wanted, package.replace("_", "-")) from None


def lazy(package: MutableMapping[str, Any], homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package.

    Parameters
    ----------
    package
        The ``globals()`` of the package.
    homes
        Module of each name.
    """

    def __getattr__(name: str) -> Any:  # noqa: N807
        if name not in homes:
            raise AttributeError(f"module {package['__name__']!r} has no attribute {name!r}")
        module = import_part(homes[name], f"{package['__name__']}.{name}")
        package[name] = value = getattr(module, name)
        return value

    return __getattr__
