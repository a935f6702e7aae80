"""``FILE.h5.part.checkpoint``: the state from which a killed run continues, and the location of its rows in the
``.part``; for an interrupted run, ``FILE.h5.checkpoint`` and the archive.

The ``.part`` is the unfinished archive of the run. A checkpoint contains the byte offsets of the rows, and all other
data that the run needs. HDF5 never moves rows, and rows written after the checkpoint do not change earlier ones. The
rows before the checkpoint can therefore be read without HDF5, even if its tables are damaged.

A checkpoint begins with its SHA-256. Its values are stored as JSON, followed by the contents of its arrays.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from mbdkit.archive.part_file import checkpoint_path, new_checkpoint_path
from mbdkit.base.errors import ArchiveError
from mbdkit.base.files import read_bytes, replace_file
from mbdkit.base.files_read import FileRead, read_files
from mbdkit.base.frozen import dataclass
from mbdkit.base.plain_data import json_data
from mbdkit.quantities.array import TEXT, Array

#: Largest size of a checkpoint [bytes]; those of long runs with many bodies have a few megabytes.
LARGEST = 1 << 30

_MAGIC = b"mbdkit checkpoint 2\n"
_HEADER = len(_MAGIC) + hashlib.sha256().digest_size

_HEAD = ("spec", "run_id", "created_utc")

_ARRAY = "array"
_KINDS = frozenset({"<f8", "<i8", "<c16", "|u1"})


#: State of a part of a run: nested mappings and lists of arrays, numbers, strings and None.
StoredState = Mapping[str, Any]


@dataclass(frozen=True)
class StoredRows:
    """Location of the rows of a growing array in a ``.part`` file.

    `row_shape`: shape of one row. `chunk_rows`: number of rows in a chunk. `offsets`: byte offset of each chunk in the
    file. `texts`: the rows themselves if they are strings, because HDF5 does not reveal where it stores strings.
    """

    row_shape: tuple[int, ...]
    chunk_rows: int
    offsets: np.ndarray
    texts: tuple[str, ...]

    @classmethod
    def of(cls, dataset: h5py.Dataset) -> StoredRows:
        """Return the locations of the rows of a flushed array."""
        if h5py.check_string_dtype(dataset.dtype) is not None:
            return cls((), 1, np.zeros(0, np.int64), tuple(dataset.asstr()[:]))
        places: list[tuple[int, int]] = []
        dataset.id.chunk_iter(lambda chunk: places.append((chunk.chunk_offset[0], chunk.byte_offset)))
        offsets = np.array([offset for _, offset in sorted(places)], np.int64)
        return cls(dataset.shape[1:], dataset.chunks[0], offsets, ())

    def read(self, part: BinaryIO, array: Array, some: slice) -> np.ndarray:
        """Return the rows `some` of `array` from the bytes of the ``.part``; the slice has a start and a stop.

        Raises ValueError or LookupError if the file does not contain these rows.
        """
        if array.dtype == TEXT:
            return np.array(self.texts[some], dtype=object)
        row_bytes = np.dtype(array.dtype).itemsize * int(np.prod(self.row_shape, dtype=object))
        if self.chunk_rows < 1 or not 0 <= row_bytes * self.chunk_rows <= os.fstat(part.fileno()).st_size:
            raise ValueError("a chunk is larger than the file")
        pieces, row = [], some.start
        while row < some.stop and row_bytes:
            chunk, first = divmod(row, self.chunk_rows)
            last = min(self.chunk_rows, first + some.stop - row)
            part.seek(int(self.offsets[chunk]) + first * row_bytes)
            pieces.append(part.read((last - first) * row_bytes))
            row += last - first
        return np.frombuffer(b"".join(pieces), array.dtype).reshape(some.stop - some.start, *self.row_shape)


@dataclass(frozen=True)
class Checkpoint:
    """The data from which a run continues.

    - `head`: ``spec``, ``run_id`` and ``created_utc`` as in the archive, its ``provenance``, and the ``files`` that
      were read for it.
    - `file`: inode number of the ``.part`` with the rows.
    - `rows`: number of rows along each growing axis of the layout.
    - `lines`: sorted lines that describe the arrays with these rows (see `fingerprint.line`). Together with the lines
      of the arrays of names, they determine `data_sha256`.
    - `arrays`: locations of the rows, by path of the array.
    - `state`: state of the run.
    """

    head: Mapping[str, Any]
    file: int
    rows: Mapping[str, int]
    lines: tuple[str, ...]
    arrays: Mapping[str, StoredRows]
    state: StoredState

    @property
    def files(self) -> tuple[FileRead, ...]:
        """The files that were read for the run."""
        return read_files(str(self.head["files"]))

    def encoded(self) -> bytes:
        """Return the bytes of the checkpoint."""
        return encoded_state({**vars(self), "arrays": {path: vars(rows) for path, rows in self.arrays.items()}})

    @classmethod
    def decoded(cls, content: bytes) -> Checkpoint | None:
        """Return the checkpoint encoded in these bytes; None if they are damaged or not a valid checkpoint."""
        try:
            values = decoded_state(content)
            return cls(
                head={
                    **{name: str(values["head"][name]) for name in _HEAD},
                    "provenance": values["head"]["provenance"],
                    **{name: values["head"][name] for name in ("files",) if name in values["head"]},
                },
                file=int(values["file"]),
                rows={str(dim): int(count) for dim, count in values["rows"].items()},
                lines=tuple(map(str, values["lines"])),
                arrays={path: _stored_rows(rows) for path, rows in values["arrays"].items()},
                state=values["state"],
            )
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            return None  # the hash is right, so the content is not damaged but forged

    def write(self, part: Path) -> None:
        """Write the checkpoint of a ``.part`` whose data are on the disk, and replace the previous one atomically."""
        new = new_checkpoint_path(part)
        new.unlink(missing_ok=True)
        try:
            with new.open("xb") as stream:
                stream.write(self.encoded())
                stream.flush()
                os.fsync(stream.fileno())
            replace_file(new, checkpoint_path(part))
            _sync_folder(part.parent)
        finally:
            new.unlink(missing_ok=True)

    @classmethod
    def of(cls, part: Path) -> Checkpoint | None:
        """Return the checkpoint of a ``.part``; None if there is none.

        Raises ArchiveError if the checkpoint is damaged. Raises SpecError if it is larger than `LARGEST`. Raises
        ResourceError if the system refuses to read it.
        """
        path = checkpoint_path(part)
        if not path.is_file():
            return None
        checkpoint = cls.decoded(read_bytes(path, LARGEST, "start the run again from the beginning"))
        if checkpoint is None:
            raise ArchiveError(
                f"{path.name} is damaged, so this run cannot be resumed; start it again from the beginning", file=part
            )
        return checkpoint


def encoded_state(state: StoredState) -> bytes:
    """Return a state as bytes: the SHA-256 of the rest, the values as JSON, and the contents of the arrays."""
    arrays: list[np.ndarray] = []
    text = json.dumps(_without_arrays(state, arrays)).encode()
    body = b"".join([len(text).to_bytes(8, "little"), text, *(array.tobytes() for array in arrays)])
    return _MAGIC + hashlib.sha256(body).digest() + body


def decoded_state(content: bytes) -> Any:
    """Return the state that `encoded_state` has returned as these bytes; None if they are damaged.

    Raises ValueError, KeyError, TypeError or RecursionError if they are forged.
    """
    digest, body = content[len(_MAGIC) : _HEADER], content[_HEADER:]
    if not content.startswith(_MAGIC) or hashlib.sha256(body).digest() != digest:
        return None
    end = 8 + int.from_bytes(body[:8], "little")
    return _with_arrays(json_data(body[8:end]), _Reader(body, end))


def _sync_folder(folder: Path) -> None:
    """Wait until files renamed in a folder have their new names on the disk, as far as the system allows."""
    with contextlib.suppress(OSError):  # Windows cannot open folders
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _stored_rows(values: Mapping[str, Any]) -> StoredRows:
    offsets, shape = values["offsets"], tuple(map(int, values["row_shape"]))
    if offsets.dtype != np.int64 or offsets.ndim != 1 or min(shape, default=0) < 0:
        raise ValueError("not the locations of rows")
    return StoredRows(shape, int(values["chunk_rows"]), offsets, tuple(map(str, values["texts"])))


class _Reader:
    def __init__(self, body: bytes, offset: int):
        self.body, self.place = body, offset

    def take(self, kind: str, shape: list[int]) -> np.ndarray:
        if kind not in _KINDS or any(not isinstance(size, int) or size < 0 for size in shape):
            raise ValueError("not an array of numbers")
        count = int(np.prod(shape, dtype=object))
        values = np.frombuffer(self.body, kind, count, self.place) if count else np.zeros(0, kind)
        self.place += values.nbytes
        return values.reshape(shape).copy()


def _without_arrays(value: object, arrays: list[np.ndarray]) -> object:
    """Return a state as JSON values; append its arrays to `arrays`."""
    match value:
        case np.ndarray():
            if value.dtype.str not in _KINDS:
                raise TypeError(f"arrays of {value.dtype} cannot be stored in a checkpoint")
            arrays.append(np.ascontiguousarray(value))
            return {_ARRAY: [value.dtype.str, list(value.shape)]}
        case Mapping():
            return {name: _without_arrays(item, arrays) for name, item in value.items()}
        case list() | tuple():
            return [_without_arrays(item, arrays) for item in value]
        case bool() | int() | float() | str() | None:
            return value
    raise TypeError(f"values of the type {type(value).__name__} cannot be stored in a checkpoint")


def _with_arrays(value: object, reader: _Reader) -> Any:
    match value:
        case dict():
            if value.keys() == {_ARRAY}:
                return reader.take(*value[_ARRAY])
            return {name: _with_arrays(item, reader) for name, item in value.items()}
        case list():
            return [_with_arrays(item, reader) for item in value]
    return value
