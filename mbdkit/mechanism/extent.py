"""The extent of a mechanism at the start, and units in which improbable lengths fit it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mbdkit.base.traced_numbers import as_float, largest, smallest
from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.mechanism import Mechanism


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
    return extent([*centres, *(mechanism.to_global(*points) for points in points_of_elements(mechanism))])


def extent(points: Sequence[tuple[float, float]]) -> float:
    """Return the longer side of the bounding box of points, parallel to the axes [m]."""
    size: float = as_float(largest([largest(x) - smallest(x) for x in zip(*points, strict=True)]))
    return size


def points_of_elements(mechanism: Mechanism) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield the bodies of the points of all elements, and the points in the frames of these bodies."""
    for elements in mechanism.elements.values():
        for element in elements.values():
            yield from element.extent_points()


def size_at_given_positions(mechanism: Mechanism) -> float:
    """Return the size of a mechanism if its bodies are where the mechanism places them, with the bits of
    `mbdkit.mechanism.size.mechanism_size`.
    """
    ground = Body(mass=1.0, inertia=1.0)
    attachments = [attached for joint in mechanism.joints.values() for attached in joint.attachments()]
    centres = [body.position for body in mechanism.bodies.values()]
    return extent([*centres, *(mechanism.bodies.get(body, ground).to_global(point) for _, body, point in attachments)])
