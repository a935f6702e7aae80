"""Safe reading and writing of files of the user.

Only regular files are read, up to a limit. Contents to be written go to a temporary file that is renamed at the end, so
that no failure damages an existing file.
"""

from __future__ import annotations

import os
import re
import secrets
import stat
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from mbdkit.base import file_locks
from mbdkit.base.errors import ResourceError, SpecError, file_error

PATIENCE = 2.0  #: Time for which Windows is asked again to rename a file that another program has open [s].

#: Errors of Windows if a file is open: ERROR_ACCESS_DENIED, ERROR_SHARING_VIOLATION, ERROR_LOCK_VIOLATION.
_OPEN_ELSEWHERE = (5, 32, 33)


def check_path(path: str | Path) -> None:
    """Raise SpecError for a name that no file can have."""
    with suppress(UnicodeEncodeError):
        if b"\0" not in os.fsencode(path):
            return
    raise SpecError("no file can have this name, with a null character or half of a surrogate pair", file=path)


def check_regular(path: str | Path) -> None:
    """Raise SpecError if `path`, which exists, is not a regular file: reading a pipe or a device may never end."""
    if not stat.S_ISREG(os.stat(path).st_mode):
        kind = "a folder" if os.path.isdir(path) else "a pipe, a socket or a device"
        raise SpecError(f"this is not a regular file but {kind}; it is not read", file=path)


def read_bytes(path: str | Path, largest: int, advice: str = "") -> bytes:
    """Return the content of a file of the user, such as a model of another program.

    `largest`: largest number of bytes. They are also counted as they are read, because a file may have more of them
    than the system states. `advice`: advice on a file that is too large, which is appended to the message. Raises
    SpecError if the file does not exist, is not a regular file, or is too large. Raises ResourceError if the system
    refuses to read the file.
    """
    check_path(path)
    try:
        check_regular(path)
        # another program may have replaced the file by a pipe since the check
        waits_not = getattr(os, "O_NONBLOCK", 0)
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | waits_not)) as stream:
            size = os.fstat(stream.fileno()).st_size
            content = b"" if size > largest else stream.read(largest + 1) or b""
    except OSError as error:
        raise file_error(error.errno, f"this file cannot be read: {error.strerror or error}", file=path) from None
    if max(size, len(content)) > largest:
        message = f"this file is larger than {largest >> 20} MiB, the limit for files of this kind"
        raise SpecError("; ".join(filter(None, (message, advice))), file=path)
    return content


def check_suffix(path: str | os.PathLike[str], allowed: Sequence[str], what: str) -> Path:
    """Return `path` as a Path after checking its suffix. Raises SpecError if the suffix is not one of `allowed`."""
    target = Path(path)
    if target.suffix.lower() not in allowed:
        names = " or ".join(filter(None, (", ".join(allowed[:-1]), allowed[-1])))
        text = f"ends in {target.suffix!r}" if target.suffix else "has no suffix"
        raise SpecError(f"{what} cannot be written to {str(target)!r}, which {text}; its name must end in {names}")
    return target


#: File names that Windows does not allow, or takes for devices or, after a colon, for streams of another file.
#:
#: See "Naming Files, Paths, and Namespaces" in Microsoft's documentation.
_REFUSED_BY_WINDOWS = re.compile(
    r'.*[<>:"|?*\x00-\x1f].*|.*[. ]|(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9\u00b9\u00b2\u00b3]) *(\..*)?',
    re.IGNORECASE | re.DOTALL,
)


def check_name_of_file(name: str) -> None:
    """Raise SpecError on Windows for a file name that it does not allow."""
    if file_locks.IS_WINDOWS and _REFUSED_BY_WINDOWS.fullmatch(name):
        raise SpecError(
            'Windows does not allow this name of a file: it contains one of <>:"|?*, ends with a full stop or a space, '
            "or is that of a device; choose another name",
            file=name,
        )


def check_output(path: Path, *, overwrite: bool, source: str | Path | None = None, suffix: str = "") -> None:
    """Check that a file may be written at `path`; the check does not change the file system.

    `overwrite`: whether an existing regular file may be replaced. Folders, devices, pipes, sockets and symbolic links
    are never replaced. `source`: the input file, which is never replaced; None or ``-`` if the input is not a file.
    `suffix`: suffix of the file name that the message suggests if `path` is a folder; by default the suffix of `path`.
    Raises SpecError if the folder does not exist, or an existing file may not be replaced. Raises ResourceError if
    writing into the folder is not permitted, or the existing file cannot be replaced because it is open.
    """
    check_path(path)
    check_name_of_file(path.name)
    # os.path instead of methods of Path, which raise for names that are too long and for folders without permission
    if os.path.isdir(path):
        suffix = suffix or path.suffix
        example = f", such as {path / 'results'}{suffix}" if suffix else ""
        raise SpecError(f"this is a folder; name a file in it{example}", file=path)
    check_folder(path.parent, path)
    if os.path.lexists(path):
        if not stat.S_ISREG(os.lstat(path).st_mode):
            kind = "a symbolic link, not a regular file," if os.path.islink(path) else "not a regular file"
            raise SpecError(f"this is {kind} and is not replaced; choose another name", file=path)
        check_not_input(path, source)
        if not overwrite:
            raise SpecError(
                "this file exists already; choose another name, or replace it with --overwrite (overwrite=True in "
                "Python)",
                file=path,
            )
        if file_locks.is_kept_by_a_program(path):
            message = "this file is open in this or another program, so that Windows cannot replace it; close it there"
            raise ResourceError(message, file=path)
    check_writable(path.parent, path)


