"""Size of a mechanism: the reference length for its misalignments."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mbdkit.mechanism.mechanism import Mechanism


def mechanism_size(mechanism: Mechanism, position: np.ndarray) -> float:
    """Return the longer side of the axis-parallel bounding box of all joint points and centres of mass [m].

    Parameters
    ----------
    position
        (B, 3) array: centre of mass x, y [m] and angle [rad] of each of the B bodies, in the order of the mechanism.
    """
    pose = dict(zip(mechanism.bodies, np.asarray(position, dtype=float), strict=True))
    points = [row[:2] for row in pose.values()]
    for joint in mechanism.joints.values():
        for _, name, (x, y) in joint.attachments():
            if name not in pose:
                points.append(np.array([x, y]))
                continue
            px, py, angle = pose[name]
            c, s = np.cos(angle), np.sin(angle)
            points.append(np.array([px + c * x - s * y, py + s * x + c * y]))
    return float(np.max(np.ptp(np.array(points), axis=0), initial=0.0)) if points else 0.0
