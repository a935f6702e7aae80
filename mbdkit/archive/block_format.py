"""Blocks: HDF5 files that hold many runs of a study, with an axis ``run`` in front of the arrays of a run archive.

Runs of one mechanism and method have the same arrays; they are a *structure* of the block. The groups of the first
structure are those of a run archive, the groups of others are in ``structure-2``, ``structure-3`` and so on.
`schemas/block.md` describes the format.
"""

from __future__ import annotations

from typing import Literal, get_args

from mbdkit.quantities.table import RECORDED

FORMAT = "mbdkit-block"
FORMAT_VERSION = "1.0"

Store = Literal["hashes", "summary", "histories", "all"]
STORES: tuple[Store, ...] = get_args(Store)

HISTORIES = frozenset(["trajectory/time", *(array.path for array in RECORDED.values() if array.is_history)])
"""Arrays that ``store: histories`` keeps."""

KEEPING_TIMES: tuple[Store, ...] = ("histories", "all")
"""Values of `store` with which a study keeps the recorded rows."""

COUNTS = (("time", "trajectory"), ("interval", "steps"), ("event", "events"))
"""Growing axes of a run archive, and the group that holds their number of rows by run."""


def prefix(structure: int) -> str:
    """Return the path, with a slash at the end, of the groups of a structure, counted from 0; empty for the first."""
    return f"structure-{structure + 1}/" if structure else ""
