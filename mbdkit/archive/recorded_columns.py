"""Base classes of histories that declare columns and labels of a kind, for type checkers and completion.

They are in ``recorded_columns.pyi``, which ``python -m mbdkit_testing.history_columns`` writes from the table of
quantities. At run time, all of them are `View`, which creates the columns from the same table.
"""

from __future__ import annotations

from mbdkit.archive.named_columns import View


def __getattr__(name: str) -> type[View]:
    if name.startswith("_"):
        raise AttributeError(f"module {__name__} has no attribute '{name}'")
    return View
