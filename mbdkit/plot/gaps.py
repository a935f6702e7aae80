"""The gaps of joints as vectors, worked out from the poses: what an animation magnifies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.plot.drawing_geometry import Drawing, build_mechanism
from mbdkit.plot.shapes import Array

if TYPE_CHECKING:
    from mbdkit.mechanism.mechanism import Mechanism

_SAME = 1e-9  # m: two points of a body that lie closer are one point of its drawing


@dataclass(frozen=True)
class Gaps:
    """By how much the two points of each joint fail to meet.

    Parameters
    ----------
    joints
        Names of the J joints.
    ends
        For each joint the indices, in the drawing's table of points, of its points on its first and second body.
    vectors
        From where the second body's point should be to where it is [m], in the global frame, shape (F, J, 2). Its
        length is the joint's misalignment.
    """

    joints: tuple[str, ...]
    ends: tuple[tuple[int, int], ...]
    vectors: Array

    def largest(self, count: int) -> Gaps:
        """Return the gaps of the `count` joints that come apart the most, in their own order."""
        size = np.nan_to_num(np.hypot(self.vectors[..., 0], self.vectors[..., 1]), nan=np.inf).max(axis=0, initial=0.0)
        kept = sorted(np.argsort(-size, kind="stable")[:count].tolist())
        return Gaps(
            tuple(self.joints[joint] for joint in kept),
            tuple(self.ends[joint] for joint in kept),
            self.vectors[:, kept],
        )


def gaps(spec: Mapping[str, Any], drawing: Drawing, poses: Array) -> Gaps:
    """Return the gaps of the joints of a run; none where its model is not installed. Drivers have no gap to draw.

    Parameters
    ----------
    spec
        The run spec as a plain mapping.
    drawing
        The drawing of its mechanism.
    poses
        x [m], y [m] and angle [rad] of each body, shape (F, B, 3).
    """
    try:
        mechanism = build_mechanism(spec)
    except Exception:  # as in `draw_spec`: a plugin that is missing or broken is no reason to show nothing
        return Gaps((), (), np.zeros((len(poses), 0, 2)))
    if tuple(mechanism.bodies) != drawing.bodies:
        return Gaps((), (), np.zeros((len(poses), 0, 2)))
    return _gaps_of(mechanism, drawing, poses)


def _gaps_of(mechanism: Mechanism, drawing: Drawing, poses: Array) -> Gaps:
    index = {"ground": -1} | {name: number for number, name in enumerate(mechanism.bodies)}
    names, ends, vectors = [], [], []
    for name, joint in mechanism.joints.items():
        if joint.is_driver or joint.points is None:
            continue
        a, b = (index[body] for body in joint.bodies)
        found = [_find(drawing, body, local) for body, local in zip((a, b), joint.points, strict=True)]
        gap = _world(poses, b, joint.points[1]) - _world(poses, a, joint.points[0])
        names.append(name)
        ends.append((found[0], found[1]))
        vectors.append(joint.gap(gap, poses[:, a, 2] if a >= 0 else np.zeros(len(poses))))
    stacked = np.stack(vectors, axis=1) if vectors else np.zeros((len(poses), 0, 2))
    return Gaps(tuple(names), tuple(ends), stacked)


def _find(drawing: Drawing, body: int, local: tuple[float, float]) -> int:
    """Return the index of a body's point in the drawing's table."""
    here = np.flatnonzero(drawing.owner == body)
    nearest = here[np.argmin(np.hypot(*(drawing.local[here] - np.asarray(local)).T))]
    assert np.hypot(*(drawing.local[nearest] - np.asarray(local))) < _SAME
    return int(nearest)


def _world(poses: Array, body: int, local: tuple[float, float]) -> Array:
    """Return a body's point in the global frame [m], shape (F, 2); the drawing's own table is rounded."""
    x, y = local
    if body < 0:
        return np.tile([x, y], (len(poses), 1))
    with np.errstate(invalid="ignore"):  # of a run that failed
        cosine, sine = np.cos(poses[:, body, 2]), np.sin(poses[:, body, 2])
    world: Array = poses[:, body, :2] + np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
    return world
