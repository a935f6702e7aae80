"""Tables as pandas DataFrames, where pandas is installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.archive.group_table import group_table
from mbdkit.base.errors import MbdkitError

if TYPE_CHECKING:
    import pandas

    from mbdkit.archive.run import Run


def data_frame(
    columns: Mapping[Any, Sequence[Any] | np.ndarray], index: Sequence[Any] | np.ndarray | None = None, name: str = ""
) -> pandas.DataFrame:
    """Return a DataFrame of columns, in their order.

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
        raise MbdkitError("to_frame needs the package pandas: pip install pandas") from error
    labels = None if index is None else pandas.Index(index, name=name)
    return pandas.DataFrame(dict(columns), index=labels, columns=list(columns))


def to_frame(run: Run, group: str) -> pandas.DataFrame:
    """Return a group of a run as a table; see `Run.to_frame`."""
    table = group_table(run, group)
    names = [column.name for column in table.columns]
    frame = data_frame(dict(zip(names, table.read(slice(None)), strict=True)), table.time, "time")
    frame.attrs["units"] = {"time": "s"} | {column.name: column.units for column in table.columns}
    return frame
