"""Warns if the contents of an archive do not match its stored hashes, as after an edit by another program."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mbdkit.archive.archive_check import blaming_damage
from mbdkit.archive.fingerprint import mismatches
from mbdkit.archive.hdf5_errors import DAMAGE, cause
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.base.logs import warn_on_stderr
from mbdkit.base.text import listed, shown


def hash_warnings(run: Run) -> list[str]:
    """Return a warning if the contents of the archive of `run` do not match its stored hashes.

    All arrays are read, which takes about 0.1 s for 100 MB.

    Returns one sentence, or none if the hashes match, are not stored, or the run is in memory.
    """
    if run.path is None:
        return []
    try:
        changed = mismatches(run.file)
    except DAMAGE as error:
        return [f"the archive cannot be read in full ({shown(cause(error))}); see `mbdkit archive check`"]
    if not changed:
        return []
    parts, hashes = listed(list(changed.values()), "and"), "hash" if len(changed) == 1 else "hashes"
    verb = "differs" if parts == "spec" else "differ"
    stored = f"the {parts} {verb} from the {hashes} that the program stored"
    return [f"{stored}, so the archive has been changed since it was written; see `mbdkit archive check`"]


@contextmanager
def opened(path: Path) -> Iterator[Run]:
    """Open an archive for a command, as `load` does, and print a warning if its contents do not match its hashes.

    Raises SpecError if `path` is not an archive that this version can read, or if the body fails because the archive is
    damaged. Raises ResourceError if a run is still writing the file, or the system refuses to read it.
    """
    with blaming_damage(path), load(path) as run:
        warn_on_stderr(f"{path}: {warning}" for warning in hash_warnings(run))
        yield run
