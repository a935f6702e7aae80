"""Creates arrays with attributes and dimension scales.

The low-level API of h5py takes half the time of the high-level one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import h5py
import numpy as np
from h5py import h5a, h5d, h5ds, h5p, h5s, h5t

from mbdkit.quantities.array import TEXT, Array

_STRING = h5t.py_create(h5py.string_dtype(), logical=True)  # in the file
_STR = h5t.py_create(h5py.string_dtype())  # in memory: references to Python strings
_SCALAR = h5s.create(h5s.SCALAR)
_type_of = cache(h5t.py_create)  # the type of numbers in HDF5


def set_text(target: h5py.Group | h5py.Dataset, name: str, value: str) -> None:
    """Add a variable-length UTF-8 string attribute to a group or an array."""
    attribute = h5a.create(target.id, name.encode(), _STRING, _SCALAR)
    attribute.write(np.array(value, dtype=object), mtype=_STR)


def set_texts(target: h5py.Group, name: str, values: Sequence[str]) -> None:
    """Add an attribute to a group: a one-dimensional array of variable-length UTF-8 strings, which may be empty."""
    attribute = h5a.create(target.id, name.encode(), _STRING, h5s.create_simple((len(values),)))
    if values:
        attribute.write(np.array(values, dtype=object), mtype=_STR)


def set_numbers(target: h5py.Group | h5py.Dataset, name: str, value: np.generic | np.ndarray) -> None:
    """Add a number or an array of numbers as an attribute to a group or an array."""
    kind, space = _type_of(value.dtype), h5s.create_simple(value.shape) if value.shape else _SCALAR
    attribute = h5a.create(target.id, name.encode(), kind, space)
    if value.size:
        attribute.write(np.asarray(value), mtype=kind)


def replace_number(target: h5py.Group, name: str, value: np.int64 | np.float64) -> None:
    """Replace the value of an attribute of a group by a number of the same type, at the same place in the file."""
    h5a.open(target.id, name.encode()).write(np.asarray(value), mtype=_type_of(value.dtype))


def create(
    file: h5py.File,
    array: Array,
    values: np.ndarray,
    *,
    chunks: tuple[int, ...] | None = None,
    plan: h5p.PropDCID | None = None,
    under: str = "",
) -> h5py.Dataset:
    """Create an array of the layout with its values and attributes.

    Unless the array is a dimension scale itself, the dimension scales of its axes must exist.

    - `file`: the archive; the array's group must exist.
    - `values`: contiguous array of the type in the layout; strings have the dtype object.
    - `chunks`: shape of a chunk for an array whose first axis grows; None for an array of fixed size.
    - `plan`: compression of an array of fixed size; None for no compression.
    - `under`: path of the group in which the layout starts, with a slash at the end; empty for the root group.
    """
    limits = None
    if chunks is not None:
        plan = h5p.create(h5p.DATASET_CREATE)
        plan.set_chunk(chunks)
        # HDF5 rejects chunks longer than a fixed axis. Axes of length zero must therefore be unlimited.
        limits = (h5s.UNLIMITED, *(size or h5s.UNLIMITED for size in values.shape[1:]))
    kind, of_values = (_STRING, _STR) if array.dtype == TEXT else 2 * (_type_of(np.dtype(array.dtype)),)
    identifier = h5d.create(
        file.id, f"{under}{array.path}".encode(), kind, h5s.create_simple(values.shape, limits), plan
    )
    if values.size:
        identifier.write(h5s.ALL, h5s.ALL, values, mtype=of_values)
    dataset = h5py.Dataset(identifier)
    if array.is_scale:
        h5ds.set_scale(identifier, array.path.rpartition("/")[2].encode())
    else:
        for axis, dim in enumerate(array.dims):
            h5ds.attach_scale(identifier, h5d.open(file.id, f"{under}{array.group}/{dim}".encode()), axis)
    set_text(dataset, "units", array.units)
    set_text(dataset, "long_name", array.long_name)
    if array.row_units:
        set_text(dataset, "row_units", array.row_units)
    return dataset


def fill_text(file: h5py.File, array: Array, values: np.ndarray) -> None:
    """Write the values of an existing array of strings."""
    if values.size:
        h5d.open(file.id, array.path.encode()).write(h5s.ALL, h5s.ALL, values, mtype=_STR)


def dims(dataset: h5py.Dataset) -> tuple[str, ...]:
    """Return the names of an array's axes: the name of the dimension scale, or NAME_AXIS for an axis without one."""
    name = dataset.name.rpartition("/")[2]
    if dataset.is_scale:
        return (name,)
    return tuple(
        dim.values()[0].name.rpartition("/")[2] if len(dim) else f"{name}_{axis}"
        for axis, dim in enumerate(dataset.dims)
    )
