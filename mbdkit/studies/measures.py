"""What is taken of each run of a study: one number a measure, nan where the run does not tell it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.reference import EVERY_ROW, LAST_ROW, offsets

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
        if reference is None or not run.status == reference.status == "complete":
            return math.nan
        if run.status_reason or reference.status_reason:  # an event ended one of them, and not at the other's end
            return math.nan
        difference = offsets(run, reference, rows)[..., part]
        return float(np.max(np.linalg.norm(difference, axis=-1), initial=0.0))

    return take


_XY, _THETA = slice(0, 2), slice(2, 3)

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
    "end_error": Measure("m", "largest distance of a body from the reference at the end", _error(_XY, LAST_ROW)),
    "end_angle_error": Measure("rad", "largest angle of a body off the reference at the end", _error(_THETA, LAST_ROW)),
    "trajectory_error": Measure(
        "m", "largest distance of a body from the reference in the recorded rows", _error(_XY, EVERY_ROW)
    ),
    "trajectory_angle_error": Measure(
        "rad", "largest angle of a body off the reference in the recorded rows", _error(_THETA, EVERY_ROW)
    ),
}


def worst_joint(run: Run) -> str:
    """Return the name of the joint with the largest misalignment over every step; empty where none is apart."""
    joints = sorted(run.joints.values(), key=lambda joint: -joint.misalignment_max)
    return joints[0].name if joints and joints[0].misalignment_max > 0 else ""
