"""Two nonlinear, non-autonomous test problems: a forced and a driven double pendulum, as witness and as spec."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .absolute import AbsoluteRods
from .rods import DrivenRods, Motion, TwoRods

Array = NDArray[np.floating[Any]]

#: Springs and dampers in both joints, a torque between the rods and a force on the end, both functions of time.
FORCED = TwoRods(
    lengths=(1.0, 0.8),
    masses=(1.0, 0.7),
    stiffness=(3.0, 2.0),
    damping=(0.2, 0.1),
    free_angles=(-1.2, 0.3),
    torque=lambda time: 1.5 * np.sin(4 * time),
    force=lambda time: (0.8 * np.cos(3 * time), 0.5 * np.sin(2 * time)),
)
MOTION = Motion(
    value=lambda time: -1.2 + 0.6 * np.sin(2.5 * time),
    rate=lambda time: 1.5 * np.cos(2.5 * time),
    acceleration=lambda time: -3.75 * np.sin(2.5 * time),
)
MOTION_TEXT = "-1.2 + 0.6*sin(2.5*t)"
DRIVEN = DrivenRods(FORCED, MOTION)


@dataclass(frozen=True)
class Problem:
    """A double pendulum with its start: the spec of mbdkit's free-form model, and the independent solution.

    Parameters
    ----------
    driven
        Whether the first rod's angle is prescribed.
    angles, rates
        Start: absolute angles [rad] and rates [rad/s] of the two rods.
    """

    driven: bool
    angles: tuple[float, float]
    rates: tuple[float, float]

    @property
    def absolute(self) -> AbsoluteRods:
        """Return the same problem in absolute coordinates with dense matrices."""
        return AbsoluteRods.of(FORCED, MOTION if self.driven else None)

    def state(self, angles: Array, rates: Array) -> Array:
        """Return (q, v) (12,) of both rods from their angles and rates."""
        return self.absolute.state(angles, rates)

    def solve(self, times: Array) -> Array:
        """Return (theta1, theta2, theta1', theta2', dissipated, work [, driver torque]) at `times`, by DOP853."""
        return _solve(self, tuple(times.tolist()))

    def model(self) -> dict[str, Any]:
        """Return the `model:` mapping of mbdkit's free-form model."""
        state = self.state(np.array(self.angles), np.array(self.rates)).reshape(2, 2, 3)
        bodies = {
            f"rod{k + 1}": {
                "mass": FORCED.masses[k],
                "inertia": FORCED.masses[k] * FORCED.lengths[k] ** 2 / 12,
                "position": state[0, k, :2].tolist(),
                "angle": float(state[0, k, 2]),
                "velocity": state[1, k, :2].tolist(),
                "angular_velocity": float(state[1, k, 2]),
            }
            for k in range(2)
        }
        half1, half2 = (length / 2 for length in FORCED.lengths)
        joints: dict[str, Any] = {
            "J1": {"type": "revolute", "bodies": ["ground", "rod1"], "points": [[0.0, 0.0], [-half1, 0.0]]},
            "J2": {"type": "revolute", "bodies": ["rod1", "rod2"], "points": [[half1, 0.0], [-half2, 0.0]]},
        }
        if self.driven:
            joints["motor"] = {
                "type": "driver",
                "bodies": ["ground", "rod1"],
                "coordinate": "angle",
                "motion": MOTION_TEXT,
            }
        forces: dict[str, Any] = {
            f"spring{k + 1}": {
                "type": "torsion-spring",
                "bodies": pair,
                "stiffness": FORCED.stiffness[k],
                "damping": FORCED.damping[k],
                "free_angle": FORCED.free_angles[k],
            }
            for k, pair in enumerate((["ground", "rod1"], ["rod1", "rod2"]))
        }
        forces["torque"] = {"type": "torque", "body": "rod2", "reaction_body": "rod1", "value": "1.5*sin(4*t)"}
        forces["push"] = {
            "type": "force",
            "body": "rod2",
            "point": [half2, 0.0],
            "value": ["0.8*cos(3*t)", "0.5*sin(2*t)"],
        }
        return {"name": "mechanism", "bodies": bodies, "joints": joints, "forces": forces}


@cache
def _solve(problem: Problem, times: tuple[float, ...]) -> Array:
    if problem.driven:
        return DRIVEN.solve(problem.angles[1], problem.rates[1], np.array(times))
    return FORCED.solve(problem.angles, problem.rates, np.array(times))


FORCED_PENDULUM = Problem(driven=False, angles=(-0.6, 0.1), rates=(0.0, 0.0))
DRIVEN_PENDULUM = Problem(driven=True, angles=(float(MOTION.value(0.0)), 0.1), rates=(float(MOTION.rate(0.0)), 0.0))
