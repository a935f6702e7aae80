"""Trend of the energy balance of a run: the rate at which numerical error adds or removes energy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mbdkit_report.analysis.growth import block_means, independent


@dataclass(frozen=True)
class Trend:
    """A straight line fitted to a time series.

    Attributes
    ----------
    slope, error
        Slope of the line and its standard error [unit of the series per s]. Oscillation about the line increases the
        error.
    largest
        Largest absolute value of the series.
    oscillation
        Largest distance of the series from the line.
    """

    #: A slope counts as a drift if its magnitude is larger than this multiple of its standard error.
    SURE: ClassVar[float] = 3.0

    slope: float
    error: float
    largest: float
    oscillation: float = math.nan

    @property
    def drifts(self) -> bool:
        """Whether the slope differs from zero by more than `SURE` standard errors."""
        return abs(self.slope) > self.SURE * self.error


def trend(time: np.ndarray, value: np.ndarray) -> Trend:
    """Fit a straight line to the block means of a time series (T,) at increasing times (T,) [s]; see `trends`."""
    return trends(time, np.asarray(value, dtype=float)[None])[0]


def trends(time: np.ndarray, values: np.ndarray) -> list[Trend]:
    """Return the trend of each of R time series at the same times: a straight line fitted to its block means.

    The standard error is computed from the effective number of independent blocks. The number of rows would give too
    small an error, because neighbouring rows are correlated.

    Parameters
    ----------
    time
        (T,) increasing times [s].
    values
        (R, T) values.

    Raises
    ------
    ValueError
        If there are fewer than 12 values per series, or if the numbers of times and values differ.
    """
    time, values = np.asarray(time, dtype=float), np.asarray(values, dtype=float)
    count = values.shape[-1]
    if len(time) != count or count < 12:
        raise ValueError(
            f"a trend needs at least 12 values and as many times, not {count} values and {len(time)} times"
        )
    t, x = block_means(time, values)
    centred = t - t.mean()
    power = np.sum(centred * centred)
    slope = np.sum(x * centred, axis=-1) / power
    line = np.stack([x.mean(axis=-1) - slope * t.mean(), slope])[..., None]
    residual = x - (line[0] + line[1] * t)
    many = np.maximum(independent(residual), 2.5)
    variance = np.mean(residual * residual, axis=-1) * many / (many - 2)
    error = np.sqrt(variance / many / (power / len(t)))
    away = np.max(np.abs(values - (line[0] + line[1] * time)), axis=-1)
    largest = np.max(np.abs(values), axis=-1)
    return [Trend(*one) for one in np.stack([slope, error, largest, away], axis=-1).tolist()]
