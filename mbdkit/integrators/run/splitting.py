"""Steppers whose steps can end at an event at which first-order states change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from mbdkit.integrators.interface import Stepper, StepTaken, Stretch, Timetable


class Splitting(Stepper, Protocol):
    """A stepper whose steps can end at an event at which first-order states change."""

    @property
    def energy(self) -> np.ndarray:
        """(2,) work of loads and drivers, and dissipated energy, so far [J]."""
        ...

    def split(self, theta: float) -> tuple[Stretch, list[StepTaken]]:
        """End the last step at the share `theta` instead. Requires ``Timetable.single``.

        Returns the rows and the steps up to the event, which replace those of the last `advance`. There are no steps if
        `theta` is 0; with controlled step size there may be several.
        """
        ...

    def change(self, values: Mapping[int, float]) -> None:
        """Set first-order states by index after an event, before the next step."""
        ...


def margin_of_stops(table: Timetable) -> float:
    """Return the largest error of the time of a stop that rounding can cause [s]."""
    return 4.0 * float(np.finfo(float).eps) * max(abs(table.start), abs(table.end))
