"""Files of the user that are read for a run: their hashes, which archives store, and which of them may be read again.

Code that reads such a file, also in plugins, calls `read_data`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from contextlib import AbstractContextManager
from contextvars import ContextVar
from pathlib import Path
from typing import NamedTuple

from mbdkit.base.context_values import value_within
from mbdkit.base.errors import SpecError
from mbdkit.base.files import read_bytes
from mbdkit.base.plain_data import json_data
from mbdkit.base.text import shown


class FileRead(NamedTuple):
    """A file that was read: name without the folder, size [bytes], and SHA-256 of the content in hexadecimal."""

    name: str
    size: int
    sha256: str


FilesRead = dict[FileRead, None]  #: Files that were read, without duplicates, in the order of reading.
_RECORDS: ContextVar[tuple[FilesRead, ...]] = ContextVar("records", default=())
#: The files that may be read, by their content; None for all.
_KNOWN: ContextVar[Sequence[FileRead] | None] = ContextVar("known", default=None)


def recording(files: FilesRead) -> AbstractContextManager[None]:
    """Add all files that are read within a block to `files`."""
    return value_within(_RECORDS, (*_RECORDS.get(), files))


def only_known(files: Sequence[FileRead] | None, *, allowed: bool) -> AbstractContextManager[None]:
    """Within a block that runs the spec of an archive, refuse all files, or those that the archive does not list.

    `files`: the files that the archive lists; None if the archive is missing, as that of a run of a study may be.
    `allowed`: whether the user allows that files are read.
    """
    return value_within(_KNOWN, files if allowed else ())


def check_readable(path: str | Path) -> None:
    """Raise SpecError if `path` is no name of a file, or if the spec of an archive names it, and no files may be read
    for it.
    """
    if "\0" in str(path):
        raise SpecError(f"the name of the file {shown(path)} has a NUL character")
    if (known := _KNOWN.get()) is not None and not known:
        raise SpecError(
            f"its spec names the file {shown(path)}; files are read only with --files (files=True in Python), and only "
            "those that the archive lists"
        )


def read_data(path: str | Path, largest: int, advice: str = "") -> bytes:
    """Return the content of a file that a spec names, and record that it was read; see `mbdkit.base.files.read_bytes`.

    Raises SpecError if the file cannot be read as a regular file of at most `largest` bytes, or if the spec comes from
    an archive and the file may not be read for it. Raises ResourceError if the system refuses to read the file.
    """
    check_readable(path)
    content = read_bytes(path, largest, advice)
    note_read(path, content)
    return content


def note_read(path: str | Path, content: bytes) -> None:
    """Record a file that was read.

    Raises SpecError if the spec comes from an archive, and this is not the content with which the run was made.
    """
    known = _KNOWN.get()
    if not _RECORDS.get() and known is None:
        return
    file = FileRead(Path(path).name, len(content), hashlib.sha256(content).hexdigest())
    if known is not None and file.sha256 not in {other.sha256 for other in known}:
        raise SpecError("this file is not the one with which the run was made: its SHA-256 differs", file=path)
    for record in _RECORDS.get():
        record[file] = None


def files_json(files: Sequence[FileRead]) -> str:
    """Return files as the JSON that archives hold."""
    return json.dumps([file._asdict() for file in files], separators=(",", ":"), ensure_ascii=False)


def read_files(text: str) -> tuple[FileRead, ...]:
    """Return files from JSON; raise ValueError or TypeError if it is damaged."""
    return tuple(FileRead(str(entry["name"]), int(entry["size"]), str(entry["sha256"])) for entry in json_data(text))
