"""The hashes of an archive, byte for byte as `schemas/archive.md` defines them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator

import h5py
import numpy as np

from mbdkit.archive.layout import TEXT, is_timing

BLOCK_BYTES = 1 << 23


def blocks(dataset: h5py.Dataset) -> Iterator[np.ndarray]:
    """Yield the values of a dataset in pieces of whole rows of about 8 MiB, strings as Python strings."""
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
    """Return the byte stream of strings: UTF-8, each followed by a zero byte."""
    return b"".join(value.encode() + b"\0" for value in values)


def line(path: str, dtype: str, shape: Iterable[int], digest: str) -> str:
    """Return the line of one array: its path, its type, its shape and the SHA-256 of its values."""
    return f"{path} {dtype} {','.join(map(str, shape))} {digest}\n"


def digest_lines(lines: Iterable[str]) -> str:
    """Return `data_sha256`: the SHA-256 of the lines of all arrays in the order of their paths."""
    return hashlib.sha256("".join(sorted(lines)).encode()).hexdigest()


def dataset_line(dataset: h5py.Dataset) -> str:
    """Return the line of one dataset of a file."""
    sha = hashlib.sha256()
    text = is_text(dataset)
    for block in blocks(dataset):
        sha.update(text_bytes(block.ravel()) if text else np.ascontiguousarray(block).data)
    return line(dataset.name.lstrip("/"), TEXT if text else dataset.dtype.str, dataset.shape, sha.hexdigest())


def datasets(group: h5py.Group) -> Iterator[h5py.Dataset]:
    """Yield every dataset below a group, in the order of their paths."""
    for name in sorted(group):
        item = group[name]
        if isinstance(item, h5py.Group):
            yield from datasets(item)
        elif isinstance(item, h5py.Dataset):
            yield item


def data_sha256(file: h5py.File) -> str:
    """Return the hash of every array of an open archive but the timings, in lower-case hexadecimal digits."""
    return digest_lines(dataset_line(item) for item in datasets(file) if not is_timing(item.name))


def spec_sha256(spec_json: str) -> str:
    """Return the hash of a spec: of the UTF-8 bytes of its canonical JSON, as it stands in the attribute `spec`."""
    return hashlib.sha256(spec_json.encode()).hexdigest()
