"""A folder that belongs to one study or design: its spec, its locks, and its replacement by a new study or design."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

from mbdkit.base.errors import SpecError, file_error
from mbdkit.base.files import check_folder, check_writable, rename_new
from mbdkit.spec.reading import read_file
from mbdkit.spec.yaml_reader import write_yaml
from mbdkit_studies.folder import folder_lock
from mbdkit_studies.folder.folder_lock import LOCK, WHOLE, Shard

JOBS = ".jobs-"  #: Prefix of the name of the folder for the files of submitted jobs.

#: Text that every page of mbdkit contains near its beginning.
_GENERATOR = b'<meta name="generator" content="mbdkit '

Spec = TypeVar("Spec")


class OwnedFolder(ABC, Generic[Spec]):
    """Paths in the folder of a study or design, and its locks.

    Attributes
    ----------
    KIND
        ``study`` or ``design``: name of the command, and of the spec in the folder (without ``.yaml``).
    files
        Paths of the files that are written into the folder in addition to the spec, the report, and the results that
        `remove_results` removes.
    """

    KIND: ClassVar[str]

    def __init__(self, path: Path, *files: Path):
        self.path, self.files = path, files
        self.spec = path / f"{self.KIND}.yaml"
        self.report = path / "report.html"
        self._begun = f".{self.spec.name}-"  # prefix of the temporary name of the spec while it is written

    @abstractmethod
    def is_same(self, spec: Spec) -> bool:
        """Return whether the spec in the folder is equal to `spec`."""

    @abstractmethod
    def plain_spec(self, spec: Spec) -> dict[str, object]:
        """Return the plain data that are written as the spec in the folder."""

    @abstractmethod
    def remove_results(self) -> None:
        """Remove all results except those in `files`; the spec and the report remain."""

    def check(self, spec: Spec, *, overwrite: bool = False) -> None:
        """Check that the folder can be used for this study or design, without changing anything.

        Parameters
        ----------
        overwrite
            Whether the folder may contain another study or design, which `clear` then removes.

        Raises
        ------
        SpecError
            If the path is not a folder, or the folder cannot be created, belongs to another study or design, contains
            other files but no spec, or contains a folder with the name of one of `files`.
        ResourceError
            If writing into it is not permitted.
        """
        path, kind = self.path, self.KIND
        if not os.path.lexists(path):
            check_folder(path.parent, path)
            check_writable(path.parent, path)
            return
        if not os.path.isdir(path):
            raise SpecError(f"this is not a folder; name a folder for the {kind} with -o", file=path)
        check_writable(path, path)
        has_others = not all(entry.name.startswith((self._begun, LOCK, JOBS)) for entry in path.iterdir())
        # looked up after the listing of other files, because another call creates the spec before any other file
        if self.spec.is_file():
            if overwrite:
                self._check_own()
            else:
                self.check_same(spec)
        elif has_others:
            message = f"this folder contains other files and no {self.spec.name}; choose another folder with -o"
            raise SpecError(message, file=path)
        for file in filter(os.path.isdir, self.files):
            message = f"this is a folder, but the {kind} writes a file of this name; rename or remove it"
            raise SpecError(message, file=file)

    def check_same(self, spec: Spec) -> None:
        """Raise SpecError unless the spec in the folder is equal to `spec`."""
        if not self.is_same(spec):
            raise SpecError(
                f"this folder belongs to another {self.KIND}, or to an earlier version of this one: its "
                f"{self.spec.name} differs; choose another folder with -o, or replace its contents with --overwrite",
                file=self.path,
            )

    def _check_own(self) -> None:
        """Raise SpecError if the file of the spec is not a spec of this kind; no file must be removed in this case."""
        if f"mbdkit_{self.KIND}" not in read_file(self.spec).data:
            message = f"this is not the spec of a {self.KIND}, so its folder is not overwritten"
            raise SpecError(message, file=self.spec)

    def clear(self) -> None:
        """Remove the spec, the results and the report.

        All other files remain, including a report.html that was not written by mbdkit.

        Raises
        ------
        SpecError
            If the file of the spec is not a spec of this kind.
        ResourceError
            If another call uses the folder, or the system refuses to remove a file.
        """
        if not self.spec.is_file():
            return
        self._check_own()
        with self.locked():
            try:
                for path in self.files:
                    path.unlink(missing_ok=True)
                self.remove_results()
                if contains(self.report, _GENERATOR):
                    self.report.unlink()
                self.spec.unlink()
            except OSError as error:
                message = f"cannot be removed: {error.strerror or error}"
                raise file_error(error.errno, message, file=error.filename or self.path) from error

    def prepare(self, spec: Spec) -> None:
        """Create the folder and the spec in it, unless they exist.

        Several calls may do this at the same time, because the spec appears before any other file, and with its whole
        content.

        Raises
        ------
        SpecError
            If another call has just begun another study or design in this folder.
        ResourceError
            If the system refuses a file or folder.
        """
        try:
            self.path.mkdir(exist_ok=True)
            if not self.spec.exists():
                begun = self.path / f"{self._begun}{secrets.token_hex(4)}"
                try:
                    begun.write_text(write_yaml(self.plain_spec(spec)), encoding="utf-8", newline="\n")
                    # another call has created the spec, or has removed the temporary file, in the meantime
                    with contextlib.suppress(FileExistsError, FileNotFoundError):
                        rename_new(begun, self.spec)
                finally:
                    begun.unlink(missing_ok=True)
            self.check_same(spec)  # another call may have written a different spec since `self.check`
            self.create_more(spec)
        except OSError as error:
            raise file_error(error.errno, f"cannot be created: {error.strerror or error}", file=self.path) from error

    def create_more(self, spec: Spec) -> None:
        """Create the files and folders that are needed in addition to the spec."""

    def owners(self) -> list[str]:
        """Return the processes that hold a lock of the folder, in words."""
        owners = map(folder_lock.Owner.of, sorted(self.path.glob(f"{LOCK}*")))
        alive = (owner for owner in owners if owner is not None and not owner.is_dead)
        return [f"process {owner.pid} on {owner.host} since {owner.since}" for owner in alive]

    @contextlib.contextmanager
    def locked(self, shard: Shard | None = None) -> Iterator[None]:
        """Lock the folder against other calls.

        Parameters
        ----------
        shard
            The part of a study that is computed; calls for parts without common runs may run at the same time. None for
            the whole study or design; files that killed calls have left are removed in this case.

        Raises
        ------
        ResourceError
            If another call holds the lock.
        """
        with folder_lock.locked(self.path, self.spec, shard or WHOLE, self.KIND):
            if shard is None:
                for begun in self.path.glob(f"{self._begun}*"):
                    begun.unlink(missing_ok=True)
                for jobs in self.path.glob(f"{JOBS}*"):
                    shutil.rmtree(jobs, ignore_errors=True)
            yield


def contains(path: Path, mark: bytes) -> bool:
    """Return whether a regular file has a mark of mbdkit near its beginning."""
    if not path.is_file() or path.is_symlink():
        return False
    with path.open("rb") as file:
        return mark in file.read(4096)
