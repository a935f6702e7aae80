"""Writes files atomically and checks their suffixes."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mbdkit.errors import SpecError, file_error


def check_suffix(path: str | os.PathLike[str], allowed: Sequence[str], what: str) -> Path:
    """Return `path` as a Path after checking its suffix.

    Raises
    ------
    SpecError
        If the suffix is not one of `allowed`.
    """
    target = Path(path)
    if target.suffix.lower() not in allowed:
        names = ", ".join(allowed[:-1]) + " or " + allowed[-1]
        given = f"ends in {target.suffix!r}" if target.suffix else "has no suffix"
        raise SpecError(f"{what} cannot be written to {str(target)!r}, which {given}; its name must end in {names}")
    return target


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Yield a temporary file in the folder of `target`; it replaces `target` if the block succeeds.

    Raises
    ------
    SpecError
        If the folder does not exist, or the system refuses the name.
    ResourceError
        If the file cannot be written, for example because the disk is full.
    """
    if not target.parent.is_dir():
        raise SpecError(f"cannot write {str(target)!r}: there is no folder {str(target.parent)!r}")
    temporary = target.with_name(f".{target.stem[:40]}-{secrets.token_hex(4)}{target.suffix}")
    try:
        temporary.touch(exist_ok=False)
        yield temporary
        temporary.replace(target)
    except OSError as error:
        if not error.errno:  # an error of HDF5 reading the run, not of this file
            raise
        raise file_error(error.errno, f"cannot write {str(target)!r}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
