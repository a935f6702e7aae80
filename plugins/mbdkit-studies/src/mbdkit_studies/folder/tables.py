"""Columns of tables with one row per run: numbers, texts and hashes, written and read as whole arrays.

A column of texts is stored as indices into an array of the distinct texts, because in tables of runs few texts differ;
the attribute `texts` of the numbers names the array of texts. A column of hashes is an array of bytes.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from h5py import h5p

from mbdkit.archive.fingerprint import is_text
from mbdkit.archive.hdf5 import create, set_text
from mbdkit.archive.part_file import LIBVER
from mbdkit.base.errors import ArchiveError, FormatVersionError
from mbdkit.quantities.array import INTEGER, TEXT, Array

#: Compression level of deflate; higher levels take longer, but reduce the size by only a few per cent.
_LEVEL = 4

SMALL = 4096  #: Arrays with fewer bytes are not compressed.

#: Size of a compressed chunk [bytes]. A chunk holds whole runs, so that reading one run decompresses few others.
CHUNK = 1 << 18


def described_columns(table: str) -> dict[str, str]:
    """Return the descriptions of the columns of texts in the index (``index``) or in blocks (``block``), by name."""
    with (Path(__file__).parent / "columns.csv").open(encoding="utf-8", newline="") as file:
        return {row["name"]: row["long_name"] for row in csv.DictReader(file) if row["table"] == table}


def write_scale(file: h5py.File, path: str, numbers: Sequence[int] | np.ndarray, what: str, under: str = "") -> None:
    """Write a dimension scale of whole numbers, whose name is that of its axis; `under`: see `write_column`."""
    group, _, name = path.partition("/")
    create(file, Array(f"{group}/{name}", (name,), "1", what, INTEGER), np.array(numbers, INTEGER), under=under)


@contextmanager
def hdf5_in_memory() -> Iterator[h5py.File]:
    """Yield an empty HDF5 file in memory, whose bytes are those of `file_bytes`.

    Files are created in memory, because HDF5 crashes the interpreter if the disk is full when a file is closed.
    """
    with h5py.File(f"table-{next(_NUMBERS)}", "w", driver="core", backing_store=False, libver=LIBVER) as file:
        yield file


_NUMBERS = itertools.count(1)


def file_bytes(file: h5py.File) -> bytes:
    """Return the bytes of a file in memory."""
    file.flush()
    image: bytes = file.id.get_file_image()
    return image


def write_header(file: h5py.File, kind: str, version: str, title: str, description: str, **texts: str) -> None:
    """Write the attributes of a file of a study: those that all kinds of files have, and further `texts`."""
    texts |= {"format": kind, "format_version": version, "Conventions": f"{kind}-{version}"}
    for name, text in {"title": title, "description": description, **texts}.items():
        set_text(file, name, text)


def check_header(file: h5py.File, path: Path, kind: str, version: str, what: str) -> None:
    """Raise ArchiveError unless a file is of a kind, in words ``the index of a study``, and its version is read."""
    if file.attrs.get("format") != kind:
        raise ArchiveError(f"this is not {what}", file=path)
    written = str(file.attrs["format_version"])
    if written.partition(".")[0] != version.partition(".")[0]:
        raise FormatVersionError(f"this is {what} with format version {written}, this mbdkit reads 1.x", file=path)


def write_column(
    file: h5py.File, array: Array, values: np.ndarray | Sequence[str], *, compress: bool = False, under: str = ""
) -> h5py.Dataset:
    """Write a column, or an array whose first axis is that of the runs.

    Parameters
    ----------
    array
        Path, axes, units and description. The group and the dimension scales must exist.
    values
        (N, ...) numbers, or (N,) strings if ``array.dtype`` is `TEXT`.
    compress
        Whether numbers are compressed.
    under
        See `mbdkit.archive.hdf5.create`.
    """
    if array.dtype != TEXT:
        plan = _plan(values, array) if compress else None
        return create(file, array, np.ascontiguousarray(values, array.dtype), plan=plan, under=under)
    texts, codes = _coded(values)
    scale = Array(f"{array.path}_texts", (f"{array.name}_texts",), "1", f"texts of {array.name}", TEXT)
    create(file, scale, texts, under=under)
    dtype = np.min_scalar_type(max(1, len(texts) - 1)).newbyteorder("<")
    numbers = Array(array.path, array.dims, array.units, array.long_name, dtype.str)
    dataset = write_column(file, numbers, codes, compress=compress, under=under)
    set_text(dataset, "texts", scale.name)
    return dataset


def write_hashes(file: h5py.File, array: Array, hashes: Sequence[str], *, compress: bool = False) -> None:
    """Write a column of hexadecimal hashes of equal length as bytes; an empty hash is stored as zeros."""
    width = max((len(text) // 2 for text in hashes), default=0) or 1
    values = np.frombuffer(b"".join(bytes.fromhex(text or "00" * width) for text in hashes), np.uint8)
    write_scale(file, f"{array.path}_byte", range(1, width + 1), f"number of the byte of {array.name}")
    bytes_ = Array(array.path, (*array.dims, f"{array.name}_byte"), "1", array.long_name, "|u1")
    set_text(write_column(file, bytes_, values.reshape(-1, width), compress=compress), "hash", "sha256")


def read_column(dataset: h5py.Dataset) -> np.ndarray:
    """Return a column: numbers, or an object array of strings for texts and hashes, coded or not."""
    if "texts" in dataset.attrs:
        texts = np.array(dataset.parent[str(dataset.attrs["texts"])].asstr()[:], object)
        return np.asarray(texts[dataset[:]], object)
    if "hash" in dataset.attrs:
        return _hexadecimal(dataset[:])
    return np.asarray((dataset.asstr() if is_text(dataset) else dataset)[:])


def _hexadecimal(values: np.ndarray) -> np.ndarray:
    width = 2 * values.shape[1]
    text = values.tobytes().hex()
    empty = ~values.any(axis=1)
    texts = np.array([text[k : k + width] for k in range(0, len(text), width)], object)
    texts[empty] = ""
    return texts


def _coded(values: Sequence[str] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct texts in order of appearance, and for each row the index of its text among them."""
    texts = list(map(str, values))
    numbers = {text: number for number, text in enumerate(dict.fromkeys(texts))}
    codes = np.fromiter(map(numbers.__getitem__, texts), np.int64, len(texts))
    return np.array(list(numbers) or [""], object), codes


def _plan(values: np.ndarray | Sequence[str], array: Array) -> h5p.PropDCID | None:
    """Return the compression settings of an array; None if it is empty or too small for compression."""
    shape, size = np.shape(values), np.dtype(array.dtype).itemsize
    if not np.prod(shape) or np.prod(shape) * size < SMALL:
        return None
    row = max(1, int(np.prod(shape[1:])) * size)
    plan = h5p.create(h5p.DATASET_CREATE)
    plan.set_chunk((max(1, min(shape[0], CHUNK // row)), *shape[1:]))
    plan.set_shuffle()
    plan.set_deflate(_LEVEL)
    return plan
