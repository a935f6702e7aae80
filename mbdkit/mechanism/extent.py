"""The extent of a mechanism at the start, and units in which improbable lengths fit it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_contact.contact import Contact


def smaller_units(length: float, limit: float) -> list[str]:
    """Return those of cm and mm in which a length is at most `limit` metres; if there are none, mm."""
    return [unit for unit, factor in (("cm", 1e-2), ("mm", 1e-3)) if factor * length <= limit] or ["mm"]


def size_if_below(mechanism: Mechanism, limit: float) -> float:
    """Return the size of a mechanism if it may be below `limit`, otherwise a lower bound of the size, which takes less
    time to compute [m].
    """
    centres = [body.position for body in mechanism.bodies.values()]
    least = extent(centres) if centres else 0.0
    if limit <= least:
        return least
    return extent([*centres, *(mechanism.to_global(*one) for one in points_of_elements(mechanism))])


def extent(points: Sequence[tuple[float, float]]) -> float:
    """Return the longer side of the bounding box of points, parallel to the axes [m]."""
    return float(max(max(x) - min(x) for x in zip(*points, strict=True)))


def points_of_elements(mechanism: Mechanism) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield the bodies of the points of all elements, and the points in the frames of these bodies.

    They include the corners of squares around the circles of contacts, but not the shapes of the ground, whose extent
    says nothing about the bodies.
    """
    for elements in mechanism.elements.values():
        for element in elements.values():
            if not isinstance(element, Contact):
                for _, name, point in element.attachments():
                    yield name, point
                continue
            for _, _, name, shape in element.by_body:
                round_shape = shape.circle or shape.hole
                radius = 0.0 if round_shape is None else round_shape.radius
                for _, (x, y) in shape.points() if name != GROUND else ():
                    for side in (-radius, radius):
                        yield name, (x + side, y + side)
