"""Archives without values: HDF5 files in memory with all groups and arrays of a run, which similar runs fill.

HDF5 takes about 0.15 ms to create an array with its attributes and dimension scales, several times as long as it takes
to write the values. The archives of runs of one mechanism often differ in their values only.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import lru_cache

import h5py
import numpy as np
from h5py import h5f, h5p

from mbdkit.archive.fingerprint import attribute_line, attribute_lines, layout_lines
from mbdkit.archive.hdf5 import create, fill_text, set_numbers, set_text, set_texts
from mbdkit.archive.layout import SHARED, is_hashed, name_texts
from mbdkit.archive.part_file import LIBVER
from mbdkit.base.frozen import dataclass
from mbdkit.quantities.array import TEXT, Array
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.registered_kinds import sizes_of

LARGEST = 1 << 20  #: Skeletons are cached if their arrays over time have at most this total size [bytes].

_IN_MEMORY = itertools.count(1)


_VARYING = "assembly"  #: Attribute of the provenance that differs between the runs of a process.


@dataclass(frozen=True)
class Skeleton:
    """An HDF5 file with the groups, arrays and names of an archive, and the provenance that all runs share.

    `image`: the bytes of the file. `texts`: the arrays of strings over time. `places`: where the values of arrays of
    numbers over time begin in `image`, by path. `unread`, `known`: lines in `attributes_sha256`: see there. Timings are
    left out.
    """

    image: bytes
    texts: tuple[Array, ...]
    places: Mapping[str, int]
    unread: Mapping[str, Sequence[str]]
    known: Mapping[str, str]

    def file(self, values: Mapping[str, np.ndarray]) -> h5py.File:
        """Return a new file in memory with the values of the arrays over time, by path."""
        image = bytearray(self.image)
        for path, offset in self.places.items():
            data = values[path].tobytes()
            image[offset : offset + len(data)] = data
        file = memory_file(image)
        for array in self.texts:
            fill_text(file, array, values[array.path])
        return file


def memory_file(image: bytes | bytearray = b"") -> h5py.File:
    """Return a new HDF5 file in memory, empty or with the content of another file."""
    # HDF5 distinguishes files in memory by name.
    name = f"memory-{next(_IN_MEMORY)}"
    if not image:
        return h5py.File(name, "w", driver="core", backing_store=False, libver=LIBVER)
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fapl_core(1 << 16, False)
    access.set_libver_bounds(h5f.LIBVER_V18, h5f.LIBVER_V18)
    access.set_fclose_degree(h5f.CLOSE_STRONG)
    access.set_file_image(image)
    return h5py.File(h5f.open(name.encode(), h5f.ACC_RDWR, fapl=access))


def begin_file(file: h5py.File, names: ArchiveNames, arrays: tuple[Array, ...]) -> None:
    """Create the groups of an archive and its arrays of names."""
    for group in (*dict.fromkeys(array.path.rpartition("/")[0] for array in arrays), "stats", "provenance"):
        file.create_group(group)
    texts = name_texts(names)
    for array in sorted((array for array in arrays if not array.grows), key=lambda one: not one.is_scale):
        create(file, array, np.array(tuple(texts[array.path]), dtype=object))


Attribute = str | tuple[str, ...] | int | float | np.generic | np.ndarray


def add_attributes(file: h5py.File, path: str, values: Mapping[str, Attribute]) -> dict[str, str]:
    """Add attributes to the group or the array at `path`, and return their lines in `attributes_sha256`, by
    ``PATH@NAME``.
    """
    target, lines = file[path] if path else file, {}
    for name, value in values.items():
        if isinstance(value, str):
            set_text(target, name, value)
        elif isinstance(value, tuple):
            set_texts(target, name, value)
        else:
            if not isinstance(value, np.ndarray):
                value = np.int64(value) if isinstance(value, int | np.integer) else np.float64(value)
            set_numbers(target, name, value)
        lines[f"{path}@{name}"] = attribute_line(f"{path}@{name}", value)
    return lines


def skeleton_of(
    names: ArchiveNames,
    arrays: tuple[Array, ...],
    rows: tuple[tuple[str, int], ...],
    provenance: Mapping[str, str | int | float],
) -> Skeleton:
    """Return the skeleton of an archive.

    `names`, `arrays`: names of the elements of the mechanism, and the arrays that its runs record. `rows`: numbers of
    rows along the growing axes, by name. `provenance`: attributes of ``/provenance``.
    """
    sizes = sizes_of(names) | dict(rows)
    values = sum(math.prod([sizes[dim] for dim in array.dims]) for array in arrays if array.grows)
    shared = tuple(entry for entry in provenance.items() if entry[0] != _VARYING)
    return (_cached if 8 * values <= LARGEST else _made)(names, arrays, rows, shared)


def _made(
    names: ArchiveNames,
    arrays: tuple[Array, ...],
    rows: tuple[tuple[str, int], ...],
    provenance: tuple[tuple[str, str | int | float], ...],
) -> Skeleton:
    sizes = sizes_of(names) | dict(rows)
    growing = sorted((array for array in arrays if array.grows), key=lambda one: not one.is_scale)
    with memory_file() as file:
        begin_file(file, names, arrays)
        for array in growing:
            shape = [sizes[dim] for dim in array.dims]
            create(file, array, np.full(shape, "", object) if array.dtype == TEXT else np.zeros(shape, array.dtype))
        texts = tuple(array for array in growing if array.dtype == TEXT)
        places = {array.path: file[array.path].id.get_offset() for array in growing if array not in texts}
        # Groups with timings, or to whose arrays a run adds attributes at its end, have to be opened then.
        opened = {"joints", *(array.group for array in arrays if array.path in SHARED or not is_hashed(array.path))}
        unread: dict[str, list[str]] = defaultdict(list)
        for one in arrays:
            if is_hashed(one.path):
                lines = attribute_lines(file[one.path].id, one.path, layout_lines(arrays), {})
                unread[one.path if one.group in opened else one.group] += lines
        known = add_attributes(file, "provenance", dict(provenance))
        file.flush()
        filled = {path: offset for path, offset in places.items() if offset is not None}  # empty arrays have no offset
        return Skeleton(file.id.get_file_image(), texts, filled, unread, known)


_cached = lru_cache(maxsize=16)(_made)
