"""Checkpoints in the ``.part`` of a run: the state from which the run continues, in two slots written in turn.

A slot is an array of bytes of fixed size. Rewriting it changes no other byte of the file, and while one slot is
written, the other one keeps the checkpoint before. A slot begins with its length and its SHA-256, so that a slot that
was not written to its end is recognized. The state is stored as JSON, with the values of its arrays behind it.

HDF5 keeps no journal: a process that is killed while HDF5 rearranges its tables can leave a file that cannot be read. A
checkpoint therefore holds a copy of all bytes of the file except the rows (`FileImage`). HDF5 never moves rows, so that
writing these bytes back returns the file to the checkpoint. `found_in` finds slots without the help of HDF5.
"""

from __future__ import annotations

import hashlib
import json
import mmap
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mbdkit.archive.layout import CHECKPOINT

SLOTS = ("first", "second")

_MAGIC = b"mbdkit checkpoint 1\n"
_HEADER = len(_MAGIC) + 8 + hashlib.sha256().digest_size

_ROOM = 1.5
"""Size of a new slot, relative to the first checkpoint in it: factors with more fill-in make later ones larger."""

_MOST_FOUND = 64
"""Slots that are looked at in a damaged file; a file has two, and places of former ones."""

_ARRAY = "array"
_KINDS = frozenset({"<f8", "<i8", "<c16", "|u1"})


@dataclass(frozen=True)
class FileImage:
    """All bytes of a flushed file except those of rows and slots.

    Parameters
    ----------
    size
        Size of the file [bytes].
    ranges
        (K, 2) start and end of each stretch of bytes.
    content
        These bytes, one stretch after another, compressed by zlib: the tables of HDF5 are mostly zeros.
    """

    size: int
    ranges: np.ndarray
    content: np.ndarray

    @classmethod
    def of(cls, file: h5py.File, path: Path) -> FileImage:
        """Return the image of an open file that is flushed."""
        rows: list[tuple[int, int]] = []

        def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
            if not isinstance(item, h5py.Dataset):
                return
            if item.chunks is not None:
                item.id.chunk_iter(lambda chunk: rows.append((chunk.byte_offset, chunk.byte_offset + chunk.size)))
            elif name.startswith(f"{CHECKPOINT}/") and (start := item.id.get_offset()) is not None:
                rows.append((start, start + item.nbytes))

        file.visititems(visit)
        size = int(file.id.get_filesize())
        held = np.array(sorted(rows), np.int64).reshape(-1, 2)
        ranges = np.column_stack([np.append(0, held[:, 1]), np.append(held[:, 0], size)])
        ranges = ranges[ranges[:, 0] < ranges[:, 1]]
        parts = []
        with path.open("rb", buffering=0) as stream:
            for start, end in ranges.tolist():
                stream.seek(start)
                parts.append(stream.read(end - start))
        return cls(size, ranges, np.frombuffer(zlib.compress(b"".join(parts), 1), np.uint8))

    def write_to(self, path: Path) -> None:
        """Return a file to this image; raise ValueError if the image does not fit the file."""
        lengths = self.ranges[:, 1] - self.ranges[:, 0]
        if np.any(lengths < 0) or np.any(self.ranges < 0) or np.any(self.ranges > self.size):
            raise ValueError("a stretch is not in the file")
        total = int(np.sum(lengths))
        if not total <= self.size <= path.stat().st_size:
            raise ValueError("the file is smaller than at its checkpoint")
        content = zlib.decompressobj().decompress(self.content.tobytes(), max(1, total))
        if len(content) != total:
            raise ValueError("a stretch has another length")
        place = 0
        with path.open("r+b") as stream:
            for (start, _), length in zip(self.ranges.tolist(), lengths.tolist(), strict=True):
                stream.seek(start)
                stream.write(content[place : place + length])
                place += length
            stream.truncate(self.size)


@dataclass(frozen=True)
class Checkpoint:
    """What a run needs to continue.

    Parameters
    ----------
    number
        Checkpoints of a run are numbered from 1.
    rows
        Number of rows of each growing axis of the layout.
    lines
        The lines of these rows for `data_sha256`, sorted.
    state
        Nested mappings and lists of arrays, numbers, strings and None.
    image
        The file at the checkpoint.
    """

    number: int
    rows: Mapping[str, int]
    lines: tuple[str, ...]
    state: Mapping[str, Any]
    image: FileImage

    def encoded(self) -> bytes:
        """Return the bytes of a slot."""
        arrays: list[np.ndarray] = []
        content = {"number": self.number, "rows": dict(self.rows), "lines": list(self.lines)}
        parts = {"state": self.state, "image": vars(self.image)}
        text = json.dumps(content | _without_arrays(parts, arrays)).encode()
        body = b"".join([len(text).to_bytes(8, "little"), text, *(array.tobytes() for array in arrays)])
        return b"".join([_MAGIC, len(body).to_bytes(8, "little"), hashlib.sha256(body).digest(), body])

    @classmethod
    def decoded(cls, content: bytes) -> Checkpoint | None:
        """Return the checkpoint in the bytes of a slot; None if they do not hold a whole one."""
        if len(content) < _HEADER or not content.startswith(_MAGIC):
            return None
        size = int.from_bytes(content[len(_MAGIC) : len(_MAGIC) + 8], "little")
        digest, body = content[len(_MAGIC) + 8 : _HEADER], content[_HEADER : _HEADER + size]
        if len(body) != size or hashlib.sha256(body).digest() != digest:
            return None
        try:
            end = 8 + int.from_bytes(body[:8], "little")
            found = json.loads(body[8:end])
            reader = _Reader(body, end)
            state, image = (_with_arrays(found[name], reader) for name in ("state", "image"))
            rows = {str(dim): int(count) for dim, count in found["rows"].items()}
            return cls(int(found["number"]), rows, tuple(map(str, found["lines"])), state, _image_of(image))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            return None  # the hash is right, so that someone has made it


