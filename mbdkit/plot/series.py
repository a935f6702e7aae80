"""Long recordings cut down to what a picture can show, read block by block so that memory stays bounded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbdkit.errors import SpecError

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

Array = NDArray[np.float64]
BLOCK = 4_000_000  # numbers read at a time
BEYOND = 1e150  # a run that has come to such numbers has failed, and no axis holds their squares
POINTS = 2_000  # points of a curve; more cannot be told apart at the pictures' size


@dataclass(frozen=True)
class Bands:
    """Several curves, cut into at most a few thousand bands of rows.

    Parameters
    ----------
    time
        Time of each band [s], shape (K,).
    low, high
        Smallest and largest value of each curve in each band, shape (K, J); the same where no rows were joined, nan
        where nothing is finite.
    peaks
        Largest magnitude of each curve over all rows, shape (J,); nan where there is no finite value.
    exact
        Every band is one row.
    """

    time: Array
    low: Array
    high: Array
    peaks: Array
    exact: bool

    def curve(self, column: int) -> tuple[Array, Array]:
        """Return times and values of one curve; where rows were joined it runs through both ends of each band."""
        if self.exact:
            return self.time, self.high[:, column]
        pairs = np.stack([self.low[:, column], self.high[:, column]], axis=1)
        pairs[1::2] = pairs[1::2, ::-1]
        return np.repeat(self.time, 2), pairs.reshape(-1)


def require_rows(run: Run) -> None:
    """Refuse a run that crashed before it recorded anything.

    Raises
    ------
    SpecError
        The run has no rows.
    """
    if not len(run.time):
        raise SpecError("this run recorded no rows, so there is nothing to draw")


def blocks(rows: int, width: int) -> Iterator[slice]:
    """Cut `rows` rows of `width` numbers into slices that fit in memory."""
    size = max(1, BLOCK // max(1, width))
    for start in range(0, rows, size):
        yield slice(start, min(start + size, rows))


def bands(time: Array, data: Any, values: Callable[[Array], Array] = np.asarray, points: int = POINTS) -> Bands:
    """Read an array (T, J, ...) and return its curves in bands.

    Parameters
    ----------
    time
        Times of the rows [s], shape (T,).
    data
        Array or HDF5 dataset, shape (T, J, ...).
    values
        Turns a block of rows into the J values of each row, such as a norm over the last axis.
    points
        Number of bands of a few curves; fewer are kept of many curves.
    """
    rows, curves = data.shape[0], data.shape[1]
    count = min(rows, points, max(200, BLOCK // max(1, curves)))
    edges = np.linspace(0, rows, count + 1).astype(np.intp)
    low, high = np.full((count, curves), np.inf), np.full((count, curves), -np.inf)
    for block in blocks(rows, int(np.prod(data.shape[1:]))):
        part = values(np.asarray(data[block], dtype=np.float64))
        finite = np.abs(part) < BEYOND  # false for nan as well
        first, last = np.searchsorted(edges, [block.start, block.stop - 1], side="right") - 1
        starts = np.maximum(edges[first : last + 1], block.start) - block.start
        here = slice(first, last + 1)
        low[here] = np.minimum(low[here], np.minimum.reduceat(np.where(finite, part, np.inf), starts))
        high[here] = np.maximum(high[here], np.maximum.reduceat(np.where(finite, part, -np.inf), starts))
    empty = high < low
    low[empty] = high[empty] = np.nan
    middle = time[edges[:-1]] if count == rows else (time[edges[:-1]] + time[edges[1:] - 1]) / 2
    magnitude = np.where(empty, -1.0, np.maximum(np.abs(low), np.abs(high)))
    peaks = np.max(magnitude, axis=0, initial=-1.0)
    peaks[peaks < 0] = np.nan
    return Bands(middle, low, high, peaks, exact=count == rows)


def evenly(rows: int, limit: int) -> NDArray[np.intp]:
    """Return at most `limit` row numbers out of `rows`, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, rows - 1, min(rows, limit)).round().astype(np.intp))


def take(data: Any, rows: NDArray[np.intp], columns: Sequence[int] | None = None) -> Array:
    """Return the given `rows` (increasing) and `columns` of an array or HDF5 dataset (T, B, ...)."""
    wanted = slice(None) if columns is None else np.asarray(columns, dtype=np.intp)
    if not len(rows):
        return np.asarray(data[:0], dtype=np.float64)[:, wanted]
    per_chunk = (getattr(data, "chunks", None) or (1,))[0]
    parts = []
    if len(rows) * per_chunk < data.shape[0]:  # far between: each by itself
        parts = [np.asarray(data[row : row + 1], dtype=np.float64)[:, wanted] for row in rows.tolist()]
    else:
        for block in blocks(data.shape[0], int(np.prod(data.shape[1:]))):
            inside = rows[(rows >= block.start) & (rows < block.stop)] - block.start
            if len(inside):
                parts.append(np.asarray(data[block], dtype=np.float64)[inside][:, wanted])
    return np.concatenate(parts)
