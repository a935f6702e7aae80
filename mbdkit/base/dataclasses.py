"""Dataclasses as in the standard library, whose methods, if they are frozen, are generated when they are first used.

`dataclasses.dataclass` compiles six functions for each class, which takes half a millisecond. A short run imports 170
frozen classes, makes instances of half of them, and compares or prints hardly any.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable
from dataclasses import field as field
from dataclasses import fields as fields
from dataclasses import is_dataclass as is_dataclass
from dataclasses import replace as replace
from functools import cache, partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any

#: Attributes that `dataclasses.dataclass` sets, except for methods that compare and print.
_GENERATED = (
    "__init__",
    "__setattr__",
    "__delattr__",
    "__match_args__",
    "__dataclass_fields__",
    "__dataclass_params__",
)

_LOCK = threading.RLock()


class _Later:
    """An attribute of a class that is generated, with others, when one of them is first used."""

    def __init__(self, name: str, generate: Callable[[], None]):
        self.name, self.generate = name, generate

    def __get__(self, instance: object, owner: type) -> Any:
        with _LOCK:
            self.generate()
        return getattr(owner if instance is None else instance, self.name)


def _lazy(cls: Any, *, eq: bool, repr: bool, **options: bool) -> type:  # noqa: A002
    own = vars(cls)
    names = [name for name in _GENERATED if name not in own]

    @cache  # several attributes, or threads, may ask for it
    def generate() -> None:
        for name in names:
            delattr(cls, name)
        dataclasses.dataclass(frozen=True, eq=False, repr=False, **options)(cls)

    @cache
    def values() -> Callable[[object], object]:
        compared = [field.name for field in fields(cls) if field.compare]
        return (
            attrgetter(*compared) if len(compared) > 1 else lambda self: tuple(getattr(self, name) for name in compared)
        )

    def __eq__(self: object, other: object) -> bool:  # noqa: N807
        return values()(self) == values()(other) if other.__class__ is self.__class__ else NotImplemented

    def __hash__(self: object) -> int:  # noqa: N807
        return hash(values()(self))

    def __repr__(self: object) -> str:  # noqa: N807
        shown = (f"{field.name}={getattr(self, field.name)!r}" for field in fields(cls) if field.repr)
        return f"{self.__class__.__qualname__}({', '.join(shown)})"

    methods: dict[str, Any] = {name: _Later(name, generate) for name in names}
    methods |= {"__eq__": __eq__, "__hash__": __hash__} if eq else {}
    methods |= {"__repr__": __repr__} if repr else {}
    for name, method in methods.items():
        if own.get(name) is None:  # also where the class has an `__eq__`, for which Python sets `__hash__` to None
            setattr(cls, name, method)
    return cls  # type: ignore[no-any-return]


if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls=None, /, *, frozen=False, slots=False, eq=True, repr=True, **options):  # noqa: A002
        """Return a dataclass, or its decorator, as the function of the standard library does."""
        if frozen and not slots:
            decorate = partial(_lazy, eq=eq, repr=repr, **options)
        else:
            decorate = dataclasses.dataclass(frozen=frozen, slots=slots, eq=eq, repr=repr, **options)
        return decorate if cls is None else decorate(cls)
