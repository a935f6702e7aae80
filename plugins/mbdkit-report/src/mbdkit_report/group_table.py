"""A group of the archive as a table: one row for each time in the group, one named column for each number.

Columns have the names that quantities have in expressions of events, such as ``knee.force_x`` or ``foot.vy``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from mbdkit.archive.fingerprint import is_text
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.named_columns import NotRecordedError
from mbdkit.base.errors import MbdkitError, UnknownNameError
from mbdkit.quantities.array import TEXT, Array
from mbdkit.quantities.registered_kinds import groups, kind_of_group

if TYPE_CHECKING:
    import pandas

    from mbdkit.archive.run import Run

_COMPONENT_DIMS = ("coordinate", "axis")
BLOCK_VALUES = 2_000_000  # values of a block; a block of text takes about ten times as much memory


@dataclass(frozen=True)
class TableColumn:
    """A column of a table.

    Parameters
    ----------
    name
        Such as ``knee.force_x``; unique in the table.
    units
        SI unit; ``1`` for counts and text.
    array
        Layout of the array with the values.
    at
        Indices along the axes of the array after the first.
    """

    name: str
    units: str
    array: Array
    at: tuple[int, ...]


@dataclass(frozen=True)
class GroupTable:
    """A group of a run as a table, whose values are read in blocks of rows.

    Parameters
    ----------
    run
        The run, which must stay open.
    group
        Name of the group.
    rows
        Number of rows T.
    columns
        All columns except the time; the columns of an element are adjacent.
    """

    run: Run
    group: str
    rows: int
    columns: tuple[TableColumn, ...]

    @property
    def first(self) -> TableColumn:
        """The column with the times."""
        return TableColumn("time", "s", Array(f"{self.group}/time", ("time",), "s", "time"), ())

    @property
    def time(self) -> np.ndarray:
        """Times of the rows, (T,), s."""
        return self.run.array(f"{self.group}/time")

    def without_text(self) -> GroupTable:
        """Return the table without its columns of text."""
        numbers = tuple(column for column in self.columns if column.array.dtype != TEXT)
        return GroupTable(self.run, self.group, self.rows, numbers)

    def read(self, rows: slice) -> list[np.ndarray]:
        """Return the values of each column in a slice of rows."""
        paths = dict.fromkeys(column.array.path for column in self.columns)
        with reading(self.group, self.run.path):
            values = {path: _values(self.run.dataset(path), rows) for path in paths}
        every: tuple[Any, ...] = (slice(None),)
        return [values[column.array.path][every + column.at] for column in self.columns]

    def blocks(self) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
        """Yield the times and the values of the columns in blocks of rows that fit in memory."""
        size = max(1, BLOCK_VALUES // (len(self.columns) + 1))
        for start in range(0, self.rows, size):
            rows = slice(start, min(start + size, self.rows))
            yield self.time[rows], self.read(rows)


def group_names(run: Run) -> tuple[str, ...]:
    """Return the names of the groups of a run that have rows over time, in the order of the layout."""
    return tuple(group for group in run.kinds if _arrays(run, group))


def group_table(run: Run, group: str) -> GroupTable:
    """Return a group of a run as a table.

    Raises
    ------
    UnknownNameError
        If there is no such group.
    MbdkitError
        If the run did not record the group, or its mechanism has no such elements.
    """
    if group not in run.kinds and group not in groups():
        raise UnknownNameError("group", group, groups())
    if not (arrays := _arrays(run, group)):
        kind = kind_of_group(group)
        if kind.is_optional and not run.objects(kind):  # raises NotRecordedError if the group was not recorded
            raise MbdkitError(f"the mechanism of this run has no {group}, so that there is no table of them")
        raise NotRecordedError(f"{group}/time")
    columns = [column for array in arrays for column in _columns(run, array)]
    # The columns of an element, such as a joint, are adjacent, in the order of the arrays.
    order = {key: index for index, key in enumerate(dict.fromkeys(_element(column) for column in columns))}
    columns.sort(key=lambda column: order[_element(column)])
    return GroupTable(run, group, len(run.dataset(f"{group}/time")), tuple(columns))


def _arrays(run: Run, group: str) -> list[Array]:
    """Return the arrays with rows that a run recorded in a group, without the array of times."""
    every = run.kinds[group].arrays if group in run.kinds else ()
    axis = next((array.dims[0] for array in every if array.name == "time"), "")
    arrays = [array for array in every if array.grows and array.dims[0] == axis and run.records(array.path)]
    return [array for array in arrays if array.name != "time"] if len(arrays) > 1 else []


def _columns(run: Run, array: Array) -> Iterator[TableColumn]:
    dims = array.dims[1:]
    names = [[str(name) for name in run.array(f"{array.group}/{dim}")] for dim in dims]
    units = [str(unit) for unit in run.array(f"{array.group}/{array.row_units}")] if array.row_units else []
    row_dim = run.kinds[array.group].by_path[f"{array.group}/{array.row_units}"].dims[0] if units else ""
    for at in product(*(range(len(each)) for each in names)):
        element = [each[k] for dim, each, k in zip(dims, names, at, strict=True) if dim not in _COMPONENT_DIMS]
        last = [(each[k], k) for dim, each, k in zip(dims, names, at, strict=True) if dim in _COMPONENT_DIMS]
        if array.components:
            quantity = array.components[last[0][1] if last else 0]
        else:
            quantity = "_".join([array.name, *(name for name, _ in last)])
        unit = units[at[dims.index(row_dim)]] if row_dim in dims else array.units
        yield TableColumn(".".join([*element, quantity]), unit, array, at)


def _element(column: TableColumn) -> tuple[tuple[str, int], ...]:
    """Return axis and index of the element to which a column belongs, such as a joint; an empty tuple if none."""
    dims = column.array.dims[1:]
    return tuple((dim, k) for dim, k in zip(dims, column.at, strict=True) if dim not in _COMPONENT_DIMS)


def _values(dataset: h5py.Dataset | np.ndarray, rows: slice) -> np.ndarray:
    source = dataset.asstr() if isinstance(dataset, h5py.Dataset) and is_text(dataset) else dataset
    return np.asarray(source[rows])


def data_frame(
    columns: Mapping[Any, Sequence[Any] | np.ndarray],
    index: Sequence[object] | np.ndarray | None = None,
    name: str = "",
) -> pandas.DataFrame:
    """Return a DataFrame with the columns in the given order.

    Parameters
    ----------
    index
        Labels of the rows; numbers from 0 by default.
    name
        Name of the index.

    Raises
    ------
    MbdkitError
        If pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise MbdkitError("the table is a pandas DataFrame, and pandas is not installed: pip install pandas") from error
    labels = None if index is None else pandas.Index(index, name=name)
    return pandas.DataFrame(dict(columns), index=labels, columns=list(columns))


def to_frame(run: Run, group: str) -> pandas.DataFrame:
    """Return a group of a run as a table; see `Run.to_frame`."""
    table = group_table(run, group)
    names = [column.name for column in table.columns]
    frame = data_frame(dict(zip(names, table.read(slice(None)), strict=True)), table.time, "time")
    frame.attrs["units"] = {"time": "s"} | {column.name: column.units for column in table.columns}
    return frame
