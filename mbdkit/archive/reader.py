"""`load`: opens a run archive as a `Run`."""

from __future__ import annotations

from pathlib import Path

from mbdkit.archive.run import Run


def load(path: str | Path) -> Run:
    """Open a run archive; arrays are read on first use, and verified by their hashes.

    Parameters
    ----------
    path
        An archive, ``FILE.h5``, or the ``FILE.h5.part`` of a crashed run.

    Returns
    -------
    Run
        The run; its status is ``running`` if it crashed.

    Raises
    ------
    SpecError
        If `path` is not an archive that this version can read.
    ArchiveError
        If it is damaged, or was changed after it was written.
    ResourceError
        If a run is still writing the file, or the system refuses to read it.

    Examples
    --------
    >>> import mbdkit
    >>> mbdkit.run("pendulum", time={"end": 1.0, "step": 0.01}).save("pendulum.h5")
    >>> with mbdkit.load("pendulum.h5") as run:
    ...     print(run.status, run.time[-1])
    complete 1.0
    """
    return Run.open(Path(path))
