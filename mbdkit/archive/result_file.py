"""Files with the result of a computation that is no run, such as an identification: written as a whole, and sealed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path

import h5py

from mbdkit.archive.fingerprint import StoredHashes, seal
from mbdkit.archive.hdf5 import set_text
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.part_file import LIBVER, check_target
from mbdkit.archive.run_writer import utc_now
from mbdkit.archive.untrusted_file import open_hdf5
from mbdkit.base.distributions import own_version
from mbdkit.base.errors import ArchiveError, SpecError
from mbdkit.base.files import replacing
from mbdkit.base.frozen import dataclass
from mbdkit.base.plain_data import json_text
from mbdkit.base.text import shown


@dataclass(frozen=True)
class ResultFile:
    """A kind of HDF5 files with results.

    Parameters
    ----------
    format, version
        Root attribute ``format``, and the number before the point in ``format_version``: versions 1.1, 1.2, ... may
        have additional data, which readers of 1.0 leave out.
    what
        What such a file is, for messages, such as ``result of an identification``.
    hint
        What to do about a damaged file, as a clause.
    """

    format: str
    version: int
    what: str
    hint: str

    def write(self, path: str | Path, fill: Callable[[h5py.File], None], *, overwrite: bool = False) -> Path:
        """Write a file with what `fill` adds to it, and return its path.

        An existing file, which `overwrite` permits to replace, is not changed before the new one is complete. Raises
        SpecError if no file of this name may be written, and ResourceError if the system refuses, as on a full disk.
        """
        target = check_target(path, overwrite=overwrite)
        with h5py.File(target.name, "w", driver="core", backing_store=False, libver=LIBVER) as file:
            version = f"{self.version}.0"
            texts = {"format": self.format, "format_version": version, "Conventions": f"{self.format}-{version}"}
            self.set_texts(file, texts | {"mbdkit_version": own_version(), "created_utc": utc_now()})
            fill(file)
            what = f"{self.what[0].upper()}{self.what[1:]}"
            self.set_texts(file, {name: what for name in ("title", "description") if name not in file.attrs})
            seal(file)
            file.flush()
            with replacing(target, overwrite=overwrite) as part:
                part.write_bytes(file.id.get_file_image())
        return target

    @staticmethod
    def set_texts(group: h5py.Group, values: Mapping[str, object]) -> None:
        """Add attributes to a group: texts, and other plain data as JSON, in which numbers are finite or null."""
        for name, value in values.items():
            set_text(group, name, value if isinstance(value, str) else json_text(value))

    @contextmanager
    def open(self, path: str | Path) -> Iterator[h5py.File]:
        """Yield a file that is read in a block, whose contents have their hashes.

        Raises SpecError if there is no such file, or it is of another kind, and ArchiveError if it is damaged, also
        for what the block cannot read.
        """
        with self._open(Path(path)) as file, reading("the result", Path(path), hint=self.hint):
            StoredHashes(file).verify()
            yield file

    @contextmanager
    def _open(self, path: Path) -> Iterator[h5py.File]:
        if not path.is_file():
            raise SpecError(f"there is no {self.what} of this name", file=path)
        with closing(open_hdf5(path, self.what, hint=self.hint)) as file:
            with reading("its format", path, hint=self.hint):
                kind, version = (str(file.attrs.get(name)) for name in ("format", "format_version"))
            if kind != self.format:
                raise SpecError(f"this is an HDF5 file, but not the {self.what}", file=path)
            if version.partition(".")[0] != str(self.version):
                message = f"this {self.what} has the format version {shown(version)}; this mbdkit reads {self.version}"
                raise SpecError(message, file=path)
            yield file

    def origin(self, path: Path) -> dict[str, str]:
        """Return when a file was written (UTC), and by which version of mbdkit."""
        with self._open(path) as file:
            return {name: str(file.attrs.get(name, "")) for name in ("created_utc", "mbdkit_version")}

    def problems(self, path: Path, read: Callable[[Path], object]) -> list[str] | None:
        """Return the problems of a file, which `read` reads, as sentences; None for a file of another kind."""
        try:
            with self._open(path):
                pass
        except (SpecError, ArchiveError):
            return None
        try:
            read(path)
        except ArchiveError as error:
            return [shown(error.message)]
        return []
