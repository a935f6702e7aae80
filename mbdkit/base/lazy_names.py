"""Names of a package whose modules are imported when a name is first used (PEP 562)."""

from __future__ import annotations

import ast
import importlib
import sys
import warnings
from collections.abc import Callable, Mapping, MutableMapping
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple


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


class LazyModule(ModuleType):
    """A module that is imported when one of its names is first used."""

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module(self.__name__), name)


class Moved(NamedTuple):
    """A name that a door had, or still has, with a warning, until the version `until`.

    `since`: version of mbdkit in which it went or was deprecated. `instead`: what replaces it, as a noun phrase.
    """

    since: str
    instead: str
    until: str = ""


def lazy(
    package: MutableMapping[str, object], homes: Mapping[str, str], moved: Mapping[str, Moved] | None = None
) -> Callable[[str], object]:
    """Return the ``__getattr__`` of a package.

    `package`: the ``globals()`` of the package. `homes`: module of each name. `moved`: names that are gone, or that
    are in `homes` and cause a DeprecationWarning when they are first used.
    """

    def __getattr__(name: str) -> object:  # noqa: N807
        full_name = f"{package['__name__']}.{name}"
        if moved and name in moved and name in homes:
            since, instead, until = moved[name]
            text = f"{full_name} is deprecated since mbdkit {since}, and ends with {until}: use {instead}"
            warnings.warn(text, DeprecationWarning, stacklevel=2)
        elif moved and name in moved:
            gone = f"{full_name} is gone since mbdkit {moved[name].since}: use {moved[name].instead}"
            import dis

            caller = sys._getframe(1)
            is_import = dis.opname[caller.f_code.co_code[caller.f_lasti]] == "IMPORT_FROM"
            raise ImportError(gone) if is_import else AttributeError(gone)  # an import drops words of AttributeError
        if name not in homes:
            raise AttributeError(f"module {package['__name__']!r} has no attribute {name!r}")
        home = homes[name]
        module = None if home == package["__name__"] else import_part(home, full_name)
        is_module = module is None or not hasattr(module, name)
        package[name] = value = import_part(f"{home}.{name}", full_name) if is_module else getattr(module, name)
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


def door(
    package: MutableMapping[str, Any], moved: Mapping[str, Moved] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the ``__getattr__`` and ``__dir__`` of a module whose names are those that it imports for type checkers,
    and set its ``__all__``.

    Each name is thus written once, in the block ``if TYPE_CHECKING`` of the module.

    `package`: the ``globals()`` of the module. `moved`: names that the module had, or will
    lose, for what is said of them.
    """
    homes = homes_of(package["__file__"])
    package["__all__"] = sorted(homes)
    return lazy(package, homes, moved), lambda: sorted(homes)
