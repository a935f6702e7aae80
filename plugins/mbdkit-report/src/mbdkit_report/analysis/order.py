"""Observed order of a method, from its errors at several step sizes, within the asymptotic range."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

#: Within the asymptotic window, the slopes between neighbouring steps differ from each other by at most this.
AGREE = 0.25
#: Errors in the asymptotic window are larger than this multiple of the round-off floor. At this multiple, round-off
#: changes the slope between two steps with the ratio 2 by about 0.07.
ABOVE_FLOOR = 20.0
#: The errors at the finest steps count as round-off if the slope between them is below this, because every method has
#: a higher order.
SLOPE_AT_FLOOR = 0.5


@dataclass(frozen=True)
class ObservedOrder:
    """Observed order of a method.

    Attributes
    ----------
    order, error
        Least-squares slope of log error over log step inside the asymptotic window, and its standard error; nan if
        there is no window.
    steps
        Step sizes in the window [s], coarsest first; empty if there is no window.
    slopes
        Slopes between neighbouring steps in the window.
    floor
        Round-off floor of the errors, as given or as estimated from the finest steps. The estimate is 0 if the error
        decreases down to the finest step.
    """

    order: float
    error: float
    steps: tuple[float, ...]
    slopes: tuple[float, ...]
    floor: float

    @property
    def found(self) -> bool:
        """Whether an asymptotic window was found."""
        return len(self.steps) > 0


def observed_order(
    steps: np.ndarray, errors: np.ndarray, *, floor: float | None = None, fewest: int = 3, agree: float = AGREE
) -> ObservedOrder:
    """Determine the asymptotic window from the errors, and return the observed order in it.

    The window is the longest sequence of step sizes in which the error decreases with the step, lies well above the
    round-off floor, and has slopes that agree with each other. If several sequences have the same length, the one with
    the finest steps is used.

    Parameters
    ----------
    steps
        (K,) step sizes [s], in any order.
    errors
        (K,) errors against a reference; zeros and values that are not finite are ignored.
    floor
        Round-off floor, if it was measured, for example as the difference of two references; by default, the largest
        error among the finest steps at which the error no longer decreases.
    fewest
        Minimum number of steps in a window.
    agree
        Largest difference between two slopes in the window.

    Returns
    -------
    ObservedOrder
        The order and its window; the order is nan and the window empty if none was found.
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
    """Return the largest error of the finest steps at which the error no longer decreases; 0 if it always does."""
    flat = len(slopes)
    while flat > 0 and slopes[flat - 1] < SLOPE_AT_FLOOR:
        flat -= 1
    return float(np.max(errors[flat + 1 :], initial=0.0))
