"""Evenly spaced times that were rounded when they were written."""

from __future__ import annotations

import numpy as np

GRIDS = tuple(10.0**-digits for digits in range(1, 7))  #: Intervals [s] of which rounded times are multiples.

#: Rounded times deviate from a straight line by less than this share of the interval of which they are multiples, which
#: happens for uneven times only by chance.
NEAR = 0.75

#: Shares of this interval by which rounded times deviate at most, and exact ones at most.
ROUNDED, EXACT = 0.51, 1e-3


def grid_of(time: np.ndarray) -> float | None:
    """Return the longest interval of `GRIDS` of which all times (T,) are multiples; None if there is none."""
    return next((grid for grid in GRIDS if np.max(np.abs(time / grid - np.round(time / grid))) < 1e-6), None)


def rounded_to(time: np.ndarray) -> float | None:
    """Return the interval to multiples of which evenly spaced times (T,) were rounded; None if they do not look so."""
    grid, row = grid_of(time), np.arange(len(time))
    if grid is None or not np.max(np.abs(time - np.polyval(np.polyfit(row, time, 1), row))) < NEAR * grid:
        return None
    return grid


def at_rate(time: np.ndarray, rate: float) -> np.ndarray:
    """Return times (T,) [s] with all digits if they are those of frames at a rate [Hz] that were rounded to less than
    half an interval; otherwise, return the same array.
    """
    grid, row, number = grid_of(time), np.arange(len(time)), np.round(time[0] * rate)
    if grid is None or not grid < 0.5 / rate:
        return time
    counted = abs(number / rate - time[0]) <= ROUNDED * grid  # frames are usually counted from time 0
    frames = (number + row) / rate if counted else time[0] + row / rate
    off = np.max(np.abs(frames - time))
    return frames if EXACT * grid < off <= ROUNDED * grid else time
