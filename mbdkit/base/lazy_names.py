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
        home, wanted = homes[name], f"{package['__name__']}.{name}"
        module = None if home == package["__name__"] else import_part(home, wanted)
        is_module = module is None or not hasattr(module, name)
        package[name] = value = import_part(f"{home}.{name}", wanted) if is_module else getattr(module, name)
        return value

    return __getattr__


def door(package: MutableMapping[str, Any]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the ``__getattr__`` and ``__dir__`` of a module whose names are what it imports for type checkers.

    The imports are read from the source, so that each name is written once. The imports of the module in effect, such
    as that of `door`, are no names of the door.

    Parameters
    ----------
    package
        The ``globals()`` of the module. Its first ``if`` statement, ``if TYPE_CHECKING``, has the imports.
    """
    body = ast.parse(Path(package["__file__"]).read_text(encoding="utf-8")).body
    block = next(statement for statement in body if isinstance(statement, ast.If))
    homes = {
        alias.name: str(statement.module)
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }
    return lazy(package, homes), lambda: sorted(homes)
