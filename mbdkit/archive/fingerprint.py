"""The hashes of an archive, as defined in `schemas/archive.md`: `seal` stores them, `StoredHashes` verifies them."""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache, partial
from types import MappingProxyType

import h5py
import numpy as np
from h5py import h5a, h5d, h5ds, h5g, h5i, h5o, h5s, h5t

from mbdkit.archive.hdf5 import set_text
from mbdkit.archive.layout import ARRAY_HASHES, ATTRIBUTES_HASH, DATA_HASH, is_hashed
from mbdkit.quantities.array import TEXT, Array
from mbdkit.quantities.registered_kinds import kind_of_group

BLOCK_BYTES = 1 << 23

_LINE = re.compile(r"(.+?) \S+ \S* [0-9a-f]{64}\n", re.DOTALL)

_STR = h5t.py_create(h5py.string_dtype())  # in memory: references to Python strings


#: Those with addresses in the file; the paths of the scales are covered instead.
_ADDRESSES = frozenset({"REFERENCE_LIST", "DIMENSION_LIST"})

#: Attributes that `attributes_sha256` does not cover: both hashes.
_NOT_COVERED = frozenset({f"/{DATA_HASH}", f"/{ATTRIBUTES_HASH}"})


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


def seal(
    file: h5py.File,
    known: Mapping[str, str] = MappingProxyType({}),
    unread: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> None:
    """Store the hashes of all contents in the root attributes of a file; nothing may be written after that.

    `known`, `unread`: see `attributes_sha256`; the lines of all arrays that are not opened are known.
    """
    items = _identifiers(h5o.open(file.id, b"/"), "", unread)
    lines = {path: line for path, line in known.items() if "@" not in path}
    lines |= {
        path: _line_of(path, item) for path, item in items if isinstance(item, h5d.DatasetID) and path not in lines
    }
    data = digest_lines(line for path, line in lines.items() if is_hashed(path))
    for name, text in ((DATA_HASH, data), (ARRAY_HASHES, "".join(sorted(lines.values())))):
        if file.attrs.get(name) != text:
            file.attrs.pop(name, None)
            set_text(file, name, text)
    file.attrs.pop(ATTRIBUTES_HASH, None)
    set_text(file, ATTRIBUTES_HASH, attributes_sha256(file, {**known, **lines}, unread))


class StoredHashes:
    """The hashes that are stored in a file, by which all of its contents are verified.

    Attributes, and which arrays there are, are verified at once; this takes about as long as opening the file. The
    values of an array are verified when it is read first, at about 1 GB/s. What has been verified is not verified again
    by this process as long as the file does not change.

    Raises ValueError if hashes are missing, or if the attributes or the arrays are not those that were written.
    """

    def __init__(self, file: h5py.File):
        self._file = file
        self._lines = {line[1]: line[0] for line in _LINE.finditer(str(file.attrs.get(ARRAY_HASHES, "")))}
        self._verified = _verified(file)
        if "" in self._verified:
            return
        stored = [file.attrs.get(name) for name in (DATA_HASH, ATTRIBUTES_HASH)]
        data = digest_lines(line for path, line in self._lines.items() if is_hashed(path))
        if stored != [data, attributes_sha256(file, self._lines)]:
            raise ValueError("its attributes have changed since they were written")
        every = _identifiers(h5o.open(file.id, b"/"), "")
        if changed := {path for path, item in every if isinstance(item, h5d.DatasetID)} ^ self._lines.keys():
            raise ValueError(f"arrays were added or removed, such as {min(changed)}")
        self._verified.add("")

    def verify(self, below: str = "") -> None:
        """Raise ValueError if the values of an array at a path, of one below a group, or of any one have changed."""
        for path, stored in self._lines.items():
            if path not in self._verified and (not below or path == below or path.startswith(f"{below}/")):
                if _line_of(path, h5d.open(self._file.id, path.encode())) != stored:
                    raise ValueError(f"{path} has changed since it was written")
                self._verified.add(path)


def _verified(file: h5py.File) -> set[str]:
    """Return the paths of the arrays of a file that this process has verified, and an empty one for the rest."""
    if file.driver == "core":
        return set()
    state = os.stat(file.filename)
    return _verified_in(file.filename, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)


@lru_cache(maxsize=1024)
def _verified_in(*_: object) -> set[str]:
    return set()


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
    lines, scales = [line for known_lines in unread.values() for line in known_lines], dict[int, str]()
    for path, item in _identifiers(h5o.open(file.id, b"/"), "", unread):
        if isinstance(item, h5d.DatasetID) and not is_hashed(path):
            lines.append(known.get(path) or _line_of(path, item))
        lines += attribute_lines(item, path, known, scales)
    return digest_lines(lines)


def attribute_lines(
    item: h5g.GroupID | h5d.DatasetID, path: str, known: Mapping[str, str], names_of_scales: dict[int, str]
) -> list[str]:
    """Return the lines of the attributes of a group or an array that `attributes_sha256` covers.

    `names_of_scales`: paths of the dimension scales of the file that are known, by address; others are added.
    """
    names: list[bytes] = []
    h5a.iterate(item, names.append)  # the high-level interface takes three times as long
    lines = [
        known.get(f"{path}@{name}") or _attribute_line(f"{path}@{name}", h5a.open(item, name.encode()))
        for name in map(bytes.decode, names)
        if name not in _ADDRESSES and f"{path}/{name}" not in _NOT_COVERED
    ]
    if b"DIMENSION_LIST" in names:
        scales: list[str] = []

        def note(scale: h5d.DatasetID) -> None:
            address = h5o.get_info(scale).addr  # a name takes ten times as long
            if address not in names_of_scales:
                names_of_scales[address] = h5i.get_name(scale).decode()
            scales.append(names_of_scales[address])

        for axis in range(item.rank):
            h5ds.iterate(item, axis, note)
        lines.append(attribute_line(f"{path}@DIMENSION_LIST", tuple(scales)))
    return lines


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
    if numbers.dtype.kind == "S" and not numbers.shape:  # the marks of dimension scales
        return line(path, TEXT, (), hashlib.sha256(bytes(numbers[()]) + b"\0").hexdigest())
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
    groups = dict.fromkeys(array.group for array in arrays)
    return {path: line for group in groups for path, line in _lines_of_group(group).items()}


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
