"""Misalignment of a run's joints: how far they came apart, when, and by which law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.analysis.growth import Growth, growth_law
from mbdkit.archive.run import Run


@dataclass(frozen=True)
class Drift:
    """How far one joint came apart.

    Attributes
    ----------
    joint
        Its name.
    time
        (T,) recorded times [s].
    misalignment
        (T,) distance by which it fails to meet [m].
    largest
        Largest misalignment over every step, recorded or not [m].
    """

    joint: str
    time: np.ndarray
    misalignment: np.ndarray
    largest: float

    def growth(self) -> Growth:
        """Return by which law it grows; see `growth_law`."""
        return growth_law(self.time, self.misalignment)


def drift(run: Run) -> dict[str, Drift]:
    """Return the drift of every joint by name, in the order of the run."""
    return {
        name: Drift(name, run.time, history.misalignment, history.misalignment_max)
        for name, history in run.joints.items()
    }


def worst_history(run: Run) -> np.ndarray:
    """Return the misalignment (T,) [m] of whichever joint is apart most at each recorded time."""
    return np.asarray(np.max(run.array("joints/misalignment"), axis=1, initial=0.0))
