"""Quantities named in expressions, and their values in states."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.quantities.array import Attribute, Kind
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.registered_kinds import kind_of_word
from mbdkit.quantities.states import States


@dataclass(frozen=True)
class Quantity:
    """One quantity of a run, such as ``joints.knee.force_x``.

    `kind`: word of the kind of object in the table of quantities, such as ``joints``. `name`: name of the body, joint,
    ...; empty for ``energy``. `attribute`: name of the quantity in expressions. `element`: element of a beam, from 0;
    None for all elements together.
    """

    kind: str
    name: str
    attribute: str
    element: int | None = None

    def __str__(self) -> str:
        return ".".join(filter(None, (self.kind, self.name, self.attribute)))

    @property
    def of(self) -> Kind:
        """The kind of the quantity in the table of quantities."""
        return kind_of_word(self.kind)

    @property
    def is_over_time(self) -> bool:
        """Whether the quantity has a value in each recorded row; quantities of events have a single value."""
        return self.attribute in self.of.attributes

    @property
    def recorded(self) -> Attribute:
        """The entry of the quantity in the table; quantities of events have none."""
        return self.of.attributes[self.attribute]

    @property
    def is_vector(self) -> bool:
        """Whether it has an x and a y component."""
        return self.is_over_time and self.recorded.is_vector

    @property
    def is_sum(self) -> bool:
        """Whether the value is the sum over all elements of a beam."""
        return bool(self.of.owner) and self.recorded.array.of_whole and self.element is None

    @property
    def beam(self) -> str:
        """Name of the beam if the quantity has a value in each element of it; empty for other quantities."""
        return self.name if self.of.owner and self.element is None and not self.is_sum else ""

    def select(self, own: np.ndarray) -> np.ndarray:
        """Return the values of the quantity from the values (T, ...) of its object in the array.

        Shapes are (T,), (T, 2) for a vector, and (T, elements) along a beam.
        """
        if self.is_sum:
            return np.asarray(np.sum(own, axis=1))
        part = self.recorded.part if self.element is None else self.element
        return own if part is None else own[:, part]

    def taker(self, names: ArchiveNames) -> Callable[[States], np.ndarray]:
        """Return a function that computes the quantity in T states; see `select` for the shape of its values."""
        take = self.recorded.array.take
        if not self.of.axis:
            return take
        index = self.of.index(self.name, names)
        return lambda states: self.select(take(states)[:, index])
