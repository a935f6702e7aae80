"""A finished run in memory, without HDF5: what its archive would contain, and the hash that it would have."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from hashlib import sha256
from itertools import repeat
from types import MappingProxyType
from typing import Any

import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.fingerprint import beginning, text_bytes
from mbdkit.archive.run_writer import Ending, RunWriter, SharedForces, name_lines, utc_now
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base.frozen import dataclass
from mbdkit.quantities.array import GROWING, TEXT, Array
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.registered_kinds import sizes_of


@dataclass(frozen=True, eq=False, kw_only=True)
class FinishedRun(Ending):
    """A finished run: how it has ended, and what it has recorded.

    - `names`: names of the mechanism's bodies, joints and other elements.
    - `layout`: the arrays of the archive's layout that the run recorded, including those of names.
    - `arrays`: values of the arrays with rows, by `Array.key`: ``time`` (T,), ``trajectory/position`` (T, B, 3), ...
    - `shared`: description of the reactions of redundant joints; None without redundant joints.
    - `data_sha256`: hash of the arrays, equal to that of the archive of this run.
    - `assembly`: sentence on how the start was made consistent.
    """

    names: ArchiveNames
    layout: tuple[Array, ...]
    arrays: Mapping[str, np.ndarray]
    shared: SharedForces | None
    data_sha256: str
    assembly: str = ""

    def rows(self, dim: str) -> int:
        """Return the number of rows along a growing axis of the layout; 0 if there is no such array."""
        return next((len(self.arrays[array.key]) for array in self.layout if array.dims[0] == dim and array.grows), 0)

    def write(self, writer: ArchiveWriter) -> None:
        """Append the rows of all arrays to an archive that was begun for them; the caller finishes the archive."""
        for dim in GROWING:
            if keys := [array.key for array in self.layout if array.grows and array.dims[0] == dim]:
                writer.take(dim, {key: self.arrays[key] for key in keys})


class ArrayWriter(RunWriter):
    """Stores the rows of a run in memory.

    - `names`, `arrays`: see `RunWriter`.
    - `shared`: see `ArchiveWriter`.
    - `assembly`: sentence on how the start was made consistent.
    - `finished`: the run, once it is finished.
    - `created_utc`: time at which the run began, ISO 8601.
    """

    def __init__(
        self, names: ArchiveNames, arrays: tuple[Array, ...], *, shared: SharedForces | None = None, assembly: str = ""
    ):
        super().__init__(names, arrays)
        self._shared, self._assembly = shared, assembly
        self._keys = {
            dim: tuple(dict.fromkeys(array.key for array in self.arrays if array.grows and array.dims[0] == dim))
            for dim in GROWING
        }
        growing, sizes = [array for array in self.arrays if array.grows], sizes_of(names)
        types = {array.key: np.dtype(object if array.dtype == TEXT else array.dtype) for array in growing}
        shapes = {array.key: tuple(sizes[dim] for dim in array.dims[1:]) for array in growing}
        self._buffers = {key: np.empty((0, *shape), types[key]) for key, shape in shapes.items()}
        self._rows = dict.fromkeys(GROWING, 0)
        self._capacity = dict.fromkeys(GROWING, 0)
        self.finished: FinishedRun | None = None
        self.created_utc = utc_now()

    @property
    def row_keys(self) -> frozenset[str]:
        """Keys that `append` requires."""
        return frozenset(self._keys["time"])

    def rows(self, dim: str) -> int:
        """Return the number of rows along a growing axis."""
        return self._rows[dim]

    def take(self, dim: str, rows: Mapping[str, np.ndarray]) -> None:
        """Append rows of the arrays that grow along `dim`, by key; the values are copied."""
        keys, begin = self._keys[dim], self._rows[dim]
        end = begin + (len(rows[keys[0]]) if keys else 0)
        if end > self._capacity[dim]:
            self._resize(dim, max(end, 2 * self._capacity[dim]) if begin else end)
        for key in keys:
            self._buffers[key][begin:end] = rows[key]
        self._rows[dim] = end

    def _resize(self, dim: str, capacity: int) -> None:
        for key in self._keys[dim]:
            buffer = self._buffers[key]
            buffer.resize((capacity, *buffer.shape[1:]), refcheck=False)  # there are no views of the buffer
        self._capacity[dim] = capacity

    def flush_if_due(self) -> None:
        """Do nothing: there is no file."""

    def abandon(self) -> None:
        """Discard the rows."""
        self._buffers = {}

    def finish(self, ending: Ending) -> FinishedRun:
        """Compute the hash of the rows, and return the run."""
        started = time.perf_counter()
        for dim, rows in self._rows.items():
            self._resize(dim, rows)
        arrays, self._buffers = self._buffers, {}
        self.finished = FinishedRun(
            **vars(ending) | {"stats": {**ending.stats, "finish_s": time.perf_counter() - started}},
            names=self.names,
            layout=self.arrays,
            arrays=arrays,
            shared=self._shared,
            data_sha256=array_hash(self.names, self.arrays).of(arrays),
            assembly=self._assembly,
        )
        return self.finished


_EMPTY = sha256()  #: A copy of it takes half the time of a new one.


def _digest(values: Any) -> str:
    own = _EMPTY.copy()
    own.update(values)
    return own.hexdigest()


class ArrayHash:
    """Computes `data_sha256` for runs that record the same arrays and whose mechanisms have the same names.

    `names`: names of bodies, joints and other elements. `recorded`: arrays of the layout that the runs record,
    including those of names.
    """

    def __init__(self, names: ArchiveNames, recorded: Sequence[Array]):
        hashed = [array for array in recorded if array.grows and layout.is_hashed(array.path)]
        lines: list[tuple[str, Array | None]] = [(name, None) for name in name_lines(names, tuple(recorded))]
        lines += [(f"{array.path} ", array) for array in hashed]
        #: For each hashed array, in the order of their paths: lines of names that precede its line, path, key and type.
        self._arrays: list[tuple[str, str, str, str]] = []
        self._dims = {array.key: array.dims[0] for array in hashed}
        self._rest = ""
        self._shared: dict[str, tuple[np.ndarray, str]] | None = None
        self._latest: tuple[tuple[tuple[int, ...], ...] | None, Sequence[tuple[str, str, bool]]] = None, []
        for name, array in sorted(lines, key=lambda item: item[0]):
            if array is None:
                self._rest += name
            else:
                self._arrays.append((self._rest, array.path, array.key, array.dtype))
                self._rest = ""

    def shared_digests(self, arrays: Mapping[str, np.ndarray]) -> dict[str, str]:
        """Return the digests of arrays that are equal in all of several runs, such as the times; they are computed only
        once.

        `arrays`: contiguous numbers (R, ...) of the R runs by `Array.key`, with the same keys in every call. Arrays
        that differed between runs in the first call are not compared again.
        """
        first, self._shared = self._shared is None, self._shared or {}
        for key in list(arrays if first else self._shared):
            bits = arrays[key].view(np.int64)  # compared bitwise: nan equals itself, and 0.0 differs from -0.0
            if key in self._shared and (bits == self._shared[key][0]).all():
                continue
            if (first or len(bits) > 1) and (bits == bits[:1]).all():
                self._shared[key] = bits[0].copy(), sha256(arrays[key][0].data).hexdigest()
            else:
                self._shared.pop(key, None)
        return {key: digest for key, (_, digest) in self._shared.items()}

    def of(self, arrays: Mapping[str, np.ndarray], known: Mapping[str, str] = MappingProxyType({})) -> str:
        """Return the hash of a run from its contiguous arrays by `Array.key`.

        `known`: known digests of arrays, by key; arrays that several runs share are then hashed only once.
        """
        digests, parts = dict(known), list[str]()
        for before, key, is_text in self._lines(tuple([arrays[key].shape for _, _, key, _ in self._arrays])):
            if (digest := digests.get(key)) is None:
                values = arrays[key]
                digests[key] = digest = sha256(text_bytes(values) if is_text else values.data).hexdigest()
            parts += before, digest
        return sha256("".join([*parts, "\n" * bool(parts), self._rest]).encode()).hexdigest()

    def of_runs(
        self, arrays: Mapping[str, np.ndarray], lengths: Mapping[str, np.ndarray], known: Mapping[str, str]
    ) -> list[str]:
        """Return the hashes of R runs from their contiguous arrays (R, T, ...), of which each run has some first rows.

        `lengths`: (R,) numbers of rows by growing axis. `known`: digests of arrays that are equal in all runs, by key.
        """
        keys, count = [key for _, _, key, _ in self._arrays], len(next(iter(lengths.values())))
        rows = {dim: {*values.tolist()} for dim, values in lengths.items()}
        if any(rows[self._dims[key]] != {arrays[key].shape[1]} for key in keys):
            ends = {key: lengths[self._dims[key]].tolist() for key in keys}
            return [self.of({key: arrays[key][run, : ends[key][run]] for key in keys}) for run in range(count)]
        digests: dict[str, Iterable[str]] = {key: repeat(digest) for key, digest in known.items()}
        columns: list[Iterable[Any]] = []
        for before, key, is_text in self._lines(tuple([arrays[key].shape[1:] for key in keys])):
            if key not in digests:
                data = map(text_bytes, arrays[key]) if is_text else arrays[key]
                digests[key] = [_digest(values) for values in data]
            columns += repeat(before), digests[key]
        columns += repeat("\n" * bool(columns) + self._rest), range(count)
        return [_digest("".join(parts[:-1]).encode()) for parts in zip(*columns, strict=False)]

    def _lines(self, shapes: tuple[tuple[int, ...], ...]) -> Sequence[tuple[str, str, bool]]:
        """Return, for arrays with these shapes, the text between two digests, the key, and whether the array contains
        texts. The result is cached, because runs often have equal shapes.
        """
        latest = self._latest
        if latest[0] != shapes:
            lines, end = [], ""
            for (names, path, key, dtype), shape in zip(self._arrays, shapes, strict=True):
                lines.append((f"{end}{names}{beginning(path, dtype, shape)} ", key, dtype == TEXT))
                end = "\n"
            self._latest = latest = shapes, lines
        return latest[1]


array_hash = lru_cache(maxsize=16)(ArrayHash)  #: The hash of arrays of a layout, which several runs share.
