"""The plane of motion in the laboratory: stated by axes, or found from the motion of the markers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit_biomech.persons.person_sections import PlaneAxes
from mbdkit_biomech.persons.rigid_clusters import Poses, rate_of

#: A motion has no plane if its root mean square velocity across the best one exceeds this share of that along it.
SIDEWAYS = 0.5


@dataclass(frozen=True)
class MotionPlane:
    """The plane of motion."""

    axes: np.ndarray  #: (3, 3) rows: the directions forward, up, and right of the person, in the laboratory.
    is_fitted: bool  #: Whether the plane was found from the motion.
    #: Root mean square horizontal velocity of the segments across the plane, relative to that along the plane.
    sideways: float
    off: float = 0.0  #: Angle between this plane and the one with the least motion across [rad].
    #: Root mean square deviation of the joint centres from their mean distances to the plane [m].
    residual: float = 0.0

    def coordinates(self, points: np.ndarray) -> np.ndarray:
        """Return points or vectors (..., 3) of the laboratory as (forward, up, right)."""
        return np.asarray(np.sum(self.axes * points[..., None, :], axis=-1))

    def reversed(self) -> MotionPlane:
        """Return the plane of a person who faces the other way."""
        return replace(self, axes=self.axes * np.array([[-1.0], [1.0], [-1.0]]))

    def with_residual(self, centers: Sequence[np.ndarray]) -> MotionPlane:
        """Return the plane with the residual of joint centres, (T, 3) each in the laboratory."""
        across = [self.coordinates(points)[:, 2] for points in centers]
        square = [np.nanmean((own - np.nanmean(own)) * (own - np.nanmean(own))) for own in across]
        return replace(self, residual=float(np.sqrt(np.mean(square))))


def plane_of(asked: PlaneAxes | None, poses: Mapping[str, Poses], time: np.ndarray) -> MotionPlane:
    """Return the plane of motion with the axes that are asked for; if they are None, it is found, and
    `MotionPlane.reversed` may be the one in which the person faces forward. Raise SpecError if the axes contradict the
    poses, or the motion has no plane.

    Up is the axis of the laboratory along which the trunk is above the feet. The horizontal direction forward is that
    across which the segments have the least mean square velocity.
    """
    feet = np.mean([np.nanmean(own.position, axis=0) for body, own in poses.items() if body.startswith("foot")], axis=0)
    above = np.nanmean(poses["trunk"].position, axis=0) - feet
    axis = int(np.argmax(np.abs(above)))
    up = np.sign(above[axis]) * np.eye(3)[axis]
    if asked is not None and not np.array_equal(up, direction(asked.up)):
        name = ("-" if above[axis] < 0 else "") + "xyz"[axis]
        raise SpecError(
            f"is {asked.up}, but the trunk is above the feet along {name}; the markers may be in another frame",
            key="motion.plane.up",
        )
    first, second = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
    v = np.concatenate([rate_of(own.position, time) for own in poses.values()])
    v = v[~np.isnan(v[:, 0])]
    a, b = np.sum(v * first, axis=1), np.sum(v * second, axis=1)
    angle = 0.5 * elementary.atan2(2 * float(np.mean(a * b)), float(np.mean(a * a) - np.mean(b * b)))
    best = elementary.cos(angle) * first + elementary.sin(angle) * second
    forward = best if asked is None else direction(asked.forward)
    right = np.cross(forward, up)
    along, across = (float(np.sqrt(np.mean(np.sum(v * axis, axis=1) ** 2))) for axis in (forward, right))
    sideways = across / along if along > 0 else np.inf
    if asked is None and not sideways <= SIDEWAYS:
        how = f"move sideways {sideways:.2g} times as fast as forward (at most {SIDEWAYS:g} times is accepted)"
        raise SpecError(
            f"cannot be found, because the segments {how if np.isfinite(sideways) else 'do not move'}; state it, "
            f"such as {{forward: x, up: {'xyz'[axis]}}}",
            key="motion.plane",
        )
    off = elementary.acos(min(1.0, abs(float(np.sum(best * forward)))))
    return MotionPlane(np.stack([forward, up, right]), asked is None, sideways, off)


def direction(name: str) -> np.ndarray:
    """Return the direction (3,) of an axis of the laboratory, such as -x."""
    return np.asarray((-1.0 if name.startswith("-") else 1.0) * np.eye(3)["xyz".index(name[-1])])
