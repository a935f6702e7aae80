"""Growing arrays: rows are copied into buffers of memory and go to the file in large pieces."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence

import h5py
import numpy as np

from mbdkit.archive.fingerprint import line, text_bytes
from mbdkit.archive.hdf5 import create
from mbdkit.archive.layout import TEXT, Array, is_timing

#: Rows wait in memory until they fill this much, or a flush is due.
BUFFER_BYTES = 1 << 23

#: A chunk holds what the first flush brought (about a second of the run), within these bounds, and at least one row.
CHUNK_BYTES = (1 << 14, 1 << 17)

FIRST_ROWS = 256

#: What HDF5 itself needs in the file for an array, as it grows, at most.
_OVERHEAD_BYTES = 1 << 12


class Series:
    """One growing array: its dataset, once there is one, and the hash of the rows it took.

    Parameters
    ----------
    array
        Its entry in the layout.
    row_shape
        The shape of one row.
    """

    def __init__(self, array: Array, row_shape: tuple[int, ...]):
        self.array = array
        self.row_shape = row_shape
        self.dtype = np.dtype(object if array.dtype == TEXT else array.dtype)
        self.row_bytes = self.dtype.itemsize * int(np.prod(row_shape))
        self.dataset: h5py.Dataset | None = None
        self._rows = 0
        self._sha = None if is_timing(array.path) else hashlib.sha256()

    def create(self, file: h5py.File, values: np.ndarray, *, more: bool) -> None:
        """Create the dataset with its first rows: of that size where no `more` will come, otherwise in chunks."""
        chunks = (self._chunk_rows(len(values)), *(max(1, size) for size in self.row_shape)) if more else None
        self.dataset = create(file, self.array, values, chunks=chunks)
        self._took(values)

    def _chunk_rows(self, first: int) -> int:
        low, high = CHUNK_BYTES
        row = max(1, self.row_bytes)
        return max(1, min(max(first * row, low), high) // row)

    def size_on_disk(self, rows: int, *, more: bool) -> int:
        """Return about how many bytes `rows` more rows take in the file, a chunk begun and HDF5's own included."""
        begun = self._chunk_rows(rows) * self.row_bytes if more or self.dataset is not None else 0
        return rows * self.row_bytes + begun + _OVERHEAD_BYTES

    def extend(self, values: np.ndarray, start: int) -> None:
        """Write the rows from row `start` on; those that an interrupted `write` wrote already are left alone."""
        assert self.dataset is not None
        new = values[self._rows - start :]
        if len(new):
            self.dataset.resize(self._rows + len(new), axis=0)
            self.dataset[self._rows :] = new
            self._took(new)

    def _took(self, values: np.ndarray) -> None:
        if self._sha is not None:
            self._sha.update(text_bytes(values) if self.array.dtype == TEXT else values.data)
        self._rows += len(values)

    def line(self) -> str | None:
        """Return the line of the array in the byte stream of the hash; None for a timing."""
        if self._sha is None:
            return None
        return line(self.array.path, self.array.dtype, (self._rows, *self.row_shape), self._sha.hexdigest())


class Table:
    """Arrays that grow together along one axis, with a buffer for each.

    Parameters
    ----------
    arrays
        Their entries in the layout.
    sizes
        The length of every axis that does not grow.
    on_full
        Called when the buffers are full; it calls `write`.
    """

    def __init__(self, arrays: Sequence[Array], sizes: Mapping[str, int], on_full: Callable[[], None]):
        # Scales come first: the other arrays are attached to them as they are made.
        ordered = sorted(arrays, key=lambda array: not array.is_scale)
        self.series = [Series(array, tuple(sizes[dim] for dim in array.dims[1:])) for array in ordered]
        self.keys = frozenset(series.array.key for series in self.series)
        self._of_key = {series.array.key: series for series in self.series}
        row_bytes = sum(series.row_bytes for series in self._of_key.values())
        self._limit = max(1, BUFFER_BYTES // row_bytes)
        self._capacity = 0
        self._buffers: dict[str, np.ndarray] = {}
        self._grow(min(FIRST_ROWS, self._limit))
        self._on_full = on_full
        self.written = 0
        self.waiting = 0

    @property
    def rows(self) -> int:
        """How many rows there are, written or waiting."""
        return self.written + self.waiting

    def append(self, rows: Mapping[str, np.ndarray]) -> None:
        """Copy rows into the buffers.

        Parameters
        ----------
        rows
            For every key of `keys` an array of the same number of rows.
        """
        missing = self.keys - rows.keys()
        if missing:
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
            self.waiting = end  # only now do the rows count: an interruption before leaves whole rows
            start = stop

    def _grow(self, capacity: int) -> None:
        for key, series in self._of_key.items():
            buffer = np.empty((capacity, *series.row_shape), series.dtype)
            if self._capacity:
                buffer[: self.waiting] = self._buffers[key][: self.waiting]
            self._buffers[key] = buffer
        self._capacity = capacity

    def size_on_disk(self, *, more: bool) -> int:
        """Return about how many bytes the waiting rows take in the file."""
        return sum(series.size_on_disk(self.waiting, more=more) for series in self.series)

    def write(self, file: h5py.File, *, more: bool) -> None:
        """Move the waiting rows into the file."""
        for series in self.series:
            values = self._buffers[series.array.key][: self.waiting]
            if series.dataset is None:
                series.create(file, values, more=more)
            else:
                series.extend(values, self.written)
        self.written += self.waiting
        self.waiting = 0
