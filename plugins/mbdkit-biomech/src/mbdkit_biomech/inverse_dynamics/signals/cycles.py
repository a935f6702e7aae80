"""Cycles of a motion, such as steps: the times at which they begin, and quantities as functions of 0 to 100 % of a
cycle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import SpecError

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

POINTS = 101  #: Number of points of a normalized cycle: one per percent, both ends included.


@dataclass(frozen=True)
class Normalized:
    """A quantity over normalized cycles.

    Attributes
    ----------
    percent
        (101,) 0 to 100 % of the cycle.
    cycles
        (N, 101) the quantity in each cycle.
    """

    percent: np.ndarray
    cycles: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """(101,) mean over the cycles."""
        return np.asarray(np.mean(self.cycles, axis=0))

    @property
    def deviation(self) -> np.ndarray:
        """(101,) standard deviation over the cycles (N - 1 in the denominator); nan with one cycle."""
        if len(self.cycles) < 2:
            return np.full(self.cycles.shape[1], np.nan)
        return np.asarray(np.std(self.cycles, axis=0, ddof=1))


def normalized(time: np.ndarray, values: np.ndarray, starts: np.ndarray) -> Normalized:
    """Return a quantity (T,) over the cycles between consecutive `starts` (N + 1,) [s], linearly interpolated."""
    percent = np.linspace(0.0, 100.0, POINTS)
    cycles = [
        np.interp(begin + (end - begin) * percent / 100.0, time, values) for begin, end in pairwise(starts.tolist())
    ]
    return Normalized(percent, np.array(cycles))


def crossings(time: np.ndarray, values: np.ndarray, threshold: float, *, rising: bool = True) -> np.ndarray:
    """Return the times [s] at which a quantity (T,) rises through a threshold, or falls through it if `rising` is
    False. The quantity is interpolated linearly.
    """
    above = values >= threshold
    change = np.flatnonzero(~above[:-1] & above[1:] if rising else above[:-1] & ~above[1:])
    before, after = values[change], values[change + 1]
    share = (threshold - before) / (after - before)
    return np.asarray(time[change] + share * (time[change + 1] - time[change]))


def contacts(run: Run, load: str, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the times [s] at which the magnitude of a load reaches a threshold [N], and those at which it falls below.

    Raises
    ------
    UnknownNameError
        If the run has no such load.
    SpecError
        If the load never rises above the threshold.
    """
    size = np.linalg.norm(run.loads[load].force, axis=1)
    on, off = (crossings(run.time, size, threshold, rising=rising) for rising in (True, False))
    if not on.size:
        raise SpecError(f"the load '{load}' never rises above {threshold:g} N; its maximum is {np.max(size):.4g} N")
    return on, off
