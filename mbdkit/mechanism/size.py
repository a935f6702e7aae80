"""Size of a mechanism, the reference length for misalignments; its extent at the start, and units that fit lengths."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.traced_numbers import as_float, largest, smallest
from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.mechanism import Mechanism


def mechanism_size(mechanism: Mechanism, position: np.ndarray) -> float:
    """Return the longer side of the bounding box, parallel to the axes, of all joint points and centres of mass [m].

    `position`: (B, 3) array: centre of mass x, y [m] and angle [rad] of each of the B bodies, in the order of the
    mechanism.
    """
    return float(mechanism_sizes([mechanism], np.asarray(position, dtype=float)[None])[0])


def mechanism_sizes(mechanisms: Sequence[Mechanism], positions: np.ndarray) -> np.ndarray:
    """Return the sizes of R mechanisms with the same bodies, (R,); see `mechanism_size`.

    `positions`: (R, B, 3) array: the positions of the bodies of each mechanism.
    """
    held = [_joint_points(mechanism) for mechanism in mechanisms]
    bodies = held[0][0]
    if any(other != bodies for other, _ in held):
        return np.array([mechanism_size(*mechanism) for mechanism in zip(mechanisms, positions, strict=True)])
    points = np.array([own for _, own in held]).reshape(len(held), -1, 2)
    poses = np.concatenate([positions, np.zeros((len(positions), 1, 3))], axis=1)  # ground is the last body
    at, x, y = poses[:, bodies], points[..., 0], points[..., 1]
    c, s = elementary.cos(at[..., 2]), elementary.sin(at[..., 2])
    joints = np.stack([at[..., 0] + c * x - s * y, at[..., 1] + s * x + c * y], axis=-1)
    every = np.concatenate([positions[..., :2], joints], axis=1)
    return np.asarray(np.max(np.ptp(every, axis=1), axis=1)) if every.shape[1] else np.zeros(len(held))


def _joint_points(mechanism: Mechanism) -> tuple[list[int], list[tuple[float, float]]]:
    """Return the joint points in the frames of their bodies, and the indices of these bodies, ground last."""
    numbers = {name: number for number, name in enumerate(mechanism.bodies)}
    attachments = [attached for joint in mechanism.joints.values() for attached in joint.attachments()]
    return [numbers.get(name, len(numbers)) for _, name, _ in attachments], [point for *_, point in attachments]


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
    `mechanism_size`.
    """
    ground = Body(mass=1.0, inertia=1.0)
    attachments = [attached for joint in mechanism.joints.values() for attached in joint.attachments()]
    centres = [body.position for body in mechanism.bodies.values()]
    return extent([*centres, *(mechanism.bodies.get(body, ground).to_global(point) for _, body, point in attachments)])