def _image_of(stored: Any) -> FileImage:
    """Return an image from its stored parts; raise ValueError if it is none."""
    ranges, content = stored["ranges"], stored["content"]
    if ranges.dtype != np.int64 or ranges.ndim != 2 or ranges.shape[1] != 2 or content.dtype != np.uint8:
        raise ValueError("not an image of a file")
    return FileImage(int(stored["size"]), ranges, content)


class _Reader:
    """Takes arrays one after another from the bytes behind the JSON."""

    def __init__(self, body: bytes, place: int):
        self.body, self.place = body, place

    def take(self, kind: str, shape: list[int]) -> np.ndarray:
        if kind not in _KINDS or any(not isinstance(size, int) or size < 0 for size in shape):
            raise ValueError("not an array of numbers")
        count = int(np.prod(shape, dtype=object))
        values = np.frombuffer(self.body, kind, count, self.place) if count else np.zeros(0, kind)
        self.place += values.nbytes
        return values.reshape(shape).copy()


def _without_arrays(value: Any, arrays: list[np.ndarray]) -> Any:
    """Return a state as JSON values; append its arrays to `arrays`."""
    match value:
        case np.ndarray():
            if value.dtype.str not in _KINDS:
                raise TypeError(f"arrays of {value.dtype} cannot be stored in a checkpoint")
            arrays.append(np.ascontiguousarray(value))
            return {_ARRAY: [value.dtype.str, list(value.shape)]}
        case Mapping():
            return {name: _without_arrays(one, arrays) for name, one in value.items()}
        case list() | tuple():
            return [_without_arrays(one, arrays) for one in value]
        case bool() | int() | float() | str() | None:
            return value
    raise TypeError(f"values of the type {type(value).__name__} cannot be stored in a checkpoint")


def _with_arrays(value: Any, reader: _Reader) -> Any:
    """Return a state from JSON values, with its arrays in the order in which `_without_arrays` met them."""
    match value:
        case dict():
            if value.keys() == {_ARRAY}:
                return reader.take(*value[_ARRAY])
            return {name: _with_arrays(one, reader) for name, one in value.items()}
        case list():
            return [_with_arrays(one, reader) for one in value]
    return value


class Slots:
    """Writes the checkpoints of one run into its open ``.part``."""

    def __init__(self, file: h5py.File):
        self._file = file

    def has_room(self, number: int, size: int) -> bool:
        """Return whether the slot of checkpoint `number` exists and holds `size` bytes."""
        slot = self._file.get(f"{CHECKPOINT}/{SLOTS[number % 2]}")
        return slot is not None and len(slot) >= size

    @property
    def exist(self) -> bool:
        """Whether the file has slots."""
        return CHECKPOINT in self._file

    def make_room(self, number: int, size: int) -> None:
        """Make the slot of checkpoint `number` hold `size` bytes; the other slot, if there is one, remains."""
        group = self._file.require_group(CHECKPOINT)
        group.pop(SLOTS[number % 2], None)
        for name in SLOTS:
            if name not in group:
                slot = group.create_dataset(name, (int(_ROOM * size),), np.uint8)
                slot[-1] = 0  # so that its place in the file is fixed

    def write(self, number: int, content: bytes) -> None:
        """Write the bytes of checkpoint `number`; the checkpoint before it remains."""
        self._file[CHECKPOINT][SLOTS[number % 2]][: len(content)] = np.frombuffer(content, np.uint8)

    def remove(self) -> None:
        """Remove the checkpoints; HDF5 uses their place for what it writes later."""
        del self._file[CHECKPOINT]


def checkpoints(file: h5py.File) -> list[Checkpoint]:
    """Return the whole checkpoints of a ``.part``, the newest first."""
    found = []
    group = file.get(CHECKPOINT)
    for name in SLOTS if isinstance(group, h5py.Group) else ():
        slot = group.get(name)
        if isinstance(slot, h5py.Dataset) and slot.dtype == np.uint8 and slot.ndim == 1:
            found.append(Checkpoint.decoded(slot[:].tobytes()))
    return _newest_first(found)


def found_in(path: Path) -> list[Checkpoint]:
    """Return the whole checkpoints of a file that HDF5 may be unable to read, the newest first."""
    found: list[Checkpoint | None] = []
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        at = content.find(_MAGIC)
        while at >= 0 and len(found) < _MOST_FOUND:
            size = int.from_bytes(content[at + len(_MAGIC) : at + len(_MAGIC) + 8], "little")
            found.append(Checkpoint.decoded(content[at : at + _HEADER + size]))
            at = content.find(_MAGIC, at + 1)
    return _newest_first(found)


def _newest_first(found: Iterable[Checkpoint | None]) -> list[Checkpoint]:
    return sorted((one for one in found if one is not None), key=lambda one: -one.number)
