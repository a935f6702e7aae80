"""Tables of an archive: results of a run other than quantities over time, such as residuals or a covariance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import h5py
import numpy as np

from mbdkit.archive.fingerprint import dataset_line, is_text
from mbdkit.archive.hdf5 import create, dims, set_text
from mbdkit.archive.layout import is_hashed
from mbdkit.base.frozen import dataclass
from mbdkit.quantities.array import FLOAT, INTEGER, TEXT, Array
from mbdkit.quantities.registered_kinds import groups

_ROLE, _IS_TABLE = "role", "table"  #: Attribute of a group that holds a table, and its value.


class TableColumn(NamedTuple):
    """One array of a table.

    Attributes
    ----------
    values
        Numbers or texts.
    axes
        Names of the axes, all different; an axis is the column with this name along itself alone.
    units
        SI unit, ``1`` for texts and counts.
    long_name
        Description.
    row_units
        If `units` is ``mixed``, the column with the unit of each number along the last axis.
    """

    values: np.ndarray
    axes: tuple[str, ...]
    units: str = "1"
    long_name: str = ""
    row_units: str = ""

    def write(self, file: h5py.File, path: str) -> h5py.Dataset:
        """Write the array at a path of an archive; those of its axes must exist."""
        values = np.ascontiguousarray(self.values)
        dtype = FLOAT if values.dtype.kind == "f" else INTEGER if values.dtype.kind in "iub" else TEXT
        array = Array(path, self.axes, self.units, self.long_name, dtype, self.row_units)
        return create(file, array, values.astype(object if dtype == TEXT else dtype))

    @classmethod
    def read(cls, dataset: h5py.Dataset) -> TableColumn:
        """Read an array of an archive; its values are read-only."""
        values = (dataset.asstr() if is_text(dataset) else dataset)[:]
        values.flags.writeable = False
        attributes = (str(dataset.attrs.get(key, "")) for key in ("units", "long_name", "row_units"))
        return cls(values, dims(dataset), *attributes)


def axes_first(columns: Mapping[str, TableColumn]) -> list[tuple[str, TableColumn]]:
    """Return the columns by name, with the axes before those that have them."""
    return sorted(columns.items(), key=lambda item: item[1].axes != (item[0],))


@dataclass(frozen=True, eq=False)
class ResultTable:
    """Arrays along common axes, which are a group of the archive; its name is that of the table.

    Parameters
    ----------
    columns
        The arrays by name. A covariance of parameters, for instance, has the axes ``parameter`` and ``other``, which
        are columns with the names of the parameters.

    Raises
    ------
    ValueError
        If a name is not an identifier, an axis is missing, or lengths differ.

    Examples
    --------
    >>> import numpy as np
    >>> names = np.array(["mass", "length"])
    >>> table = ResultTable({
    ...     "parameter": TableColumn(names, ("parameter",)),
    ...     "deviation": TableColumn(np.array([0.1, 0.02]), ("parameter",), "1", "standard deviation"),
    ... })
    >>> table["deviation"].shape
    (2,)
    """

    columns: Mapping[str, TableColumn]

    def __post_init__(self) -> None:
        for name, column in self.columns.items():
            lengths = [len(self.columns[axis].values) for axis in column.axes if axis in self.columns]
            if not name.isidentifier():
                raise ValueError(f"the name {name!r} of a column is not made of letters, digits and _")
            if np.shape(column.values) != tuple(lengths) or len({*column.axes}) < len(column.axes):
                raise ValueError(f"the column {name} of the shape {np.shape(column.values)} has the axes {column.axes}")

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the values of a column."""
        return self.columns[name].values

    def write(self, file: h5py.File, name: str) -> Iterator[str]:
        """Write the table to an archive, and yield the lines of its arrays in `data_sha256`.

        Raises ValueError if the archive has a group of this name, or quantities have.
        """
        if name in groups() or name in file or not name.isidentifier():
            raise ValueError(f"a table cannot have the name {name!r}")
        set_text(file.create_group(name), _ROLE, _IS_TABLE)
        for key, column in axes_first(self.columns):
            dataset = column.write(file, f"{name}/{key}")
            if is_hashed(f"{name}/{key}"):
                yield dataset_line(dataset)

    @classmethod
    def of_file(cls, file: h5py.File) -> dict[str, ResultTable]:
        """Return the tables of an archive by name; raise ValueError if one is damaged."""
        return {name: cls.read(group) for name, group in file.items() if is_table(group)}

    @classmethod
    def read(cls, group: h5py.Group) -> ResultTable:
        """Read the table of a group."""
        return cls({name: TableColumn.read(dataset) for name, dataset in group.items()})


def is_table(group: h5py.Group | h5py.Dataset) -> bool:
    """Return whether an object of an archive is a group that holds a table."""
    return isinstance(group, h5py.Group) and group.attrs.get(_ROLE) == _IS_TABLE
