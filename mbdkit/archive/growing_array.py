"""Growing arrays: rows are buffered in memory and written to the file in large blocks."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence

import h5py
import numpy as np

from mbdkit.archive.fingerprint import line, text_bytes
from mbdkit.archive.hdf5 import create
from mbdkit.quantities.array import TEXT, Array

#: Size of the row buffers of a table [bytes]; they are written when they are full or when a flush is due.
BUFFER_BYTES = 1 << 23

#: Bounds of the size of a chunk [bytes]. Within these bounds, a chunk has the size of the rows of the first flush
#: (about one second of the run). A chunk holds at least one row, even if this row exceeds the upper bound.
CHUNK_BYTES = (1 << 14, 1 << 17)

FIRST_ROWS = 256


class Series:
    """One growing array: its dataset, created with the first rows, and the hash of the rows written."""

    def __init__(self, array: Array, row_shape: tuple[int, ...]):
        self.array = array
        self.row_shape = row_shape
        self.dtype = np.dtype(object if array.dtype == TEXT else array.dtype)
        self.row_bytes = self.dtype.itemsize * math.prod(row_shape)
        self.dataset: h5py.Dataset | None = None
        self._rows = 0
        self._sha = hashlib.sha256()

    def create(self, file: h5py.File, values: np.ndarray, *, more: bool) -> None:
        """Create the dataset with its first rows: chunked if more rows will follow (`more`), otherwise of fixed
        size.
        """
        chunks = (self._chunk_rows(len(values)), *(max(1, size) for size in self.row_shape)) if more else None
        self.dataset = create(file, self.array, values, chunks=chunks)
        self.take(values)

    def _chunk_rows(self, first: int) -> int:
        low, high = CHUNK_BYTES
        row = max(1, self.row_bytes)
        return max(1, min(max(first * row, low), high) // row)

    def extend(self, values: np.ndarray, start: int) -> None:
        """Write `values`, the rows from row `start` on, except for rows that an interrupted `write` has already
        written.
        """
        assert self.dataset is not None
        new = values[self._rows - start :]
        if len(new):
            self.dataset.resize(self._rows + len(new), axis=0)
            self.dataset[self._rows :] = new
            self.take(new)

    def take(self, values: np.ndarray) -> None:
        """Add rows to the hash."""
        self._sha.update(text_bytes(values) if self.array.dtype == TEXT else values.data)
        self._rows += len(values)

    def line(self) -> str:
        """Return the line of the array in the hashes."""
        return line(self.array.path, self.array.dtype, (self._rows, *self.row_shape), self._sha.hexdigest())


class Table:
    """Arrays that grow together along one axis, with one buffer per array.

    `sizes`: lengths of the axes that do not grow, by name. `on_full`: called when the buffers are full; it must call
    `write`.
    """

    def __init__(self, arrays: Sequence[Array], sizes: Mapping[str, int], on_full: Callable[[], None]):
        # Dimension scales come first because the other arrays are attached to them on creation.
        ordered = sorted(arrays, key=lambda array: not array.is_scale)
        self.series = [Series(array, tuple(sizes[dim] for dim in array.dims[1:])) for array in ordered]
        self.keys = frozenset(series.array.key for series in self.series)
        self._of_key = {series.array.key: series for series in self.series}
        self._limit = max(1, BUFFER_BYTES // sum(series.row_bytes for series in self._of_key.values()))
        self._capacity = 0
        self._buffers: dict[str, np.ndarray] = {}
        self._grow(min(FIRST_ROWS, self._limit))
        self._on_full = on_full
        self.written = 0
        self.waiting = 0

    @property
    def rows(self) -> int:
        """Number of rows, written or buffered."""
        return self.written + self.waiting

    def append(self, rows: Mapping[str, np.ndarray]) -> None:
        """Copy rows into the buffers. `rows`: one array for each key in `keys`, all with the same number of rows."""
        if missing := self.keys - rows.keys():
            raise ValueError(f"rows lack {', '.join(sorted(missing))}")
        values = {key: np.asarray(rows[key]) for key in self.keys}
        count = len(next(iter(values.values())))
        for key, value in values.items():
            if value.shape != (count, *self._of_key[key].row_shape):
                raise ValueError(f"{key} has shape {value.shape}, not {(count, *self._of_key[key].row_shape)}")
        start = 0
        while start < count:
            if self.waiting == self._limit:
                self._on_full()
            stop = min(count, start + self._limit - self.waiting)
            end = self.waiting + stop - start
            if end > self._capacity:
                self._grow(min(self._limit, max(end, 2 * self._capacity)))
            for key, value in values.items():
                self._buffers[key][self.waiting : end] = value[start:stop]
            self.waiting = end  # set last, so that an interrupted append leaves no incomplete rows
            start = stop

    def _grow(self, capacity: int) -> None:
        for key, series in self._of_key.items():
            buffer = np.empty((capacity, *series.row_shape), series.dtype)
            if self._capacity:
                buffer[: self.waiting] = self._buffers[key][: self.waiting]
            self._buffers[key] = buffer
        self._capacity = capacity

    def taken(self) -> dict[str, np.ndarray]:
        """Return the buffered rows by path, and count them as written.

        This is for an archive that is written as a whole, so that no row has been written before.
        """
        values = {series.array.path: self._buffers[series.array.key][: self.waiting] for series in self.series}
        for series in self.series:
            series.take(values[series.array.path])
        self.written, self.waiting = self.waiting, 0
        return values

    def write(self, file: h5py.File, *, more: bool) -> None:
        """Move the buffered rows into the file."""
        for series in self.series:
            values = self._buffers[series.array.key][: self.waiting]
            if series.dataset is None:
                series.create(file, values, more=more)
            else:
                series.extend(values, self.written)
        self.written += self.waiting
        self.waiting = 0
