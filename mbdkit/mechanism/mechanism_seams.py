"""What functions of plugins about mechanisms take and return."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Never

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.element_items import ElementKind
from mbdkit.registry.seam import OwnSeam, Seam

#: Bodies and points in their frames [m], in the order in which a line joins them.
Line = Sequence[tuple[str, tuple[float, float]]]


@OwnSeam
def model_builder(options: Never, /) -> Mechanism:
    """Return the mechanism of a model with these options.

    Raises SpecError if no mechanism has these parameters; any other exception counts as a failure of the plugin.
    """
    raise NotImplementedError


@OwnSeam
def model_extension(values: Never, mechanism: Mechanism, /) -> None:
    """Add elements to the mechanism of a model, as a key of the model says: `values` are those of the key by name.

    Raises SpecError, whose key begins with that of the section, such as ``devices.NAME``.
    """
    raise NotImplementedError


@Seam
def mechanism_attribute(mechanism: Mechanism, /) -> object:
    """Return the value of an attribute of a mechanism."""
    raise NotImplementedError


@Seam
def member_names(mechanism: Mechanism, /) -> list[str]:
    """Return the names of the objects of which a mechanism with such elements records quantities."""
    raise NotImplementedError


@Seam
def run_check(mechanism: Mechanism, /) -> None:
    """Raise SpecError for an element of a mechanism, with its `treatments`, that the run does not support."""
    raise NotImplementedError


@OwnSeam
def element_lines(element: Never, mechanism: Mechanism, /) -> Sequence[Line]:
    """Return the lines with which an element is drawn."""
    raise NotImplementedError


def lines_of(kind: ElementKind, mechanism: Mechanism, element: object) -> Sequence[Line]:
    """Return the lines with which an element of a kind is drawn."""
    if kind.draw is not None:
        return element_lines.of(kind.draw)(element, mechanism)
    bodies, ends = getattr(element, "bodies", ()), getattr(element, "ends", ())
    return [list(zip(bodies, ends, strict=True))] if getattr(element, "is_line", False) else []
