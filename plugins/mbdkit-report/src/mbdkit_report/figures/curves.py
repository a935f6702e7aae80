"""Curves in pictures, with error bands. Long recordings are downsampled, and read in blocks to limit the memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbdkit.base.errors import SpecError

if TYPE_CHECKING:
    from mbdkit.archive.accuracy import Accuracy
    from mbdkit.archive.run import Run

Array = NDArray[np.float64]
BLOCK = 4_000_000  # values read at a time
BEYOND = 1e150  # larger values are left out: the run has failed, and their squares would overflow
POINTS = 2_000  # points of a curve; more are indistinguishable at the size of a picture

UNKNOWN = "errors unknown afterwards"  #: Label of the time until which errors are known.


@dataclass(frozen=True)
class Bands:
    """Several curves, downsampled to bands of consecutive rows.

    Parameters
    ----------
    time
        Time of each band [s], shape (K,).
    low, high
        Smallest and largest finite value of each curve in each band, shape (K, J); nan if there is none.
    peaks, peak_times
        Largest finite magnitude of each curve over all rows, and its time [s], shape (J,); nan if there is none.
    exact
        Whether every band is a single row.
    """

    time: Array
    low: Array
    high: Array
    peaks: Array
    peak_times: Array
    exact: bool

    def only(self, columns: list[int]) -> Bands:
        """Return some of the curves."""
        low, high, peaks, times = (x[..., columns] for x in (self.low, self.high, self.peaks, self.peak_times))
        return Bands(self.time, low, high, peaks, times, self.exact)

    def curve(self, column: int) -> tuple[Array, Array]:
        """Return times and values of one curve; unless exact, it passes through both extremes of each band."""
        if self.exact:
            return self.time, self.high[:, column]
        pairs = np.stack([self.low[:, column], self.high[:, column]], axis=1)
        pairs[1::2] = pairs[1::2, ::-1]
        return np.repeat(self.time, 2), pairs.reshape(-1)


def require_rows(run: Run) -> None:
    """Raise SpecError if a run has no rows."""
    if not len(run.time):
        raise SpecError("this run recorded no rows, so there is nothing to draw")


def blocks(rows: int, width: int) -> Iterator[slice]:
    """Divide `rows` rows of `width` numbers into slices that fit in memory."""
    size = max(1, BLOCK // max(1, width))
    yield from (slice(start, min(start + size, rows)) for start in range(0, rows, size))


def bands(time: Array, data: Any, values: Callable[[Array], Array] = np.asarray, points: int = POINTS) -> Bands:
    """Return the J curves of an array (T, J, ...) in bands.

    Parameters
    ----------
    time
        Times of the rows [s], shape (T,).
    data
        Array or HDF5 dataset, shape (T, J, ...).
    values
        Function that maps a block of rows to J values for each row, such as the norm over the last axis.
    points
        Largest number of bands; smaller for many curves.
    """
    rows, curves = data.shape[0], data.shape[1]
    count = min(rows, points, max(200, BLOCK // max(1, curves)))
    edges = np.linspace(0, rows, count + 1).astype(np.intp)
    low, high = np.full((count, curves), np.inf), np.full((count, curves), -np.inf)
    peaks, peak_times = np.full(curves, -1.0), np.full(curves, np.nan)
    for block in blocks(rows, int(np.prod(data.shape[1:]))):
        part = values(np.asarray(data[block], dtype=np.float64))
        finite = np.abs(part) < BEYOND  # also false for nan
        first, last = np.searchsorted(edges, [block.start, block.stop - 1], side="right") - 1
        size = np.where(finite, np.abs(part), -1.0)
        row = np.argmax(size, axis=0)
        largest = size[row, np.arange(curves)]
        is_larger = largest > peaks
        peaks[is_larger], peak_times[is_larger] = largest[is_larger], time[block][row[is_larger]]
        starts = np.maximum(edges[first : last + 1], block.start) - block.start
        here = slice(first, last + 1)
        low[here] = np.minimum(low[here], np.minimum.reduceat(np.where(finite, part, np.inf), starts))
        high[here] = np.maximum(high[here], np.maximum.reduceat(np.where(finite, part, -np.inf), starts))
    empty = high < low
    low[empty] = high[empty] = np.nan
    middle = time[edges[:-1]] if count == rows else (time[edges[:-1]] + time[edges[1:] - 1]) / 2
    peaks[peaks < 0] = np.nan
    return Bands(middle, low, high, peaks, peak_times, exact=count == rows)


def evenly(rows: int, limit: int) -> NDArray[np.intp]:
    """Return at most `limit` row indices, evenly spaced, with the first and the last of `rows` rows."""
    return np.unique(np.linspace(0, rows - 1, min(rows, limit)).round().astype(np.intp))


def take(data: Any, rows: NDArray[np.intp], columns: Sequence[int] | None = None) -> Array:
    """Return the given `rows` (increasing) and `columns` of an array or HDF5 dataset (T, B, ...)."""
    wanted = slice(None) if columns is None else np.asarray(columns, dtype=np.intp)
    if not len(rows):
        return np.asarray(data[:0], dtype=np.float64)[:, wanted]
    per_chunk = (getattr(data, "chunks", None) or (1,))[0]
    parts = []
    if len(rows) * per_chunk < data.shape[0]:  # sparse rows are read one at a time
        parts = [np.asarray(data[row : row + 1], dtype=np.float64)[:, wanted] for row in rows.tolist()]
    else:
        for block in blocks(data.shape[0], int(np.prod(data.shape[1:]))):
            inside = rows[(rows >= block.start) & (rows < block.stop)] - block.start
            if len(inside):
                parts.append(np.asarray(data[block], dtype=np.float64)[inside][:, wanted])
    return np.concatenate(parts)


def errors_at(accuracy: Accuracy, errors: Array, time: Array) -> Array:
    """Return the estimated errors at the times of a picture.

    They are those of the last recorded row at or before each time. After `Accuracy.known_until` they are nan, even for
    joints or bodies whose errors are known longer.

    Parameters
    ----------
    errors
        (T, ...) errors of the recorded rows.
    time
        (K,) times of the picture [s].
    """
    rows = np.searchsorted(accuracy.time, time, side="right") - 1
    values = np.array(errors[rows], dtype=np.float64)
    values[rows >= accuracy.rows_known] = np.nan
    return values


def band_over_time(time: Array, low: Array, high: Array, error: Array) -> Array | None:
    """Return the outline (2 R, 2) of the error band around a curve at its R times with known errors; None if there are
    none.

    Parameters
    ----------
    time, low, high
        (K,) times [s] and the smallest and largest value at each of them.
    error
        (K,) error of the values, nan where unknown.
    """
    known = np.isfinite(low - error) & np.isfinite(high + error)
    if not np.any(known):
        return None
    lower = np.stack([time[known], (low - error)[known]], axis=-1)
    return np.concatenate([lower, np.stack([time[known], (high + error)[known]], axis=-1)[::-1]])


def band_along_path(path: Array, error: Array) -> Array | None:
    """Return the outline of a band along a path (K, 2) [m], which extends on both sides by the error (K,) of its points
    [m], nan where unknown; None if the error is known at fewer than two points.
    """
    known = np.isfinite(error) & np.all(np.isfinite(path), axis=1)
    if np.sum(known) < 2:
        return None
    points, width = path[known], error[known, None]
    along = np.gradient(points, axis=0)
    length = np.hypot(along[:, 0], along[:, 1])[:, None]
    across = np.divide(along[:, ::-1] * [-1.0, 1.0], length, out=np.zeros_like(along), where=length > 0) * width
    return np.concatenate([points - across, (points + across)[::-1]])
