"""A dictionary that cannot be changed, whose keys and items IPython completes."""

from __future__ import annotations

from typing import Any, NoReturn, TypeVar

K = TypeVar("K")
V = TypeVar("V")


class ReadOnlyDict(dict[K, V]):
    """A dictionary whose methods that change it raise TypeError.

    IPython looks into the items of an expression, such as ``run.joints["A"].``, only if its type has the
    ``__getitem__`` of `dict`.
    """

    def _refuse(self, *args: Any, **named: Any) -> NoReturn:
        """Raise TypeError."""
        raise TypeError(f"a {type(self).__name__} cannot be changed")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse
