"""Whether a run gains or loses energy that it should not, and how fast."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mbdkit.analysis.block_statistics import BLOCKS, block_means, independent
from mbdkit.archive.run import Run

SURE = 3.0
"""Standard errors that a slope must be away from zero to count as a trend."""


@dataclass(frozen=True)
class Trend:
    """A straight line through a history.

    Attributes
    ----------
    slope, error
        Change per second and its standard error [unit of the history per s]; an oscillation about the line goes into
        the error.
    largest
        Largest absolute value of the history.
    oscillation
        Largest distance of the history from the line.
    """

    slope: float
    error: float
    largest: float
    oscillation: float = math.nan

    @property
    def drifts(self) -> bool:
        """Whether the slope is certainly not zero."""
        return abs(self.slope) > SURE * self.error


def trend(time: np.ndarray, value: np.ndarray, *, blocks: int = BLOCKS) -> Trend:
    """Return the slope of a history with an error that neighbouring rows do not make too small.

    Parameters
    ----------
    time
        (T,) increasing times [s].
    value
        (T,) values.
    blocks
        Most blocks that means are taken over.

    Raises
    ------
    ValueError
        For fewer than 12 rows.
    """
    time, value = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    if len(time) != len(value) or len(time) < 12:
        raise ValueError(f"a trend needs 12 rows and as many times, not {len(value)} and {len(time)}")
    t, x = block_means(time, value, blocks)
    slope, start = np.polyfit(t, x, 1)
    residual = x - (start + slope * t)
    count = max(independent(residual), 2.5)
    variance = float(residual @ residual) / len(x) * count / (count - 2)
    error = math.sqrt(variance / count / float(np.var(t)))
    away = float(np.max(np.abs(value - (start + slope * time))))
    return Trend(float(slope), error, float(np.max(np.abs(value))), away)


def energy_trend(run: Run) -> Trend:
    """Return the trend of a run's energy balance [W], which is zero but for numerical error."""
    return trend(run.time, run.energy.balance)
