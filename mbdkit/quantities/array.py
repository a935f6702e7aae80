"""Entries of the table of quantities: arrays of the archive, some of which are computed from the states of a
mechanism.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.frozen import dataclass

if TYPE_CHECKING:
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.quantities.names import ArchiveNames
    from mbdkit.quantities.states import States

FLOAT = "<f8"
INTEGER = "<i8"
TEXT = "utf-8"
MIXED = "mixed"

#: Units along the axis ``coordinate``, by the name of the array with this axis.
COORDINATE_UNITS: Mapping[str, tuple[str, ...]] = {
    "row_units": ("m", "m", "rad"),
    "velocity_row_units": ("m/s", "m/s", "rad/s"),
    "acceleration_row_units": ("m/s^2", "m/s^2", "rad/s^2"),
}

#: Axes that grow during a run: recorded rows, intervals between them, events, impacts, settings of inputs, and samples
#: of controllers in Python.
GROWING = ("time", "interval", "event", "impact", "set/number", "sample")

_XY = slice(0, 2)


@dataclass(frozen=True)
class Array:
    """One array of the archive.

    - `path`: ``group/name`` in the file.
    - `dims`: dimension scales of the axes: names of arrays in the same group.
    - `units`: SI units; ``mixed`` if they vary along an axis, ``1`` for names and counts.
    - `long_name`: description, stored as the attribute ``long_name``.
    - `dtype`: ``<f8``, ``<i8`` or ``utf-8`` (variable-length strings).
    - `row_units`: if `units` is ``mixed``, name of the array in the same group that contains the unit of each entry
      along the last axis.
    - `optional`: whether an archive may lack the array.
    - `components`: names, in tables and expressions, of the numbers along the axis ``axis`` or ``coordinate``; a single
      name replaces the name of the array. By default, a name consists of the name of the array and the name along the
      axis.
    - `about`: descriptions of the first two components and of the third one, if `long_name` describes all three
      together.
    - `texts`: function that returns the values of an array of names or units.
    - `label`: name of the attribute of an object's history that contains the text of the object in this array. The
      texts of two arrays with the same label are combined to a pair.
    """

    path: str
    dims: tuple[str, ...]
    units: str
    long_name: str
    dtype: str = FLOAT
    row_units: str = ""
    optional: bool = False
    components: tuple[str, ...] = ()
    about: tuple[str, ...] = ()
    texts: Callable[[ArchiveNames], Sequence[str]] | None = None
    label: str = ""

    @cached_property
    def group(self) -> str:
        """Name of the array's group."""
        return self.path.partition("/")[0]

    @cached_property
    def name(self) -> str:
        """Name of the array within its group."""
        return self.path.partition("/")[2]

    @cached_property
    def is_scale(self) -> bool:
        """Whether the array is a dimension scale."""
        return self.dims == (self.name,)

    @cached_property
    def grows(self) -> bool:
        """Whether rows are appended during the run."""
        return self.dims[0] in GROWING

    @cached_property
    def key(self) -> str:
        """Key of the rows to append: the path of the array, or ``time`` for the times of all groups."""
        return "time" if self.dims == ("time",) and self.is_scale else self.path


def time_of(states: States) -> np.ndarray:
    """Return the times of states, (T,) [s]."""
    return states.time


@dataclass(frozen=True)
class Recorded(Array):
    """An array with a value for each recorded state, computed from the states of the mechanism.

    - `take`: function that returns the values in T states, with the axes of the array. If the arrays of the states have
      an additional last axis of derivatives, so has the result.
    - `vector`: name, in expressions, of the vector of the first two components; empty for scalars.
    - `has_norm`: whether expressions of events may also contain the name of the vector, which there denotes its norm.
    - `is_not_negative`: whether the values are never negative, so that they cannot cross zero.
    - `accumulates`: whether the value is an integral over time, which is known in the recorded rows only.
    - `is_of_steps`: whether the value is an error of computed states, which is not defined for the motion between them.
    - `no_derivative`: reason why the quantity has no derivatives with respect to parameters; empty if it has
      derivatives. Quantities that redundant joints share never have derivatives.
    - `of_whole`: whether the quantity in expressions is the sum over the elements of a beam; otherwise, it has a value
      in each element.
    - `is_shared`: whether the values are not unique in redundant joints, which the attribute ``not_unique`` lists.
    - `is_history`: whether studies with ``store: histories`` store the array.
    - `charts`: charts of the quantity in reports.
    """

    take: Callable[[States], np.ndarray] = time_of
    vector: str = ""
    has_norm: bool = False
    is_not_negative: bool = False
    accumulates: bool = False
    is_of_steps: bool = False
    no_derivative: str = ""
    of_whole: bool = False
    is_shared: bool = False
    is_history: bool = False
    charts: tuple[Chart, ...] = ()

    @cached_property
    def attributes(self) -> tuple[Attribute, ...]:
        """The quantities in expressions whose values the array contains."""
        if len(self.components) < 2:
            name = self.components[0] if self.components else self.name
            return (Attribute(self, name, None, "" if self.units == MIXED else self.units),)
        units = COORDINATE_UNITS[self.row_units] if self.row_units else (self.units,) * 2
        parts = (Attribute(self, *component) for component in zip(self.components, range(3), units, strict=False))
        return (Attribute(self, self.vector, _XY, units[0]), *parts)


