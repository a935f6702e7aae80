"""Objects of a run with named columns, which follow from the table of quantities: the base classes of histories."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import lru_cache
from types import new_class
from typing import Any, Protocol, TypeVar, cast, overload

import numpy as np

from mbdkit.archive.read_only_dict import ReadOnlyDict
from mbdkit.base.errors import MbdkitError, UnknownNameError
from mbdkit.quantities.array import COORDINATE_UNITS, MIXED, Array, Kind, Recorded
from mbdkit.quantities.registered_kinds import added_kinds, array_at, kind_of_group
from mbdkit.registry.element_items import QuantityKind
from mbdkit.registry.manager import use


class NotRecordedError(MbdkitError, KeyError):
    """The requested array was not recorded by the run. `what`: path of the array or name of the group."""

    def __init__(self, what: str):
        why = "`output.quantities` in its spec selects the recorded quantities"
        if (array := array_at(what)) is not None and array.optional:
            why = "its method, stabilization and events do not produce it"
        if what.startswith("accuracy/"):
            why = "`check: true` in its spec, or `--check`, estimates errors"
        super().__init__(f"this run did not record {what}; {why}")

    def __str__(self) -> str:
        return str(self.args[0])


class Source(Protocol):
    """Interface of the run from which histories are read."""

    def array(self, path: str) -> np.ndarray:
        """Return the whole array at `path`."""

    def records(self, path: str) -> bool:
        """Return whether the run recorded the array at `path`."""

    def column(self, path: str, index: int | slice | None, part: slice | int | None) -> np.ndarray:
        """Return the array at `path`, restricted to an `index` of its second axis and a `part` of its third."""

    def text(self, path: str, index: int | slice | None) -> str:
        """Return one of the texts at `path`; empty if the archive lacks them."""

    def objects(self, kind: Kind) -> Sequence[str]:
        """Return the name of the object of each element along the axis of a kind."""

    @property
    def joint_misalignments(self) -> np.ndarray:
        """Largest misalignment of each joint over all steps."""


class Column:
    """A property that returns one column of an array of the archive as a read-only array.

    `part`: index or slice of the array's third axis; None for arrays with two axes. `is_sum`: whether the values are
    summed over the array's second axis. `what`: docstring with shape and unit.
    """

    def __init__(self, array: Array, part: slice | int | None, what: str, *, is_sum: bool = False):
        self.path, self.part, self.is_sum = array.path, part, is_sum
        self.__doc__ = what

    @overload
    def __get__(self, view: None, owner: type) -> Column: ...

    @overload
    def __get__(self, view: View, owner: type) -> np.ndarray: ...

    def __get__(self, view: View | None, owner: type) -> Column | np.ndarray:
        if view is None:
            return self
        values = view.source.column(self.path, view.index, self.part)
        return np.asarray(values.sum(axis=1)) if self.is_sum else values


def columns_of(kind: Kind) -> Iterator[tuple[str, Column]]:
    """Yield the columns of one object of a kind with their names."""
    for array in kind.columns:
        rows = "N" if array.dims[0] == "interval" else "T"
        if array.dims[-1] == "coordinate":
            units = COORDINATE_UNITS[array.row_units]
            point, angle = array.about
            yield array.name, Column(array, slice(0, 2), f"{point}, (T, 2), {units[0]}")
            yield array.components[2], Column(array, 2, f"{angle}, (T,), {units[2]}")
        else:
            unit = "units by row" if array.units == MIXED else array.units
            is_sum = isinstance(array, Recorded) and array.of_whole
            shape = f"({rows}, 2)" if array.dims[-1] == "axis" else f"({rows},)"
            if kind.owner:
                shape = "(T,), summed over the elements" if is_sum else "(T, elements)"
            yield array.name, Column(array, None, f"{array.long_name}, {shape}, {unit}", is_sum=is_sum)


class Label:
    """A property that returns a text about an object, such as its unit; a tuple of texts from several arrays."""

    def __init__(self, arrays: Sequence[Array]):
        self.paths = [array.path for array in arrays]
        self.__doc__ = "; ".join(array.long_name for array in arrays)

    def __get__(self, view: View | None, owner: type) -> Label | str | tuple[str, ...]:
        if view is None:
            return self
        texts = tuple(view.source.text(path, view.index) for path in self.paths)
        return texts if len(texts) > 1 else texts[0]


class View:
    """Base class of histories: the columns of one object of a run, or of a whole group.

    Subclasses have the columns and labels of a kind, which is given by its group or as such;
    `mbdkit.archive.recorded_columns` declares them for type checkers and completion.

    `name`: name of the body, joint or constraint row; empty for a whole group. `index`: index or indices along the
    second axis of the arrays.
    """

    def __init_subclass__(cls, of: str | Kind) -> None:
        kind = kind_of_group(of) if isinstance(of, str) else of
        for name, column in columns_of(kind):
            setattr(cls, name, column)
        for name, arrays in kind.labels.items():
            setattr(cls, name, Label(arrays))
        if isinstance(of, str):
            VIEWS[of] = cls

    def __init__(self, source: Source, name: str = "", index: int | slice | None = None):
        self.source = source
        self.name = name
        self.index = index

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>" if self.name else f"<{type(self).__name__}>"


#: Classes of histories by group; a kind without such a class gets one when it is first read.
VIEWS: dict[str, type[View]] = {}


@lru_cache(maxsize=32)
def view_of(kind: Kind) -> type[View]:
    """Return the class of the histories of a kind."""
    if (item := added_kinds().get(kind.group)) is not None and kind is kind_of_group(kind.group):
        if (history := cast(QuantityKind, item.plugin).history) is not None:
            return cast("type[View]", use(item, history, type))
    elif item is None and kind.group in VIEWS:
        return VIEWS[kind.group]
    return type(f"{kind.one.title().replace(' ', '')}History", (View,), {}, of=kind)


V = TypeVar("V", bound=View)


class Histories(ReadOnlyDict[str, V]):
    """The histories of the objects of one kind by name, in the order of the archive.

    `kind`: kind of the objects, such as bodies or joints.
    """

    def __init__(self, kind: Kind, run: Source):
        self.kind = kind
        owners = list(run.objects(kind))
        counts = Counter(owners)
        make: Any = view_of(kind)
        first, items = 0, []
        for name in dict.fromkeys(owners):
            index = slice(first, first + counts[name]) if kind.owner else first
            items.append((name, make(run, name, index)))
            first += counts[name]
        super().__init__(items)

    def __missing__(self, name: str) -> V:
        raise UnknownNameError(self.kind.one, name, list(self))

    def __repr__(self) -> str:
        few = ", ".join(list(self)[:8])
        return f"<{len(self)} of {self.kind.one}: {few}{', ...' if len(self) > 8 else ''}>"


@lru_cache(maxsize=32)
def histories_of(kind: Kind) -> type[Histories[View]]:
    """Return a class of histories; IPython completes the attributes of an item by the argument of its base class."""
    view = view_of(kind)
    return new_class(view.__name__.removesuffix("History") + "Histories", (Histories[view],))  # type: ignore[valid-type]
