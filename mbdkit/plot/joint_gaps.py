"""Gaps of the joints as vectors, computed from poses, for an animation to magnify."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.plot.drawing_geometry import Drawing, build_mechanism
from mbdkit.plot.plane_geometry import Array

if TYPE_CHECKING:
    from mbdkit.mechanism.mechanism import Mechanism

_SAME = 1e-9  # m: closer points of a body are one point of its drawing


@dataclass(frozen=True)
class Gaps:
    """Gaps of the joints over F frames.

    Parameters
    ----------
    ends
        For each joint the indices, in the drawing's table of points, of its points on its first and second body.
    vectors
        Vector from the required to the actual position of the second body's point [m], in the global frame, shape
        (F, J, 2). Its length is the misalignment of the joint.
    """

    joints: tuple[str, ...]
    ends: tuple[tuple[int, int], ...]
    vectors: Array

    def largest(self, count: int) -> Gaps:
        """Return the `count` largest gaps, in the order of the joints."""
        size = np.nan_to_num(np.hypot(self.vectors[..., 0], self.vectors[..., 1]), nan=np.inf).max(axis=0, initial=0.0)
        kept = sorted(np.argsort(-size, kind="stable")[:count].tolist())
        return Gaps(
            tuple(self.joints[joint] for joint in kept),
            tuple(self.ends[joint] for joint in kept),
            self.vectors[:, kept],
        )


def gaps(spec: Mapping[str, Any], drawing: Drawing, poses: Array) -> Gaps:
    """Return the gaps of the joints of a run, drivers excepted; none if the model is not installed.

    Parameters
    ----------
    spec
        The run spec as a plain mapping.
    poses
        x [m], y [m] and angle [rad] of each body, shape (F, B, 3).
    """
    try:
        mechanism = build_mechanism(spec)
    except (Exception, SystemExit):  # as in `draw_spec`: a missing or broken plugin must not prevent a picture
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
        angles = [poses[:, body, 2] if body >= 0 else np.zeros(len(poses)) for body in (a, b)]
        vectors.append(joint.gap(gap, np.stack(angles, axis=-1)))
    stacked = np.stack(vectors, axis=1) if vectors else np.zeros((len(poses), 0, 2))
    return Gaps(tuple(names), tuple(ends), stacked)


def _find(drawing: Drawing, body: int, local: tuple[float, float]) -> int:
    """Return the index of a body's point in the drawing's table."""
    here = np.flatnonzero(drawing.owner == body)
    nearest = here[np.argmin(np.hypot(*(drawing.local[here] - np.asarray(local)).T))]
    assert np.hypot(*(drawing.local[nearest] - np.asarray(local))) < _SAME
    return int(nearest)


def _world(poses: Array, body: int, local: tuple[float, float]) -> Array:
    """Return a point of a body in the global frame [m], shape (F, 2); the table of the drawing is rounded."""
    x, y = local
    if body < 0:
        return np.tile([x, y], (len(poses), 1))
    with np.errstate(invalid="ignore"):  # a failed run may contain infinities
        cosine, sine = np.cos(poses[:, body, 2]), np.sin(poses[:, body, 2])
    world: Array = poses[:, body, :2] + np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
    return world
