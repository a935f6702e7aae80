"""Exceptions raised by mbdkit."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from mbdkit.base.interrupts import is_interrupt
from mbdkit.base.parts import OWN_PACKAGES
from mbdkit.base.text import bounded, did_you_mean, listed, one_line, shortened, shown


class MbdkitError(Exception):
    """Base class of the exceptions raised by mbdkit; `str(error)` is a message for the user."""

    def __init__(self, *args: object):
        super().__init__(*(bounded(part) if isinstance(part, str) else part for part in args))


class SpecError(MbdkitError, ValueError):
    """Wrong input, such as a spec, a mechanism, an expression or a file name.

    `message`: what is wrong and how to correct it. `key`: dotted key path of the input in a spec, such as
    ``model.joints.A.bodies[1]``; empty if unknown or not in a spec. `file`, `line`: location of the input, if known
    (lines count from 1).
    """

    def __init__(self, message: str, *, key: str = "", file: str | Path | None = None, line: int | None = None):
        super().__init__(message)
        self.message = str(self.args[0])
        self.key = key
        self.file = None if file is None else str(file)
        self.line = line

    def __str__(self) -> str:
        location = bounded(shown(self.file or ""))
        if self.line is not None:
            location += f":{self.line}" if location else f"line {self.line}"
        where = ": ".join(part for part in (location, shortened(shown(self.key))) if part)
        return f"{where}: {self.message}" if where else self.message

    def located(self, *, prefix: str = "", file: str | Path | None = None, line: int | None = None) -> SpecError:
        """Return a copy with `prefix` prepended to the key, and with `file` and `line` if the error has none."""
        joint = "" if not prefix or not self.key or self.key.startswith("[") else "."
        key = f"{prefix}{joint}{self.key}"
        new = type(self)(self.message, key=key, file=self.file or file, line=self.line or line)
        new.__cause__ = self.__cause__
        return new

    @staticmethod
    @contextmanager
    def place_by(place: Callable[[SpecError], SpecError]) -> Iterator[None]:
        """Replace a SpecError in a block by what `place` returns for it, such as a copy with its line in a file."""
        try:
            yield
        except SpecError as error:
            raise place(error) from None

    @staticmethod
    def locate(prefix: str) -> AbstractContextManager[None]:
        """Prepend `prefix` to the key of a SpecError in a block; see `located`."""
        return SpecError.place_by(lambda error: error.located(prefix=prefix))

    @staticmethod
    def rekey(key: str) -> AbstractContextManager[None]:
        """Replace the place of a SpecError in a block by a key, where the text at this key is wrong."""
        return SpecError.place_by(lambda error: SpecError(error.message, key=key))


class UnsupportedMechanismError(SpecError):
    """A method does not support elements of a mechanism; the claims of the method say which mechanisms it supports."""


class _FileError(MbdkitError):
    """Base class of errors about a file or a folder that the content of a spec does not cause.

    `message`: what is wrong, and how to correct it. `file`: the file or folder, if any.
    """

    def __init__(self, message: str, *, file: str | Path | None = None):
        super().__init__(message)
        self.message = str(self.args[0])
        self.file = None if file is None else str(file)

    def __str__(self) -> str:
        return f"{bounded(shown(self.file))}: {self.message}" if self.file else self.message


class ArchiveError(_FileError):
    """A file that mbdkit wrote, such as an archive, a block or the index of a study, or a checkpoint, is damaged, is of
    another kind or version, or is refused because reading it could do harm.
    """

    is_other_version = False


class FormatVersionError(ArchiveError):
    """A file has a version of its format that this mbdkit does not read, so that it is not damaged, nor replaced."""

    is_other_version = True


class ResourceError(_FileError):
    """A resource is not available: disk space, memory, a permission, or a file that another process uses.

    The input is not the cause, and the same call may succeed later.
    """


#: Error numbers of the system that are due to a file name given by the user.
_OF_NAMES = {
    getattr(errno, name) for name in ("ENOENT", "ENOTDIR", "EISDIR", "ENAMETOOLONG", "EINVAL", "ELOOP", "EILSEQ")
}


def file_error(number: int | None, message: str, *, file: str | Path | None = None) -> SpecError | ResourceError:
    """Return the error for a file that cannot be used: SpecError if its name is the cause, otherwise ResourceError.

    `number`: error number of the system; None if unknown.
    """
    return (SpecError if number in _OF_NAMES else ResourceError)(message, file=file)


class PluginError(MbdkitError):
    """A plugin could not be imported, conflicts with another, provides a wrong value, or raised an exception."""


class in_this_process:  # noqa: N801 (used like a function; a generator takes three times as long in every step)
    """If a plugin forks the process within a block, end the new process at the end of the block.

    Only the original process continues.
    """

    __slots__ = ("process",)

    def __enter__(self) -> None:
        self.process = os.getpid()

    def __exit__(self, *raised: object) -> None:
        if os.getpid() != self.process:
            os._exit(1)


@contextmanager
def blaming(what: str, *expected: type[Exception]) -> Iterator[None]:
    """Convert any exception of a plugin in this block, including SystemExit, to a PluginError that begins with `what`.

    Ctrl-C, errors of mbdkit about the input or a plugin, and the `expected` exceptions pass unchanged.
    """
    unchanged: tuple[type[BaseException], ...] = (SpecError, ArchiveError, PluginError, *expected)
    try:
        with in_this_process():
            yield
    except BaseException as error:
        if isinstance(error, unchanged) or is_interrupt(error):
            raise
        raise PluginError(f"{what}: {with_place(error)}") from error


#: Packages that are not plugins, but that call plugins or are called by them.
_NO_PLUGINS = {*OWN_PACKAGES, "pluggy", "pydantic", "pydantic_core", "numpy", "scipy", "sympy", "numba", "h5py"}


def with_place(error: BaseException) -> str:
    """Return an exception of a plugin on one line, with the file and line of the plugin where it was raised, if any.

    The package of the plugin is the first one in the traceback that is neither in `_NO_PLUGINS` nor in the standard
    library, and the line is the last one in this package. An exception raised in a library is thus reported with the
    line of the plugin that called the library.
    """
    location = _place_of(error)
    cause = error.__cause__
    while not location and cause is not None:  # mbdkit raised this error because of an exception of the plugin
        location, cause = _place_of(cause), cause.__cause__
    return f"{one_line(error)} ({shown(location)})" if location else one_line(error)


def _place_of(error: BaseException) -> str:
    package, location = "", ""
    trace = error.__traceback__
    while trace is not None:
        frame = trace.tb_frame
        name = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if not package and name and name not in _NO_PLUGINS | sys.stdlib_module_names:
            package = name
        if package and name == package:
            location = f"{frame.f_code.co_filename}, line {trace.tb_lineno}"
        trace = trace.tb_next
    return location


class MissingPartError(MbdkitError, ImportError):
    """A part of mbdkit is needed that is not installed.

    `wanted`: what needs the part. `part`: the part, such as ``mbdkit-studies``.
    """

    def __init__(self, wanted: str, part: str):
        super().__init__(f"{wanted} needs {part}, a part of mbdkit that is not installed")


class UnknownNameError(MbdkitError, KeyError):
    """The requested name does not exist in the run."""

    def __init__(self, what: str, name: object, known: Sequence[str]):
        few = listed(known[:8]) + (", ..." if len(known) > 8 else "")
        hint = did_you_mean(str(name), known) or (f"; available: {few}" if known else "; it has none")
        super().__init__(f"the run has no {what} {name!r}{hint}")

    def __str__(self) -> str:
        return str(self.args[0])


class RunError(MbdkitError):
    """A run did not complete; raised by `Run.check`."""


class StepError(Exception):
    """A step failed. The run ends with the status ``failed`` and this reason; its archive contains the results that
    were recorded before.

    `EquationsOfMotion` raises it if the equations have no unique or no finite solution; a method raises it if its own
    iteration does not converge.

    `code`: code of the reason, stored in the archive: ``newton-failed``, ``singular``, ``not-finite`` or
    ``step-too-small``, or a code of a plugin. `sentence`: description of the failure, without the time and without a
    full stop.
    """

    def __init__(self, code: str, sentence: str):
        super().__init__(code, sentence)
        self.code, self.sentence = code, sentence

    def __str__(self) -> str:
        return self.sentence
