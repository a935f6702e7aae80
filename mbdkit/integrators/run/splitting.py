"""Steppers whose steps can end at an event at which first-order states change."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from mbdkit.integrators.interface import Moment, Stepper, StepTaken, Stretch, Timetable

Change = Callable[[float, Moment], np.ndarray]
"""Function that returns new first-order states (Z,) from the time [s] and the state at an event."""


class Splitting(Stepper, Protocol):
    """A stepper whose steps can end at an event at which first-order states change."""

    def split(self, theta: float, change: Change) -> tuple[Stretch, list[StepTaken]]:
        """End the last step at the share `theta` instead, change the first-order states there, and continue.

        Requires ``Timetable.single``. States do not change if the shortened step ends the run.

        Returns the rows and the steps up to the event, which replace those of the last `advance`. There are no steps if
        `theta` is 0; with controlled step size there may be several.
        """
        ...


def margin_of_stops(table: Timetable) -> float:
    """Return the largest error of the time of a stop that rounding can cause [s]."""
    return 4.0 * float(np.finfo(float).eps) * max(abs(table.start), abs(table.end))
