"""Target file of an archive: written as FILE.h5.part under a lock, and renamed atomically at the end."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import h5py

from mbdkit.archive.hdf5_errors import cause, error_number
from mbdkit.archive.part_stream import PartStream
from mbdkit.base import file_locks
from mbdkit.base.errors import MbdkitError, ResourceError, SpecError, file_error
from mbdkit.base.files import check_not_input, check_output, rename_new, replace_file

SUFFIX = ".h5"

#: Suffix that is appended to the name of an archive while it is being written.
PART = ".part"

#: HDF5 1.8 (2008) is the oldest library that can read an archive. Older object headers limit attributes to 64 KiB,
#: which `misalignment_max` exceeds from about 8,000 joints on.
LIBVER = ("v108", "v108")


def part_path(path: Path) -> Path:
    """Return the name of an archive while it is being written."""
    return path.with_name(path.name + PART)


def checkpoint_path(part: Path) -> Path:
    """Return the name of the checkpoint of a ``.part``, or of the archive of an interrupted run."""
    return part.with_name(f"{part.name}.checkpoint")


def new_checkpoint_path(part: Path) -> Path:
    """Return the name of a checkpoint while it is being written."""
    return part.with_name(f"{part.name}.checkpoint.new")


def remove_checkpoint(part: Path) -> None:
    """Remove the checkpoint of a ``.part``, or of the archive of an interrupted run, if there is one."""
    for path in (checkpoint_path(part), new_checkpoint_path(part)):
        path.unlink(missing_ok=True)


def remove_part(part: Path) -> None:
    """Remove a ``.part`` and its checkpoint, if these exist."""
    remove_checkpoint(part)
    part.unlink(missing_ok=True)


def check_target(path: str | Path, *, overwrite: bool = False, source: str | Path | None = None) -> Path:
    """Check that an archive may be written at `path`, without changing the file system.

    `overwrite`: whether an existing file may be replaced. `source`: the input file, which is never replaced. Raises
    SpecError if the name is not suitable, the folder does not exist, or an existing file may not be replaced. Raises
    ResourceError if writing into the folder is not permitted.
    """
    path = Path(path)
    check_not_input(path, source)
    if path.suffix != SUFFIX and (os.path.isfile(path) or not os.path.lexists(path)):  # devices, folders: see below
        raise SpecError(f"the name of an archive ends in .h5: write {path.with_suffix(SUFFIX)}", file=path)
    check_output(path, overwrite=overwrite, source=source, suffix=SUFFIX)
    return path


class Target:
    """An archive being written to `path`: created as ``.part`` immediately, in the end renamed (`publish`) or removed
    (`drop`).

    `overwrite`: whether publishing replaces an existing file. `part`: name of the file until `publish` or
    `take_place_of` renames it; by default `path` with the suffix ``.part``. Raises SpecError if no archive may be
    written at `path`. Raises ResourceError if the system refuses to create the file, or another run is writing it.
    """

    def __init__(self, path: Path, *, overwrite: bool, part: Path | None = None):
        self._path = check_target(path, overwrite=overwrite)
        self._part = part_path(path) if part is None else part
        # a plugin may change the working folder, or fork the process
        self._folder, self._process = os.getcwd(), os.getpid()
        self.overwrite = overwrite
        self.is_kept = False  # whether `drop` leaves the .part in place
        self._handle: int | None = self._create()
        self.file: h5py.File | None = None
        self._stream: PartStream | None = None
        try:
            remove_checkpoint(self.part)  # it may have been left by an earlier file of this name
        except OSError as error:
            self.drop()
            message = f"the checkpoint of an earlier file cannot be removed: {cause(error)}"
            raise ResourceError(message, file=self.path) from error

    @property
    def path(self) -> Path:
        """Final name of the archive; absolute if the working folder has changed since."""
        return self._from_here(self._path)

    @property
    def part(self) -> Path:
        """Current name of the file."""
        return self._from_here(self._part)

    def _from_here(self, path: Path) -> Path:
        with contextlib.suppress(OSError):  # raised if the working folder has been removed
            if path.is_absolute() or os.getcwd() == self._folder:
                return path
        return Path(self._folder) / path

    def _end_if_forked(self) -> None:
        """End the process if it is a fork, made by a plugin, of the process that writes the archive.

        Two processes that write to the same file would damage it.
        """
        if os.getpid() != self._process:
            os._exit(1)

    def _create(self) -> int:
        # Exclusive creation: if two runs start at the same time, only one of them can create the .part.
        for _ in range(3):
            try:
                handle = file_locks.open_file(self.part, os.O_RDWR | os.O_CREAT | os.O_EXCL)
            except FileExistsError:
                self._remove_stale()
                continue
            except OSError as error:
                message = f"the archive cannot be created: {cause(error)}"
                raise file_error(error_number(error), message, file=self.path) from error
            if self._is_locked(handle):
                return handle
            os.close(handle)
        raise self._in_use()

    def _is_locked(self, handle: int) -> bool:
        """Lock a new .part. Return False if another run took it for that of a crashed run before it was locked."""
        try:
            file_locks.lock(handle)
        except BlockingIOError:
            return False
        except OSError:  # the file system does not support locks
            return True
        return file_locks.has_name(handle, self.part)

    def open(self) -> h5py.File:
        """Open the .part as an HDF5 file, for a run that writes rows before its end."""
        self._end_if_forked()
        self._stream = PartStream(self._open_handle())
        with self._stream.checked():
            self.file = h5py.File(self._stream, "w", libver=LIBVER)
        return self.file

    def _in_use(self) -> ResourceError:
        message = f"{self.part} is in use by another run; wait for it, or choose another name"
        return ResourceError(message, file=self.path)

    def _remove_stale(self) -> None:
        """Remove the .part of a crashed run; raise ResourceError if it is locked by a run in progress."""
        try:
            if not stat.S_ISREG(os.lstat(self.part).st_mode):
                raise SpecError(f"{self.part} exists and is not a regular file", file=self.path)
            handle = file_locks.open_file(self.part, os.O_RDWR | file_locks.NO_LINKS)
            try:
                file_locks.lock(handle)
                if file_locks.has_name(handle, self.part):
                    remove_part(self.part)
            finally:
                os.close(handle)
        except FileNotFoundError:
            pass
        except BlockingIOError:
            raise self._in_use() from None
        except OSError as error:
            message = f"the unfinished {self.part} cannot be replaced: {cause(error)}"
            raise ResourceError(message, file=self.path) from error

    def _open_handle(self) -> int:
        assert self._handle is not None
        return self._handle

    @contextlib.contextmanager
    def committing(self) -> Iterator[None]:
        """Flush the HDF5 file after a block, so that all changes since the last flush take effect at once.

        Without such a block, or if it raises an exception, the file remains as it is.
        """
        self._end_if_forked()
        assert self.file is not None
        assert self._stream is not None
        with self._stream.checked():
            yield
            self.file.flush()
        self._stream.commit(self.file.id.get_filesize())

    def sync(self) -> None:
        """Wait until the flushed data are on the disk."""
        os.fsync(self._open_handle())

    def write(self, image: bytes) -> None:
        """Write the bytes of an HDF5 file that was created in memory, and wait until they are on the disk."""
        self._end_if_forked()
        with PartStream(self._open_handle()) as stream:
            with stream.checked():
                stream.write(image)
            stream.commit(len(image))
        self.sync()

    def end(self) -> None:
        """Close the flushed HDF5 file, and wait until its data are on the disk."""
        self._close_file()
        self.sync()

    def publish(self, *, keep: bool = False) -> None:
        """Rename the complete .part to its final name, and rename or remove its checkpoint.

        Nothing is written to the file afterwards, so that an archive with its final name is sound. Unless `overwrite`
        is set, a file that was created there during the run is not replaced. The .part is still locked, so that other
        runs do not take it for that of a crashed run and remove it.

        `keep`: whether the checkpoint is kept beside the archive, so that the run can be resumed. Raises MbdkitError if
        the .part cannot be renamed; it then keeps its name.
        """
        self._end_if_forked()
        try:
            if not keep:
                remove_checkpoint(self.part)
            if self.overwrite:
                replace_file(self.part, self.path)
            else:
                rename_new(self.part, self.path)
        except FileExistsError as error:
            raise MbdkitError(
                f"{self.path} was created during the run and is not overwritten; the archive is {self.part}"
            ) from error
        except OSError as error:
            raise ResourceError(f"the archive {self.part} cannot be renamed to {self.path} ({cause(error)})") from error
        with contextlib.suppress(OSError):  # the archive is complete; only resuming needs its checkpoint
            if keep and checkpoint_path(self.part).exists():
                replace_file(checkpoint_path(self.part), checkpoint_path(self.path))
            else:
                remove_checkpoint(self.path)  # of a run whose archive has been replaced

    def close(self) -> None:
        """Close the archive and release the lock, whether it has been renamed or not; discard a write that failed
        halfway.
        """
        self._end_if_forked()
        self._close_file()
        if self._handle is not None:
            with contextlib.suppress(OSError):  # closing does not unlock it if a forked process, as of a plugin, has it
                file_locks.unlock(self._handle)
            with contextlib.suppress(OSError):  # the data of an archive with its final name are on the disk
                os.close(self._handle)
            self._handle = None

    def _close_file(self) -> None:
        """Close the HDF5 file if it is open, and discard what HDF5 writes: the file has had it since its last flush."""
        if self._stream is None:
            return
        self._stream.discard()
        if self.file is not None:
            with contextlib.suppress(OSError, RuntimeError):
                self.file.close()
        self._stream.close()
        self.file = self._stream = None

    def drop(self) -> None:
        """Close and remove the .part and its checkpoint, unless `take_place_of` has renamed them."""
        self.close()
        if not self.is_kept:
            with contextlib.suppress(OSError):  # called when writing has failed, possibly on the whole disk
                remove_part(self.part)

    def take_place_of(self, part: Path) -> None:
        """Rename this .part and its checkpoint to `part` and the checkpoint of `part`, and replace existing files.

        The data must have been flushed. Afterwards, `drop` does not remove the files, even if only the checkpoint could
        be renamed.

        Raises ResourceError if a file cannot be renamed.
        """
        self.sync()
        try:
            # A checkpoint contains the inode number of its file: if the process is killed between the two renamings, or
            # the second one fails, `mbdkit.runs.resuming` recognizes the file, and finishes the replacement.
            replace_file(checkpoint_path(self.part), checkpoint_path(part))
            self.is_kept = True
            replace_file(self.part, part)
        except OSError as error:
            raise ResourceError(f"{self.part} cannot be renamed to {part} ({cause(error)})") from error
        self._part = part


def write_image(path: Path, image: bytes, *, overwrite: bool = False) -> None:
    """Write the bytes of an HDF5 file that was created in memory.

    Raises SpecError if no archive may be written at `path`. Raises ResourceError if the file cannot be written, as on a
    full disk, or another run is writing it. Raises MbdkitError if the file was created by another program in the
    meantime, and `overwrite` is not set.
    """
    target = Target(path, overwrite=overwrite)
    try:
        target.write(image)
    except OSError as error:
        target.drop()
        raise ResourceError(f"{path} cannot be written: {cause(error)}") from error
    try:
        target.publish()
    finally:
        target.close()
