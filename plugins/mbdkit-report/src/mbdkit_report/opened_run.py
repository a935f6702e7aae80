"""Archives that a command opens."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from mbdkit.archive.archive_check import blaming_damage
from mbdkit.archive.run import Run


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Run]:
    """Open an archive for a command, as `load` does.

    Raises SpecError if `path` is not an archive that this version can read, or if the body fails because the archive is
    damaged. Raises ResourceError if a run is still writing the file, or the system refuses to read it.
    """
    with blaming_damage(path), Run.open(path) as run:
        yield run
