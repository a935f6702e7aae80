"""Converts a run archive to an xarray DataTree."""

from __future__ import annotations

from typing import TYPE_CHECKING

import h5py

from mbdkit.archive.fingerprint import is_text
from mbdkit.archive.hdf5 import dims
from mbdkit.base.errors import MbdkitError

if TYPE_CHECKING:
    import xarray


#: Attributes in which HDF5 stores dimension scales.
OF_SCALES = frozenset({"CLASS", "NAME", "REFERENCE_LIST", "DIMENSION_LIST"})


def to_datatree(file: h5py.File) -> xarray.DataTree:
    """Load an open archive into an xarray DataTree.

    Returns
    -------
    xarray.DataTree
        Equal to the result of `xarray.open_datatree(path, engine="h5netcdf")`.

    Raises
    ------
    MbdkitError
        If xarray is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        raise MbdkitError("to_xarray needs the package xarray: pip install xarray") from error

    nodes: dict[str, xarray.Dataset] = {"/": xarray.Dataset(attrs=_attributes(file))}
    groups = list(file.values())
    for group in groups:
        datasets = {name: item for name, item in group.items() if isinstance(item, h5py.Dataset)}
        groups += [item for item in group.values() if isinstance(item, h5py.Group)]
        variables = {
            name: xarray.Variable(
                dims(dataset),
                (dataset.asstr() if is_text(dataset) else dataset)[:],
                _attributes(dataset),
            )
            for name, dataset in datasets.items()
        }
        nodes[group.name] = xarray.Dataset(variables, attrs=_attributes(group))
    return xarray.DataTree.from_dict(nodes)


def _attributes(item: h5py.Group | h5py.Dataset) -> dict[str, object]:
    # netCDF does not distinguish an array of one value from a scalar.
    return {
        name: value[0] if getattr(value, "shape", None) == (1,) else value
        for name, value in item.attrs.items()
        if name not in OF_SCALES  # xarray represents them as dimensions
    }
