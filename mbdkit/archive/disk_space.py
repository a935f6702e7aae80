"""Checks before a run that its archive will fit on the disk or in memory."""

from __future__ import annotations

import math
import shutil
from functools import lru_cache
from pathlib import Path

from mbdkit.archive import layout
from mbdkit.base.errors import ResourceError, SpecError
from mbdkit.base.memory import available_memory, in_bytes
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.registered_kinds import sizes_of

NEARLY_NOTHING = 2**20  #: A disk with less free space than this is reported as full [bytes].

#: Size from which an archive is taken for a mistake in the spec, because no disk has room for it [bytes].
LARGEST = 2**50

#: For archives in memory up to this size [bytes], free memory is not checked, because querying it takes 0.1 ms.
SMALL = 2**22


@lru_cache(maxsize=16)
def row_bytes(names: ArchiveNames, quantities: frozenset[str], kept: frozenset[str] | None = None) -> int:
    """Return the size of one recorded row, including the statistics of the interval that ends there [bytes].

    `names`: names along the axes. `quantities`: which of `layout.QUANTITIES` are recorded. `kept`: paths of the arrays
    that are stored; by default, all.
    """
    sizes, arrays = sizes_of(names), (array for array in layout.recorded_by(names, quantities) if array.grows)
    return sum(
        8 * math.prod(sizes[dim] for dim in array.dims[1:]) for array in arrays if kept is None or array.path in kept
    )


def check_room(path: Path | None, rows: int, row: int, every: int | None) -> None:
    """Check that an archive fits into the free space on its disk or in memory.

    `path`: path of the archive; None for an archive in memory. `rows`: number of recorded rows. `row`: size of one row
    [bytes]. `every`: number of steps between rows; None if rows are recorded at a time interval. Raises SpecError if
    the archive is larger than `LARGEST`. Raises ResourceError if the archive is larger than the space that is free now,
    even if it is larger than the whole disk or memory.
    """
    needed = rows * row
    if path is None:
        if needed <= SMALL:
            return
        free = available_memory()
    else:
        free = shutil.disk_usage(path.parent).free
    if free is None or needed <= free:
        return
    where = "available in memory" if path is None else f"free in {path.parent.resolve()}"
    setting = "interval" if every is None else "every"
    times = 2 * needed // max(free, 1) + 1
    less = f"`interval` {times:,} times as long" if every is None else f"`every: {_round_up(every * times)}`"
    message = (
        f"{rows:,} rows of {row:,} bytes take {in_bytes(needed)}, but only {in_bytes(free)} are {where}: "
        f"record less often, such as {less}, or fewer `quantities`"
    )
    if path is not None and free < NEARLY_NOTHING:
        raise ResourceError(
            f"the disk of {path.parent.resolve()} is full: {in_bytes(free)} are free, and the archive takes about "
            f"{in_bytes(needed)}; free some space, or choose another folder"
        )
    if needed > LARGEST:
        raise SpecError(message, key=f"output.{setting}")
    raise ResourceError(f"output.{setting}: {message}")


def _round_up(number: int) -> int:
    ten: int = 10 ** (len(str(number)) - 1)
    return -(-number // ten) * ten
