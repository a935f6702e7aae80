"""Bands of estimated errors around curves over time and around paths in the plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.plot.downsampling import Array

if TYPE_CHECKING:
    from mbdkit.archive.accuracy import Accuracy

UNKNOWN = "errors unknown afterwards"
"""Label of the time until which errors are known."""


def errors_at(accuracy: Accuracy, errors: Array, time: Array) -> Array:
    """Return estimated errors (T, ...) of the recorded rows at the last row before each time [s] of a picture.

    Errors are nan from `Accuracy.known_until` on, also those of single joints or bodies that are known longer.
    """
    rows = np.searchsorted(accuracy.time, time, side="right") - 1
    found = np.array(errors[rows], dtype=np.float64)
    found[rows >= accuracy.rows_known] = np.nan
    return found


def band_over_time(time: Array, low: Array, high: Array, error: Array) -> Array | None:
    """Return the outline of a band around a curve; None where no error is known.

    Parameters
    ----------
    time, low, high
        (K,) times [s] and the smallest and largest value at each of them.
    error
        (K,) error of the values, nan where unknown.

    Returns
    -------
    Array
        (2 R, 2) corners of the closed outline around the R known values.
    """
    known = np.isfinite(low - error) & np.isfinite(high + error)
    if not np.any(known):
        return None
    lower = np.stack([time[known], (low - error)[known]], axis=-1)
    upper = np.stack([time[known], (high + error)[known]], axis=-1)
    return np.concatenate([lower, upper[::-1]])


def band_along_path(path: Array, error: Array) -> Array | None:
    """Return the outline of a band on both sides of a path, whose half-width is the error; None if none is known.

    Parameters
    ----------
    path
        (K, 2) points [m].
    error
        (K,) error of their positions [m], nan where unknown.
    """
    known = np.isfinite(error) & np.all(np.isfinite(path), axis=1)
    if np.sum(known) < 2:
        return None
    points, width = path[known], error[known, None]
    along = np.gradient(points, axis=0)
    length = np.hypot(along[:, 0], along[:, 1])[:, None]
    across = np.divide(along[:, ::-1] * [-1.0, 1.0], length, out=np.zeros_like(along), where=length > 0) * width
    return np.concatenate([points - across, (points + across)[::-1]])
