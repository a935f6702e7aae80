"""Misalignment of the joints of a run over time, and its growth law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.analysis.growth import Growth, growth_law
from mbdkit.archive.run import Run


@dataclass(frozen=True)
class Drift:
    """Misalignment of one joint.

    Attributes
    ----------
    joint
        Name of the joint.
    time
        (T,) recorded times [s].
    misalignment
        (T,) distance between the two joint points [m].
    largest
        Largest misalignment over every step, recorded or not [m].
    """

    joint: str
    time: np.ndarray
    misalignment: np.ndarray
    largest: float

    def growth(self) -> Growth:
        """Return the growth law of the misalignment; see `growth_law`."""
        return growth_law(self.time, self.misalignment)


def drift(run: Run) -> dict[str, Drift]:
    """Return the drift of every joint by name, in the order in which the run lists the joints."""
    return {
        name: Drift(name, run.time, history.misalignment, history.misalignment_max)
        for name, history in run.joints.items()
    }


def worst_history(run: Run) -> np.ndarray:
    """Return the largest misalignment (T,) [m] of any joint at each recorded time."""
    return np.asarray(np.max(run.array("joints/misalignment"), axis=1, initial=0.0))
