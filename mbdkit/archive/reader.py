"""`mbdkit.load`."""

from __future__ import annotations

from pathlib import Path

from mbdkit.archive.run import Run


def load(path: str | Path) -> Run:
    """Open a run archive; its arrays are read when they are first used.

    Parameters
    ----------
    path
        An archive, ``FILE.h5``, or what a crashed run left, ``FILE.h5.part``.

    Returns
    -------
    Run
        With status ``running`` if the run crashed.

    Raises
    ------
    SpecError
        If there is no archive at `path` that this version can read.
    """
    return Run.open(Path(path))
