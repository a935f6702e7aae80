"""Converts errors of HDF5 and h5py into readable messages."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import h5py

from mbdkit.base.errors import ArchiveError, MbdkitError
from mbdkit.base.text import shown

#: Exceptions that h5py raises on damaged files.
DAMAGE = (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError)


def error_number(error: BaseException) -> int | None:
    """Return the system's error number, which HDF5 often reports only in the message; None if there is none."""
    if (number := getattr(error, "errno", None)) is None and "errno = " in str(error):
        number = int(str(error).partition("errno = ")[2].partition(",")[0])
    return number


def cause(error: BaseException) -> str:
    """Return the cause of an error of the system or of HDF5, without HDF5's internal details."""
    number, text = error_number(error), str(getattr(error, "strerror", None) or error)
    return os.strerror(number) if number and "errno = " in text else text.partition("\n")[0]


@contextlib.contextmanager
def closed_on_error(file: h5py.File) -> Iterator[None]:
    """Close a file if the body of the `with` statement raises an exception."""
    try:
        yield
    except BaseException:
        file.close()
        raise


@contextlib.contextmanager
def reading(what: str, file: Path | None, *, hint: str = "`mbdkit archive check` says more") -> Iterator[None]:
    """Convert read errors on a damaged archive or study index into ArchiveError.

    `what`: name of the data that the `with` block reads, such as ``energy/total``. `file`: path of the archive; None if
    it is in memory. `hint`: advice appended to the message. Raises ArchiveError in place of the exceptions in `DAMAGE`.
    """
    try:
        yield
    except MbdkitError:
        raise
    except DAMAGE as error:
        message = f"this file is damaged, {shown(what)} cannot be read ({shown(cause(error))}); {hint}"
        raise ArchiveError(message, file=file) from error
