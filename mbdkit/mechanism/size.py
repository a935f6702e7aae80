"""Size of a mechanism: the reference length for the misalignments of its joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base import elementary

if TYPE_CHECKING:
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
