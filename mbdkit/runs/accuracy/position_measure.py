"""The measure of position errors: a single number, relative to the size of the mechanism, for all positions and
angles.
"""

from __future__ import annotations

import math

import numpy as np

from mbdkit.archive.accuracy import Accuracy
from mbdkit.base import elementary
from mbdkit.base.frozen import dataclass
from mbdkit.engine.workspace import Workspace
from mbdkit.runs.preparation import size_at_start
from mbdkit.spec import RunSpec


@dataclass(frozen=True)
class PositionMeasure:
    """Measures errors of positions.

    The error of a body is that of its centre of mass or, if it is larger, the error of its angle times its `arm`. This
    includes the errors of the ends of a rod, and of the rotation of a disc about its centre.

    `size`: size of the mechanism at its start [m]. `arm`: (B,) largest distance of a joint point from the centre of
    mass of each body [m]; `size` for bodies whose distance is 0.
    """

    size: float
    arm: np.ndarray

    @classmethod
    def of(cls, spec: RunSpec, workspace: Workspace) -> PositionMeasure:
        """Return the measure of the mechanism of a spec."""
        size, mechanism = size_at_start(spec, workspace), spec.mechanism()
        arm = dict.fromkeys(mechanism.bodies, 0.0)
        for joint in mechanism.joints.values():
            for _, name, point in joint.attachments():
                if name in arm:
                    arm[name] = max(arm[name], float(elementary.hypot(*point)))
        return cls(size, np.array([length or size for length in arm.values()]))

    def share(self, error: np.ndarray) -> np.ndarray:
        """Return the largest error of all bodies as a share of the size, (T,); nan where an error is nan.

        `error`: (T, B, 3) errors of x, y [m] and angle [rad].
        """
        ends = np.maximum(np.linalg.norm(error[..., :2], axis=-1), self.arm * np.abs(error[..., 2]))
        return np.asarray(np.max(ends, axis=-1, initial=0.0)) / self.size

    def known(self, accuracy: Accuracy) -> float:
        """Return the largest estimated error up to the time until which errors are known; nan if nothing is known."""
        count = accuracy.rows_known
        # the estimates never decrease with time
        return float(self.share(accuracy.position_error[count - 1 : count])[0]) if count else math.nan
