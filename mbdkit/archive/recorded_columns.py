"""Base classes of histories that declare columns and labels of a kind, for type checkers and completion.

They are in ``recorded_columns.pyi``, which ``python -m tests.history_columns`` writes from the table of
quantities. At run time, all of them are `View`, which creates the columns from the same table.
"""

from __future__ import annotations

from mbdkit.archive.named_columns import View


class FurtherKinds:
    """Base class of runs that declares the histories of most kinds; `RecordedData` adds them to its class."""


def __getattr__(name: str) -> type[View]:
    if name.startswith("_"):
        raise AttributeError(f"module {__name__} has no attribute '{name}'")
    return View
