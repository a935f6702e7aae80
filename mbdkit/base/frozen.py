"""Frozen dataclasses whose comparison, hash and text are shared instead of being compiled for each class.

They are dataclasses as those of the standard library are. A run makes 200 of them when it starts, and compiling six
functions for each took a tenth of the time of a short command.
"""

from __future__ import annotations

import dataclasses
import reprlib
from collections.abc import Callable
from dataclasses import field as field
from dataclasses import fields as fields
from dataclasses import replace as replace
from functools import cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls: type | None = None, /, **options: Any) -> Any:
        """Return a class as a dataclass; see `dataclasses.dataclass`."""
        if cls is None:
            return lambda cls: dataclass(cls, **options)
        if options.get("frozen") and not options.get("order"):
            own = vars(cls)
            if options.pop("repr", True) and "__repr__" not in own:
                cls.__repr__ = _text
            if options.pop("eq", True):
                cls.__hash__ = own.get("__hash__") or _hash
                cls.__eq__ = own.get("__eq__", _is_equal)
            options |= {"eq": False, "repr": False}
        return dataclasses.dataclass(**options)(cls)


@cache
def _compared(cls: Any) -> Callable[[Any], object]:
    names = [item.name for item in fields(cls) if item.compare]
    return attrgetter(*names) if len(names) > 1 else lambda value: tuple(getattr(value, name) for name in names)


def _is_equal(self: Any, other: object) -> bool:
    values = _compared(self.__class__)
    return values(self) == values(other) if type(other) is type(self) else NotImplemented


def _hash(self: Any) -> int:
    return hash(_compared(self.__class__)(self))


@reprlib.recursive_repr()
def _text(self: Any) -> str:
    parts = ", ".join(f"{item.name}={getattr(self, item.name)!r}" for item in fields(self) if item.repr)
    return f"{type(self).__qualname__}({parts})"
