"""What HDF5's errors say, in words for people."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from mbdkit.errors import MbdkitError, SpecError

#: What h5py raises on a damaged file, wherever it happens to notice.
DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError)


def cause(error: BaseException) -> str:
    """Return why the system or HDF5 refused, without HDF5's inner details.

    Parameters
    ----------
    error
        What was raised; HDF5 often hides the system's error number in its text.
    """
    number = getattr(error, "errno", None)
    if number is None and "errno = " in str(error):
        number = int(str(error).partition("errno = ")[2].partition(",")[0])
    return os.strerror(number) if number else str(error).partition("\n")[0]


@contextlib.contextmanager
def reading(what: str, file: Path | None, *, hint: str = "`mbdkit archive check` says more") -> Iterator[None]:
    """Say in a sentence what of an archive, or of the index of a study, cannot be read.

    Parameters
    ----------
    what
        What is read within the block, such as ``energy/total``.
    file
        The archive; None if it is in memory.
    hint
        What the user may do about it.

    Raises
    ------
    SpecError
        Instead of whatever h5py raises on a damaged file.
    """
    try:
        yield
    except MbdkitError:
        raise
    except DAMAGE as error:
        message = f"this file is damaged, {what} cannot be read ({cause(error)}); {hint}"
        raise SpecError(message, file=file) from error
