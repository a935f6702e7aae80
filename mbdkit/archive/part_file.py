"""Where an archive goes: written as FILE.h5.part under a lock, and given its final name in one atomic step."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

import h5py

from mbdkit.archive.hdf5_errors import cause
from mbdkit.errors import MbdkitError, SpecError

SUFFIX = ".h5"

#: HDF5 1.8 (2008) is the oldest library that reads an archive. Its object headers, unlike the older ones, hold
#: attributes of more than 64 KiB, which `misalignment_max` is from 8,000 joints on.
LIBVER = ("v108", "v108")

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def part_path(path: Path) -> Path:
    """Return the name an archive has while it is written."""
    return path.with_name(path.name + ".part")


def check_target(path: str | Path, *, overwrite: bool = False) -> Path:
    """Check, without touching anything, that an archive may be written at `path`.

    Parameters
    ----------
    path
        The final name; it ends in ``.h5``.
    overwrite
        Whether an existing file may be replaced.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    SpecError
        If the name, the folder or what stands there does not allow it.
    """
    path = Path(path)
    # Not Path's own questions: they raise for a name too long or a folder that cannot be searched.
    if os.path.isdir(path):
        raise SpecError(f"this is a folder; name a file in it, such as {path / 'run.h5'}", file=path)
    if path.suffix != SUFFIX:
        raise SpecError(f"the name of an archive ends in .h5: write {path.with_suffix(SUFFIX)}", file=path)
    folder = path.parent
    if not os.path.isdir(folder):
        what = "is not a folder" if os.path.exists(folder) else "does not exist; create it first"
        raise SpecError(f"the folder {folder} {what}", file=path)
    if os.path.lexists(path):
        if not os.path.isfile(path):
            raise SpecError("this is not a regular file and is not replaced; choose another name", file=path)
        if not overwrite:
            raise SpecError("this file exists already; choose another name, or allow it to be overwritten", file=path)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise SpecError(f"the folder {folder} cannot be written to", file=path)
    return path


class Target:
    """One archive on its way to `path`: created as ``.part`` at once, published or dropped at the end.

    Parameters
    ----------
    path
        The final name.
    overwrite
        Whether an existing file is replaced when the archive is published.

    Raises
    ------
    SpecError
        If the archive may not be written there, or another run is writing it.
    """

    def __init__(self, path: Path, *, overwrite: bool):
        self.path = check_target(path, overwrite=overwrite)
        self.part = part_path(path)
        self.overwrite = overwrite
        self._torn = False  # whether a write is under way, or failed half-way
        self.file = self._create()
        self._handle: int | None = os.open(self.part, os.O_RDWR)
        self._lock()

    def _create(self) -> h5py.File:
        # A .part is only ever created where there is none, so of two runs that start at once one is refused.
        for attempt in range(3):
            try:
                return h5py.File(self.part, "x", libver=LIBVER, locking="best-effort")
            except BlockingIOError:
                raise self._in_use() from None
            except (OSError, ValueError) as error:
                # HDF5 has no errno for a file that it has open itself.
                if not isinstance(error, FileExistsError) and "file exists" not in str(error):
                    raise SpecError(f"the archive cannot be created: {cause(error)}", file=self.path) from error
                if attempt == 2:
                    raise self._in_use() from None
                self._remove_stale()
        raise AssertionError("unreachable")

    def _in_use(self) -> SpecError:
        return SpecError(f"{self.part} is in use by another run; wait for it, or choose another name", file=self.path)

    def _remove_stale(self) -> None:
        """Remove a .part whose writer is dead: a live one holds a lock on it."""
        try:
            if not stat.S_ISREG(os.lstat(self.part).st_mode):
                raise SpecError(f"{self.part} stands in the way and is not a regular file", file=self.path)
            if sys.platform == "win32":  # an open file cannot be removed there
                self.part.unlink()
                return
            import fcntl

            handle = os.open(self.part, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.path.samestat(os.fstat(handle), os.lstat(self.part)):
                    self.part.unlink()
            finally:
                os.close(handle)
        except FileNotFoundError:
            pass
        except BlockingIOError:
            raise self._in_use() from None
        except OSError as error:
            raise SpecError(f"the unfinished {self.part} cannot be replaced: {cause(error)}", file=self.path) from error

    def _lock(self) -> None:
        """Lock the new .part where HDF5 did not, as with HDF5_USE_FILE_LOCKING=FALSE."""
        if sys.platform != "win32":
            import fcntl

            with contextlib.suppress(OSError):  # HDF5 did
                fcntl.flock(self._open_handle(), fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _open_handle(self) -> int:
        assert self._handle is not None
        return self._handle

    @contextlib.contextmanager
    def reserved(self, size: int) -> Iterator[None]:
        """Write about `size` bytes to the file within this block; a disk too full for it fails before it.

        A write that fails within HDF5 would cost all that was written before, for HDF5 cannot take it back.
        """
        handle = self._open_handle()
        end = os.fstat(handle).st_size
        if hasattr(os, "posix_fallocate"):
            try:
                os.posix_fallocate(handle, end, size)
            except OSError as error:
                os.ftruncate(handle, end)
                if error.errno in _FULL:
                    raise
        elif shutil.disk_usage(self.part.parent).free < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._torn = True
        yield
        self.file.flush()
        os.ftruncate(handle, self.file.id.get_filesize())
        self._torn = False

    def sync(self) -> None:
        """Wait until the disk has what was flushed."""
        os.fsync(self._open_handle())

    def replace_content(self, image: bytes) -> None:
        """Make the .part a copy of another archive; `file` is closed.

        Parameters
        ----------
        image
            All bytes of that archive.
        """
        self.file.close()
        self._lock()
        with open(self._open_handle(), "wb", closefd=False) as out:
            out.truncate(0)
            out.write(image)
        self.sync()

    def publish(self) -> None:
        """Give the flushed .part its final name; a file that appeared there meanwhile is not replaced.

        The archive is still open, and so its lock keeps other runs from taking the .part for a dead one's.

        Raises
        ------
        MbdkitError
            If it cannot be renamed; it stays under the name of the .part.
        """
        if sys.platform == "win32":  # an open file cannot be renamed there
            self.file.close()
        try:
            if self.overwrite:
                os.replace(self.part, self.path)
            else:
                _rename_new(self.part, self.path)
        except FileExistsError as error:
            raise MbdkitError(
                f"{self.path} appeared while the run was under way and is left as it is; the archive is {self.part}"
            ) from error
        except OSError as error:
            raise MbdkitError(
                f"the archive cannot be renamed to {self.path} ({cause(error)}); it is {self.part}"
            ) from error

    def close(self) -> None:
        """Close the archive, by whatever name, and let go of the lock; a write that failed half-way is forgotten."""
        if self._torn and self.file and hasattr(os, "memfd_create"):
            # HDF5 tries what it could not write again and again, and crashes the interpreter at its end: let it write
            # to memory instead.
            nowhere = os.memfd_create("mbdkit")
            os.dup2(nowhere, self.file.id.get_vfd_handle())
            os.close(nowhere)
        with contextlib.suppress(OSError, RuntimeError):
            self.file.close()
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def drop(self) -> None:
        """Close the .part and remove it."""
        self.close()
        self.part.unlink(missing_ok=True)


def _rename_new(source: Path, target: Path) -> None:
    """Rename in one step that fails if `target` exists."""
    try:
        os.link(source, target)
    except FileExistsError:
        raise
    except OSError:
        # A file system without hard links: look, then rename; the instant between the two is not covered.
        if os.path.lexists(target):
            raise FileExistsError(str(target)) from None
        os.rename(source, target)
    else:
        source.unlink()
