"""Trend of the energy balance of a run: the rate at which numerical error adds or removes energy."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mbdkit.analysis.block_statistics import BLOCKS, block_means, independent
from mbdkit.archive.run import Run

SURE = 3.0
"""Minimum ratio of a slope to its standard error for the slope to count as a trend."""


@dataclass(frozen=True)
class Trend:
    """A straight line fitted to a time series.

    Attributes
    ----------
    slope, error
        Change per second and its standard error [unit of the series per s]; the error includes oscillation about the
        line.
    largest
        Largest absolute value of the series.
    oscillation
        Largest distance of the series from the line.
    """

    slope: float
    error: float
    largest: float
    oscillation: float = math.nan

    @property
    def drifts(self) -> bool:
        """Whether the slope differs from zero by more than `SURE` standard errors."""
        return abs(self.slope) > SURE * self.error


def trend(time: np.ndarray, value: np.ndarray, *, blocks: int = BLOCKS) -> Trend:
    """Fit a straight line to the block means of a time series.

    The standard error is computed from the effective number of independent blocks, because the correlation of
    neighbouring rows would make it too small.

    Parameters
    ----------
    time
        (T,) increasing times [s].
    value
        (T,) values.
    blocks
        Maximum number of blocks.

    Raises
    ------
    ValueError
        If there are fewer than 12 rows, or not as many times as values.
    """
    time, value = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    if len(time) != len(value) or len(time) < 12:
        raise ValueError(
            f"a trend needs at least 12 values and as many times, not {len(value)} values and {len(time)} times"
        )
    t, x = block_means(time, value, blocks)
    slope, start = np.polyfit(t, x, 1)
    residual = x - (start + slope * t)
    count = max(independent(residual), 2.5)
    variance = float(residual @ residual) / len(x) * count / (count - 2)
    error = math.sqrt(variance / count / float(np.var(t)))
    away = float(np.max(np.abs(value - (start + slope * time))))
    return Trend(float(slope), error, float(np.max(np.abs(value))), away)


def energy_trend(run: Run) -> Trend:
    """Return the trend of the energy balance [W] of a run; the exact solution has zero balance."""
    return trend(run.time, run.energy.balance)
