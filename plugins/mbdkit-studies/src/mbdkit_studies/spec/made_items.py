"""Sequences of points, specs and runs, of which a study may have a million: each item is made when it is needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar, overload

Item = TypeVar("Item")


class MadeItems(Sequence[Item], Generic[Item]):
    """Items that are made on access.

    Parameters
    ----------
    count
        Number of items.
    make
        Function that returns the item with an index, from 0.
    most_kept
        The first items, up to this number, are kept.
    """

    def __init__(self, count: int, make: Callable[[int], Item], most_kept: int = 0):
        self._count, self._make, self._most_kept = count, make, most_kept
        self._kept: dict[int, Item] = {}

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> Item: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Item, ...]: ...

    def __getitem__(self, index: int | slice) -> Item | tuple[Item, ...]:
        if isinstance(index, slice):
            return tuple(self[place] for place in range(*index.indices(self._count)))
        if (place := range(self._count)[index]) in self._kept:
            return self._kept[place]
        item = self._make(place)
        if place < self._most_kept:
            self._kept[place] = item
        return item
