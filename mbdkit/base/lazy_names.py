"""Names of a package whose modules are imported when a name is first used (PEP 562)."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Callable, Mapping, MutableMapping
from pathlib import Path
from types import ModuleType
from typing import Any


def import_part(module: str, wanted: str) -> ModuleType:
    """Import a module, which may be of a part of mbdkit that is not installed.

    Raises MissingPartError if it is not installed; `wanted` is what needs it.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        from mbdkit.base.errors import MissingPartError

        raise MissingPartError(wanted, package.replace("_", "-")) from None


def lazy(package: MutableMapping[str, object], homes: Mapping[str, str]) -> Callable[[str], object]:
    """Return the ``__getattr__`` of a package.

    `package`: the ``globals()`` of the package. `homes`: module of each name.
    """

    def __getattr__(name: str) -> object:  # noqa: N807
        if name not in homes:
            raise AttributeError(f"module {package['__name__']!r} has no attribute {name!r}")
        home, wanted = homes[name], f"{package['__name__']}.{name}"
        module = None if home == package["__name__"] else import_part(home, wanted)
        is_module = module is None or not hasattr(module, name)
        package[name] = value = import_part(f"{home}.{name}", wanted) if is_module else getattr(module, name)
        return value

    return __getattr__


def homes_of(file: str | Path) -> dict[str, str]:
    """Return the module of each name of a door, from its source: what its first ``if`` statement imports."""
    body = ast.parse(Path(file).read_text(encoding="utf-8")).body
    block = next(statement for statement in body if isinstance(statement, ast.If))
    return {
        alias.name: str(statement.module)
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }


def door(package: MutableMapping[str, Any]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the ``__getattr__`` and ``__dir__`` of a module whose names are those that it imports for type checkers,
    and set its ``__all__``.

    Each name is thus written once, in the block ``if TYPE_CHECKING`` of the module.

    `package`: the ``globals()`` of the module.
    """
    homes = homes_of(package["__file__"])
    package["__all__"] = sorted(homes)
    return lazy(package, homes), lambda: sorted(homes)
