"""The order that a method shows over a sequence of steps, where it shows it: below the coarse, above the rounding."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

AGREE = 0.25
"""Most by which slopes between neighbours may differ within the asymptotic window."""
ABOVE_FLOOR = 20.0
"""How far above the floor of rounding an error must be to tell of the method: a twentieth shifts a slope by 0.07."""
SLOPE_AT_FLOOR = 0.5
"""Slope below which the finest steps no longer reduce the error: no method has such an order."""


@dataclass(frozen=True)
class ObservedOrder:
    """An order read off errors over steps.

    Attributes
    ----------
    order, error
        Slope of log error over log step by least squares inside the window, and its standard error; nan where no window
        was found.
    steps
        The steps of the window, coarsest first; empty where there is none.
    slopes
        Slopes between neighbours in the window.
    floor
        The floor of rounding: as given, or as seen at the finest steps; 0 where it was not reached.
    """

    order: float
    error: float
    steps: tuple[float, ...]
    slopes: tuple[float, ...]
    floor: float

    @property
    def found(self) -> bool:
        """Whether there is a window."""
        return len(self.steps) > 0

    def describe(self) -> str:
        """Return the finding in words."""
        if not self.found:
            return "no asymptotic window"
        return f"{self.order:.2f} over steps of {self.steps[0]:.3g} to {self.steps[-1]:.3g} s"


def observed_order(
    steps: np.ndarray, errors: np.ndarray, *, floor: float | None = None, fewest: int = 3, agree: float = AGREE
) -> ObservedOrder:
    """Return the order in the asymptotic window, which is found from the errors themselves.

    The window is the longest run of neighbouring steps whose errors fall steadily, lie well above the floor of rounding
    and whose slopes agree with each other; of equally long ones, that of the finest steps.

    Parameters
    ----------
    steps
        (K,) step sizes [s], in any order.
    errors
        (K,) errors against a reference; those that are not finite or zero are left out.
    floor
        The floor of rounding, where it was measured, such as the difference of two references; by default the largest
        error among the finest steps that no longer reduce it.
    fewest
        Fewest steps that make a window.
    agree
        Most by which slopes between neighbours may differ.

    Returns
    -------
    ObservedOrder
        With an empty window where there is none.
    """
    steps, errors = np.asarray(steps, dtype=float), np.asarray(errors, dtype=float)
    keep = np.isfinite(errors) & (errors > 0)
    steps, errors = steps[keep], errors[keep]
    descending = np.argsort(-steps)
    h, e = np.log(steps[descending]), np.log(errors[descending])
    slopes = np.diff(e) / np.diff(h) if len(h) > 1 else np.zeros(0)
    if floor is None:
        floor = _floor(slopes, errors[descending])
    best = range(0)
    for first in range(len(h)):
        for last in range(first + fewest - 1, len(h)):
            inside = slopes[first:last]
            above = math.exp(float(e[last])) > ABOVE_FLOOR * floor
            if above and np.all(inside > SLOPE_AT_FLOOR) and np.ptp(inside) <= agree and last + 1 - first >= len(best):
                best = range(first, last + 1)
    if not best:
        return ObservedOrder(math.nan, math.nan, (), (), floor)
    x, y = h[best.start : best.stop], e[best.start : best.stop]
    slope, start = np.polyfit(x, y, 1)
    residual = y - (start + slope * x)
    freedom = max(len(x) - 2, 1)
    error = math.sqrt(float(residual @ residual) / freedom / float(np.sum((x - x.mean()) ** 2)))
    window = tuple(float(value) for value in np.exp(x))
    seen = tuple(float(value) for value in slopes[best.start : best.stop - 1])
    return ObservedOrder(float(slope), error, window, seen, floor)


def _floor(slopes: np.ndarray, errors: np.ndarray) -> float:
    """Return the largest error of the finest steps that no longer reduce it, 0 where every step still does."""
    flat = len(slopes)
    while flat > 0 and slopes[flat - 1] < SLOPE_AT_FLOOR:
        flat -= 1
    return float(np.max(errors[flat + 1 :], initial=0.0))