@dataclass(frozen=True)
class Chart:
    """A chart of a report with the values of an array for each element of its kind.

    `name`, `title`, `caption`: name, title and caption of the chart. `axis`: label of the values. `unit`: unit of the
    elements that the chart shows; if empty, there is a chart for each unit.
    """

    name: str
    title: str
    caption: str
    axis: str
    unit: str


@dataclass(frozen=True)
class Attribute:
    """A quantity in expressions, such as ``force_x``: an array, or a part of its last axis.

    `name`: name in expressions. `part`: part of the last axis; None for the whole array. `units`: SI unit; empty if it
    is the unit of the element.
    """

    array: Recorded
    name: str
    part: int | slice | None
    units: str

    @property
    def is_vector(self) -> bool:
        """Whether the quantity has an x and a y component."""
        return isinstance(self.part, slice)

    @property
    def in_events(self) -> bool:
        """Whether the quantity is allowed in expressions of events: it must be a number that is known in every
        state.
        """
        return not self.array.accumulates and (not self.is_vector or self.array.has_norm)


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of objects that have quantities; its arrays are a group of the archive.

    - `arrays`: the arrays in their order.
    - `word`: attribute of `Run` that contains the objects by name, and word for the kind in expressions; empty if there
      is neither.
    - `one`: word for one object, such as ``joint``.
    - `example`: quantity that error messages give as an example; empty if expressions cannot contain the kind.
    - `axis`: name of the axis of the arrays that runs over the objects, or over their elements.
    - `owner`: array with the name of the object of each element along this axis, if an object has several.
    - `is_bare`: whether `word` may be omitted in expressions.
    - `is_chosen`: whether the group can be selected by `output.quantities`.
    - `is_optional`: whether mechanisms may have no object of the kind; archives then lack the group.
    - `may_be_unknown`: whether numbers may be nan.
    - `unit_of`: function that returns the unit of the length or angle of an object, from which the units of its
      quantities follow.
    """

    arrays: tuple[Array, ...]
    word: str = ""
    one: str = ""
    example: str = ""
    axis: str = ""
    owner: str = ""
    is_bare: bool = False
    is_chosen: bool = False
    is_optional: bool = False
    may_be_unknown: bool = False
    unit_of: Callable[[Mechanism, str], str] | None = None

    @property
    def group(self) -> str:
        """Name of the group."""
        return self.arrays[0].group

    @property
    def named_by(self) -> str:
        """Path of the array with the names of the objects."""
        return f"{self.group}/{self.owner or self.axis}"

    @cached_property
    def by_path(self) -> Mapping[str, Array]:
        """The arrays by path."""
        return {array.path: array for array in self.arrays}

    @cached_property
    def names_along(self) -> Mapping[str, Callable[[ArchiveNames], Sequence[str]]]:
        """Functions that return the names along the axes that do not grow, by name of the axis."""
        return {array.name: array.texts for array in self.arrays if array.is_scale and array.texts is not None}

    @cached_property
    def columns(self) -> tuple[Array, ...]:
        """Arrays with the numbers of each object over time."""
        axes = (self.axis,) if self.axis else ()
        return tuple(array for array in self.arrays if array.grows and not array.is_scale and array.dims[1:2] == axes)

    @cached_property
    def labels(self) -> Mapping[str, tuple[Array, ...]]:
        """Arrays with the texts of each object, by their label."""
        labels = dict.fromkeys(array.label for array in self.arrays if array.label)
        return {label: tuple(array for array in self.arrays if array.label == label) for label in labels}

    def index(self, name: str, names: ArchiveNames) -> int | slice:
        """Return the index of an object along the axis, or the indices of its elements."""
        texts = next(array.texts for array in self.arrays if array.path == self.named_by)
        assert texts is not None
        owners = list(texts(names))
        first = owners.index(name)
        return slice(first, first + owners.count(name)) if self.owner else first

    @cached_property
    def attributes(self) -> Mapping[str, Attribute]:
        """Quantities in expressions by name; empty if expressions cannot contain the kind."""
        recorded = (column for column in self.columns if isinstance(column, Recorded))
        return {attribute.name: attribute for array in recorded for attribute in array.attributes if self.example}
