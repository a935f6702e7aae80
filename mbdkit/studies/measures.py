"""What is taken of each run of a study: one number a measure, nan where the run does not tell it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


@dataclass(frozen=True)
class Measure:
    """One measure.

    Parameters
    ----------
    units
        SI units.
    long_name
        What it is, in words.
    take
        Gives its value for a run and the reference of that run, or None without one.
    """

    units: str
    long_name: str
    take: Callable[[Run, Run | None], float]


def _largest(path: str) -> Callable[[Run, Run | None], float]:
    def take(run: Run, reference: Run | None) -> float:
        if not run.records(path):
            return math.nan
        return float(np.max(np.abs(run.array(path)), initial=0.0))

    return take


def _misalignment(run: Run, reference: Run | None) -> float:
    return run.misalignment_max


def _end_balance(run: Run, reference: Run | None) -> float:
    if not run.records("energy/balance") or not len(run.time):
        return math.nan
    return float(run.energy.balance[-1])


def _error(part: slice, rows: slice) -> Callable[[Run, Run | None], float]:
    """Return the measure of the largest distance of any body from the reference, over `rows` of the run."""

    def take(run: Run, reference: Run | None) -> float:
        if not _comparable(run, reference):
            return math.nan
        assert reference is not None
        time, position = run.time[rows], run.array("trajectory/position")[rows]
        difference = (position - interpolated(reference, time))[..., part]
        return float(np.max(np.linalg.norm(difference, axis=-1), initial=0.0))

    return take


def _comparable(run: Run, reference: Run | None) -> bool:
    return (
        reference is not None
        and run.status == reference.status == "complete"
        and tuple(run.bodies) == tuple(reference.bodies)
    )


def interpolated(run: Run, time: np.ndarray) -> np.ndarray:
    """Return the positions of a run between its recorded rows.

    A polynomial of degree five through position, velocity and acceleration at both ends of each interval: its error is
    of the sixth power of the interval, and none at a recorded row.

    Parameters
    ----------
    run
        The run.
    time
        Times within its span, (N,), s.

    Returns
    -------
    ndarray
        Positions and angles of the bodies, (N, B, 3), m and rad.
    """
    rows = run.time
    left = np.clip(np.searchsorted(rows, time, side="right") - 1, 0, len(rows) - 2)
    span = rows[left + 1] - rows[left]
    u = np.clip((time - rows[left]) / span, 0.0, 1.0)
    u = np.where(np.abs(time - rows[left + 1]) <= 1e-9 * span, 1.0, u)
    w = 1.0 - u
    weights = (
        (w**3 * (1 + 3 * u + 6 * u**2), w**3 * (u + 3 * u**2), w**3 * u**2 / 2),
        (u**3 * (1 + 3 * w + 6 * w**2), -(u**3) * (w + 3 * w**2), u**3 * w**2 / 2),
    )
    motion = [run.array(f"trajectory/{name}") for name in ("position", "velocity", "acceleration")]
    powers = (np.ones_like(span), span, span**2)
    result = np.zeros((len(time), *motion[0].shape[1:]))
    for end, of_end in enumerate(weights):
        for values, weight, power in zip(motion, of_end, powers, strict=True):
            result += (weight * power)[:, None, None] * values[left + end]
    return result


_XY, _THETA = slice(0, 2), slice(2, 3)
_ALL, _END = slice(None), slice(-1, None)

MEASURES: Mapping[str, Measure] = {
    "misalignment_max": Measure("m", "largest misalignment of any joint over every step", _misalignment),
    "velocity_misalignment_max": Measure(
        "m/s",
        "largest velocity misalignment of any joint in the recorded rows",
        _largest("joints/velocity_misalignment"),
    ),
    "angle_misalignment_max": Measure(
        "rad", "largest angle misalignment of any joint in the recorded rows", _largest("joints/angle_misalignment")
    ),
    "energy_balance_max": Measure("J", "largest absolute energy balance", _largest("energy/balance")),
    "energy_balance_end": Measure("J", "energy balance at the end", _end_balance),
    "energy_scale": Measure("J", "largest kinetic energy", _largest("energy/kinetic")),
    "end_error": Measure("m", "largest distance of a body from the reference at the end", _error(_XY, _END)),
    "end_angle_error": Measure("rad", "largest angle of a body off the reference at the end", _error(_THETA, _END)),
    "trajectory_error": Measure(
        "m", "largest distance of a body from the reference in the recorded rows", _error(_XY, _ALL)
    ),
    "trajectory_angle_error": Measure(
        "rad", "largest angle of a body off the reference in the recorded rows", _error(_THETA, _ALL)
    ),
}


def worst_joint(run: Run) -> str:
    """Return the name of the joint with the largest misalignment over every step; empty where none is apart."""
    joints = sorted(run.joints.values(), key=lambda joint: -joint.misalignment_max)
    return joints[0].name if joints and joints[0].misalignment_max > 0 else ""