def check_folder(folder: Path, path: Path) -> None:
    """Raise SpecError about `path`, which is to be created in `folder`, if `folder` is not a folder."""
    if not os.path.isdir(folder):
        what = "is not a folder" if os.path.exists(folder) else "does not exist; create it first"
        raise SpecError(f"the folder {folder} {what}", file=path)


def check_writable(folder: Path, path: Path) -> None:
    """Raise ResourceError about `path` if writing into `folder` is not permitted."""
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ResourceError(f"the folder {folder} cannot be written to", file=path)


def check_not_input(path: Path, source: str | Path | None) -> None:
    """Raise SpecError if `path` is the input file `source` of a command; None or ``-`` means that the input is not a
    file.
    """
    if source in (None, "-") or not os.path.isfile(path) or not os.path.isfile(str(source)):
        return
    if os.path.samefile(path, str(source)):
        raise SpecError("this file is the input, which is not overwritten; choose another name", file=path)


@contextmanager
def replacing(target: Path, *, overwrite: bool = True, source: str | Path | None = None) -> Iterator[Path]:
    """Yield a temporary file in the folder of `target`; it becomes `target` if the block succeeds.

    The temporary file, ``.NAME-xxxxxxxx.mbdkit.SUFFIX``, is locked while it is being written. A temporary file left by
    a killed process is removed when `target` is written the next time.

    `overwrite`, `source`: see `check_output`. Raises SpecError if the file may not be written, or its name is not
    valid. An existing file then remains unchanged. Raises ResourceError if writing fails for another reason, such as a
    full disk. An existing file then remains unchanged.
    """
    check_output(target, overwrite=overwrite, source=source)
    stem = f".{target.stem[:40]}"
    temporary: Path | None = None
    lock: int | None = None
    try:
        _remove_left(target.parent, re.compile(rf"{re.escape(stem)}-[0-9a-f]{{8}}\.mbdkit{re.escape(target.suffix)}"))
        temporary, lock = _created(target, stem)
        yield temporary
        os.fsync(lock)
        if os.path.lexists(target) and not stat.S_ISREG(os.lstat(target).st_mode):
            check_output(target, overwrite=overwrite)  # another process has created the file since the check
        if overwrite:
            replace_file(temporary, target)
        else:
            rename_new(temporary, target)
    except FileExistsError:
        raise SpecError("this file was created meanwhile and is not overwritten", file=target) from None
    except OSError as error:
        if not error.errno:  # an error of HDF5 while reading the run, which does not concern this file
            raise
        raise file_error(error.errno, f"this file cannot be written: {error.strerror or error}", file=target) from error
    finally:
        if temporary is not None and lock is not None:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            os.close(lock)


def _created(target: Path, stem: str) -> tuple[Path, int]:
    """Create a temporary file in the folder of `target`, lock it, and return its path and its handle."""
    while True:
        path = target.with_name(f"{stem}-{secrets.token_hex(4)}.mbdkit{target.suffix}")
        handle = file_locks.open_file(path, os.O_RDWR | os.O_CREAT | os.O_EXCL)
        _locked(handle, wait=True)
        # Before the file is locked, another process may mistake it for the file of a killed process, and remove it.
        if file_locks.has_name(handle, path):
            return path, handle
        os.close(handle)


def replace_file(source: Path, target: Path) -> None:
    """Rename `source` to `target`, and replace a file that exists there; raise OSError if this is not possible."""
    _rename(os.replace, source, target)


def _rename(rename: Callable[[Path, Path], None], source: Path, target: Path) -> None:
    """Rename a file, and on Windows wait up to `PATIENCE` until no other program has it open.

    Windows cannot rename or replace a file that is open in a program that does not expect this, such as one that uses
    HDF5. Virus scanners and search indexers open new files for a short time.
    """
    until = time.monotonic() + PATIENCE
    while True:
        try:
            return rename(source, target)
        except PermissionError as error:
            if getattr(error, "winerror", None) not in _OPEN_ELSEWHERE:
                raise
            if time.monotonic() > until:
                reason = f"{target.name} is open in this or another program, or is write-protected; close it there"
                raise PermissionError(error.errno, reason) from error
        time.sleep(0.02)


def rename_new(source: Path, target: Path) -> None:
    """Rename `source` atomically, or raise FileExistsError if `target` exists."""
    if file_locks.IS_WINDOWS:
        return _rename(os.rename, source, target)  # on Windows, it replaces nothing
    try:
        os.link(source, target)
    except FileExistsError:
        raise
    except OSError:
        # The file system has no hard links. A target created between the next two statements is overwritten.
        if os.path.lexists(target):
            raise FileExistsError(str(target)) from None
        os.rename(source, target)
    else:
        with suppress(OSError):  # the file has its new name; where the old one cannot be removed, it has both
            source.unlink()


def _remove_left(folder: Path, pattern: re.Pattern[str]) -> None:
    """Remove temporary files of killed processes; files of running processes are locked."""
    with os.scandir(folder) as entries:
        left = [entry.name for entry in entries if pattern.fullmatch(entry.name)]
    for name in left:
        with suppress(OSError):
            handle = file_locks.open_file(folder / name, os.O_RDWR | file_locks.NO_LINKS)
            try:
                if stat.S_ISREG(os.fstat(handle).st_mode) and _locked(handle):
                    os.unlink(folder / name)
            finally:
                os.close(handle)


def _locked(handle: int, *, wait: bool = False) -> bool:
    """Lock an open file, and return whether this was possible; with `wait`, wait until another process unlocks it."""
    try:
        file_locks.lock(handle, wait=wait)
    except OSError:  # locked by another process, or the file system does not support locks
        return False
    return True
