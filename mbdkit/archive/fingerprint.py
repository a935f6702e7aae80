"""The hashes of an archive, as defined in `schemas/archive.md`."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator

import h5py
import numpy as np

from mbdkit.archive.layout import TEXT, is_hashed

BLOCK_BYTES = 1 << 23


def blocks(dataset: h5py.Dataset) -> Iterator[np.ndarray]:
    """Yield the values of a dataset in blocks of whole rows of about 8 MiB; strings are Python strings."""
    source = dataset.asstr() if is_text(dataset) else dataset
    if dataset.ndim == 0:
        yield np.asarray(source[()])
        return
    row_bytes = dataset.dtype.itemsize * int(np.prod(dataset.shape[1:]))
    rows = max(1, BLOCK_BYTES // max(1, row_bytes))
    for start in range(0, dataset.shape[0], rows):
        yield source[start : start + rows]


def is_text(dataset: h5py.Dataset) -> bool:
    """Whether the dataset holds strings."""
    return h5py.check_string_dtype(dataset.dtype) is not None


def text_bytes(values: Iterable[str]) -> bytes:
    """Return the concatenated UTF-8 bytes of strings, each followed by a zero byte."""
    return b"".join(value.encode() + b"\0" for value in values)


def line(path: str, dtype: str, shape: Iterable[int], digest: str) -> str:
    """Return the line of one array: path, type, shape and SHA-256 of the values."""
    return f"{path} {dtype} {','.join(map(str, shape))} {digest}\n"


def digest_lines(lines: Iterable[str]) -> str:
    """Return `data_sha256`, the SHA-256 of the sorted lines of all arrays."""
    return hashlib.sha256("".join(sorted(lines)).encode()).hexdigest()


def dataset_line(dataset: h5py.Dataset) -> str:
    """Return the line of one dataset of a file."""
    sha = hashlib.sha256()
    text = is_text(dataset)
    for block in blocks(dataset):
        sha.update(text_bytes(block.ravel()) if text else np.ascontiguousarray(block).data)
    return line(dataset.name.lstrip("/"), TEXT if text else dataset.dtype.str, dataset.shape, sha.hexdigest())


def datasets(group: h5py.Group) -> Iterator[h5py.Dataset]:
    """Yield every dataset in a group and its subgroups, sorted by name within each group."""
    for name in sorted(group):
        item = group[name]
        if isinstance(item, h5py.Group):
            yield from datasets(item)
        elif isinstance(item, h5py.Dataset):
            yield item


def data_sha256(file: h5py.File) -> str:
    """Return the hash of all arrays of an archive except timings and estimated errors, in lower-case hexadecimal."""
    return digest_lines(dataset_line(item) for item in datasets(file) if is_hashed(item.name))


def spec_sha256(spec_json: str) -> str:
    """Return the SHA-256 of the UTF-8 bytes of a spec's canonical JSON, as stored in the attribute `spec`."""
    return hashlib.sha256(spec_json.encode()).hexdigest()
