"""How far a run is from a reference: at the end, and on the times that both recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.errors import MbdkitError

SAME_TIME = 1e-9
"""Times that differ by less than this share of the duration are the same."""


@dataclass(frozen=True)
class Deviation:
    """Distances of a run's bodies from those of a reference; each the largest over the bodies.

    Attributes
    ----------
    end_position, end_angle, end_velocity, end_angular_velocity
        At the end [m, rad, m/s, rad/s].
    rms_position, max_position
        Of the centres of mass over the common times [m].
    rms_angle, max_angle
        Of the angles over the common times [rad].
    times
        Number of common times.
    """

    end_position: float
    end_angle: float
    end_velocity: float
    end_angular_velocity: float
    rms_position: float
    max_position: float
    rms_angle: float
    max_angle: float
    times: int


def common_times(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows (K,) of `first` and of `second` [s] at which both have the same time."""
    duration = max(float(np.ptp(first)), float(np.ptp(second)), np.finfo(float).tiny)
    nearest = np.clip(np.searchsorted(second, first), 1, max(len(second) - 1, 1))
    nearest = np.where(
        np.abs(second[np.minimum(nearest, len(second) - 1)] - first) < np.abs(second[nearest - 1] - first),
        np.minimum(nearest, len(second) - 1),
        nearest - 1,
    )
    same = np.abs(second[nearest] - first) <= SAME_TIME * duration
    return np.flatnonzero(same), nearest[same]


def error_against(run: Run, reference: Run) -> Deviation:
    """Return how far `run` is from `reference`.

    Parameters
    ----------
    run, reference
        Runs of the same bodies over the same span, complete.

    Raises
    ------
    RunError
        If one of them is not complete.
    MbdkitError
        If their bodies or their ends differ.
    """
    run.check()
    reference.check()
    if list(run.bodies) != list(reference.bodies):
        raise MbdkitError(
            f"the reference has the bodies {', '.join(reference.bodies)}, but the run has {', '.join(run.bodies)}"
        )
    mine, theirs = common_times(run.time, reference.time)
    if len(mine) < 2 or mine[-1] != len(run.time) - 1 or theirs[-1] != len(reference.time) - 1:
        raise MbdkitError(f"the reference ends at {reference.time[-1]:g} s, but the run at {run.time[-1]:g} s")
    q = run.array("trajectory/position")[mine] - reference.array("trajectory/position")[theirs]
    v = run.array("trajectory/velocity")[-1] - reference.array("trajectory/velocity")[-1]
    distance, angle = np.hypot(q[..., 0], q[..., 1]), np.abs(q[..., 2])
    return Deviation(
        end_position=float(distance[-1].max()),
        end_angle=float(angle[-1].max()),
        end_velocity=float(np.hypot(v[:, 0], v[:, 1]).max()),
        end_angular_velocity=float(np.abs(v[:, 2]).max()),
        rms_position=float(np.sqrt(np.mean(distance**2, axis=0)).max()),
        max_position=float(distance.max()),
        rms_angle=float(np.sqrt(np.mean(angle**2, axis=0)).max()),
        max_angle=float(angle.max()),
        times=len(mine),
    )
