"""The hashes of an archive, as defined in `schemas/archive.md`."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache, partial
from types import MappingProxyType

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5o, h5s, h5t

from mbdkit.archive.layout import ATTRIBUTES_HASH, is_hashed
from mbdkit.quantities.array import TEXT, Array
from mbdkit.quantities.registered_kinds import kind_of_group

BLOCK_BYTES = 1 << 23

_STR = h5t.py_create(h5py.string_dtype())  # in memory: references to Python strings

#: Attributes in which HDF5 stores dimension scales; they hold addresses in the file.
OF_SCALES = frozenset({"CLASS", "NAME", "REFERENCE_LIST", "DIMENSION_LIST"})

#: Attributes that `attributes_sha256` does not cover: both hashes, and `finish_s`, which is written after them.
_NOT_COVERED = frozenset({"/data_sha256", f"/{ATTRIBUTES_HASH}", "stats/finish_s"})


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


def line(path: str, dtype: str, shape: tuple[int, ...], digest: str) -> str:
    """Return the line that describes one array in the hash: path, type, shape and SHA-256 of the values."""
    return f"{beginning(path, dtype, shape)} {digest}\n"


@lru_cache(maxsize=1024)
def beginning(path: str, dtype: str, shape: tuple[int, ...]) -> str:
    """Return the beginning of the line of an array, up to its digest."""
    return f"{path} {dtype} {','.join(map(str, shape))}"


def digest_lines(lines: Iterable[str]) -> str:
    """Return the SHA-256 of lines, sorted and joined; for the lines of all arrays, this is `data_sha256`."""
    return hashlib.sha256("".join(sorted(lines)).encode()).hexdigest()


def dataset_line(dataset: h5py.Dataset) -> str:
    """Return the line that describes one dataset of a file in the hash."""
    sha = hashlib.sha256()
    text = is_text(dataset)
    for block in blocks(dataset):
        sha.update(text_bytes(block.ravel()) if text else np.ascontiguousarray(block).data)
    return line(dataset.name.lstrip("/"), TEXT if text else dataset.dtype.str, dataset.shape, sha.hexdigest())


def datasets(group: h5py.Group) -> Iterator[h5py.Dataset]:
    """Yield every dataset in a group and its subgroups, sorted by name within each group."""
    return (item for item in objects(group) if isinstance(item, h5py.Dataset))


def data_sha256(file: h5py.File) -> str:
    """Return the hash of all arrays of an archive except timings and estimated errors, in lower-case hexadecimal."""
    arrays = (entry for entry in _identifiers(h5o.open(file.id, b"/"), "") if isinstance(entry[1], h5d.DatasetID))
    return digest_lines(_line_of(path, item) for path, item in arrays if is_hashed(path))


def _line_of(path: str, item: h5d.DatasetID) -> str:
    """Return the `dataset_line` of the array at `path`; the high-level interface takes four times as long."""
    kind = item.get_type()
    is_fixed = isinstance(kind, h5t.TypeStringID) and not kind.is_variable_str()
    if is_fixed or math.prod(item.shape) * kind.get_size() > BLOCK_BYTES:
        return dataset_line(h5py.Dataset(item))
    return _line_with(path, item, partial(item.read, h5s.ALL, h5s.ALL))


def mismatches(file: h5py.File, data: str = "") -> dict[str, str]:
    """Return the stored hashes that do not match the contents of an archive: what they cover, by attribute.

    A hash that is not stored, as in archives of crashed runs, matches everything.

    `data`: hash of the arrays if it is known, as returned by `data_sha256`.
    """
    stored = file.attrs
    checks: tuple[tuple[str, str, Callable[[], str]], ...] = (
        ("data", "data_sha256", lambda: data or data_sha256(file)),
        ("spec", "spec_sha256", lambda: spec_sha256(str(stored.get("spec", "")))),
        ("attributes", ATTRIBUTES_HASH, lambda: attributes_sha256(file)),
    )
    return {name: what for what, name, there in checks if stored.get(name) and stored[name] != there()}


def attributes_sha256(
    file: h5py.File,
    known: Mapping[str, str] = MappingProxyType({}),
    unread: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> str:
    """Return the hash of everything that `data_sha256` does not cover: attributes, timings and estimated errors.

    `known`: known lines of attributes, by ``PATH@NAME``, and of arrays, by path; their values are not read from the
    file. `unread`: known lines of arrays and of groups with all that they contain, by path; these objects are not
    opened.
    """
    lines = [line for known_lines in unread.values() for line in known_lines]
    for path, item in _identifiers(h5o.open(file.id, b"/"), "", unread):
        if isinstance(item, h5d.DatasetID) and not is_hashed(path):
            lines.append(known.get(path) or _line_of(path, item))
        lines += attribute_lines(item, path, known)
    return digest_lines(lines)


def attribute_lines(item: h5g.GroupID | h5d.DatasetID, path: str, known: Mapping[str, str]) -> list[str]:
    """Return the lines of the attributes of a group or an array that `attributes_sha256` covers."""
    names: list[bytes] = []
    h5a.iterate(item, names.append)  # the high-level interface takes three times as long
    return [
        known.get(f"{path}@{name}") or _attribute_line(f"{path}@{name}", h5a.open(item, name.encode()))
        for name in map(bytes.decode, names)
        if name not in OF_SCALES and f"{path}/{name}" not in _NOT_COVERED
    ]


def _identifiers(
    group: h5g.GroupID, path: str, without: Collection[str] = ()
) -> Iterator[tuple[str, h5g.GroupID | h5d.DatasetID]]:
    """Yield path and identifier of a group and of all groups and datasets below it, except the paths in `without`."""
    yield path, group
    for name in group:
        below = f"{path}/{name.decode()}".lstrip("/")
        if below in without:
            continue
        item = h5o.open(group, name)
        if isinstance(item, h5g.GroupID):
            yield from _identifiers(item, below, without)
        else:
            yield below, item


def objects(group: h5py.Group) -> Iterator[h5py.Group | h5py.Dataset]:
    """Yield every group and dataset in a group and its subgroups, sorted by name within each group."""
    for name in sorted(group):
        item = group[name]
        yield item
        if isinstance(item, h5py.Group):
            yield from objects(item)


def _attribute_line(path: str, attribute: h5a.AttrID) -> str:
    return _line_with(path, attribute, attribute.read)


def _line_with(path: str, item: h5a.AttrID | h5d.DatasetID, read: Callable[..., None]) -> str:
    """Return the line of an attribute or an array whose values `read` writes into an array."""
    kind = item.get_type()
    if isinstance(kind, h5t.TypeStringID) and kind.is_variable_str():
        text = np.empty(item.shape, object)
        if text.size:
            read(text, mtype=_STR)
        values = b"".join((value if isinstance(value, bytes) else value.encode()) + b"\0" for value in text.ravel())
        return line(path, TEXT, item.shape, hashlib.sha256(values).hexdigest())
    numbers = np.empty(item.shape, item.dtype)
    if numbers.size:
        read(numbers)
    return line(path, numbers.dtype.str, item.shape, hashlib.sha256(numbers.tobytes()).hexdigest())


def attribute_line(path: str, value: str | tuple[str, ...] | np.generic | np.ndarray) -> str:
    """Return the line of an attribute with the path ``PATH@NAME``: a string, a number, or an array of either."""
    if isinstance(value, np.generic | np.ndarray):
        return line(path, value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest())
    shape, texts = ((), (value,)) if isinstance(value, str) else ((len(value),), value)
    return line(path, TEXT, shape, hashlib.sha256(text_bytes(texts)).hexdigest())


def layout_lines(arrays: Iterable[Array]) -> Mapping[str, str]:
    """Return the hash lines of the attributes with which arrays of the layout are created, by ``PATH@NAME``; also those
    of the other arrays in their groups.
    """
    lines: dict[str, str] = {}
    for group in dict.fromkeys(array.group for array in arrays):
        lines |= _lines_of_group(group)
    return lines


@cache
def _lines_of_group(group: str) -> Mapping[str, str]:
    texts = {
        f"{array.path}@{name}": text
        for array in kind_of_group(group).arrays
        for name, text in (("units", array.units), ("long_name", array.long_name))
    }
    return {path: attribute_line(path, text) for path, text in texts.items()}


def spec_sha256(spec_json: str) -> str:
    """Return the SHA-256 of the UTF-8 bytes of a spec's canonical JSON, as stored in the attribute `spec`."""
    return hashlib.sha256(spec_json.encode()).hexdigest()
