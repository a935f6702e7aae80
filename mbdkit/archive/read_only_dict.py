"""A dictionary that cannot be changed, for which IPython completes keys and the attributes of items."""

from __future__ import annotations

from typing import NoReturn, TypeVar

K = TypeVar("K")
V = TypeVar("V")


class ReadOnlyDict(dict[K, V]):
    """A dictionary whose methods that change it raise TypeError.

    IPython completes the attributes of an item, such as ``run.joints["A"].``, only if the type of the mapping has the
    ``__getitem__`` of `dict`.
    """

    def _refuse(self, *args: object, **named: object) -> NoReturn:
        """Raise TypeError."""
        raise TypeError(f"a {type(self).__name__} cannot be changed")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse
