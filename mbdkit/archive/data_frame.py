"""Converts a group of a run to a pandas DataFrame."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbdkit.archive.group_table import group_table
from mbdkit.errors import MbdkitError

if TYPE_CHECKING:
    import pandas

    from mbdkit.archive.run import Run


def to_frame(run: Run, group: str) -> pandas.DataFrame:
    """Return a group of a run as a table; see `Run.to_frame`."""
    try:
        import pandas
    except ImportError as error:
        raise MbdkitError("to_frame needs the package pandas: pip install pandas") from error
    table = group_table(run, group)
    names = [column.name for column in table.columns]
    index = pandas.Index(table.time, name="time")
    values = dict(zip(names, table.read(slice(None)), strict=True))
    frame = pandas.DataFrame(values, index=index, columns=names)
    frame.attrs["units"] = {"time": "s"} | {column.name: column.units for column in table.columns}
    return frame
